"""Engines of named solvers, for tests of what is below `run`."""

from cosim.integrate.engine import Problem
from cosim.integrate.solvers import chosen_solver, engine_of, requested_solver


def build(dae, grid, solver=None, tolerance=None, *, step_size=None, **settings):
    """Return the engine of a solver, with what it needs by name."""
    both = (None, None) if tolerance is None else (tolerance.relative, tolerance.absolute)
    chosen, _ = chosen_solver(dae, requested_solver(dae, solver, *both, step_size))
    return engine_of(Problem(dae, grid.tobytes(), **settings), chosen)
