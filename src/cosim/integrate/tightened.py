"""Default solvers at tight tolerances, whose promise is about the result and not about each step.

CVODES and IDAS are BDF methods: they control the error of each step, and these add up. Over the
examples (docs/examples.md) a run at 1e-10 is wrong by 1e-10 to 1.8e-7; with a thirtieth of the
tolerance, all of them are right to 5.1e-9, in 1.6 times the steps (median). At 1e-12 IDAS gives up.
"""

from dataclasses import replace

from cosim.integrate.families.sundials import Cvodes, Idas
from cosim.integrate.solver import Solver

DEFAULT = 1e-8  # relative tolerance: as it is down to here
MOST = 30.0  # times tighter
LEAST = 3e-12  # what both solvers reach
_GROWTH = 0.75  # power of the tolerance: 30 times tighter at 1e-10


def tightened(solver: Solver) -> Solver:
    """Return a default solver with what it takes for a result as good as a tight tolerance asks.

    A tolerance of 1e-8 or more stays as it is, and so does one with an absolute tolerance beside.
    """
    if not isinstance(solver, Cvodes | Idas) or solver.absolute_tolerance is not None:
        return solver
    asked = solver.relative_tolerance
    if not 0 < asked < DEFAULT:
        return solver
    inner = max(asked / min(MOST, (DEFAULT / asked) ** _GROWTH), LEAST)
    return replace(solver, relative_tolerance=min(asked, inner))


def said(solver: Solver, inner: Solver) -> str:
    """Say with what a solver integrates where that is not what was asked for."""
    if inner == solver:
        return ""
    return f"{inner.name} at {inner.settings}, as errors of its steps add up"
