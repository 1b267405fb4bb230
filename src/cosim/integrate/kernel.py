"""`Kernel`: the kernel of events in C (fmu/solvers/hybrid), called at the instants of a run."""

import ctypes
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from casadi_models.dae.hybrid import Hybrid
from cosim.arrays import Vector
from cosim.codegen.c_fields import fields
from cosim.codegen.c_sources import source_text
from cosim.codegen.kernel_library import kernel_library
from cosim.errors import SolverError
from cosim.integrate.engine import Left
from cosim.integrate.modes import Instant
from cosim.memo import cached_per_thread
from cosim.text import EndKind

_DOUBLE, _LONG = ctypes.c_double, ctypes.c_longlong
_PLACE = ctypes.c_void_p
_NUMBERS = ctypes.POINTER(_DOUBLE)
_NOTE = ctypes.CFUNCTYPE(None, *[_NUMBERS] * 4)
_FRESH_RUN = ctypes.CFUNCTYPE(ctypes.c_bool, _DOUBLE, _NUMBERS, _NUMBERS)


class _Call(ctypes.Structure):
    """`Call` of fmu/solvers/instants.h."""

    _fields_ = fields("solvers/instants.h", "Call", note=_NOTE)


class _Rows(ctypes.Structure):
    """`MotionRows` of fmu/solvers/instants.h."""

    _fields_ = fields("solvers/instants.h", "MotionRows")


class Reason(IntEnum):
    """`Reason` of fmu/solvers/hybrid/settle.h."""

    GOES_ON = 0
    STOPPED = 1
    NO_VALUE = 2
    NO_MODES = 3
    TOO_MANY_ROUNDS = 4
    TOO_CLOSE = 5
    CONTRADICTS = 6
    NOT_FINITE_ASSIGNED = 7
    VIOLATES = 8
    STAYS_TRUE = 9


class State(IntEnum):
    """States of a relation; see fmu/solvers/hybrid/switching.h."""

    FREE = 0
    LEAVES = 1
    HELD = 2
    SLIDES = 3


class Outcome(NamedTuple):
    """How an instant ended: `Ending` of fmu/solvers/hybrid/settle.h.

    Attributes:
        reason: Why the run does not go on, or `GOES_ON`.
        part, other: Positions of events or relations; -1 for none.
        state: Position of a state; -1 for none.
        size: Size of a violation.
    """

    reason: Reason
    part: int
    other: int
    state: int
    size: float


class Happening(NamedTuple):
    """What happened at an instant.

    Attributes:
        ending: How it ended.
        events: Positions of the events that happened, in their order.
        zero: Relations whose arguments became 0.
        replan: Whether the next time event has to be found anew.
    """

    ending: Outcome
    events: list[int]
    zero: frozenset[int]
    replan: bool


class Rows(NamedTuple):
    """Rows of a motion, one per time; arrays are contiguous.

    Attributes:
        times: s, (n,).
        x, dx: States and their time derivatives, (n, nx).
        u, du: Inputs with modes, and their slopes, (n, nu).
        inside: How far each relation is within its mode, (n, m).
        defects: What the slope of the cubic from a row to the next is off by, (n - 1, nx).
    """

    times: Vector
    x: Vector
    dx: Vector
    u: Vector
    du: Vector
    inside: Vector
    defects: Vector

    @classmethod
    def of(cls, *columns: Vector) -> "Rows":
        """Return rows of columns that need not be contiguous."""
        return cls(*(np.ascontiguousarray(column, dtype=float) for column in columns))


_MEMBERS = [name for name, _ in fields("solvers/hybrid/switching.h", "Switching")]
Listener = Callable[[Vector, Vector, Vector, list[int]], None]  # x, z, u before; events of a round
FreshRun = Callable[[float], tuple[Vector, Vector]]  # margins and their rates at a time, (m,)


