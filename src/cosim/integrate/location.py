"""Where the relations of a hybrid model leave their modes along the motion of a solver."""

from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from casadi_models.dae import Dae
from casadi_models.dae.hybrid import Hybrid, input_rates, with_rates
from cosim.arrays import Vector
from cosim.codegen.functions import equations
from cosim.errors import SolverError
from cosim.integrate.call import INTERRUPTED, Reached
from cosim.integrate.engine import MOST_STEPS, Counts, Problem
from cosim.integrate.kernel import Kernel, Rows, State
from cosim.integrate.modes import Instant, Passed, Watched, hybrid, passed_events, watch
from cosim.integrate.nominal import InitialState, scaled_call
from cosim.memo import cached_per_thread
from cosim.model.inputs import InputSeries
from cosim.model.solver import AdaptiveSolver, Solver
from cosim.model.values import Values
from cosim.text import Ending

_INNER = np.linspace(0, 1, 10)[1:-1]  # places in a grid interval at which relations are looked at
_CLOSE = 1e-5  # share of a fresh run within which the cubic to its end tells the state
_SAME_INSTANT = 32  # units in the last place of a time
SAME_TIME = 1e-12  # of the span: too short a step


class Located(NamedTuple):
    """The first event of a piece.

    Attributes:
        at: The instant just before it.
        first: The relation whose argument becomes 0 there, or that no longer slides.
    """

    at: Instant
    first: int


