"""Starts of a DAE whose index was reduced: they must satisfy what was differentiated away.

`casadi.dae_reduce_index` returns these constraints as `I`; a solution keeps them at zero if they
are zero at its start. Some states are therefore calculated from the others.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from cosim.arrays import Vector
from cosim.errors import InitialConditionError

START_TOLERANCE = 1e-12  # of a constraint at the start, relative to the starts
PIVOT = 1e-8  # below, a constraint repeats others
NEWTON_STEPS = 50


@dataclass(frozen=True)
class ConsistentStart:
    """A start that satisfies the constraints, and which states follow from the others.

    Attributes:
        x: Every state, (nx,).
        rows: Constraints that repeat no other one.
        states: As many states that these constraints determine.
    """

    x: Vector
    rows: tuple[int, ...]
    states: tuple[int, ...]


def consistent_start(
    who: str,
    constraints: ca.Function,
    x: Vector,
    p: Vector,
    names: Sequence[str],
    given: Collection[int],
) -> ConsistentStart:
    """Move states that nobody gave onto the constraints, by least squares.

    Args:
        who: For messages.
        constraints: Of (x, p), (m,).
        x, p: Starts and parameters.
        names: Of the states.
        given: Positions of states whose start was given.

    Raises:
        InitialConditionError: The given starts contradict the constraints.
    """
    slope = constraints.factory("slope", constraints.name_in(), [f"jac:{_out(constraints)}:x"])
    free = [i for i in range(x.size) if i not in given]
    x = x.copy()
    for _ in range(NEWTON_STEPS):
        residual = np.asarray(constraints(x, p)).ravel()
        if np.abs(residual).max() <= START_TOLERANCE * (1 + np.abs(x).max()):
            break
        matrix = np.asarray(ca.DM(slope(x, p)))[:, free]
        if not (np.isfinite(matrix).all() and np.isfinite(residual).all()):
            break
        x[free] -= np.linalg.lstsq(matrix, residual, rcond=1e-12)[0]
    residual = np.asarray(constraints(x, p)).ravel()
    worst = int(np.argmax(np.abs(np.nan_to_num(residual, nan=np.inf))))
    if not np.abs(residual).max() <= 1e3 * START_TOLERANCE * (1 + np.abs(x).max()):
        fixed = ", ".join(names[i] for i in sorted(given)) or "none"
        raise InitialConditionError(
            f"{who}: constraint {worst + 1} of I is {residual[worst]:.3g} at the start and cannot "
            f"vanish with the given starts ({fixed}); give consistent ones, or fewer"
        )
    rows, states = _pivots(np.asarray(ca.DM(slope(x, p))), free, sorted(given))
    return ConsistentStart(x, rows, states)


def _pivots(matrix: Vector, *groups: Sequence[int]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return rows and columns of a regular part, with columns of the first group where possible."""
    rest, size = matrix.copy(), np.abs(matrix).max(initial=0.0)
    rows: list[int] = []
    columns: list[int] = []
    for group in groups:
        for _ in range(min(len(group), matrix.shape[0])):
            part = np.abs(rest[:, group])
            row, place = np.unravel_index(int(np.argmax(part)), part.shape)
            if part[row, place] <= PIVOT * size:
                break
            column = group[int(place)]
            rows.append(int(row))
            columns.append(int(column))
            rest -= np.outer(rest[:, column] / rest[row, column], rest[row])
            rest[row] = 0.0
    return tuple(rows), tuple(columns)


def _out(function: ca.Function) -> str:
    return str(function.name_out()[0])