@dataclass
class Switching:
    """What past events leave for later ones: `Switching` of fmu/solvers/hybrid/switching.h.

    Attributes:
        numbers: All of it.
        modes: How many relations there are.
    """

    numbers: Vector
    modes: int

    def _row(self, name: str) -> Vector:
        return self.numbers[_MEMBERS.index(name) * (self.modes + 1) :][: self.modes]

    @property
    def states(self) -> Vector:
        """A `State` of each relation, (m,)."""
        return self._row("state")

    @property
    def slack(self) -> Vector:
        """By how much rounding moves each argument, (m,)."""
        return self._row("slack")

    @property
    def last_event(self) -> float:
        """Time of the last event, s."""
        return float(self.numbers[_MEMBERS.index("last") - len(_MEMBERS)])

    @property
    def sliding(self) -> frozenset[int]:
        """Relations whose arguments stay 0 because their modes make them so."""
        return frozenset(np.flatnonzero(self.states == State.SLIDES).tolist())


@cached_per_thread(16)
def _library(system: Hybrid) -> tuple[ctypes.CDLL, int, int]:
    """Return the library of a model; how many numbers its `Switching` and work space have."""
    library = ctypes.CDLL(kernel_library(system))
    library.cosim_due.restype = _DOUBLE
    sizes = (_LONG * 9)()
    library.cosim_kernel_sizes(sizes)
    dae = system.dae
    numels = [column.numel() for column in (dae.x, dae.z, dae.u)]
    structures = [ctypes.sizeof(structure) for structure in (_Call, _Rows)]
    own = [*structures, *numels, len(system.relations), len(system.events)]
    assert sizes[:7] == own, "the library of events belongs to another model"
    return library, sizes[7], sizes[8]


