"""Explicit methods in C around generated equations: the engine of all, and `dop853`."""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np
from casadi import MX
from numpy.typing import NDArray

from cosim.arrays import Vector
from cosim.codegen.functions import equations, inputs_at, prepared, symbols_of
from cosim.codegen.initialization import algebraic_function
from cosim.codegen.runge_kutta.explicit_library import (
    MethodText,
    dop853_method,
    explicit_function,
    explicit_library,
    work_space,
)
from cosim.codegen.runge_kutta.projection import projection_step
from cosim.integrate.engine import Engine, EngineFunctions, Problem, reported
from cosim.integrate.run.call import call_on_arrays
from cosim.integrate.solver import AdaptiveSolver


@dataclass(frozen=True, kw_only=True)
class Dop853(AdaptiveSolver):
    """Hairer's pair of order 8(5,3) with an interpolant of order 7."""

    name = "dop853"
    order = 8
    solves_dae = True
    compiled_only = True
    projects = True
    counts_in_nominal = True

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
    projection = _projection(problem, c.numel()) if problem.project else None
    rhs = ca.Function("rhs", symbols, [ode, solved])
    path = explicit_library(rhs, name, method, projection)
    grid, breaks = problem.grid, np.empty(0)
    kept: NDArray[np.intp] | None = None
    if inputs is not None and settings[0]:  # where error control would stumble over kinks
        grid, breaks, kept = _with_samples(grid, inputs.time)
    columns = len(grid) if problem.piecewise else 1
    library = ctypes.CDLL(path)
    nominal = problem.nominal or (1.0,) * len(dae.states)
    numbers = (len(grid), len(breaks), columns, *settings, *nominal)
    known = np.concatenate((numbers, grid, breaks))

    def make() -> EngineFunctions:
        run, _ = explicit_function(path, len(grid), len(breaks), columns)
        p = MX.sym("p", dae.p.numel())
        extended = ca.vertcat(constants(p), ca.DM(known))
        return EngineFunctions(run, ca.Function("parameters", [p], [extended]))

    counts, direct = reported(library, 0.0, 1.0), DirectCall(library, constants, known)
    every = problem.piecewise
    return Engine(make, len(grid), every, counts, True, library, kept, direct=direct)


def _projection(problem: Problem, constants: int) -> ca.Function:
    """Return the projection of a run, its inputs those of its series."""
    step = projection_step(problem.dae, constants)
    if problem.inputs is None:
        return step
    t, x, u, c = symbols = [MX.sym(step.name_in(i), step.numel_in(i)) for i in range(4)]
    moved, change = step(t, x, inputs_at(problem.dae, problem.inputs, t, u), c)
    return ca.Function("project", symbols, [moved, change])


class DirectCall:
    """A compiled run on arrays, with work space of its own; not for two threads at once.

    Args:
        library: Of `explicit_library`.
        constants: `p -> c` of its right-hand side.
        known: What stands behind c in the parameters of its function `run`.
    """

    def __init__(self, library: ctypes.CDLL, constants: ca.Function, known: Vector) -> None:
        self._run, self._constants = library.run, constants
        self._passed: Callable[[], int] = library.cosim_passed
        library.cosim_passed.restype = ctypes.c_longlong
        self._work = work_space(library)
        self._p: bytes | None = None
        self._c = np.empty(constants.numel_out(0))
        self._extended = np.concatenate((self._c, known))

    def __call__(
        self, x0: Vector, z0: Vector, p: Vector, u: Vector, states: Vector, algebraics: Vector
    ) -> tuple[bool, int]:
        """Fill states and algebraic unknowns, (n, nx) and (n, nz).

        Returns:
            Whether it succeeded, and how many of the times it reached.
        """
        if p.tobytes() != self._p:  # CasADi is asked for what follows from them once
            call_on_arrays(self._constants, [p], [self._c])
            self._extended[: len(self._c)] = self._c
            self._p = p.tobytes()
        arguments, results, integers, doubles = self._work
        held = [*map(np.ascontiguousarray, (x0, z0, self._extended, u))]
        for place, array in enumerate(held):
            arguments[place] = array.ctypes.data if array.size else None
        for place, array in enumerate((states, algebraics)):
            results[place] = array.ctypes.data if array.size else None
        failed = self._run(arguments, results, integers, doubles, 0)
        return not failed, self._passed() if failed else len(states)


def _with_samples(grid: Vector, samples: Vector) -> tuple[Vector, Vector, NDArray[np.intp]]:
    """Return a grid with the samples within it, the positions of these, and those of its own."""
    within = samples[(samples > grid[0]) & (samples < grid[-1])]
    every = np.union1d(grid, within)
    return every, np.searchsorted(every, within).astype(float), np.searchsorted(every, grid)
