"""Changes to the C code that CasADi generates for its `erk` and `rosenbrock` integrators.

The generated driver assigns both tolerances once and asks for every evaluation in one switch. Each
of these places must occur exactly once, otherwise this CasADi generates other code.
"""

import re
from collections.abc import Mapping

import casadi as ca

from cosim.errors import UsageError

COUNTERS = 4  # right-hand sides, Jacobians, step trials, status


def run_time_tolerances(code: str, relative: str, absolute: str) -> str:
    """Make the tolerances C expressions that are evaluated at every call.

    Args:
        code: What CasADi generated, with one integrator in it.
        relative, absolute: C expressions over the function's `arg`.

    Raises:
        UsageError: This version of CasADi generates the driver in another form.
    """
    return _replace(
        code,
        {
            r"p\.reltol = [^;]+;": f"p.reltol = {relative};",
            r"p\.abstol = [^;]+;": f"p.abstol = {absolute};",
        },
    )


def differential_errors(code: str) -> str:
    """Let the errors of the differential states alone decide on steps and on the start.

    Algebraic unknowns are functions of the states and as accurate; their rounding errors, large
    forces beside small ones, can exceed what a tight tolerance allows.

    Raises:
        UsageError: See `run_time_tolerances`.
    """
    return _replace(code, {r"p\.nz_err = \d+;": "p.nz_err = 0;"})


def counted(code: str) -> str:
    """Count evaluations and trials per thread; `cosim_counters(long long out[4])` reads them.

    Raises:
        UsageError: See `run_time_tolerances`.
    """
    counted_code = _replace(
        code,
        {
            r"  /\* Problem structure \*/\n": "  for (j = 0; j < 4; ++j) cosim_count[j] = 0;\n",
            r"case IVP_EVAL_RHS:\n": "case IVP_EVAL_RHS:\n          ++cosim_count[0];\n",
            r"case IVP_STEP_CONTROL:\n": "case IVP_STEP_CONTROL:\n          ++cosim_count[2];\n",
            r"if \(d\.status != IVP_SUCCESS\) return 1;": (
                "cosim_count[3] = (long long) d.status;\n"
                "      if (d.status != IVP_SUCCESS) return 1;"
            ),
        },
    )
    if "case IVP_EVAL_JAC:\n" in counted_code:
        counting = "case IVP_EVAL_JAC:\n          ++cosim_count[1];\n"
        counted_code = _replace(counted_code, {r"case IVP_EVAL_JAC:\n": counting})
    return (
        f"static _Thread_local long long cosim_count[{COUNTERS}];\n{counted_code}\n"
        "void cosim_counters(long long *out) {\n"
        f"  for (int i = 0; i < {COUNTERS}; ++i) out[i] = cosim_count[i];\n}}\n"
    )


def _replace(code: str, replacements: Mapping[str, str]) -> str:
    for pattern, text in replacements.items():
        code, found = re.subn(pattern, text.replace("\\", "\\\\"), code)
        if found != 1:
            raise UsageError(
                f"casadi {ca.CasadiMeta.version()} generates integrators in another form "
                f"('{pattern}' found {found} times); run without compiling, or use casadi 3.8"
            )
    return code