class Kernel:
    """The kernel of events for a run; it has work space of its own.

    Args:
        system: Frozen equations.
        p: Parameters, SI.
        sizes: Sizes of the states, in whose rounding an argument is 0, (nx,).
        span: Length of the run, s.
        end: Its end, up to which time events are planned, s.

    Raises:
        MissingTool, UsageError: See `kernel_library`.
    """

    def __init__(
        self, system: Hybrid, p: Vector, sizes: Vector, span: float, end: float = np.inf
    ) -> None:
        self.system = system
        self.span = span
        self._end = _DOUBLE(end)
        self._library, count, room = _library(system)
        dae, m = system.dae, len(system.relations)
        self._arrays = {
            "x": np.zeros(dae.x.numel() + 1),
            "z": np.zeros(dae.z.numel() + 1),
            "u": np.zeros(dae.u.numel() + 1),
            "slopes": np.zeros(dae.u.numel() + 1),
            "c": np.append(p, 0.0),
            "sizes": np.append(sizes, 0.0),
            "switching": np.zeros(count),
            "w": np.zeros(room),
            "zero": np.zeros(m + 1),
            "later": np.zeros(m + 1),
            "order": np.zeros(len(system.events) + 1),
        }
        self.switching = Switching(self._arrays["switching"], m)
        self._call = _Call(span=span)
        for name, array in self._arrays.items():
            setattr(self._call, name, array.ctypes.data)

    def _pass(self, at: Instant) -> None:
        self._call.t = at.t
        for name, values in (("x", at.x), ("z", at.z), ("u", at.inputs), ("slopes", at.slopes)):
            self._arrays[name][: len(values)] = values

    def _ask(self, function: str, *arguments: Any) -> Any:
        """Call a function of the library, which gets arrays by their addresses."""
        given = (_PLACE(a.ctypes.data) if isinstance(a, np.ndarray) else a for a in arguments)
        return getattr(self._library, function)(ctypes.byref(self._call), *given)

    def begin(self, at: Instant) -> Outcome:
        """Find the modes of a start, with a guess of its algebraic unknowns; see `after`."""
        self._pass(at)
        self._ask("cosim_begin")
        return self._ending()

    def happen(
        self,
        at: Instant,
        crossing: int = -1,
        listener: Listener | None = None,
        later: frozenset[int] = frozenset(),
    ) -> Happening:
        """Let all happen that happens at an instant; see `after`.

        Args:
            at: Just before it, with the inputs just after it.
            crossing: A relation whose argument is 0 there; -1 for none.
            listener: Called in each round with the values before it, and its events.
            later: Relations that keep their modes, although their arguments are 0.
        """
        self._pass(at)
        sizes = [len(self._arrays[name]) - 1 for name in ("z", "u", "x", "order")]

        def note(*places: "ctypes._Pointer[ctypes.c_double]") -> None:
            before = [
                np.ctypeslib.as_array(place, (size,)).copy()
                for place, size in zip(places, sizes, strict=True)
            ]
            z, u, x, risen = before
            assert listener is not None
            listener(x, z, u, np.flatnonzero(risen).tolist())

        self._arrays["later"][:] = 0.0
        self._arrays["later"][list(later)] = 1.0
        self._call.note = _NOTE(note) if listener else _NOTE()
        self._ask("cosim_happen", _LONG(crossing))
        order, zero = self._arrays["order"][:-1], self._arrays["zero"][:-1]
        events = [i for _, i in sorted((n, i) for i, n in enumerate(order.tolist()) if n)]
        zeros = frozenset(np.flatnonzero(zero).tolist())
        return Happening(self._ending(), events, zeros, bool(self._call.replan))

    def note_rounding(self, at: Instant) -> None:
        """Take what rounding makes of slow relations at an instant."""
        self._pass(at)
        self._ask("cosim_note_least")

    def note_steps(self, t: float, steps: int) -> None:
        """Take that a solver which knows no events has rounded time in some steps up to a time."""
        self._ask("cosim_note_steps", _DOUBLE(t), _DOUBLE(steps))

    @property
    def left(self) -> Left:
        """What past events have left, for an engine."""
        return Left(self.switching.numbers, self._arrays["sizes"], self._end.value)

    def after(self, at: Instant) -> Instant:
        """Return what an instant has become by the last call."""
        x, z, u = (self._arrays[name][:-1].copy() for name in ("x", "z", "u"))
        return replace(at, x=x, z=z, modes=u[len(at.u) :], sliding=self.switching.sliding)

    def plan(self, at: Instant) -> None:
        """Plan the time events that follow an instant."""
        self._call.t = at.t
        self._arrays["u"][:-1] = at.inputs
        self._ask("cosim_plan", self._end)

    @property
    def due(self) -> float:
        """The next time event of the run, s; infinite if there is none."""
        return float(self._ask("cosim_due", self._end))

    def margins(self, arguments: Vector, rates: Vector, modes: Vector) -> tuple[Vector, Vector]:
        """Return how far each relation is within its mode, and the rate of that, (n, m) each.

        Args:
            arguments, rates: Of the relations, one row per time, (n, m).
            modes: Their modes, (n, m) or (m,).
        """
        each = arguments, rates, np.broadcast_to(modes, arguments.shape)
        rows = [np.ascontiguousarray(a) for a in each]
        inside, towards = np.empty_like(rows[0]), np.empty_like(rows[0])
        self._ask("cosim_margins", _LONG(len(inside)), *rows, inside, towards)
        return inside, towards

    def leaving(self, times: Vector, inside: Vector, towards: Vector) -> NDArray[np.intp]:
        """Return which relation leaves its mode at each time, but for rounding; -1 for none, (n,).

        Args:
            times: s, (n,).
            inside, towards: As `margins` returns them, (n, m).
        """
        found = np.empty(len(times))
        rows = [np.ascontiguousarray(a) for a in (times, inside, towards)]
        self._ask("cosim_leaving", _LONG(len(times)), *rows, found)
        return found.astype(np.intp)

    def stay(self, rows: "Rows") -> NDArray[np.bool_]:
        """Return from which of n rows to the next one no relation leaves its mode, (n - 1,)."""
        found = np.ones(len(rows.times) - 1)
        given = self._rows(rows)
        self._ask("cosim_stay", ctypes.byref(given), _LONG(len(rows.times)), found)
        return found > 0

    def search(
        self, rows: "Rows", z: Vector, run: FreshRun | None = None, *, goes_on: bool = False
    ) -> tuple[float, int]:
        """Return where a relation leaves its mode between two rows, s, and which one; or -1.

        Args:
            rows: The rows.
            z: A guess of the algebraic unknowns.
            run: Tells margins by a fresh run from the first row, the last time where the relation
                leaves its mode; None if the cubic between the rows is the motion.
            goes_on: Whether the motion goes on as it is beyond the second row.
        """
        time, errors = _DOUBLE(), list[BaseException]()

        def report(t: float, *places: "ctypes._Pointer[ctypes.c_double]") -> bool:
            assert run is not None
            try:
                margins = run(t)
            except BaseException as error:  # it cannot pass through C
                errors.append(error)
                return False
            for place, values in zip(places, margins, strict=True):
                np.ctypeslib.as_array(place, values.shape)[:] = values
            return True

        given = self._rows(rows)
        self._arrays["z"][: len(z)] = z
        fresh = _FRESH_RUN(report) if run else _FRESH_RUN()
        places = ctypes.byref(given), fresh, _LONG(goes_on), ctypes.byref(time)
        relation = self._ask("cosim_search", *places)
        if errors:
            raise errors[0]
        return time.value, int(relation)

    def _rows(self, rows: "Rows") -> _Rows:
        self._arrays["u"][:-1] = rows.u[0]
        return _Rows(*(array.ctypes.data for array in rows))

    def note_inside(self, modes: Vector, arguments: Vector) -> None:
        """Let go of boundaries that an event has displaced, where arguments are inside again."""
        rows = [np.ascontiguousarray(a) for a in (modes, arguments)]
        self._ask("cosim_note_inside", *rows)

    def _ending(self) -> Outcome:
        call = self._call
        return Outcome(Reason(call.reason), call.part, call.other, call.state, call.size)