class Piece:
    """A motion with fixed modes, from an instant over some times.

    `passed` are events of states within it; `begin` is then the instant after the last of them.

    Args:
        system: The frozen equations, nothing sliding.
        own: Those of the piece.
        problem: `own` over the times.
        solver: The solver.
        begin: Where it begins.
        began: States at the start of the run, (nx,).
        p: Parameters.
        kernel: What past events have left; None without relations.
    """

    def __init__(
        self,
        system: Hybrid,
        own: Hybrid,
        problem: Problem,
        solver: Solver,
        begin: Instant,
        began: Vector,
        p: Vector,
        kernel: Kernel | None,
    ) -> None:
        self.system, self.own, self.begin, self.began, self.p = system, own, begin, began, p
        self.kernel = kernel
        self.span = kernel.span if kernel else 1.0
        self.problem, self.solver = problem, solver
        z = begin.z
        if own.sliding and own.dae.derived and problem.inputs:
            for name in moving_paths(own, problem.inputs):
                why = f"derivatives of what rests on {name}, which a series moves, are not known"
                raise SolverError.of(own.dae.full_name, why, "give it as a formula")
        if own.sliding and own.dae.algebraics:
            z = np.concatenate((begin.z, begin.modes[list(own.sliding)]))
        watched = replace(problem, system=own)
        self.reached = self._run(watched, problem.grid, begin.x, z)
        self.problem = replace(problem, most_steps=MOST_STEPS)  # a fresh start within takes more
        n = self.reached.states.shape[1]
        self.times = problem.grid[:n]
        if self.reached.crossing is not None:
            self.times = np.append(problem.grid[: n - 1], self.reached.crossing[0])
        self.x, self.z = self.reached.states.T, self.reached.algebraics.T
        self.reason = self.reached.reason
        self._rates = dict[int, Vector]()
        events = self.reached.events
        self.passed = list[Passed]()
        if events is not None and len(events):
            self.passed = passed_events(events, self._own_inputs(events["time"]))
        if self.passed:
            self.begin = self.passed[-1].after
        self.u, _ = self._inputs(self.times)  # in the modes after these events

    def _run(self, problem: Problem, times: Vector, x: Vector, z: Vector) -> Reached:
        u, _ = self._inputs(times[:1])
        values = Values(x, self.p, u[0])
        # no solver begins with an output time so near, up to which the motion is a line
        near = times <= times[0] + _SAME_INSTANT * np.spacing(abs(times[0]))
        if not len(x) or near.sum() > 1:
            line = self._line(times[near] if len(x) else times, x, z)
            if line[0].shape[1] == len(times):
                return Reached(*line, Counts(0, 0, 0), Ending(), 0.0)
            found = self._run(problem, np.append(times[:1], times[~near]), x, z)
            further = found.states[:, 1:], found.algebraics[:, 1:]
            states, unknowns = (np.hstack(pair) for pair in zip(line, further, strict=True))
            return replace(found, states=states, algebraics=unknowns)
        if times.tobytes() != problem.times:
            problem = replace(problem, times=times.tobytes())
        left = None if self.kernel is None else self.kernel.left
        start = InitialState(x, z, values, self.began, left)
        found = scaled_call(problem, self.solver, start, in_pieces=True)
        if self.kernel is not None and found.events is None:
            self.kernel.note_steps(times[-1], found.counts.steps or 0)
        if found.events is None or not len(found.events):
            constant = self.system.constant  # a solver may change them by rounding
            found.states[constant] = x[constant, None]
        return found

    def _line(self, times: Vector, x: Vector, z: Vector) -> tuple[Vector, Vector]:
        """Return states on the line from those at the first of some times, and the unknowns."""
        rates = self._slopes(times[:1], x[None], z[None])[0] if len(x) else x
        moving = np.where(np.isfinite(rates), rates, 0)
        return x[:, None] + moving[:, None] * (times - times[0]), np.tile(z[:, None], len(times))

    def _inputs(self, times: Vector) -> tuple[Vector, Vector]:
        """Return inputs with modes, and their slopes, one row per time."""
        row = np.concatenate((self.begin.u, self.begin.modes))
        return with_slopes(self.own.dae, self.problem.inputs, row, times)

    def at_end(self) -> Instant:
        """Return the instant at its end, in the modes of the piece."""
        solved = self.seen.solved[-1] if self.own.sliding else None
        return self.instant(self.times[-1], self.x[-1], self.z[-1], solved)

    def instant(self, t: float, x: Vector, z: Vector, solved: Vector | None = None) -> Instant:
        """Return an instant of the piece from a time and a row of states and unknowns.

        Args:
            t: s.
            x, z: The row.
            solved: Modes of the relations that slide; as at the start if None.
        """
        slid, modes = self.own.sliding, self.begin.modes.copy()
        if solved is not None:
            modes[list(slid)] = solved
        (u,), (du,) = self._own_inputs(np.array([t]))
        z = z[: len(self.begin.z)]
        return replace(self.begin, t=float(t), x=x, z=z, u=u, du=du, modes=modes)

    def _own_inputs(self, times: Vector) -> list[Vector]:
        """Return inputs without modes, and their slopes, one row per time."""
        return [columns[:, : len(self.begin.u)] for columns in self._inputs(times)]

    @cached_property
    def seen(self) -> Watched:
        """The relations at the times."""
        return self.watched(self.times, self.x, self.z, closely=False)

    def watched(self, times: Vector, x: Vector, z: Vector, *, closely: bool = True) -> Watched:
        """Return the relations at some times and states."""
        return watch(self.own, times, (x, z, *self._inputs(times)), self.p, closely=closely)

    def rates(self, k: int) -> Vector:
        """Return dx/dt at a time and the next one, (2, nx)."""
        if k not in self._rates:
            ends = slice(k, k + 2)
            self._rates[k] = self.watched(self.times[ends], self.x[ends], self.z[ends]).ode
        return self._rates[k]

    def margins(self, seen: Watched) -> tuple[Vector, Vector]:
        """Return how far every relation is within its mode, and the rates of that, (n, m).

        Rounding is inside. Of a relation that slides, how far its mode is within -1 ... 1.
        Relations of time alone, whose times are known, are left out: far within.
        """
        assert self.kernel is not None
        slid = list(self.own.sliding)
        modes = np.tile(self.begin.modes, (len(seen.arguments), 1))
        modes[:, slid] = seen.solved
        inside, towards = self.kernel.margins(seen.arguments, seen.rates, modes)
        towards[:, slid] = -np.sign(seen.solved) * seen.solved_rates
        return inside, towards

    def rows(self, inside: Vector) -> Rows:
        """Return its rows; margins as `margins` gives them."""
        t, x, z = self.times, self.x, self.z
        dx = self._slopes(t, x, z)
        states = cubics(t, x, dx, np.array([0.5]))[:, 0]
        slopes = 1.5 * np.diff(x, axis=0) / np.diff(t)[:, None] - (dx[1:] + dx[:-1]) / 4
        middle = self._slopes((t[1:] + t[:-1]) / 2, states, (z[1:] + z[:-1]) / 2)
        return Rows.of(t, x, dx, *self._inputs(t), inside, np.abs(middle - slopes))

    def ends(self, k: int) -> Rows:
        """Return the rows at both ends of an interval, with its own slopes of inputs."""
        own = slice(k, k + 2)
        t, x = self.times[own], self.x[own]
        u, du = self._inputs(t)
        _, before = self._inputs(np.nextafter(t[1:], -np.inf))
        slopes, unknown = np.concatenate((du[:1], before)), np.empty(0)
        return Rows.of(t, x, self.rates(k), u, slopes, unknown, unknown)

    def _slopes(self, times: Vector, x: Vector, z: Vector) -> Vector:
        """Return dx/dt at some times and states, (n, nx)."""
        u, _ = self._inputs(times)
        return np.array(equations(self.own.dae)(times[None], x.T, z.T, u.T, self.p)[0]).T

    def stay(self, inside: Vector) -> NDArray[np.bool_]:
        """Return from which times to the next no relation leaves its mode, by bounds, (n - 1,).

        Relations without bounds are taken to stay, and all of them while one slides.
        """
        assert self.kernel is not None
        if self.own.sliding or not self.system.enclosures.relations:
            return np.ones(len(self.times) - 1, dtype=bool)
        return self.kernel.stay(self.rows(inside))

    def let_go(self) -> None:
        """Let go of boundaries that an event has displaced, if the end is within them."""
        if self.kernel is None or len(self.times) < 2:
            return
        if (self.kernel.switching.states == State.LEAVES).any():
            self.kernel.note_inside(self.begin.modes, self.seen.arguments[-1])

    def within(self, k: int) -> "Piece":
        """Return the same motion in one interval, at more times."""
        begin = self.instant(self.times[k], self.x[k], self.z[k])
        times = np.linspace(self.times[k], self.times[k + 1], len(_INNER) + 2)
        problem = replace(self.problem, times=times.tobytes())
        known = self.solver, begin, self.began, self.p, self.kernel
        found = Piece(self.system, self.own, problem, *known)
        if found.reason == INTERRUPTED:
            raise KeyboardInterrupt
        return found

    def state_at(self, k: int, t: float) -> tuple[Vector, Vector] | None:
        """Return states and unknowns at a time after the k-th one, or None where that fails."""
        times = np.array([self.times[k], t])
        rounding = _SAME_INSTANT * np.spacing(abs(times[0]))
        if t - times[0] <= max(SAME_TIME * min(1.0, self.span), rounding):  # too short a step
            return self.x[k] + (t - times[0]) * self.rates(k)[0], self.z[k]
        found = self._run(self.problem, times, self.x[k], self.z[k])
        if found.reason == INTERRUPTED:
            raise KeyboardInterrupt
        if found.states.shape[1] < 2:
            return None
        return found.states[:, 1], found.algebraics[:, 1]


