"""`Problem`: a model over a grid of output times; `Engine`: a solver for it, ready to be called."""

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf, isnan
from typing import Any, NamedTuple, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_models.dae import Dae
from casadi_models.dae.hybrid import Hybrid
from cosim.arrays import Vector
from cosim.codegen.casadi_patches import REPORT
from cosim.model.inputs import InputSeries
from cosim.text import Ending, EndKind

MOST_STEPS = 100_000  # from one output time to the next
_ROOM_FOR_EVENTS = 100_000  # bytes, of the events that one call of a solver goes through


class Counts(NamedTuple):
    """Numbers of steps and calls; `cause` is why the solver failed, if it reports that."""

    steps: int | None = None
    rhs_calls: int | None = None
    jacobian_calls: int | None = None
    cause: Ending = Ending()

    @classmethod
    def total(cls, every: "Sequence[Counts]") -> "Counts":
        """Return the sums over parts of a run; None where one is not known."""
        rows = np.array([counts[:3] for counts in every], dtype=float)  # None is NaN there
        sums = rows.reshape(-1, 3).sum(axis=0).tolist()
        steps, rhs_calls, jacobian_calls = (None if isnan(n) else int(n) for n in sums)
        return cls(steps, rhs_calls, jacobian_calls)


@dataclass(frozen=True)
class Problem:
    """A model over a grid of output times; equal problems have equal engines.

    Attributes:
        dae: The model.
        times: Output times, s, at least two and increasing, as the bytes of an array of doubles.
        inputs: Time series of some inputs.
        compiled: Whether the equations are compiled.
        sensitivities: Whether the engine's function must have derivatives.
        piecewise: Whether inputs have a column per output time, constant in the interval before it.
        project: Whether every step ends with a projection onto the constraints.
        nominal: Nominal value of each state, for solvers with `takes_nominal_values`; 1 SI unit if
            empty.
        shares: Of the absolute tolerance that each state has; empty for 1, as in that of an engine.
        in_own_time: Whether the times are shares of a span, whose begin and length, s, follow the
            model's parameters.
        system: The frozen equations, of which `dae` is a part, if the engine is to end a run where
            a relation leaves its mode; engines that cannot do so ignore it.
        most_instants: Instants with events after which a run ends.
        most_steps: Steps from one output time to the next after which an engine that does not end
            at events fails.
        ends: Times between them at which a step ends and a fresh one begins, s, in the same form;
            only for engines of compiled equations with `takes_times`.
    """

    dae: Dae
    times: bytes
    inputs: InputSeries | None = None
    compiled: bool = False
    sensitivities: bool = True
    piecewise: bool = False
    project: bool = False
    nominal: tuple[float, ...] = ()
    shares: tuple[float, ...] = ()
    in_own_time: bool = False
    system: Hybrid | None = None
    most_instants: float = inf
    most_steps: int = MOST_STEPS
    ends: bytes = b""

    @property
    def grid(self) -> Vector:
        """Output times, s, (n,)."""
        return np.frombuffer(self.times)

    def longest(self, step: float | None) -> float | None:
        """Return a longest step of which none spans a sample of the inputs, s; None for any.

        Args:
            step: The longest one otherwise, s, which has been limited so in the problem's own time.
        """
        if self.inputs is None or self.in_own_time:
            return step
        closest = float(np.diff(self.inputs.time).min())
        return closest if step is None else min(step, closest)


EngineBuffer = tuple[Any, Callable[[], None]]  # CasADi's buffer and what evaluates it


class EngineFunctions(NamedTuple):
    """CasADi functions of an engine.

    Attributes:
        function: `(x0, z0, p, u, ...) -> (xf, zf, ...)`, one column per output time.
        parameters: From the model's parameters to those of `function`; None if these are equal.
    """

    function: ca.Function
    parameters: ca.Function | None = None


Crossing = tuple[float, int]  # a time, and the relation that leaves its mode there; -1 of time


class Filled(NamedTuple):
    """What a call that fills arrays of states and algebraic unknowns tells.

    Attributes:
        succeeded: Whether it came to the last output time, or to a crossing.
        reached: Number of output times reached; None if the engine does not report it.
        crossing: Where it ended; the values there follow those of the output times.
        events: Those that it went through before, an array of `event_type`.
    """

    succeeded: bool
    reached: int | None = None
    crossing: Crossing | None = None
    events: NDArray[np.void] | None = None


