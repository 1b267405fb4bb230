"""scipy's solvers around a right-hand side of numba."""

from collections.abc import Iterator

import with_numba
from entries import Run, Solver
from problem import Problem
from scipy.integrate import odeint, solve_ivp

PACKAGES = ("scipy", "numba")
MOST_STEPS = 100_000  # between two output times; the default of 500 is too few


def solvers(problem: Problem) -> Iterator[Solver]:
    rhs, jacobian = with_numba.rhs_of_new(problem), with_numba.jacobian(problem)
    x0, grid = problem.start["x0"], problem.grid

    def prepared(method: str, **options: object) -> Solver:
        def prepare(tolerance: float) -> Run:
            accuracy = {"rtol": tolerance, "atol": 1e-2 * tolerance}
            span = (grid[0], grid[-1])
            return lambda: solve_ivp(rhs, span, x0, method, grid, **accuracy, **options).y.T

        return Solver(f"scipy {method}", prepare)

    yield prepared("DOP853")
    yield prepared("LSODA")
    yield prepared("Radau", jac=jacobian)

    def prepare(tolerance: float) -> Run:
        accuracy = {"rtol": tolerance, "atol": 1e-2 * tolerance, "mxstep": MOST_STEPS}
        return lambda: odeint(rhs, x0, grid, Dfun=jacobian, tfirst=True, **accuracy)

    yield Solver("scipy odeint (LSODA)", prepare, tightest=1e-12)
