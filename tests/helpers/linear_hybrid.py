"""Courses of piecewise linear systems with dry contacts, events and samplers, by exponentials.

They know neither CasADi nor our code. Between switches y' = M y, where y holds states, discrete
variables, sines of time and 1. A switch is a change of sign of a row times y; it is looked for on
a fine grid, and located with Brent's method.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

POINTS = 4000  # of the grid of a run, on which switches are looked for
ROWS = 200  # of its output
MOST_EVENTS = 100  # of a course
_ZERO = 1e-11  # what rounding leaves of 0


class TooManyEvents(Exception):
    """A course that switches ever faster."""


@dataclass(frozen=True)
class Contact:
    """A term `along * sign(of @ y)` of y', which sticks where no sign is consistent."""

    along: np.ndarray
    of: np.ndarray


@dataclass(frozen=True)
class When:
    """y becomes `new @ y` as `of @ y` becomes positive."""

    name: str
    of: np.ndarray
    new: np.ndarray


@dataclass(frozen=True)
class Every:
    """y becomes `new @ y` at each multiple of a period, s, from 0 s on."""

    name: str
    period: float
    new: np.ndarray


@dataclass
class Course:
    """Values at `ROWS` + 1 times, events by time, and how near other events were.

    A margin of 1e-5 means that a condition was missed or touched by so little, or met so slowly,
    that solvers may see it differently.
    """

    time: np.ndarray
    values: np.ndarray
    events: list[tuple[float, str]] = field(default_factory=list)
    margin: float = math.inf

    @property
    def gap(self) -> float:
        """Shortest time between two instants with events, s."""
        times = sorted({time for time, _ in self.events})
        return min(np.diff(times), default=math.inf)


@dataclass(frozen=True)
class LinearHybrid:
    """y' = flow @ y and contacts, with events and samplers."""

    flow: np.ndarray
    contacts: Sequence[Contact] = ()
    whens: Sequence[When] = ()
    everys: Sequence[Every] = ()

    def course(self, start: np.ndarray, stop: float) -> Course:
        """Return the course from a start value to a stop time, s.

        Raises:
            TooManyEvents: There are more than `MOST_EVENTS`.
        """
        times = np.linspace(0, stop, ROWS + 1)
        return _Run(self, Course(times, np.full((ROWS + 1, len(start)), np.nan)), start).done()