@cached_per_thread(16)
def _without_rules(system: Hybrid) -> Hybrid:
    return replace(system, events=())


def settled(system: Hybrid, at: Instant, p: Vector) -> tuple[Instant, dict[int, float]]:
    """Return a state with consistent modes, and the relations that switch there.

    These are by position, with the value of the argument: 0, or of a floor an integer.

    Args:
        system: Frozen equations; its events do not happen.
        at: The state; its modes are ignored.
        p: Parameters.

    Raises:
        SolverError: No modes are consistent.
        MissingTool, UsageError: See `kernel_library`.
    """
    plain = _without_rules(system)
    nominal = np.array([variable.nominal for variable in system.dae.states])
    kernel = Kernel(plain, p, nominal, 1.0)
    reject(plain, at.t, kernel.begin(at), "")
    at = kernel.after(at)
    found = kernel.happen(at)  # what is 0 but for rounding
    reject(plain, at.t, found.ending, "")
    at = kernel.after(at)
    arguments = at.watched(plain, p).arguments[0]
    edges = np.where(plain.floors, np.round(arguments), 0.0)
    small = np.abs(arguments - edges) <= kernel.switching.slack
    return at, {i: float(edges[i]) for i in plain.of_states if small[i]}


@cache
def _texts() -> dict[Reason, tuple[str, list[str]]]:
    """Return what to tell of an ending, and the facts in it; see TEXTS_OF_ENDINGS in C."""
    source = source_text("runtime/modes.c").replace("\\\n", "")
    found = re.findall(r'X\((\w+), *((?:"[^"]*" *)+), *([\w, ]+)\)', source)
    return {
        Reason[name]: ("".join(re.findall('"([^"]*)"', parts)), re.findall(r"\w+", facts))
        for name, parts, facts in found
    }


def reject(system: Hybrid, t: float, ending: Outcome, switched: str) -> None:
    """Raise the error of an instant that a run cannot go on from.

    Args:
        system: Frozen equations.
        t: Time, s.
        ending: How the instant ended.
        switched: What switched there, if no event did.

    Raises:
        SolverError: Unless the run goes on, or an event has ended it.
    """
    reason, part, other, state, size = ending
    if reason not in _texts():
        return
    facts = {"t": t, "rule": switched, "size": size}
    if reason is Reason.NO_MODES:
        facts["relation"] = system.described(part)
    elif part >= 0:
        facts["rule"] = system.events[part].name
    if reason is Reason.CONTRADICTS:
        facts["other"] = system.events[other].name
    elif reason is Reason.VIOLATES:
        facts["violated"] = system.dae.invariants[other].meaning
    if state >= 0:
        facts["state"] = system.dae.states[state].name
    text, names = _texts()[reason]
    why, _, remedy = text.partition("; ")
    why %= tuple(facts[name] for name in names)
    raise SolverError.of(system.dae.full_name, why, remedy, kind=EndKind.EVENT)
