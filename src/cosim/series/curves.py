"""`Curves`: a motion as polynomials, for its extremes, means and crossings between output times."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from cosim.arrays import Integers, Truths, Vector

DEFAULT_RELATIVE_TOLERANCE = 1e-8  # of solvers that do not tell theirs
_NODES = 16  # of a panel
_FINE = 64  # points of a panel between which its extremes are sought
_LEVELS = 10  # of refinement; each one computes the motion once
_PARTS = 4  # of a panel that is refined
_PER_STEP = 2  # nodes in a mean step of the solver
_MOST = 20_000  # panels of a run
_GRADE = 4  # length of a part, in that of a neighbor
_SLACK = 100.0  # errors of steps add up to about this many tolerances over a run

_AT = np.cos(np.pi * (np.arange(_NODES)[::-1] + 0.5) / _NODES)  # never an end: no event is there
_FIT = np.linalg.inv(chebyshev.chebvander(_AT, _NODES - 1))
_LOOKS = np.linspace(-1, 1, _FINE + 1)
_SEEN = chebyshev.chebvander(_LOOKS, _NODES - 1) @ _FIT  # from values at the nodes
_REAL = 1e-6  # imaginary part of a root that a double one has by rounding
_SLOPE, _BEND = (chebyshev.chebder(np.eye(_NODES), order) for order in (1, 2))
_EVEN = np.arange(0, _NODES, 2)
_WEIGHTS = (2 / (1 - _EVEN**2)) @ _FIT[_EVEN]  # Fejer's first rule: exact for the polynomial

# increasing times, s, (n,), and positions of runs, (m,), to values, (m, n, curves)
Sample = Callable[[Vector, Integers], Vector]


class Rows(NamedTuple):
    """Known values: output times, and both sides of events, in their order.

    Attributes:
        time: s, (n,).
        values: SI, (n, curves); NaN where a curve is not known.
    """

    time: Vector
    values: Vector


class Extremes(NamedTuple):
    """Smallest and largest value of each curve, (curves,), and when they occur, s."""

    low: Vector
    low_at: Vector
    high: Vector
    high_at: Vector


@dataclass(frozen=True, eq=False)
class Curves:
    """A motion over a span: on each panel, every curve is a polynomial of degree 15.

    Attributes:
        rows: Known values.
        begins, ends: Panels in the order of time, s, (panels,).
        values: At the nodes of each panel, (panels, nodes, curves).
        rough: Whether each curve is less well known than requested, (panels, curves): beside a
            jump, its polynomial overshoots.
    """

    rows: Rows
    begins: Vector
    ends: Vector
    values: Vector
    rough: Truths

    @cached_property
    def extremes(self) -> Extremes:
        """The smallest and the largest value of each curve, and when they occur."""
        (low, low_at), (high, high_at) = self._highest(-1.0), self._highest(1.0)
        return Extremes(0.0 - low, low_at, high, high_at)

    def mean(self) -> Vector:
        """Return the mean over time of each curve, (curves,)."""
        return self._mean(1)

    def rms(self) -> Vector:
        """Return the root mean square over time of each curve, (curves,)."""
        return np.asarray(np.sqrt(self._mean(2)))

    def first(self, curve: int, level: float) -> float:
        """Return when a curve first has or passes a value, s; NaN if it never does."""
        fine, seen = _times(self.begins, self.ends, _LOOKS), self.values[:, :, curve] @ _SEEN.T
        inside = ~self._at_jumps()
        times = np.concatenate((self.rows.time, fine[inside]))
        heights = np.concatenate((self.rows.values[:, curve], seen[inside])) - level
        order = np.argsort(times, kind="stable")  # rows first: they are exact
        time = first_crossing(times[order], heights[order])
        panel = int(np.searchsorted(self.begins, time, "right")) - 1
        exact = (self.rows.values[self.rows.time == time, curve] == level).any()
        if np.isnan(time) or exact or panel < 0 or time >= self.ends[panel]:
            return time
        fit = _FIT @ self.values[panel, :, curve]
        roots = chebyshev.chebroots(chebyshev.chebsub(fit, [level]))
        real = roots[np.abs(roots.imag) < _REAL].real
        begin, end = float(self.begins[panel]), float(self.ends[panel])
        place = 2 * (time - begin) / (end - begin) - 1
        near = real[np.abs(real - place) <= 2 / _FINE]
        if not near.size:
            return time
        return begin + (float(near[np.abs(near - place).argmin()]) + 1) / 2 * (end - begin)

    def _at_jumps(self) -> Truths:
        """Return which places of `_LOOKS` are ends at events, known from there, (panels, looks)."""
        time = self.rows.time
        known = [*time[1:][np.diff(time) == 0], *time[:1], *time[-1:]]
        at = np.zeros((len(self.begins), len(_LOOKS)), dtype=bool)
        at[:, 0], at[:, -1] = np.isin(self.begins, known), np.isin(self.ends, known)
        return at

    def _mean(self, power: int) -> Vector:
        time, rows = self.rows
        if len(self.begins):
            halves = (self.ends - self.begins) / 2
            total = np.einsum("p,k,pkc->c", halves, _WEIGHTS, self.values**power)
            return np.asarray(total / (2 * halves.sum()))
        if not (span := np.ptp(time)):
            return np.asarray(rows[0] ** power)
        return np.asarray(np.trapezoid(rows**power, time, axis=0) / span)

    def _highest(self, sign: float) -> tuple[Vector, Vector]:
        """Return the largest value of each curve times a sign, and when it occurs."""
        count = self.values.shape[2]
        times = np.concatenate((self.rows.time, _times(self.begins, self.ends, _AT).ravel()))
        known = sign * np.concatenate((self.rows.values, self.values.reshape(-1, count)))
        known[np.isnan(known)] = -np.inf
        best, columns = known.argmax(axis=0), np.arange(count)
        found, at = known[best, columns], times[best]
        if len(self.begins):
            seen = sign * (_SEEN @ self.values).reshape(-1, count)
            jumps = self._at_jumps()
            # beside a jump, all coefficients are about as large as the last ones
            doubt = np.where(self.rough, _NODES, 1) * _tail(_FIT @ self.values)
            seen -= np.repeat(doubt, _FINE + 1, axis=0)
            seen[jumps.ravel()] = -np.inf
            seen[~np.isfinite(seen)] = -np.inf
            panel, place = np.divmod(seen.argmax(axis=0), _FINE + 1)
            fits = _FIT @ (sign * self.values[panel, :, columns].T)
            limits = np.where(jumps[panel][:, [0, -1]], _AT[[0, -1]], _LOOKS[[0, -1]]).T
            value, where = _peaks(fits, place, limits)
            begin, end = self.begins[panel], self.ends[panel]
            noise = doubt[panel, columns] + 4 * np.spacing(np.abs(found))
            better = value - found > noise  # else the known value is as good, and exact
            found = np.where(better, value, found)
            at = np.where(better, begin + (where + 1) / 2 * (end - begin), at)
        found[np.isneginf(found)] = np.nan
        return found, at


def of_rows(rows: Rows) -> Curves:
    """Return what is known of a motion if only rows of it are."""
    count = rows.values.shape[1]
    ends, values = np.empty(0), np.empty((0, _NODES, count))
    return Curves(rows, ends, ends, values, np.empty((0, count), dtype=bool))


def curves(
    sample: Sample,
    rows: Sequence[Rows],
    steps: Sequence[int],
    accuracy: float,
    sizes: Vector,
    breaks: Iterable[float] = (),
    changes: Sequence[Vector] | None = None,
) -> list[Curves]:
    """Return motions as polynomials, each refined by itself until these fit it.

    The first panels are those of the output times. A panel is refined while it holds more than a
    few mean steps of the solver, or while the last coefficients of a curve are not small. Where
    these are small and do not fall any more, they are the noise of the solver's interpolation.

    Args:
        sample: Computes motions at times that are no breaks.
        rows: Known values of each motion, those at the common begin and end among them.
        steps: How many steps the solver took for each.
        accuracy: Relative tolerance of the solver (1).
        sizes: Nominal values of the curves, (curves,).
        breaks: Times of events, where values and slopes may jump, s.
        changes: Times of each motion, s, between which it may change within a part of a mean step.
    """
    begin, end = float(rows[0].time[0]), float(rows[0].time[-1])
    shortest = 1e3 * np.spacing(max(abs(begin), abs(end)))  # else its nodes are the same numbers
    widths = [_NODES * (end - begin) / (_PER_STEP * max(count, 1)) for count in steps]
    even = _first_edges(begin, end, breaks, len(rows[0].time))
    own_changes = changes or [np.empty(0)] * len(rows)
    first = [_with_changes(even, own, shortest).tolist() for own in own_changes]
    older = dict[tuple[int, tuple[float, float]], tuple[Vector, Vector]]()  # tails two levels up
    unknown = np.full(len(sizes), np.inf)
    leaves = [list[tuple[float, float, Vector, Truths]]() for _ in rows]
    waiting = {
        run: [panel for panel in pairwise(own) if _width(panel) > shortest]
        for run, own in enumerate(first)
    }
    largest = [_largest(own.values) for own in rows]
    for level in range(_LEVELS + 1):
        panels = sorted({panel for own in waiting.values() for panel in own})
        if not panels:
            break
        edges = np.array(panels)
        times = _times(edges[:, 0], edges[:, 1], _AT)
        runs = np.array([run for run, own in waiting.items() if own])
        table = sample(times.ravel(), runs).reshape(len(runs), *times.shape, len(sizes))
        places = {panel: i for i, panel in enumerate(panels)}
        for run, found in zip(runs.tolist(), table, strict=True):
            own, waiting[run] = waiting[run], []
            values = found[[places[panel] for panel in own]]
            largest[run] = np.maximum(largest[run], _largest(values.reshape(-1, len(sizes))))
            allowed = _SLACK * accuracy * np.maximum(largest[run], accuracy * sizes)
            with np.errstate(invalid="ignore"):
                tails = _tail(_FIT @ values)
                rough = tails > allowed
            full = len(leaves[run]) + _PARTS * len(own) > _MOST
            doubt = np.sqrt(accuracy) * largest[run]  # below it, what does not fall is noise
            for panel, here, tail, bad in zip(own, values, tails, rough, strict=True):
                before, parent = older.pop((run, panel), (unknown, unknown))
                bad &= (tail > doubt) | (tail < before / _PARTS)  # a kink falls by its square
                split = bad.any() or _width(panel) > widths[run]
                if split and level < _LEVELS and not full and _width(panel) > _PARTS * shortest:
                    parts = np.linspace(*panel, _PARTS + 1).tolist()
                    waiting[run] += pairwise(parts)
                    older |= {(run, part): (parent, tail) for part in pairwise(parts)}
                else:
                    leaves[run].append((*panel, here, bad))
    joined = (zip(*sorted(mine, key=lambda leaf: leaf[0]), strict=True) for mine in leaves)
    return [
        Curves(own, *map(np.array, columns)) if mine else of_rows(own)
        for own, mine, columns in zip(rows, leaves, joined, strict=True)
    ]


def _first_edges(begin: float, end: float, breaks: Iterable[float], count: int) -> Vector:
    """Return edges of panels between breaks with about as many nodes as there are output times."""
    edges = [begin, *sorted({time for time in breaks if begin < time < end}), end]
    found = [np.array([begin])]
    for a, b in pairwise(edges):
        parts = int(np.ceil(count / _NODES * (b - a) / (end - begin))) if b > a else 1
        found.append(np.linspace(a, b, max(1, parts) + 1)[1:])
    return np.concatenate(found)


def _with_changes(edges: Vector, changes: Vector, shortest: float) -> Vector:
    """Return edges of panels with times of changes, and with panels that grow beside these."""
    if not len(changes):
        return edges
    own = changes[np.diff(changes, prepend=-np.inf) > shortest]
    after = edges.searchsorted(own).clip(1, len(edges) - 1)
    own = own[(own - edges[after - 1] > shortest) & (edges[after] - own > shortest)]
    return graded(np.union1d(edges, own))


def graded(edges: Vector) -> Vector:
    """Return ascending edges; parts are halved that are much longer than a neighbor."""
    while True:
        gaps = np.diff(edges)
        around = np.concatenate(([np.inf], gaps, [np.inf]))
        long = gaps > _GRADE * np.minimum(around[:-2], around[2:])
        if not long.any():
            return edges
        edges = np.union1d(edges, (edges[:-1] + edges[1:])[long] / 2)


def _width(panel: tuple[float, float]) -> float:
    return panel[1] - panel[0]


def _largest(values: Vector) -> Vector:
    """Return the size of each column, (curves,)."""
    size: Vector = np.where(np.isfinite(values), np.abs(values), 0.0).max(axis=0, initial=0.0)
    return size


def first_crossing(time: Vector, heights: Vector) -> float:
    """Return the time when heights, (times,), first are or cross zero; NaN if they never do.

    It is interpolated linearly between times, s, (times,).
    """
    with np.errstate(invalid="ignore"):
        side = np.sign(heights)  # products of small heights may be 0
        passes = np.append(side[:-1] * side[1:] < 0, False) | (heights == 0)
    places = np.flatnonzero(passes)
    if not places.size:
        return float("nan")
    at = int(places[0])
    left = heights[at]
    if left == 0:
        return float(time[at])
    with np.errstate(invalid="ignore"):
        part = left / (left - heights[at + 1])
        return float(time[at] + part * (time[at + 1] - time[at]))


def _times(begins: Vector, ends: Vector, at: Vector) -> Vector:
    """Return times of places -1 ... 1 of each panel, (panels, places)."""
    middle, half = (begins + ends) / 2, (ends - begins) / 2
    return middle[:, None] + half[:, None] * at


def _tail(fits: Vector) -> Vector:
    """Return the size of the last coefficients, about that of the missing ones."""
    size: Vector = np.abs(fits[..., -3:, :]).sum(axis=-2)
    return size


def _peaks(fits: Vector, places: Integers, limits: Vector) -> tuple[Vector, Vector]:
    """Return the largest value of each polynomial around a place of `_LOOKS`, and where it is.

    Args:
        fits: Coefficients, (nodes, curves).
        places: Where the largest value of `_LOOKS` is, (curves,).
        limits: Between which places it is sought, (2, curves).
    """
    left = np.maximum(_LOOKS[np.maximum(places - 1, 0)], limits[0])
    right = np.minimum(_LOOKS[np.minimum(places + 1, _FINE)], limits[1])
    slopes, bends = _SLOPE @ fits, _BEND @ fits
    start = at = _LOOKS[places]
    for _ in range(4):  # Newton's method converges from so close a start
        slope, bend = _valued(slopes, at), _valued(bends, at)
        move = np.divide(slope, bend, out=np.zeros_like(at), where=bend < 0)
        at = np.clip(at - move, left, right)
    before, after = _valued(fits, start), _valued(fits, at)
    better = after > before
    return np.where(better, after, before), np.where(better, at, start)


def _valued(fits: Vector, at: Vector) -> Vector:
    """Return each polynomial of (orders, curves) at a place of its own, (curves,)."""
    orders = np.arange(len(fits))[:, None]
    value: Vector = (fits * np.cos(orders * np.arccos(at))).sum(axis=0)
    return value
