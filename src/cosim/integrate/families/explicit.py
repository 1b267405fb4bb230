"""Explicit methods in C around generated equations: the engine of all, and `dop853`."""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from casadi import MX
from numpy.typing import NDArray

from cosim.arrays import Vector
from cosim.codegen.functions import equations, inputs_at, prepared, symbols_of
from cosim.codegen.initialization import algebraic_function
from cosim.codegen.projection import projection_step
from cosim.codegen.runge_kutta.explicit_library import (
    MethodText,
    dop853_method,
    explicit_function,
    explicit_library,
)
from cosim.integrate.engine import Engine, Problem, reported
from cosim.integrate.solver import AdaptiveSolver


@dataclass(frozen=True, kw_only=True)
class Dop853(AdaptiveSolver):
    """Hairer's pair of order 8(5,3) with an interpolant of order 7."""

    name = "dop853"
    order = 8
    solves_dae = True
    compiled_only = True
    projects = True

    def engine(self, problem: Problem) -> Engine:
        """Build the engine for a problem."""
        return explicit_engine(problem, self.name, dop853_method(), (*self.tolerance.pair, np.inf))


def explicit_engine(
    problem: Problem, name: str, method: MethodText, settings: tuple[float, float, float]
) -> Engine:
    """Return the engine of an explicit method in C.

    Algebraic unknowns are solved for within the right-hand side.

    Args:
        problem: What it is for.
        name: Of the method.
        method: Its C text; see `explicit_library`.
        settings: Relative and absolute tolerance, and the largest step, s.
    """
    dae, inputs = problem.dae, problem.inputs
    if dae.algebraics:
        function = equations(dae, sensitivities=False)
        constants = ca.Function("constants", [dae.p], [dae.p])
        t, x, z, u, c = symbols = symbols_of(function)
        solved = algebraic_function(dae)(t, x, z, inputs_at(dae, inputs, t, u), c)
    else:
        function, constants = prepared(dae)
        t, x, z, u, c = symbols = symbols_of(function)
        solved = z
    ode, _ = function(t, x, solved, inputs_at(dae, inputs, t, u), c)
    projection = projection_step(dae, c.numel()) if problem.project else None
    rhs = ca.Function("rhs", symbols, [ode, solved])
    path = explicit_library(rhs, name, method, projection)
    grid, breaks = problem.grid, ca.DM(0, 1)
    kept: NDArray[np.intp] | None = None
    if inputs is not None and settings[0]:  # where error control would stumble over kinks
        grid, breaks, kept = _with_samples(grid, inputs.time)
    columns = len(grid) if problem.piecewise else 1
    run, library = explicit_function(path, len(grid), breaks.numel(), columns)
    p = MX.sym("p", dae.p.numel())
    numbers = (len(grid), breaks.numel(), columns, *settings)
    extended = ca.vertcat(constants(p), *numbers, ca.DM(grid), breaks)
    parameters = ca.Function("parameters", [p], [extended])
    counts = reported(library, 0.0, 1.0)
    return Engine(run, parameters, problem.piecewise, counts, True, library, kept)


def _with_samples(grid: Vector, samples: Vector) -> tuple[Vector, ca.DM, NDArray[np.intp]]:
    """Return a grid with the samples within it, the positions of these, and those of its own."""
    within = samples[(samples > grid[0]) & (samples < grid[-1])]
    every = np.union1d(grid, within)
    return every, ca.DM(np.searchsorted(every, within).astype(float)), np.searchsorted(every, grid)
