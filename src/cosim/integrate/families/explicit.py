"""Explicit Runge-Kutta methods in C around generated equations, and the solver `dop853`."""

import ctypes
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np
from casadi import MX
from numpy.typing import NDArray

from casadi_models.dae import Dae
from casadi_models.dae.hybrid import Hybrid
from cosim.arrays import Vector
from cosim.codegen.casadi_patches import REPORT
from cosim.codegen.functions import hoisted_laws, inputs_at, prepared, symbols_of
from cosim.codegen.initialization import prepared_algebraic, projection_step
from cosim.codegen.kernel_library import law_text
from cosim.codegen.runge_kutta.explicit_library import (
    MethodText,
    WatchText,
    dop853_method,
    explicit_function,
    explicit_library,
    work_space,
)
from cosim.integrate.call import call_on_arrays
from cosim.integrate.engine import (
    EVENT,
    Engine,
    EngineFunctions,
    Filled,
    Left,
    Problem,
    reported,
    room_for_events,
)
from cosim.memo import cached_per_thread
from cosim.model.inputs import InputSeries
from cosim.model.solver import AdaptiveSolver


@dataclass(frozen=True, kw_only=True)
class Dop853(AdaptiveSolver):
    """Dormand and Prince's method of order 8(5,3) by Hairer, with an interpolant of order 7."""

    name = "dop853"
    order = 8
    solves_dae = True
    compiled_only = True
    projects = True
    takes_nominal_values = True
    watches = True
    takes_times = True
    leaves_stiff: ClassVar[bool] = False

    def engine(self, problem: Problem) -> Engine:
        """Build the engine for a problem."""
        settings = (*self.tolerance.pair, self.max_step or np.inf)
        found = explicit_engine(problem, self.name, dop853_method(), settings)
        if isinstance(found.direct, DirectCall):
            found.direct.leaves_stiff = self.leaves_stiff
        return found


class NonStiffDop853(Dop853):
    """The same, but it fails at once where a run turns out to be stiff."""

    leaves_stiff = True


def explicit_engine(
    problem: Problem, name: str, method: MethodText, settings: tuple[float, float, float]
) -> Engine:
    """Return the engine of an explicit method in C.

    Every call of the right-hand side solves for the algebraic unknowns.

    Args:
        problem: The problem to solve.
        name: Name of the method.
        method: C text of the method; see `explicit_library`.
        settings: Relative and absolute tolerance (1), and the largest step, s.
    """
    dae, inputs = problem.dae, problem.inputs
    system = problem.system if problem.system and problem.system.relations else None
    path, constants = _compiled(dae, inputs, problem.project, name, method, system)
    grid, breaks = problem.grid, np.empty(0)
    selected: NDArray[np.intp] | None = None
    samples = np.frombuffer(problem.ends)
    if inputs is not None and any(settings[:2]):  # error control would reject steps over kinks
        samples = np.append(samples, inputs.time)
    if len(samples):
        grid, breaks, selected = _with_samples(grid, samples)
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

    counts, direct = reported(library, 0.0, 1.0), DirectCall(library, constants, known, system)
    every, watches = problem.piecewise, system is not None
    return Engine(make, len(grid), every, counts, library, selected, direct=direct, watches=watches)


@cached_per_thread(16)
def _compiled(
    dae: Dae,
    inputs: InputSeries | None,
    project: bool,
    name: str,
    method: MethodText,
    system: Hybrid | None,
) -> tuple[str, ca.Function]:
    """Return the library of a method for a model, and from its parameters to its constants."""
    function, constants = prepared(dae)
    t, x, z, u, c = symbols = symbols_of(function)
    now = inputs_at(dae, inputs, t, u)
    solved = prepared_algebraic(hoisted_laws(dae))(t, x, z, now, c) if dae.algebraics else z
    ode, _ = function(t, x, solved, now, c)
    projection = _projection(dae, inputs, c.numel()) if project else None
    rhs = ca.Function("rhs", symbols, [ode, solved])
    events = _events(system, inputs, c.numel()) if system else None
    return explicit_library(rhs, name, method, projection, events), constants


def block_library(own: Hybrid) -> tuple[ctypes.CDLL, ca.Function]:
    """Return the library of `dop853` that goes through all events of a model, for block.h.

    Args:
        own: The frozen equations.

    Returns:
        It, and from the model's parameters to the constants of its equations.
    """
    path, constants = _compiled(own.dae, None, False, Dop853.name, dop853_method(), own)
    return ctypes.CDLL(path), constants


