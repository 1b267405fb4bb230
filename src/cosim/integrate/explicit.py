"""Explicit methods in C around generated equations: the engine of all, and `dop853`."""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from casadi import MX

from cosim.codegen.explicit_library import (
    MethodText,
    dop853_method,
    explicit_function,
    explicit_library,
)
from cosim.codegen.functions import driven, equations, prepared, symbols_of
from cosim.codegen.initialization import algebraic_function
from cosim.codegen.projection import projection_step
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
        inputs = problem.inputs
        longest = np.inf if inputs is None else float(np.diff(inputs.time).min())
        return explicit_engine(problem, self.name, dop853_method(), (*self.tolerance.pair, longest))


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
        solved = algebraic_function(dae)(t, x, z, driven(dae, inputs, t, u), c)
    else:
        function, constants = prepared(dae)
        t, x, z, u, c = symbols = symbols_of(function)
        solved = z
    ode, _ = function(t, x, solved, driven(dae, inputs, t, u), c)
    projection = projection_step(dae, c.numel()) if problem.project else None
    rhs = ca.Function("rhs", symbols, [ode, solved])
    path = explicit_library(rhs, name, method, projection)
    grid = problem.grid
    run, library = explicit_function(path, len(grid))
    p = MX.sym("p", dae.p.numel())
    extended = ca.vertcat(constants(p), len(grid), *settings, ca.DM(grid))
    parameters = ca.Function("parameters", [p], [extended])
    return Engine(run, parameters, False, reported(library, 0.0, 1.0), True, library)
