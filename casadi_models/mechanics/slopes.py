"""Slopes of constraints, a row for each: what they determine, and which one repeats others."""

import casadi as ca
from casadi import DM

REPEATED = 1e-9  # of the largest entry: what is left of a row that repeats others


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
