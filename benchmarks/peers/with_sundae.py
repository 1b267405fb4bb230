"""CVODE of scikit-sundae around a right-hand side of numba."""

from collections.abc import Iterator

import with_numba
from entries import Run, Solver
from problem import Problem
from sksundae.cvode import CVODE

PACKAGES = ("scikit-sundae", "numba")
MOST_STEPS = 100_000  # between two output times; the default of 500 is too few


def solvers(problem: Problem) -> Iterator[Solver]:
    rhs, matrix = with_numba.rhs(problem), with_numba.jacobian(problem)
    x0, grid = problem.start["x0"], problem.grid

    @with_numba.compiled
    def jacobian(t, x, dx, result):
        result[:, :] = matrix(t, x)

    def prepared(method: str) -> Solver:
        def prepare(tolerance: float) -> Run:
            solver = CVODE(
                rhs,
                method=method,
                rtol=tolerance,
                atol=1e-2 * tolerance,
                jacfn=jacobian,
                max_num_steps=MOST_STEPS,
            )
            return lambda: solver.solve(grid, x0).y

        return Solver(f"scikit-sundae CVODE {method}", prepare)

    yield prepared("Adams")
    yield prepared("BDF")
