"""The generated C files of an FMU: constants and variables for the runtime, and the equations."""

import re
from collections.abc import Sequence

from casadi_models.dae import Dae
from cosim.fmi.export.equations import equations_code
from cosim.fmi.export.folding import folded
from cosim.fmi.export.solver_choice import uses_dop853
from cosim.fmi.export.variables import FmuVariable

LEAST_STEPS = 50  # of the solver in a model's span: it steps over no short event


def model_header(
    dae: Dae, identifier: str, guid: str, tolerance: float, fmi: int, solver: str
) -> str:
    """Return `model.h`: the sizes and names that the runtime is compiled with."""
    span = dae.experiment.stop_time
    return f"""/* Generated from {dae.full_name}. */
#ifndef MODEL_H
#define MODEL_H
#define MODEL_IDENTIFIER {_string(identifier)}
#define MODEL_NAME {_string(dae.full_name)}
#define MODEL_GUID {_string(guid)}
#define NX {len(dae.states)}
#define NZ {len(dae.algebraics)}
#define NU {len(dae.inputs)}
#define NP {len(dae.parameters)}
#define NY {len(dae.output_variables)}
#define DEFAULT_TOLERANCE {tolerance!r}
#define HAS_ADJOINT {int(fmi == 3)}
#define SOLVER_DOP853 {int(uses_dop853(dae, solver))}
#define LARGEST_STEP {span / LEAST_STEPS!r}
#endif
"""


def variable_table(variables: Sequence[FmuVariable]) -> str:
    """Return `model.c`: every variable, in the order of the value references."""
    rows = "".join(f"    {{{', '.join(_row(variable))}}},\n" for variable in variables)
    return f"""/* Generated. */
#include "variables.h"
#include <float.h>

const VariableInfo variables[] = {{
{rows}}};
"""


# Compilers of other people do not get our options; system headers must stay outside.
_HEAD = """#include <math.h>
#include "visibility.h"
INSIDE_BEGIN
#define CASADI_SYMBOL_EXPORT
#if defined __GNUC__
#define SMALL __attribute__((cold)) /* compiled for size */
#else
#define SMALL
#endif
"""

# Start values and derivatives: most of the code, and no solver waits for it in every step.
_SMALL = re.compile(r"^(/\* (?:along|back|blocks|start)\w*:.*\n)(?=static int )", re.MULTILINE)


def equations(dae: Dae, fmi: int, solver: str) -> str:
    """Return `equations.c`: CasADi's code, its functions visible inside the library only."""
    code = re.sub(r"^ \* +$", " *", equations_code(dae, fmi, solver), flags=re.MULTILINE)
    return _HEAD + _SMALL.sub(r"\1SMALL ", folded(code))


def _row(variable: FmuVariable) -> tuple[str, ...]:
    return (
        _string(variable.name),
        variable.role.name,
        variable.start_kind.name,
        _number(variable.start or 0.0),
        _number(variable.nominal),
        _number(variable.minimum),
        _number(variable.maximum),
    )


def _number(value: float) -> str:
    """Return a C literal of the same bits."""
    if value in (float("inf"), float("-inf")):
        return "DBL_MAX" if value > 0 else "-DBL_MAX"
    return repr(float(value))


def _string(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
