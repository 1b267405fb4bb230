"""`changing_parts`: where a function bends, from bounds of its distance from a line."""

from collections.abc import Callable
from typing import NamedTuple

import casadi as ca
import numpy as np
from casadi import SX

from cosim.arrays import Truths, Vector
from cosim.series.curves import graded

_STRAIGHT = 0.05  # distance of a function from a line, as a share of its range
FLAT = 1e-3  # change of a resting function in a part, as a share of its range
_AT_ONCE, _MOST_CELLS, _DEEPEST, _MOST_ROUNDS = 512, 8_000, 50, 200  # cells; halvings of one
_STRIDES = 64, 8  # cells that are looked at as one
_SAMPLES, _OF_TABLE = 64, 4  # of a cell, without bounds; if a table's knots are known
_ROUNDINGS = 64  # within which edges are one
_PARTS = 8  # of the range of a term and of the time of a pulse, at whose ends a step ends
_GREATEST = 1e300  # number whose differences are finite
_ENDS = 1e-5  # change before and after a pulse, as a share of the range
_LEAST_SIZE, GREATEST_SIZE = 1e-12, 1e30  # of a term that grows, where its places are
_GROWTH = 28.0  # asinh(value / _LEAST_SIZE) of a value near 1, about which they are dense


class Changes(NamedTuple):
    """Parts of a variable's way in which a function is no line, and changes.

    Attributes:
        parts: Begin and end of each, in order.
        low, high: Range of the function, as far as it is known.
        unknown: Begins of the cells in which it may be no line, although they were halved; not
            of those narrower than rounding, and those in which it has no value.
        pinched: Those of cells as narrow as rounding in which it may leave its value and return.
    """

    parts: list[tuple[float, float]]
    low: float
    high: float
    unknown: Vector
    pinched: Vector = np.empty(0)

    @property
    def is_whole(self) -> bool:
        """Whether the function is a line in all that was not halved to the end."""
        return not len(self.unknown)


def in_decades(term: SX) -> SX:
    """Return a function of a term, between -1 and 1, that changes with its logarithm."""
    return ca.tanh(ca.asinh(term / _LEAST_SIZE) / _GROWTH)


def unseen(edges: Vector) -> Changes:
    """Return that nothing is known of a function within cells."""
    return Changes([], np.nan, np.nan, edges[:-1])


Values = Callable[[Vector], Vector]  # a function at values of its variable
Bounds = Callable[[Vector, Vector], Vector]  # begins and widths of cells -> distances from lines


def bent_parts(
    values: Values,
    bounds: Bounds | None,
    edges: Vector,
    knots: Vector,
    *,
    is_table: bool = False,
) -> list[Vector]:
    """Return where a function bends within cells, by samples where bounds do not tell: edges.

    Where it leaves its value for less than rounding, there is one edge.

    Args:
        values, bounds, edges: See `changing_parts`; bounds are None if there are none.
        knots: Values of the variable at which the function has samples of its own.
        is_table: Whether it is a line or a cubic between these, if there are any.
    """
    if bounds is None:
        changes = unseen(edges)
    else:
        changes = changing_parts(values, bounds, _joined(values, bounds, edges))
    count = _OF_TABLE if is_table and len(knots) else _SAMPLES
    sampled = [] if changes.is_whole else _sampled_changes(values, edges, knots, changes, count)
    found = list(changes.pinched[:, None])
    for own in apart(sorted({*changes.parts, *sampled})):
        if np.ptp(own) > _ROUNDINGS * np.spacing(np.abs(own).max()):
            found.append(own)
        elif _returns(values, own, float(np.ptp(values(own)))):
            found.append(own[:1])
    return found


def _returns(values: Values, edges: Vector, size: float) -> bool:
    """Return whether a function has one value, but for a small part of a size, beyond edges."""
    first, last = edges[[0, -1]]
    room = max(_ROUNDINGS * np.spacing(np.abs(edges).max()), last - first)
    return bool(np.ptp(values(np.array([first - room, last + room]))) <= _STRAIGHT * size)