def with_slopes(
    dae: Dae, series: InputSeries | None, row: Vector, times: Vector
) -> tuple[Vector, Vector]:
    """Return a row of inputs at each time, some of which follow a series, and their slopes."""
    size = len(times), len(row)
    u, du = np.empty(size), np.zeros(size)
    u[:] = row
    if series is None:
        return u, du
    known = [variable.name for variable in dae.inputs]
    places = [known.index(name) for name in series.names]
    u[:, places] = series.at(times).T
    du[:, places] = [series.slopes(float(t)) for t in times]
    for name, place in input_rates(dae).items():
        u[:, place] = du[:, known.index(name)]
    return u, du


_with_rates = cached_per_thread(16)(with_rates)


def with_input_rates(problem: Problem, start: InitialState) -> tuple[Problem, InitialState]:
    """Return a problem whose inputs hold the rates of those along which states may slide."""
    system, series = hybrid(problem.dae), problem.inputs
    names = moving_paths(system, series) if system and series else ()
    if problem.dae.derived or not names:
        return problem, start
    values = start.values
    u = np.concatenate((values.u, np.zeros(len(names))))
    problem = replace(problem, dae=_with_rates(problem.dae, names))
    return problem, replace(start, values=replace(values, u=u))


def moving_paths(system: Hybrid, series: InputSeries) -> tuple[str, ...]:
    """Return the inputs that a series moves steadily, and along which states may slide."""
    moving = (np.diff(series.values, axis=0) != 0)[np.diff(series.time) > 0].any(axis=0)
    pairs = zip(series.names, moving, strict=True)
    return tuple(name for name, moves in pairs if moves and name in system.paths)


