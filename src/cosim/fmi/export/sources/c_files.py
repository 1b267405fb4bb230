"""The generated C files of an FMU: constants and variables for the runtime, and the equations."""

import re
from collections.abc import Sequence

import casadi as ca

from casadi_models.dae import Dae
from cosim.codegen.pieces import in_pieces
from cosim.errors import UsageError
from cosim.fmi.export.description.model_description import Identity
from cosim.fmi.export.solver_choice import uses_dop853
from cosim.fmi.export.sources.equations import equations_code
from cosim.fmi.export.sources.folding import folded
from cosim.fmi.export.sources.rank import has_rank
from cosim.fmi.export.sources.work import most_trials
from cosim.fmi.export.variables import FmuVariable, Role
from cosim.model.rank import LOST

LEAST_STEPS = 50  # of the solver in a model's span: it steps over no short event


def model_header(dae: Dae, identity: Identity, fmi: int, solver: str, *, valid: bool) -> str:
    """Return `model.h`: the sizes and names that the runtime is compiled with."""
    span = dae.experiment.stop_time
    return f"""/* Generated from {dae.full_name}. */
#ifndef MODEL_H
#define MODEL_H
#define MODEL_IDENTIFIER {_string(identity.identifier)}
#define MODEL_PREFIX {identity.identifier}_
#define MODEL_NAME {_string(dae.full_name)}
#define MODEL_GUID {_string(identity.guid)}
#define NX {len(dae.states)}
#define NZ {len(dae.algebraics)}
#define NU {len(dae.inputs)}
#define NP {len(dae.parameters)}
#define NY {len(dae.output_variables)}
#define N_LIMITS {len(dae.limits)}
#define HAS_VALID {int(valid)}
#define DEFAULT_TOLERANCE {identity.tolerance!r}
#define HAS_RANK {int(has_rank(dae))}
#define LEAST_RANK {1 / LOST!r}
#define HAS_ADJOINT {int(fmi == 3)}
#define SOLVER_DOP853 {int(uses_dop853(dae, solver))}
#define LARGEST_STEP {span / LEAST_STEPS!r}
#define MOST_TRIALS {most_trials(dae)}
#endif
"""


def variable_table(dae: Dae, variables: Sequence[FmuVariable]) -> str:
    """Return `model.c`: every variable, in the order of the value references, and the limits."""
    limits = "".join(f"    {_string(meaning)},\n" for _, meaning in dae.limits)
    numbers = [variable for variable in variables if variable.role is not Role.VALIDITY]
    rows = "".join(f"    {{{', '.join(_fields(variable))}}},\n" for variable in numbers)
    return f"""/* Generated. */
#include "variables.h"
#include <float.h>
#include <stddef.h>

const VariableInfo variables[] = {{
{rows}}};

const char *const limits[] = {{
{limits}    NULL,
}};
"""


# Compilers of other people do not get our options; system headers must stay outside.
_INCLUDES = """#include "visibility.h"
INSIDE_BEGIN
#define CASADI_SYMBOL_EXPORT
#if defined __GNUC__
#define SMALL __attribute__((cold)) /* compiled for size */
#else
#define SMALL
#endif
"""

_LONGEST = 250_000  # characters of a function that stays whole, written in fewer lines

# Start values and derivatives: most of the code, and no solver waits for it in every step.
_SMALL_FUNCTION = re.compile(
    r"^(/\* (?:along|back|blocks|start)\w*:.*\n)(?=static int )", re.MULTILINE
)


# Some function must be headed so: a model may have no derivative that is worth its own.
_HEADING = re.compile(r"^/\* \w+:.*\n(?:SMALL )?(?:static )?int ", re.MULTILINE)

_SYSTEM_HEADER = re.compile(r"^#include <[^>]*>\n", re.MULTILINE)
_MODEL_NAME = re.compile(r"\bmodel_")  # what CasADi makes around a function has its name, too


def equations_c(dae: Dae, identifier: str, fmi: int, solver: str) -> str:
    """Return `equations.c`: CasADi's code, its functions visible inside the library only.

    Raises:
        UsageError: This version of CasADi generates code of another form.
    """
    code = re.sub(
        r"^ \* +$", " *", equations_code(dae, identifier, fmi, solver), flags=re.MULTILINE
    )
    code = _SMALL_FUNCTION.sub(r"\1SMALL ", in_pieces(folded(code), _LONGEST))
    if not _HEADING.search(code):
        raise UsageError(
            f"casadi {ca.CasadiMeta.version()} names generated functions in another way; "
            "use casadi 3.8"
        )
    # CasADi includes them itself, but where everything is hidden
    headers = sorted({"#include <math.h>\n", *_SYSTEM_HEADER.findall(code)})
    return "".join(headers) + _INCLUDES + _MODEL_NAME.sub(f"{identifier}_model_", code)


def _fields(variable: FmuVariable) -> tuple[str, ...]:
    guess = variable.start if variable.guess is None else variable.guess
    start = guess if variable.start is None else variable.start
    return (
        _string(variable.name),
        variable.role.name,
        variable.start_kind.name,
        _c_literal(start or 0.0),
        _c_literal(variable.nominal),
        _c_literal(variable.minimum),
        _c_literal(variable.maximum),
        _c_literal(guess or 0.0),
        str(variable.tunable).lower(),
    )


def _c_literal(value: float) -> str:
    """Return a C literal of the same bits."""
    if value in (float("inf"), float("-inf")):
        return "DBL_MAX" if value > 0 else "-DBL_MAX"
    return repr(float(value))


def _string(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
