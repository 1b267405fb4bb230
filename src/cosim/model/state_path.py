"""`StatePath`: states over time with their equations; `Bends`, `Departures`: which are lines."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import casadi as ca
import numpy as np

from cosim.arrays import Integers, Truths, Vector

_FEWEST, _MOST_SPANS = 2, 8  # rows after the first of a line; lines
_PLACES = 3  # of a path, where it is seen which states act on each other
SHORTER = 4.0  # by which the next line is shorter that is tried
SHORTEST = 1e-3  # of a run: its shortest line
_WEAK = 1e-6  # share of the strongest influence on a state that is none

Span = tuple[int, int, Truths]  # the rows between which states are lines in time, and which are


@dataclass(frozen=True, eq=False)
class StatePath:
    """States over time, with their equations.

    Attributes:
        names: Of the states.
        time: Rows, s, (n,), not descending: an event has a row before and one after it.
        states: (nx, n).
        sizes: Nominal values of the states, (nx,).
        rates: Returns dx/dt, (nx, m), at times, s, (m,), and states, (nx, m).
        slopes: Returns the derivatives of dx/dt by the states, (m, nx, nx), at times, s, (m,), and
            states, (nx, m); not finite where they have no value.
        grows: Which states may grow by acting on themselves, (nx,).
    """

    names: Sequence[str]
    time: Vector
    states: Vector
    sizes: Vector
    rates: Callable[[Vector, Vector], Vector]
    slopes: Callable[[Vector, Vector], Vector]
    grows: Truths
    _known: dict[int, Vector] = field(init=False, default_factory=dict, repr=False)

    @property
    def jumps(self) -> Integers:
        """Rows before events, (m,)."""
        return np.flatnonzero(np.diff(self.time) == 0)

    @property
    def begins(self) -> Integers:
        """The first row, and those that begin the longest parts between events, (m,)."""
        rows = self.jumps + 1
        lengths = np.diff(self.time[rows], append=self.time[-1])
        return np.append(0, rows[np.argsort(-lengths, kind="stable")[:_MOST_SPANS]])

    def since(self, time: float) -> "StatePath":
        """Return the path from a time on, s."""
        first = int(self.time.searchsorted(time))
        return replace(self, time=self.time[first:], states=self.states[:, first:])

    @cached_property
    def groups(self) -> list[Truths]:
        """Of each state that may grow, the states on which it depends, and itself, (nx,).

        Each set of states that depend on each other is there once. Weak influences are none.
        """
        rows = np.linspace(0, len(self.time) - 1, _PLACES).astype(int)
        strengths = np.fmax.reduce(np.abs(self.slopes_at(rows)), axis=0)
        finite = np.where(np.isfinite(strengths), strengths, 0)
        acts = ~(strengths <= _WEAK * finite.max(axis=1, keepdims=True))
        nx = len(acts)
        pattern = ca.Sparsity.triplet(nx, nx, *(own.tolist() for own in np.nonzero(acts)))
        _, order, ends = pattern.scc()
        found = np.eye(nx, dtype=bool)
        chosen = list[int]()
        for first, last in reversed([*pairwise(ends)]):  # each depends on later ones
            own = order[first:last]
            direct = acts[own].any(axis=0)
            direct[own] = False
            found[own] = found[direct].any(axis=0)
            found[np.ix_(own, own)] = True
            chosen += own[:1] if self.grows[own].any() else []
        return [*found[chosen]]

    def alone(self, calm: Truths) -> Truths:
        """Return which groups are lines, (g, ...), of which states are, (nx, ...)."""
        found = [calm[group].all(axis=0) for group in self.groups]
        return np.array(found, dtype=bool).reshape(-1, *calm.shape[1:])

    def slopes_at(self, rows: Integers) -> Vector:
        """Return the slopes at rows in nominal values, (m, nx, nx)."""
        missing = (row for row in dict.fromkeys(rows.tolist()) if row not in self._known)
        new = np.array(list(missing), dtype=int)
        if len(new):
            scaled = self.scaled_slopes(self.time[new], self.states[:, new])
            self._known.update(zip(new.tolist(), scaled, strict=True))
        return np.array([self._known[row] for row in rows.tolist()])

    def scaled_slopes(self, times: Vector, states: Vector) -> Vector:
        """Return `slopes` in nominal values."""
        return self.slopes(times, states) * self.sizes / self.sizes[:, None]


class Bends(NamedTuple):
    """How far a motion leaves its lines between rows that are about a step of its solver apart.

    Attributes:
        rows: In which a motion that steps follow is never straight, (m,).
        time: There, s, (m,).
        sizes: Absolute values of the states at the ends of the gaps between them, (nx, m - 1).
        bends: How far the states are there from where the gap before leads, (nx, m - 1).
    """

    rows: Integers
    time: Vector
    sizes: Vector
    bends: Vector

    @classmethod
    def of(cls, path: StatePath, steps: int) -> "Bends":
        """Return the bends of a path that a solver found in so many steps."""
        t = path.time
        wanted = np.linspace(t[0], t[-1], min(len(t), max(steps, 1) + 1))
        rows = np.minimum(t.searchsorted(wanted), len(t) - 1)
        rows = rows[np.diff(rows, prepend=-1) > 0]
        t, x = t[rows], path.states[:, rows]
        gaps = np.diff(t)
        slopes = np.diff(x, axis=1) / gaps
        if len(gaps) == 1:
            before = path.rates(t[:1], x[:, :1])
        else:
            before = np.hstack((slopes[:, 1:2], slopes[:, :-1]))
        return cls(rows, t, np.abs(x[:, 1:]), np.abs((slopes - before) * gaps))

    def spans(self, relative: float, absolute: float, path: StatePath) -> list[Span]:
        """Return the longest spans in which all states are lines, and in which some groups are.

        Args:
            relative, absolute: By how much lines bend, the absolute value in nominal values.
            path: Of which these are the bends.
        """
        calm: Truths = self.bends <= relative * self.sizes + absolute * path.sizes[:, None]
        if not calm[path.grows].any():
            return []
        rows, t = self.rows, self.time
        every = _longest(np.logical_and.reduce(calm), t)
        some = {edges for own in path.alone(calm) for edges in _longest(own, t)}.difference(every)
        chosen = [*every, *sorted(some, key=lambda edges: t[edges[0]] - t[edges[1]])[:_MOST_SPANS]]
        return [
            (int(rows[first]), int(rows[last]), np.logical_and.reduce(calm[:, first:last], axis=1))
            for first, last in chosen
        ]


class Starts(NamedTuple):
    """Lines from some rows of a path along their slopes.

    Attributes:
        rows: Where they begin, (n,).
        lengths: Their lengths, s, (n,).
        rates: dx/dt there, (nx, n).
        calm: Which states follow them, (nx, n).
    """

    rows: Integers
    lengths: Vector
    rates: Vector
    calm: Truths


class Departures(NamedTuple):
    """How far a motion may leave lines of several lengths from some rows along its slopes.

    Attributes:
        rows: Where they begin, (n,).
        lengths: Their lengths, s, (n, m).
        rates: dx/dt at the begins, (nx, n).
        sizes: Absolute values of the states at the ends of lines, (nx, n, m).
        bends: How far dx/dt at the ends leads away from the lines, (nx, n, m).
    """

    rows: Integers
    lengths: Vector
    rates: Vector
    sizes: Vector
    bends: Vector

    @classmethod
    def of(cls, path: StatePath, rows: Integers) -> "Departures":
        """Return how far lines are followed from some rows of a path."""
        t, x = path.time, path.states[:, rows, None]
        start = t[rows, None]
        rates = path.rates(start[:, 0], x[..., 0])[..., None]
        shares = SHORTER ** np.arange(0, np.log(SHORTEST) / np.log(SHORTER), -1)
        lengths = (t[-1] - start) * shares
        ends = x + lengths * rates
        there = path.rates((start + lengths).ravel(), ends.reshape(len(x), -1))
        bends = lengths * np.abs(there.reshape(ends.shape) - rates)
        return cls(rows, lengths, rates[..., 0], np.abs(ends), bends)

    def starts(self, relative: float, absolute: float, path: StatePath) -> Starts | None:
        """Return the longest lines, to a tolerance, of groups of states, if any.

        Args:
            relative, absolute: By how much lines bend, the absolute value in nominal values.
            path: From which these lead.
        """
        most = relative * self.sizes + absolute * path.sizes[:, None, None]
        calm: Truths = self.bends <= most
        alone = path.alone(calm)
        which, own = np.nonzero((alone & (alone.cumsum(axis=-1) == 1)).any(axis=0))
        known = self.rows[which], self.lengths[which, own], self.rates[:, which]
        return Starts(*known, calm[:, which, own]) if len(which) else None


def _longest(calm: Truths, t: Vector) -> list[tuple[int, int]]:
    """Return the longest spans of times, by their first and last place, whose gaps are calm."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], calm, [0])))).reshape(-1, 2)
    edges = edges[np.diff(edges)[:, 0] >= min(_FEWEST, len(calm))]
    spans = [(first, last) for first, last in edges.tolist()]
    return sorted(spans, key=lambda span: float(t[span[0]] - t[span[1]]))[:_MOST_SPANS]