def cubics(t: Vector, x: Vector, f: Vector, shares: Vector) -> Vector:
    """Return the cubics with given values and slopes at the ends of intervals, (n - 1, m, k).

    Args:
        t: The times, (n,).
        x, f: Values and slopes there, (n, k).
        shares: Where in each interval to evaluate its cubic, 0 to 1, (m,).
    """
    s, h = shares[:, None], np.diff(t)[:, None, None]
    r = 1 - s
    x, f = x[:, None], f[:, None]
    ends = x[:-1] + s * s * (1 + 2 * r) * np.diff(x, axis=0)  # exact where values are equal
    return ends + h * s * r * (r * f[:-1] - s * f[1:])


def located(piece: Piece, *, closely: bool = True) -> Located | None:
    """Return the first event of a piece that is not of time alone; None if there is none.

    Args:
        piece: The motion.
        closely: Whether the solver, not the cubic, shows how near a relation comes and returns.
    """
    if piece.reached.watched:
        return _crossed(piece)
    if not piece.system.of_states or len(piece.times) < 2:
        return None
    inside, towards = piece.margins(piece.seen)
    outside = inside[1:] < 0
    with np.errstate(invalid="ignore"):
        lowest = cubics(piece.times, inside, towards, _INNER).min(axis=1)
        dips = ~outside & (towards[:-1] < 0) & (towards[1:] > 0)
        near = 0.5 if closely else 0.1
        dips &= lowest < near * np.maximum(inside[:-1], inside[1:])
    seen = np.asarray((outside | dips).any(axis=1))
    assert piece.kernel is not None
    leaves = piece.kernel.leaving(piece.times, inside, towards)[1:] >= 0
    leaves[-1] = False  # what follows may move otherwise
    doubtful = seen | ~piece.stay(inside)
    for k in np.flatnonzero(doubtful | leaves).tolist():
        closer = closely and doubtful[k] and not outside[k].any()
        found = located(piece.within(k), closely=False) if closer else None
        if found is None and (leaves[k] or not closer):
            found = _left_in(piece, k, goes_on=k < len(leaves) - 1)
        if found is not None:
            return found
    return None


