"""Generated C files of an FMU: constants, table of variables, equations."""

import re
from collections.abc import Sequence
from math import inf

import casadi as ca

from casadi_models.dae import Dae
from casadi_models.dae.hybrid import Hybrid
from casadi_models.dae.invariants import SINGULAR_CONDITION
from cosim.codegen.pieces import in_pieces
from cosim.errors import UsageError
from cosim.fmi.export.co_simulation import most_trials, uses_dop853
from cosim.fmi.export.equations import has_rank
from cosim.fmi.export.events import LEAST_STEPS, event_sizes, event_tables, literal
from cosim.fmi.export.model_description import Identity
from cosim.fmi.export.variables import FmuVariable, Role


def model_header(
    dae: Dae,
    identity: Identity,
    fmi: int,
    solver: str,
    *,
    valid: bool,
    max_step: float | None,
    system: Hybrid | None,
) -> str:
    """Return `model.h`: sizes and names for compiling the runtime."""
    step_size, derivatives = identity.step_size, identity.derivatives
    longest = min(max_step or inf, dae.experiment.stop_time / LEAST_STEPS)
    return f"""/* Generated from {dae.full_name}. */
#ifndef MODEL_H
#define MODEL_H
#define MODEL_IDENTIFIER {literal(identity.identifier)}
#define MODEL_PREFIX {identity.identifier}_
#define MODEL_NAME {literal(dae.full_name)}
#define MODEL_GUID {literal(identity.guid)}
#define NX {len(dae.states)}
#define NZ {len(dae.algebraics)}
#define NU {len(dae.inputs)}
#define NP {len(dae.parameters)}
#define NY {len(dae.output_variables)}
#define N_LIMITS {len(dae.limits)}
#define HAS_VALID {int(valid)}
#define DEFAULT_TOLERANCE {identity.tolerance!r}
#define HAS_RANK {int(has_rank(dae))}
#define LEAST_RANK {1 / SINGULAR_CONDITION!r}
#define HAS_ADJOINT {int(fmi == 3 and derivatives)}
#define NO_DERIVATIVES {int(not derivatives)}
#define SOLVER_DOP853 {int(uses_dop853(dae, solver))}
#define FIXED_STEPS {int(step_size is not None)}
#define LARGEST_STEP {longest if step_size is None else step_size!r}
#define MOST_TRIALS {most_trials(dae, solver)}
{event_sizes(system)}#endif
"""


def variable_table(dae: Dae, variables: Sequence[FmuVariable], system: Hybrid | None = None) -> str:
    """Return `model.c`: variables by value reference, validity conditions, relations and events."""
    limits = "".join(f"    {literal(meaning)},\n" for _, meaning in dae.limits)
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
{event_tables(system)}"""


# Start values and derivatives are most of the code, and no solver evaluates them in every step.
_SMALL_FUNCTION = re.compile(
    r"^(/\* (?:along|back|blocks|start)\w*:.*\n)(?=static int )", re.MULTILINE
)


# The heading of at least one function: not every model has functions of its derivatives.
_HEADING = re.compile(r"^/\* \w+:.*\n(?:SMALL )?(?:static )?int ", re.MULTILINE)

_SYSTEM_HEADER = re.compile(r"^#include <[^>]*>\n", re.MULTILINE)
_MODEL_NAME = re.compile(r"\bmodel_")  # also the prefix of CasADi's helper functions


def equations_c(generated: str, identifier: str) -> str:
    """Return `equations.c`: CasADi's code, its functions visible inside the library only.

    Raises:
        UsageError: This version of CasADi generates code in another form.
    """
    code = re.sub(r"^ \* +$", " *", generated, flags=re.MULTILINE)
    code = _SMALL_FUNCTION.sub(r"\1SMALL ", in_pieces(code))
    if not _HEADING.search(code):
        raise UsageError(
            f"casadi {ca.CasadiMeta.version()} names generated functions differently; "
            "use casadi 3.8"
        )
    # system headers come first, as everything after generated.h is hidden
    headers = sorted({"#include <math.h>\n", *_SYSTEM_HEADER.findall(code)})
    own = _MODEL_NAME.sub(f"{identifier}_model_", code)
    return "".join((*headers, '#include "generated.h"\n', own))


def _fields(variable: FmuVariable) -> tuple[str, ...]:
    guess = variable.start if variable.guess is None else variable.guess
    start = guess if variable.start is None else variable.start
    return (
        literal(variable.name),
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
    """Return a C literal with the same bits."""
    if value in (float("inf"), float("-inf")):
        return "DBL_MAX" if value > 0 else "-DBL_MAX"
    return repr(float(value))