def changing_parts(values: Values, bounds: Bounds, edges: Vector) -> Changes:
    """Return where a function bends within cells of its variable.

    Args:
        values: Returns the function at values of the variable.
        bounds: Returns bounds of its distance from the line between its ends, from the begins of
            cells and their widths; NaN if there is none.
        edges: Ends of the cells, ascending.
    """
    ends = values(edges)
    if not np.isfinite(ends).any():
        return unseen(edges)
    low, high = float(np.nanmin(ends)), float(np.nanmax(ends))
    begins, widths = edges[:-1], np.diff(edges)
    least = np.maximum(widths * 2.0**-_DEEPEST, np.spacing(np.abs(edges[1:])))
    halved = np.zeros(len(widths), dtype=bool)
    valued = np.isfinite([ends[:-1], ends[1:]])  # at both ends of each cell
    off = _off(bounds, begins, widths)
    for _ in range(_MOST_ROUNDS):
        bent = np.flatnonzero(~(off <= _STRAIGHT * (high - low)) & (widths > least))
        if not len(bent) or len(begins) > len(edges) + _MOST_CELLS:
            break
        known = valued[:, bent].any(axis=0)
        bent = bent[known] if known.any() else bent
        bent = bent[np.argsort(-off[bent], kind="stable")[:_AT_ONCE]]
        half = widths[bent] / 2
        middles = begins[bent] + half
        inner = values(middles)
        low, high = float(np.nanmin([low, *inner])), float(np.nanmax([high, *inner]))
        keep = np.delete(np.arange(len(begins)), bent)
        first, last = valued[:, bent]
        middle = np.isfinite(inner)
        valued = np.hstack((valued[:, keep], [first, middle], [middle, last]))
        new = np.concatenate((begins[bent], middles))
        off = np.concatenate((off[keep], _off(bounds, new, np.tile(half, 2))))
        begins, widths = np.append(begins[keep], new), np.append(widths[keep], np.tile(half, 2))
        least, halved = (np.append(a[keep], np.tile(a[bent], 2)) for a in (least, halved))
        halved[len(keep) :] = True
    line = off <= _STRAIGHT * (high - low)
    left = np.flatnonzero(~line)
    is_narrow = (widths <= least)[left]
    known = valued[:, left]
    has_value = np.where(is_narrow, known.all(axis=0), known.any(axis=0))
    left, is_narrow = left[has_value], is_narrow[has_value]
    deep = is_narrow & np.isfinite(off[left]).all()  # what is near a pole is none
    own = begins[left[deep]], (begins + widths)[left[deep]]
    cells = sorted(zip(*(side.tolist() for side in own), strict=True))
    pinched = [own[0] for own in apart(cells) if _returns(values, own, high - low)]
    narrow = left[is_narrow & ~deep]
    around = [begins[narrow] + beside * widths[narrow] for beside in (-_ROUNDINGS, 0, _ROUNDINGS)]
    seen = np.clip([values(at) for at in around], -_GREATEST, _GREATEST)
    rests = np.ptp(seen, axis=0) <= _STRAIGHT * (high - low)  # beside a pole, it may
    unknown = begins[np.concatenate((left[~is_narrow], narrow[~rests]))]
    order = np.argsort(begins[halved & line])
    begins, widths = begins[halved & line][order], widths[halved & line][order]
    parts = _changing(values, begins, begins + widths, high - low)
    parts = parts if pinched else sorted(parts + cells)  # a jump within rounding is one
    return Changes(parts, low, high, unknown, np.array(pinched))


def _joined(values: Values, bounds: Bounds, edges: Vector) -> Vector:
    """Return the edges without those within longer cells in which a function is near one line.

    It is at most twice as far from a line between any two of its values there.
    """
    last = len(edges) - 1
    some = values(edges[:: _STRIDES[0]])
    size = np.ptp(np.clip(some, -_GREATEST, _GREATEST))  # at most the range
    kept = np.ones(last + 1, dtype=bool)
    for stride in _STRIDES:
        first = np.arange(0, last, stride)
        first = first[kept[np.minimum(first + 1, last)]]
        ends = np.minimum(first + stride, last)
        straight = _off(bounds, edges[first], edges[ends] - edges[first]) <= _STRAIGHT / 2 * size
        inner = first[straight, None] + np.arange(1, stride)
        kept[inner[inner < ends[straight, None]]] = False
    return edges[kept]


