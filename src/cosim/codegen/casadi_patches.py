"""Patches of the C code that CasADi generates for its `erk` and `rosenbrock` integrators.

Each patched text must occur exactly once; otherwise this CasADi version generates other code, and
every function here raises UsageError. casadi_patches.toml has the texts, and what they are for.
"""

import re
import tomllib
from pathlib import Path
from string import Template

import casadi as ca

from cosim.codegen.c_sources import solver_source
from cosim.errors import UsageError

REPORT = 9  # numbers that `cosim_report` writes; the last three in fmu/solvers/external.h only
_PATCHES = tomllib.loads(
    Path(__file__).with_name("casadi_patches.toml").read_text(encoding="utf-8")
)


def watched(code: str) -> str:
    """Add functions that report on an integration and that let signals stop it.

    `void cosim_report(double out[9])` writes statistics of the thread's last run: steps,
    right-hand sides, Jacobians, the driver's status (0: success), final time, last step size.
    After `void cosim_watch(int of_command)`, signals stop runs at their next right-hand side, and
    `int cosim_halted(void)` returns the signal; see fmu/solvers/interrupt.h.
    """
    return f"""static _Thread_local double cosim_seen[{REPORT}];
{solver_source("interrupt.h")}
{patched(code, "watched", report=REPORT)}
CASADI_SYMBOL_EXPORT void cosim_report(double *out) {{
  for (int i = 0; i < {REPORT}; ++i) out[i] = cosim_seen[i];
}}
"""


def run_time_grid(code: str, constants: int) -> str:
    """Read the output times from the parameters at run time, see fmu/solvers/casadi_driver.h.

    Args:
        code: C code that CasADi generated for an integrator over the grid 0, 1, whose inputs may
            change at these times.
        constants: Number of the integrator's parameters; `arg[2]` continues with the number of
            output times, the number of times passed without a stop, and the times themselves.
    """
    return (
        f"{patched(code, 'run_time_grid', constants=constants)}\n{solver_source('casadi_driver.h')}"
    )


def patched(code: str, patch: str, **values: str | int) -> str:
    """Return code with a patch, whose $names stand for the values: C expressions over `arg`.

    Raises:
        UsageError: A text of the patch does not occur exactly once.
    """
    for pattern, text in _PATCHES[patch].items():
        replacement = Template(text).substitute(values)
        code, found = re.subn(pattern, replacement.replace("\\", "\\\\"), code)
        if found != 1:
            raise UsageError(
                f"casadi {ca.CasadiMeta.version()} generates integrators in another form "
                f"('{pattern}' found {found} times); run without compiling, or use casadi 3.8"
            )
    return code
