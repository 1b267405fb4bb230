"""Statistics over runs that can be merged, with the same bits however the runs were grouped.

Means and variances merge along one binary tree over the positions of the runs (Chan, Golub &
LeVeque, The American Statistician 37, 1983), whatever part of it a chunk holds. Quantiles come from
counts in bins of relative width 1/128 (as DDSketch: Masson, Rim & Lee, VLDB 12, 2019; the bins here
are the leading bits of the number, so that nothing is rounded).
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cosim.arrays import Integers, Truths, Vector

_SHIFT = 45  # keeps sign, exponent and 7 bits of a double: 19 bits
_SKETCH_KEYS = np.int64(1) << 19
_MIDDLE = np.int64(1) << 18


@dataclass(frozen=True, eq=False)
class Node:
    """Statistics of the runs from `first` on, `size` of them, a power of two that divides `first`.

    Attributes:
        count, mean, squares, low, high: Per time and column: runs, mean, sum of squared deviations,
            extremes; (times, columns).
    """

    first: int
    size: int
    count: Integers
    mean: Vector
    squares: Vector
    low: Vector
    high: Vector


def node_of(first: int, values: Vector, good: Truths) -> Node:
    """Return the statistics of the good runs among consecutive ones.

    Args:
        first: Position of the first run, a multiple of the next power of two of their number.
        values: (runs, times, columns).
        good: Which runs count, (runs,).
    """
    size = 1 << max(0, len(values) - 1).bit_length()
    shape = (size, *values.shape[1:])
    count = np.zeros(shape, dtype=np.int64)
    count[: len(values)] = good[:, None, None]
    mean = np.zeros(shape)
    mean[: len(values)] = np.where(good[:, None, None], values, 0.0)
    parts = [count, mean, np.zeros(shape)]
    parts += [np.where(count > 0, mean, limit) for limit in (np.inf, -np.inf)]
    while len(parts[0]) > 1:
        parts = _merged([part[0::2] for part in parts], [part[1::2] for part in parts])
    return Node(first, size, *(part[0] for part in parts))


def merged_branches(nodes: list[Node]) -> list[Node]:
    """Merge the last of consecutive nodes as far as whole branches of the tree are there."""
    stack = list(nodes)
    while len(stack) > 1 and stack[-1].size == stack[-2].size and _siblings(*stack[-2:]):
        right, left = stack.pop(), stack.pop()
        stack.append(_joined(left, right))
    return stack


def merged(nodes: Iterable[Node]) -> Node:
    """Merge nodes that follow each other; the last may end anywhere."""
    stack: list[Node] = []
    for node in nodes:
        stack = merged_branches([*stack, node])
    last = stack.pop()
    while stack:  # what is missing to whole branches counts nothing
        last = _joined(stack.pop(), last)
    return last


def _siblings(left: Node, right: Node) -> bool:
    return left.first % (2 * left.size) == 0 and right.first == left.first + left.size


def _joined(left: Node, right: Node) -> Node:
    parts = _merged(*([n.count, n.mean, n.squares, n.low, n.high] for n in (left, right)))
    return Node(left.first, 2 * left.size, *parts)


def _merged(a: list[NDArray], b: list[NDArray]) -> list[NDArray]:  # type: ignore[type-arg]
    """Merge count, mean, squares, low and high; what is empty leaves the other's bits alone."""
    count = a[0] + b[0]
    whole = np.maximum(count, 1)
    shift = b[1] - a[1]
    mean = a[1] + shift * (b[0] / whole)
    squares = a[2] + b[2] + shift * shift * (a[0] * b[0] / whole)
    only_a, only_b = b[0] == 0, a[0] == 0
    mean = np.where(only_a, a[1], np.where(only_b, b[1], mean))
    squares = np.where(only_a, a[2], np.where(only_b, b[2], squares))
    return [count, mean, squares, np.minimum(a[3], b[3]), np.maximum(a[4], b[4])]


@dataclass(frozen=True, eq=False)
class Sketch:
    """Counts of values in bins, for every time and column: codes in increasing order."""

    codes: Integers
    counts: Integers


def sketch_of(values: Vector, good: Truths) -> Sketch:
    """Return the counts of the good runs' values, (runs, times, columns)."""
    chosen = np.ascontiguousarray(values[good])
    bits = chosen.view(np.int64)
    size = (bits & np.int64(0x7FFF_FFFF_FFFF_FFFF)) >> _SHIFT
    keys = np.where(bits < 0, -size, size) + _MIDDLE
    series = np.arange(values[0].size, dtype=np.int64).reshape(values.shape[1:])
    codes, counts = np.unique(series * _SKETCH_KEYS + keys, return_counts=True)
    return Sketch(codes, counts.astype(np.int64))


def added(left: Sketch, right: Sketch) -> Sketch:
    """Return the counts of both."""
    codes, places = np.unique(np.concatenate((left.codes, right.codes)), return_inverse=True)
    counts = np.zeros(len(codes), dtype=np.int64)
    np.add.at(counts, places, np.concatenate((left.counts, right.counts)))
    return Sketch(codes, counts)


def quantile(sketch: Sketch, node: Node, q: float) -> Vector:
    """Return a quantile per time and column, (times, columns), within 0.4 % of its value."""
    series = sketch.codes // _SKETCH_KEYS
    total = np.bincount(series, sketch.counts, node.mean.size).astype(np.int64)
    before = np.cumsum(sketch.counts)
    begin = np.concatenate(([0], np.cumsum(total)))[:-1]
    rank = begin + np.maximum(np.ceil(q * total), 1).astype(np.int64)
    place = np.minimum(np.searchsorted(before, rank), len(before) - 1)
    keys = sketch.codes[place] % _SKETCH_KEYS - _MIDDLE
    middle = (np.abs(keys) << _SHIFT) + (np.int64(1) << (_SHIFT - 1))
    found = np.where(keys == 0, 0.0, np.copysign(middle.view(np.float64), keys))
    shaped = np.where(total > 0, found, np.nan).reshape(node.mean.shape)
    return np.clip(shaped, node.low, node.high)