class _Run:
    def __init__(self, law: LinearHybrid, course: Course, start: np.ndarray) -> None:
        self.law, self.result = law, course
        self.time, self.stop = 0.0, course.time[-1]
        self.y = np.array(start, dtype=float)
        self.taken = [0] * len(law.everys)
        self.modes = [0] * len(law.contacts)
        self.true = [bool(when.of @ self.y > 0) for when in law.whens]

    def done(self) -> Course:
        """Go to the stop time."""
        self._happen()
        while self.time < self.stop:
            self._advance()
        self.result.values[-1] = self.y
        return self.result

    def _advance(self):
        flow, shares = self._motion(self.modes)
        until = min([self._due(i) for i in range(len(self.taken))] + [self.stop])
        guards = self._guards(shares)
        end, which = self._first(flow, guards, until)
        self._record(flow, end)
        self.y, self.time = expm(flow * (end - self.time)) @ self.y, end
        held = {}
        if which is not None:
            kind, i, side = guards[which][1]
            if kind == "when":
                self.true[i] = not self.true[i]
                if self.true[i]:
                    self._assign(self.law.whens[i])
            else:
                self.result.events.append((self.time, f"contact {i}"))
            held = {i: side} if kind == "release" else {}
            if kind == "contact":
                self.modes[i] = 0
        self._happen(held)

    def _due(self, i):
        return self.taken[i] * self.law.everys[i].period

    def _happen(self, held=None):
        """Take due samples, then events that follow, then find the modes of the contacts."""
        for i, every in enumerate(self.law.everys):
            if self._due(i) <= self.time * (1 + 1e-14):
                self.taken[i] += 1
                self._assign(every)
        changed = True
        while changed:
            changed = False
            for i, when in enumerate(self.law.whens):
                value = when.of @ self.y
                was, self.true[i] = (
                    self.true[i],
                    value > (0 if abs(value) > _ZERO else math.inf)
                    or (self.true[i] and abs(value) <= _ZERO),
                )
                if self.true[i] and not was:
                    self._assign(when)
                    changed = True
        self._settle(held or {})

    def _assign(self, event):
        self.result.events.append((self.time, event.name))
        if len(self.result.events) > MOST_EVENTS:
            raise TooManyEvents
        self.y = event.new @ self.y

    def _settle(self, held):
        """Find consistent modes: sliding, or a sign in whose direction the motion leads."""
        speeds = [contact.of @ self.y for contact in self.law.contacts]
        choices = [[held[i]] if i in held else [0, 1, -1] if abs(s) <= _ZERO else [np.sign(s)]
                   for i, s in enumerate(speeds)]  # fmt: skip
        for modes in product(*choices):
            if self._consistent(modes, speeds, held):
                self.modes = list(modes)
                return
        raise AssertionError(f"no consistent modes at {self.time} s")

    def _consistent(self, modes, speeds, held):
        flow, shares = self._motion(modes)
        for i, (mode, contact) in enumerate(zip(modes, self.law.contacts, strict=True)):
            if mode == 0 and abs(shares[i] @ self.y) > 1:
                return False
            leaves = mode * (contact.of @ flow @ self.y)
            if mode != 0 and abs(speeds[i]) <= _ZERO and i not in held and leaves <= 0:
                return False
        return True

    def _motion(self, modes):
        """Return the matrix of y', and the rows that give the shares of sticking contacts."""
        contacts = self.law.contacts
        stuck = [i for i, mode in enumerate(modes) if mode == 0]
        flow = self.law.flow.copy()
        one = np.zeros(len(self.y))
        one[-1] = 1
        for mode, contact in zip(modes, contacts, strict=True):
            flow += mode * np.outer(contact.along, one)
        if not stuck:
            return flow, {}
        of = np.array([contacts[i].of for i in stuck])
        along = np.array([contacts[i].along for i in stuck]).T
        shares = -np.linalg.solve(of @ along, of @ flow)
        return flow + along @ shares, dict(zip(stuck, shares, strict=True))

    def _guards(self, shares):
        """Return rows that are positive until something happens, and what happens then."""
        one = np.zeros(len(self.y))
        one[-1] = 1
        guards = []
        for i, contact in enumerate(self.law.contacts):
            if self.modes[i]:
                guards.append((self.modes[i] * contact.of, ("contact", i, 0)))
            else:
                guards += [(one - side * shares[i], ("release", i, side)) for side in (1, -1)]
        for i, when in enumerate(self.law.whens):
            guards.append(((1 if self.true[i] else -1) * when.of, ("when", i, 0)))
        return guards

    def _first(self, flow, guards, until):
        """Return when the first guard leaves, and which one, or `until` and None."""
        if not guards or until <= self.time:
            return until, None
        rows = np.array([row for row, _ in guards])
        count = max(8, math.ceil((until - self.time) / self.stop * POINTS))
        step = (until - self.time) / count
        points = _along(flow, self.y, step, count)
        values, rates = rows @ points, rows @ flow @ points
        end, which = until, None
        for g in range(len(guards)):
            outside = np.flatnonzero(values[g] < -_ZERO)
            found = (
                self._root(flow, rows[g], step * (outside[0] - 1), step) if len(outside) else until
            )
            if found < end:
                end, which = found, g
        inside = max(1, math.floor((end - self.time) / step))
        turns = np.diff(np.sign(rates[:, : inside + 1]), axis=1) != 0
        near = np.abs(values[:, :inside])[turns[:, :inside]]
        speeds = [] if which is None else [abs(rows[which] @ flow @ self._later(flow, end))]
        away = near[near > _ZERO]
        self.result.margin = min([self.result.margin, *away, *speeds])
        return end, which

    def _later(self, flow, time):
        return expm(flow * (time - self.time)) @ self.y

    def _root(self, flow, row, after, step):
        start = expm(flow * after) @ self.y
        value = lambda t: row @ expm(flow * t) @ start  # noqa: E731
        if value(0.0) <= 0:
            return self.time + after
        return self.time + after + brentq(value, 0, step, xtol=1e-15)

    def _record(self, flow, end):
        rows = np.flatnonzero((self.result.time >= self.time) & (self.result.time < end))
        if len(rows):
            first = self._later(flow, self.result.time[rows[0]])
            step = self.stop / ROWS
            self.result.values[rows] = _along(flow, first, step, len(rows) - 1).T


def _along(flow, y, step, count):
    """Return y at count + 1 equal steps, as columns."""
    points, across = y[:, None], expm(flow * step)
    while points.shape[1] < count + 1:
        points = np.hstack((points, across @ points))
        across = across @ across
    return points[:, : count + 1]