def event_type(system: Hybrid) -> np.dtype[np.void]:
    """Return how fmu/solvers/watch.h records an event."""
    dae, m = system.dae, len(system.relations)
    sides = ("x", dae.x.numel()), ("z", dae.z.numel()), ("modes", m)
    side = np.dtype([(name, float, (size,)) for name, size in sides])
    more = ("zero", float, (m,)), ("order", float, (len(system.events),))
    return np.dtype([("time", float), ("before", side), ("after", side), *more])


def room_for_events(system: Hybrid) -> NDArray[np.void]:
    """Return an array for the events that one call of a solver goes through."""
    record = event_type(system)
    return np.empty(1 + _ROOM_FOR_EVENTS // record.itemsize, record)


class Left(NamedTuple):
    """What past events have left for an engine that goes through further ones.

    Attributes:
        switching: `Switching` of the kernel of events, which these events change.
        sizes: Sizes of the states, in whose rounding an argument is 0, (nx,).
        end: End of the run, up to which time events are planned, s.
    """

    switching: Vector
    sizes: Vector
    end: float


# (x0, z0, p, u, states, algebraics, what past events have left)
DirectRun = Callable[[Vector, Vector, Vector, Vector, Vector, Vector, Left | None], Filled]


@dataclass(frozen=True)
class Engine:
    """An integrator over a grid, ready to be called.

    Attributes:
        make: Builds the CasADi functions, on demand only: their sizes grow with the grid.
        points: Number of output times, columns of the results.
        repeat_u: Whether `u` has one column per output time.
        counts: Returns the counts of the thread's last call.
        library: A library that runs as one C function and handles Ctrl-C itself
            (fmu/solvers/interrupt.h); None if CasADi handles it.
        selected: Columns of the results that are at the problem's output times; all when None.
        restart: Builds, from dx/dt at the start, (nx,), an engine for consistent initial values at
            which this one fails; None if there is no such engine.
        direct: Does the same on arrays without CasADi; None if not available. It prints nothing,
            and does not write the output times that it does not reach.
        time_unit: Unit of the times in the solver's messages, s.
        watches: Whether it goes through events, and ends a run at those of which only the caller
            knows what follows.
    """

    make: Callable[[], EngineFunctions]
    points: int
    repeat_u: bool
    counts: Callable[[], Counts]
    library: ctypes.CDLL | None = None
    selected: NDArray[np.intp] | None = None
    restart: "Callable[[Vector], Engine] | None" = None
    direct: DirectRun | None = None
    time_unit: float = 1.0
    watches: bool = False

    @cached_property
    def functions(self) -> EngineFunctions:
        """CasADi functions."""
        return self.make()

    @cached_property
    def buffer(self) -> EngineBuffer:
        """Buffer of the function: one for all calls, so that counts are read from its memory."""
        return self.functions.function.buffer()


class Integrating(Protocol):
    """Protocol of the solver classes in `integrate/families`, which add `engine` to `Solver`."""

    def engine(self, problem: Problem) -> Engine:
        """Build the engine for a problem.

        Raises:
            UsageError: The solver does not support the problem.
            ParameterError: The step size would need too many steps.
            MissingTool: The equations must be compiled, and no compiler works.
        """


def reported(library: ctypes.CDLL, start: float, length: float) -> Callable[[], Counts]:
    """Return a function that reads the counts of a library with time = start + length * its own."""
    numbers = (ctypes.c_double * REPORT)()

    def counts() -> Counts:
        library.cosim_report(numbers)
        steps, rhs, jacobians, status, reached, last, *_ = numbers
        cause = Ending()
        if status not in (0, EVENT):
            why = CAUSES.get(int(status), "it gave up")
            kind = _KINDS.get(int(status), EndKind.FAILED)
            place = f"t = {start + length * reached:g}, h = {length * last:.2g}"
            cause = Ending(f"{why} at {place}", kind)
        return Counts(int(steps), int(rhs), int(jacobians), cause)

    return counts


EVENT = 6  # status of a run that ended where a relation leaves its mode
_KINDS = {1: EndKind.TOO_MANY_STEPS, 7: EndKind.STIFF}
CAUSES = {  # by code of fmu/solvers
    1: "too many steps",
    2: "step size too small",
    3: "inconsistent algebraic unknowns",
    4: "a state is not finite",
    5: "halted",
    7: "stiff",
    8: "no projection onto the invariants",
}
