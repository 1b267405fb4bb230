"""Slopes of constraints, a row for each: what they determine, and which one repeats others."""

from collections.abc import Sequence

import casadi as ca
from casadi import DM

REPEATED = 1e-9  # of the largest entry: what is left of a row that repeats others
VANISHED = 1e-12  # of the largest entry: columns of a unit that rounding has left


def in_sizes_of_units(slopes: DM, units: Sequence[str]) -> DM:
    """Return slopes whose columns are divided by the largest entry of all that have their unit.

    The unit of length then makes no difference: a mechanism may be of micrometers or of meters.

    Args:
        slopes: (m, n).
        units: Of the columns, (n,).

    Example:
        >>> in_sizes_of_units(DM([[4, 2, 5]]), ["m", "m", "rad"])
        DM([[1, 0.5, 1]])
    """
    tops = [float(ca.norm_inf(column)) for column in ca.horzsplit(slopes)]
    sizes = {unit: max(t for t, u in zip(tops, units, strict=True) if u == unit) for unit in units}
    least = VANISHED * max(tops, default=0.0)
    factors = DM([1 / sizes[unit] if sizes[unit] > least else 1.0 for unit in units])
    return slopes @ ca.diag(ca.reshape(factors, len(units), 1))


def determined(slopes: DM) -> tuple[list[int], list[int]]:
    """Return columns that rows determine, later ones first, by elimination with pivots.

    Args:
        slopes: (m, n).

    Returns:
        As many columns as the rank, in order, and the rows that are left over.

    Example:
        >>> determined(DM([[1, 1, 0], [2, 2, 0]]))
        ([1], [0])
    """
    m, n = slopes.shape
    rows = [[float(v) for v in ca.horzsplit(row)] for row in ca.vertsplit(slopes)]
    largest = max((abs(v) for row in rows for v in row), default=0.0)
    found, left = list[int](), list(range(m))
    for column in reversed(range(n)):
        if not left:
            break
        pivot = max(left, key=lambda r: abs(rows[r][column]))
        if abs(rows[pivot][column]) <= max(REPEATED, 1e-6 * (n > m)) * largest:
            continue
        left.remove(pivot)
        found.append(column)
        for r in left:
            factor = rows[r][column] / rows[pivot][column]
            rows[r] = [a - factor * b for a, b in zip(rows[r], rows[pivot], strict=True)]
    return sorted(found), left


def first_repeating(slopes: DM, otherwise: int) -> int:
    """Return the first row that those before it span.

    Args:
        slopes: (m, n).
        otherwise: What is returned where there is none.

    Example:
        >>> first_repeating(DM([[1, 0], [0, 1], [3, 4]]), 0)
        2
    """
    known = DM(0, slopes.shape[1])
    for i, row in enumerate(ca.vertsplit(ca.densify(slopes))):
        rest = row
        for _ in range(2):  # twice is enough (Kahan): against cancellation
            rest -= (rest @ known.T) @ known
        length = float(ca.norm_2(rest))
        if length <= REPEATED * max(float(ca.norm_2(row)), REPEATED):
            return i
        known = ca.vertcat(known, rest / length)
    return otherwise