class _FreshRuns:
    """Runs from where an interval of a piece begins to times near its first event.

    Attributes:
        t, x: Time and state that were asked for last.
        seen: The relations there.
    """

    def __init__(self, piece: Piece, k: int) -> None:
        self.piece, self.k = piece, k
        self.t, self.x, self.seen = float(piece.times[k]), piece.x[k], piece.seen
        self._end: tuple[float, Vector, Vector, Vector] | None = None  # of a run: t, x, dx/dt, z

    def __call__(self, t: float) -> tuple[Vector, Vector]:
        """Return the margins at a time, and their rates, (m,)."""
        piece, k = self.piece, self.k
        begin = float(piece.times[k])
        near = self._end is not None and abs(t - self._end[0]) < _CLOSE * (t - begin)
        found = None if near else piece.state_at(k, t)
        x, z = found or self._on_cubic(t)
        seen = piece.watched(np.array([t]), x[None], z[None])
        if near and not self._is_exact(t, x, seen.ode[0]):
            found = piece.state_at(k, t)
            x, z = found or (x, z)
            seen = piece.watched(np.array([t]), x[None], z[None])
        if found:
            self._end = t, x, seen.ode[0], z
        self.t, self.x, self.seen = t, x, seen
        (inside,), (towards,) = piece.margins(seen)
        return inside, towards

    def _is_exact(self, t: float, x: Vector, rates: Vector) -> bool:
        """Return whether a state on the cubic follows from the rates there and at its end."""
        assert self._end is not None
        end, at_end, rates_at_end, _ = self._end
        solver = self.piece.solver
        relative = solver.tolerance.pair[0] if isinstance(solver, AdaptiveSolver) else _CLOSE**2
        own = slice(self.k, self.k + 2)
        sizes = np.fmax(np.abs(self.piece.x[own]).max(axis=0), np.abs(x))
        off = x - at_end - (t - end) * (rates + rates_at_end) / 2
        return bool((np.abs(off) <= relative * sizes).all())

    def _on_cubic(self, t: float) -> tuple[Vector, Vector]:
        """Return states and unknowns on the cubic to the end of the last run, or interval."""
        piece, k = self.piece, self.k
        own = slice(k, k + 2)
        times, x, rates, z = piece.times[own], piece.x[own], piece.rates(k), piece.z[k + 1]
        if self._end is not None:
            times, x, rates = times.copy(), x.copy(), rates.copy()
            times[1], x[1], rates[1], z = self._end
        share = np.array([(t - times[0]) / (times[1] - times[0])])
        return cubics(times, x, rates, share)[0, 0], z


def _left_in(piece: Piece, k: int, *, goes_on: bool) -> Located | None:
    """Return the first event in an interval of a piece; None if there is none.

    Args:
        piece, k: The interval.
        goes_on: Whether the motion goes on as it is beyond it.
    """
    assert piece.kernel is not None
    fresh = _FreshRuns(piece, k)
    _, i = piece.kernel.search(piece.ends(k), piece.z[k], fresh, goes_on=goes_on)
    return None if i < 0 else _at_event(piece, fresh.t, fresh.x, fresh.seen, i)


def located_at_end(piece: Piece) -> Located | None:
    """Return the event that only rounding is between it and the end of a piece; None without one.

    The motion must go on beyond the end as it is.
    """
    if piece.kernel is None or not piece.system.of_states:
        return None
    piece.kernel.note_rounding(piece.at_end())
    last = slice(-1, None)
    seen = piece.watched(piece.times[last], piece.x[last], piece.z[last])
    inside, towards = piece.margins(seen)
    (i,) = piece.kernel.leaving(piece.times[last], inside, towards).tolist()
    return None if i < 0 else _at_event(piece, float(piece.times[-1]), piece.x[-1], seen, i)


def _crossed(piece: Piece) -> Located | None:
    """Return the event at which the solver ended a piece; None if it did not."""
    if piece.reached.crossing is None:
        return None
    t, i = piece.reached.crossing
    x, z = piece.x[-1], piece.z[-1]
    return _at_event(piece, t, x, piece.watched(np.array([t]), x[None], z[None]), i)


def _at_event(piece: Piece, t: float, x: Vector, seen: Watched, i: int) -> Located:
    """Return the event of a relation at a known time and state."""
    return Located(piece.instant(t, x, seen.unknowns[0], seen.solved[0]), i)
