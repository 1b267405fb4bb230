"""`Motion`: what an integration over a grid of times found, with its events."""

from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Integers, Vector
from cosim.codegen.functions import equations
from cosim.codegen.initialization import algebraic_function
from cosim.integrate.engine import Counts
from cosim.integrate.modes import Instant
from cosim.text import Ending

_ROUNDING = 1e-9  # of gaps that are equal
CERTAIN = 4  # times the error of an integral over rows


class EventRecord(NamedTuple):
    """An event of a run.

    Attributes:
        time: s.
        name: Name of the event.
        before, after: States just before and after it, (nx,).
        instant: Position of its instant in `Motion.instants`.
    """

    time: float
    name: str
    before: Vector
    after: Vector
    instant: int


@dataclass
class Motion:
    """Result of an integration over a grid, up to the last time that was reached.

    Attributes:
        dae: The model whose outputs the columns determine: with modes as further inputs.
        time: The grid, s, (n,); if an event ends the run, up to the time of that event.
        states, algebraics, u: One column per time; one of u if it is constant.
        p: Parameters.
        counts: Numbers of steps and calls.
        reason: Why the run stopped early; empty if it did not.
        solve_time: Time of the solver, s.
        events: Events in their order.
        stop: Message of the event that ended the run.
        instants: What was just before and after each instant with an event.
        note: What the steps may have passed over; empty if nothing.
    """

    dae: Dae
    time: Vector
    states: Vector
    algebraics: Vector
    u: Vector
    p: Vector
    counts: Counts
    reason: Ending = Ending()  # noqa: RUF009 (a text, which nothing changes)
    solve_time: float | None = None
    events: list[EventRecord] = field(default_factory=list)
    stop: str = ""
    instants: list[tuple[Instant, Instant]] = field(default_factory=list)
    note: str = ""

    def is_as_dense_as(self, rows: int) -> bool:
        """Tell whether its rows are nowhere farther apart than so many that are evenly spread."""
        gap, span = np.diff(self.time).max(initial=0.0), np.ptp(self.time)
        return bool(len(self.time) >= rows and (rows - 1) * gap <= (1 + _ROUNDING) * span)

    def with_sides(self) -> "Motion":
        """Return the motion with a row before and one after each instant with an event."""
        n, sides = len(self.time), [side for pair in self.instants for side in pair]
        u = np.broadcast_to(self.u, (len(self.u), n))
        if not sides:
            return replace(self, u=u)
        times = np.append([side.t for side in sides], self.time)
        order = np.argsort(times, kind="stable")
        rows = (
            ([getattr(side, name) for side in sides], own)
            for name, own in (("x", self.states), ("z", self.algebraics), ("inputs", u))
        )
        columns = (np.hstack((np.array(seen).T, own))[:, order] for seen, own in rows)
        states, algebraics, u = columns
        return replace(self, time=times[order], states=states, algebraics=algebraics, u=u)