def _events(system: Hybrid, inputs: InputSeries | None, constants: int) -> WatchText:
    """Return what looks at relations, and goes through events, with inputs from a series."""
    dae = system.dae
    sizes = (*(s.numel() for s in dae.arguments[:4]), constants, dae.x.numel())
    t, x, z, u, c, dx = symbols = [MX.sym("argument", size) for size in sizes]
    now = inputs_at(dae, inputs, t, u)
    slopes = MX.zeros(u.numel()) if inputs is None else ca.densify(ca.jtimes(now, t, 1))
    seen = system.along_motion("seen")(t, x, z, now, c[: dae.p.numel()], slopes, dx)
    moving = ca.Function("model_inputs", [t, u, c], [now, slopes]) if inputs is not None else None
    return WatchText(ca.Function("watch", symbols, [*seen]), law_text(system, moving))


def _projection(dae: Dae, inputs: InputSeries | None, constants: int) -> ca.Function:
    """Return the projection onto the constraints, with inputs from a series."""
    step = projection_step(dae, constants)
    if inputs is None:
        return step
    t, x, u, c = symbols = [MX.sym(step.name_in(i), step.numel_in(i)) for i in range(4)]
    projected, change = step(t, x, inputs_at(dae, inputs, t, u), c)
    return ca.Function("project", symbols, [projected, change])


_NO_EVENTS = None, ctypes.c_longlong(0), None, None, ctypes.c_double(0)


class DirectCall:
    """Call of a compiled integration on arrays; not thread-safe, as it has one work space.

    Args:
        library: A library of `explicit_library`.
        constants: From parameters p to the constants c of its right-hand side.
        known: Numbers that follow c in the parameters of its function `run`.
        system: The frozen equations whose relations it watches.
    """

    def __init__(
        self, library: ctypes.CDLL, constants: ca.Function, known: Vector, system: Hybrid | None
    ) -> None:
        self._run, self._constants, self._library = library.run, constants, library
        self._events = None
        if system is not None:
            room = room_for_events(system)
            # others need what only the caller knows
            self._events = room[:0] if system.sliding or system.dae.derived else room
        self._work = work_space(library)
        self._report = (ctypes.c_double * REPORT)()
        self.leaves_stiff = False
        self._p: bytes | None = None
        self._c = np.empty(constants.numel_out(0))
        self._extended = np.concatenate((self._c, known))

    def __call__(
        self,
        x0: Vector,
        z0: Vector,
        p: Vector,
        u: Vector,
        states: Vector,
        algebraics: Vector,
        left: Left | None,
    ) -> Filled:
        """Fill states and algebraic unknowns, (n, nx) and (n, nz); `left` changes at events."""
        if p.tobytes() != self._p:  # evaluate the constants once
            call_on_arrays(self._constants.buffer(), [p], [self._c])
            self._extended[: len(self._c)] = self._c
            self._p = p.tobytes()
        arguments, results, integers, doubles = self._work
        arrays = [*map(np.ascontiguousarray, (x0, z0, self._extended, u))]  # referenced here
        for i, array in enumerate(arrays):
            arguments[i] = array.ctypes.data if array.size else None
        for i, array in enumerate((states, algebraics)):
            results[i] = array.ctypes.data if array.size else None
        library, events = self._library, self._events if left else None
        if events is not None and left is not None:
            count = ctypes.c_longlong(len(events))
            places = (ctypes.c_void_p(a.ctypes.data) for a in (events, left.switching, left.sizes))
            end = ctypes.c_double(left.end)
            library.cosim_prepare(next(places), count, *places, end, self.leaves_stiff)
        else:
            library.cosim_prepare(*_NO_EVENTS, self.leaves_stiff)
        failed = self._run(arguments, results, integers, doubles, 0)
        library.cosim_prepare(*_NO_EVENTS, False)
        library.cosim_report(self._report)
        *_, status, time, _, passed, relation, recorded = self._report
        found = None if events is None else events[: int(recorded)].copy()
        if not failed:
            return Filled(True, len(states), None, found)
        crossing = (time, int(relation)) if status == EVENT else None
        return Filled(crossing is not None, int(passed), crossing, found)


def _with_samples(grid: Vector, samples: Vector) -> tuple[Vector, Vector, NDArray[np.intp]]:
    """Return a grid with samples added, and the positions of the samples and of the old times."""
    within = samples[(samples > grid[0]) & (samples < grid[-1])]
    every = np.union1d(grid, within)
    return every, np.searchsorted(every, within).astype(float), np.searchsorted(every, grid)
