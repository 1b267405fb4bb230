"""Samples over time at other times: local polynomials that never reach across a jump."""

import numpy as np
from numpy.typing import ArrayLike

from cosim.arrays import Vector
from cosim.errors import ParameterError


def resample(time: Vector, values: Vector, at: Vector) -> tuple[Vector, Vector]:
    """Return samples at other times by local polynomials of degree 5.

    A time that stands twice is a jump: its first sample ends what comes before, its second one
    begins what comes after. Pieces of fewer samples take polynomials of a lower degree.

    Args:
        time: Sample times that do not fall, (n,), n > 0.
        values: Samples, (n, columns).
        at: Times within them, (m,).

    Returns:
        Values, (m, columns), and the largest change that degree 3 would make to each column, an
        estimate of the error.
    """
    five, three = (_local(time, values, at, points) for points in (6, 4))
    with np.errstate(invalid="ignore"):  # infinity less infinity
        gap = np.abs(five - three)
    return five, gap.max(axis=0, initial=0.0)


def times_within(owner: str, span: Vector, times: ArrayLike) -> Vector:
    """Return times that somebody asks for, of shape () or (m,), clipped to the span for rounding.

    Raises:
        ParameterError: They are no numbers, fall, or are not within the span.
    """
    try:
        wanted = np.array(times, dtype=float)
    except (TypeError, ValueError) as error:
        raise ParameterError(f"{owner}: times {error}; give numbers, s") from error
    if not len(span):
        raise ParameterError(f"{owner}: the run has no times to look between")
    begin, end = float(span[0]), float(span[-1])
    slack = 1e-9 * max(1.0, abs(begin), abs(end))
    inside = (wanted >= begin - slack) & (wanted <= end + slack)
    if wanted.ndim > 1 or not inside.all():
        first = wanted[~inside].flat[0] if wanted.size and not inside.all() else wanted.shape
        raise ParameterError(
            f"{owner}: time {first} is not within the run, {begin:g} ... {end:g} s"
        )
    if (np.diff(np.atleast_1d(wanted)) < 0).any():
        raise ParameterError(f"{owner}: the times fall; give times that increase")
    clipped: Vector = np.clip(wanted, begin, end)
    return clipped


def _local(time: Vector, values: Vector, at: Vector, points: int) -> Vector:
    """Interpolate by polynomials through as many points around each time (Neville)."""
    begins = np.flatnonzero(np.diff(time, prepend=-np.inf) == 0)  # of pieces, after a jump
    edges = np.array([0, *begins, len(time)])
    below = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 1)
    piece = np.searchsorted(edges, below, side="right") - 1
    result = np.empty((len(at), values.shape[1]))
    for p in np.unique(piece):
        first, end = edges[p], edges[p + 1]
        here = piece == p
        count = min(points, end - first)
        start = np.clip(below[here] - (count // 2 - 1), first, end - count)
        nodes = start[:, None] + np.arange(count)
        result[here] = _neville(time[nodes], values[nodes], at[here])
    return result


def _neville(t: Vector, y: Vector, at: Vector) -> Vector:
    """Evaluate polynomials through (m, count) times and (m, count, columns) values at m times."""
    table = y.copy()
    count = t.shape[1]
    for width in range(1, count):
        for i in range(count - width):
            left, right = t[:, i], t[:, i + width]
            share = ((at - left) / (right - left))[:, None]
            table[:, i] += share * (table[:, i + 1] - table[:, i])
    result: Vector = table[:, 0]
    return result