class Path(NamedTuple):
    """What moves in a motion, and at which rates.

    Attributes:
        time: s, (n,), not descending: an instant with an event has a row before and one after it.
        states: (nx, n).
        rates: dx/dt, (nx, n).
        others: Algebraic unknowns and inputs, (rows, n), lines in time.
    """

    time: Vector
    states: Vector
    rates: Vector
    others: Vector

    @staticmethod
    def of(motion: Motion) -> "Path":
        """Return the path of a motion through its rows and its instants."""
        motion = motion.with_sides()
        rates = rates_at(motion, slice(None))
        return Path(motion.time, motion.states, rates, np.vstack((motion.algebraics, motion.u)))

    @property
    def moved(self) -> Vector:
        """Time, states, unknowns and inputs, (rows, n)."""
        return np.vstack((self.time, self.states, self.others))

    def at(self, times: Vector) -> "Path":
        """Return the path at other times: the states by cubics, where their rates are finite."""
        rows = np.clip(self.time.searchsorted(times, "right") - 1, 0, len(self.time) - 2)
        h = self.time[rows + 1] - self.time[rows]
        with np.errstate(divide="ignore", invalid="ignore"):
            s = np.where(h > 0, np.clip((times - self.time[rows]) / h, 0, 1), 1)
        change, begin, end = self._slopes(rows)
        states = self.states[:, rows] + s * (
            change + (1 - s) * ((1 - s) * (begin - change) - s * (end - change))
        )
        first, last = self.rates[:, rows], self.rates[:, rows + 1]
        others = self.others[:, rows] + s * (self.others[:, rows + 1] - self.others[:, rows])
        return Path(times, states, first + s * (last - first), others)

    def strays(self, least: Vector) -> bool:
        """Tell whether somewhere the states do not change as the integrals of their rates tell.

        Args:
            least: Differences of the states that matter, (nx,).
        """
        n = (len(self.time) - 1) // 2 * 2 + 1
        t = self.time[:n]
        rates = self.rates[:, :n]
        with np.errstate(divide="ignore", invalid="ignore"):  # at events, two rows have one time
            fine = simpson(t, rates)
            lines = (np.diff(t) * (rates[:, 1:] + rates[:, :-1]) / 2).reshape(len(rates), n // 2, 2)
            off = np.abs(np.diff(self.states[:, :n:2]) - fine)
            seen = np.maximum(least[:, None], CERTAIN * np.abs(fine - lines.sum(axis=2)))
        return bool((off > seen).any())

    def with_turns(self, row: int) -> "Path":
        """Return the path with the times at which a state turns; unchanged for one of time."""
        if row >= len(self.states):
            return self
        change, begin, end = (slope[row] for slope in self._slopes(np.arange(len(self.time) - 1)))
        turns = np.flatnonzero(begin * end < 0)
        change, begin, end = change[turns], begin[turns], end[turns]
        a, b = 3 * (begin + end) - 6 * change, 6 * change - 4 * begin - 2 * end
        root = b + np.copysign(np.sqrt(np.maximum(b**2 - 4 * a * begin, 0)), b)
        with np.errstate(divide="ignore", invalid="ignore"):
            both = np.array([-root / (2 * a), -2 * begin / root])
        share = np.where((both > 0) & (both < 1), both, np.nan)
        share = np.fmin(*share)
        times = self.time[turns] + share * np.diff(self.time)[turns]
        own = self.at(np.sort(times[np.isfinite(times)]))
        order = np.argsort(np.append(self.time, own.time), kind="stable")
        return Path(
            *(np.concatenate(pair, axis=-1)[..., order] for pair in zip(self, own, strict=True))
        )

    def _slopes(self, rows: Integers) -> tuple[Vector, Vector, Vector]:
        """Return changes of the states from rows to the next, and those by the rates at both."""
        h = self.time[rows + 1] - self.time[rows]
        change = self.states[:, rows + 1] - self.states[:, rows]
        ends = h * self.rates[:, rows], h * self.rates[:, rows + 1]
        known = np.isfinite(ends[0]) & np.isfinite(ends[1])
        begin, end = (np.where(known, own, change) for own in ends)
        return change, begin, end


def simpson(t: Vector, rows: Vector) -> Vector:
    """Return the integrals of rows between every second time; intervals need not be equal."""
    a, b = np.diff(t)[::2], np.diff(t)[1::2]
    weights = 2 - b / a, (a + b) ** 2 / (a * b), 2 - a / b
    parts = (w * rows[:, i : i + 2 * len(a) : 2] for i, w in enumerate(weights))
    return np.asarray(sum(parts) * (a + b) / 6)


def rates_at(motion: Motion, rows: Vector | slice) -> Vector:
    """Return dx/dt at rows of a motion, (nx, n), where the unknowns solve their equations."""
    t, x, z = motion.time[rows][None], motion.states[:, rows], motion.algebraics[:, rows]
    u = np.broadcast_to(motion.u, (len(motion.u), len(motion.time)))[:, rows]
    if len(z):  # the solver's own are interpolated between its steps
        with suppress(RuntimeError):  # CasADi's factorization meets a singular matrix
            solved = np.array(algebraic_function(motion.dae)(t, x, z, u, motion.p))
            z = np.where(np.isfinite(solved).all(axis=0), solved, z)
    return np.array(equations(motion.dae)(t, x, z, u, motion.p)[0])
