"""Changes to the C code that CasADi generates for its `erk` and `rosenbrock` integrators.

Each place that is changed must occur exactly once, otherwise this CasADi generates other code.
"""

import re
from collections.abc import Mapping

import casadi as ca

from cosim.codegen.c_sources import solver_source
from cosim.errors import UsageError

REPORT = 6  # numbers in a report


def run_time_tolerances(code: str, relative: str, absolute: str) -> str:
    """Make the tolerances C expressions that are evaluated at every call.

    Args:
        code: What CasADi generated, with one integrator in it.
        relative, absolute: C expressions over the function's `arg`.

    Raises:
        UsageError: This version of CasADi generates the driver in another form.
    """
    return _replace_each(
        code,
        {
            r"p\.reltol = [^;]+;": f"p.reltol = {relative};",
            r"p\.abstol = [^;]+;": f"p.abstol = {absolute};",
        },
    )


def smallest_step(code: str) -> str:
    """Let a step be as small as time resolves it, not a part of the whole span.

    Raises:
        UsageError: See `run_time_tolerances`.
    """
    return _replace_each(
        code,
        {
            r"p\.h_min = [^;]+;": "p.h_min = 1e-60;",
            r"if \(d->h_next < p->h_min\)": (
                "if (d->h_next < p->h_min || d->h_next < 2.3e-16 * fabs(d->t))"
            ),
        },
    )


def differential_errors(code: str) -> str:
    """Let the errors of the differential states alone decide on steps and on the start.

    Algebraic unknowns are functions of the states and as accurate; their rounding errors, large
    forces beside small ones, can exceed what a tight tolerance allows.

    Raises:
        UsageError: See `run_time_tolerances`.
    """
    return _replace_each(code, {r"p\.nz_err = \d+;": "p.nz_err = 0;"})


def watched(code: str) -> str:
    """Add what an integration can be watched and ended by from outside.

    `void cosim_report(double out[6])` tells what the thread's last run took and where it ended:
    steps, right-hand sides, Jacobians, the driver's status (0: success), time, step size.
    `void cosim_watch(void)` makes signals end runs at their next right-hand side, `int
    cosim_halted(void)` tells which one did; see fmu/solvers/interrupt.h.

    Raises:
        UsageError: See `run_time_tolerances`.
    """
    read = "d.n_steps, d.n_rhs, d.n_jac, d.status, d.t, d.h"
    kept = f"const double seen[{REPORT}] = {{{read}}};"
    copy = f"for (int i = 0; i < {REPORT}; ++i)"
    code = _replace_each(
        code,
        {
            r"if \(d\.status != IVP_SUCCESS\) return 1;": (
                f"{{ {kept} {copy} cosim_seen[i] = seen[i]; }}\n"
                "      if (d.status != IVP_SUCCESS) return 1;"
            ),
            r"case IVP_EVAL_RHS:\n": ("case IVP_EVAL_RHS:\n          if (halted) return 1;\n"),
        },
    )
    return (
        f"static _Thread_local double cosim_seen[{REPORT}];\n"
        f"{solver_source('interrupt.h')}\n{code}\n"
        "CASADI_SYMBOL_EXPORT void cosim_report(double *out) {\n"
        f"  {copy} out[i] = cosim_seen[i];\n}}\n"
    )


def run_time_grid(code: str, constants: int) -> str:
    """Let the output times come with the parameters, see fmu/solvers/casadi_driver.h.

    Args:
        code: What CasADi generated with an integrator over 0, 1 whose inputs may change there.
        constants: Number of its parameters; `arg[2]` goes on with the number of output times, of
            those that are passed without a stop, and with the times themselves.

    Raises:
        UsageError: See `run_time_tolerances`.
    """
    first, last = "(j*passed)", "((j+1)*passed)"
    code = _replace_each(
        code,
        {
            r"  /\* Initial state, parameters \*/\n": (
                "  /* Initial state, parameters */\n"
                f"  const casadi_real *settings = arg[2] + {constants}, *times = settings + 2;\n"
                "  const casadi_int points = (casadi_int) settings[0];\n"
                "  const casadi_int passed = (casadi_int) settings[1];\n"
            ),
            r"for \(j = 0; j < \d+; \+\+j\) \{": "for (j = 0; j*passed < points; ++j) {",
            r"j \? casadi_c\d+\[casadi_s\d+\[j\]-1\]": f"j ? times[{first}-1]",
            r"for \(k = casadi_s\d+\[j\]; k < casadi_s\d+\[j\+1\]; \+\+k\)": (
                f"for (k = {first}; k < {last}; ++k)"
            ),
            r"casadi_c\d+\[k\], casadi_c\d+\[casadi_s\d+\[j\+1\]-1\]": (
                f"times[k], times[{last}-1]"
            ),
        },
    )
    return f"{code}\n{solver_source('casadi_driver.h')}"


def in_one_piece(code: str) -> str:
    """Have driver and equations compiled as one function: a fifth less time per run of `erk`.

    Raises:
        UsageError: See `run_time_tolerances`.
    """
    entry = "static int casadi_f0("
    return _replace_each(code, {re.escape(entry): f"__attribute__((flatten)) {entry}"})


def _replace_each(code: str, replacements: Mapping[str, str]) -> str:
    for pattern, text in replacements.items():
        code, found = re.subn(pattern, text.replace("\\", "\\\\"), code)
        if found != 1:
            raise UsageError(
                f"casadi {ca.CasadiMeta.version()} generates integrators in another form "
                f"('{pattern}' found {found} times); run without compiling, or use casadi 3.8"
            )
    return code