def _off(bounds: Bounds, begins: Vector, widths: Vector) -> Vector:
    """Return how far a function may be from a line within cells."""
    off = bounds(begins, widths)
    return np.asarray(np.where(np.isnan(off), np.inf, off))


def _changing(
    values: Values, begins: Vector, ends: Vector, size: float
) -> list[tuple[float, float]]:
    if not len(begins):
        return []
    changes = np.abs(values(ends) - values(begins)) > FLAT * size
    return list(zip(begins[changes].tolist(), ends[changes].tolist(), strict=True))


def changes_between(values: Values, knots: Vector) -> Changes:
    """Return which parts between knots, where alone a function bends, it changes in."""
    seen = values(knots)
    low, high = float(seen.min()), float(seen.max())
    parts = _changing(values, knots[:-1], knots[1:], high - low)
    return Changes(parts, low, high, np.empty(0))


def _sampled_changes(
    values: Values, edges: Vector, knots: Vector, known: Changes, count: int
) -> list[tuple[float, float]]:
    """Return where a function bends within cells as samples show, and its values at its knots.

    Only the cells are sampled in which bounds do not tell, with a count of samples in each.
    """
    own = knots[(edges[0] < knots) & (knots < edges[-1])]
    unknown = np.unique(edges.searchsorted(known.unknown, "right") - 1)
    shares = np.arange(count) / count
    inner = (edges[unknown, None] + np.diff(edges)[unknown, None] * shares).ravel()
    at = np.unique(np.concatenate((inner, own, edges)))
    seen = values(at)
    size = float(np.fmax(np.ptp(seen), known.high - known.low))
    off = np.abs(seen - np.interp(at, edges, np.interp(edges, at, seen))) > _STRAIGHT * size
    cells = np.clip(edges.searchsorted(at, "right") - 1, 0, len(edges) - 2)
    bent = np.bincount(cells, off, len(edges) - 1)[cells[:-1]] > 0
    return _changing(values, at[:-1][bent], at[1:][bent], size)


def apart(parts: list[tuple[float, float]]) -> list[Vector]:
    """Return the edges of parts; those are together between which is less room than each takes."""
    found = list[list[float]]()
    for a, b in parts:
        if found and a - found[-1][-1] <= min(found[-1][-1] - found[-1][0], b - a):
            found[-1] += [a, b]
        else:
            found.append([a, b])
    return [np.unique(edges) for edges in found]


def are_near(places: Vector, others: Vector) -> Truths:
    """Return which others are nearer to places than half of the way to their neighbors, (m, n)."""
    gaps = np.abs(np.diff(places, prepend=np.nan, append=np.nan))
    room = np.nan_to_num(np.fmin(gaps[:-1], gaps[1:]) / 2, posinf=0.0)
    return np.asarray(np.abs(places[:, None] - others) <= room[:, None])


def with_surroundings(edges: Vector, count: int) -> Vector:
    """Return places: in each part between edges, and as far before and after as all are long.

    Args:
        edges: Ascending, (n,).
        count: Equal intervals in each part.
    """
    length = edges[-1] - edges[0]
    every = np.concatenate(([edges[0] - length], edges, [edges[-1] + length]))
    every = every[np.append(True, np.diff(every) > _ROUNDINGS * np.spacing(np.abs(every[1:])))]
    every = graded(every)
    inner = every[:-1, None] + np.diff(every)[:, None] * np.arange(count) / count
    return np.append(inner, every[-1])


def parted(t: Vector, values: Vector, size: float) -> Vector:
    """Return times that divide a pulse into parts of little change and equal parts of time.

    The values are those of the term at the times, and the size is its range in the run.
    """
    size = max(size, float(np.ptp(values)))
    if not size:
        return t[[0, -1]]
    change = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(values))))) / size
    first, last = np.interp([_ENDS, change[-1] - _ENDS], change, t)
    way = change + np.clip((t - first) / max(last - first, np.spacing(last)), 0, 1)
    begin, end = np.interp([first, last], t, way)
    return np.interp(np.linspace(begin, end, int((end - begin) * _PARTS) + 2), way, t)
