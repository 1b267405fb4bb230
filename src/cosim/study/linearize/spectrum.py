"""Eigenvalues of a matrix by its structure, with the errors that rounding leaves in them."""

from dataclasses import dataclass

import numpy as np

from cosim.arrays import Truths, Vector
from cosim.series.samples import ROUNDING_OF_OTHERS

EPS = float(np.finfo(float).eps)
MOST_BALANCINGS = 50


def balance(matrix: Vector) -> Vector:
    """Return scales of the states, powers of 2, with which rows and columns are equally large.

    So the accuracy of the eigenvalues does not depend on units (Parlett and Reinsch 1969).
    """
    scale, own = np.ones(len(matrix)), np.abs(matrix) * (1 - np.eye(len(matrix)))
    for _ in range(MOST_BALANCINGS):
        before = scale.copy()
        for i in range(len(own)):
            column, row = own[:, i].sum(), own[i].sum()
            if column and row:
                factor = 2.0 ** round(np.log2(row / column) / 2)
                own[:, i] *= factor
                own[i] /= factor
                scale[i] *= factor
        if np.array_equal(before, scale):
            break
    return scale


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Eigenvalues of a matrix, (n,), with eigenvectors.

    Attributes:
        values: Eigenvalues.
        right: Right eigenvectors as columns, (n, n).
        left: Left eigenvectors as rows, (n, n), scaled so that left @ right is the identity; not
            finite where the matrix is defective.
        errors: Estimated errors from rounding, (n,); they do not depend on units.
    """

    values: Vector
    right: Vector
    left: Vector
    errors: Vector

    @classmethod
    def of(cls, matrix: Vector, noise: Vector) -> "Spectrum":
        """Return the spectrum of a matrix whose entries are known but for `noise`, both (n, n)."""
        if len(matrix) == 1:
            one, size = np.ones((1, 1)), np.abs(matrix) * EPS + noise
            return cls(matrix[0].astype(complex), one, one, size[0])
        scale = balance(matrix)
        own, noise = (rows / scale[:, None] * scale for rows in (matrix, noise))
        values, right = np.linalg.eig(own)
        try:
            left = np.linalg.inv(right)
        except np.linalg.LinAlgError:
            left = np.full_like(right, np.inf)
        largest = float(np.abs(own).max()) or 1.0  # so that no square overflows
        norm = largest * float(np.linalg.norm(own / largest))
        doubt = len(own) * EPS * norm + float(np.linalg.norm(noise))
        condition = np.linalg.norm(left, axis=1) * np.linalg.norm(right, axis=0)
        most = norm * EPS ** (1 / len(own))  # a multiple eigenvalue splits by a root of the error
        errors = np.fmin(condition * doubt, most + float(np.linalg.norm(noise)))
        return cls(values.astype(complex), right * scale[:, None], left / scale, errors)

    def moved(self, change: Vector) -> Vector:
        """Return the eigenvalues after a change of the matrix, (n, n), to first order."""
        with np.errstate(invalid="ignore", over="ignore"):
            found = self.values + np.einsum("ij,jk,ki->i", self.left, change, self.right)
        return np.where(np.isfinite(found), found, self.values)


def rate_sizes(slopes: Vector, sizes: Vector) -> Vector:
    """Return how large rates are where one state has its size, (rows,).

    A row of zeros, as rounding knows them, has the size of the largest one.

    Args:
        slopes: Derivatives of the rates by the states, (rows, states).
        sizes: Sizes of the states, (states,).
    """
    found: Vector = (np.abs(slopes) * sizes).max(axis=1, initial=0.0)
    largest = found.max(initial=0.0)
    found[found <= ROUNDING_OF_OTHERS * largest] = largest
    return found


def reachable(influence: Truths) -> Truths:
    """Return whether a state influences a rate, directly or through other states."""
    reach: Truths = np.asarray(influence) != 0
    for k in range(len(reach)):
        reach = reach | np.outer(reach[:, k], reach[k, :])
    return reach


def blocks(influence: Truths) -> tuple[tuple[int, ...], ...]:
    """Return the groups of states that influence each other, directly or through other states."""
    reach = reachable(influence) | np.eye(len(influence), dtype=bool)
    both = reach & reach.T
    return tuple(dict.fromkeys(tuple(map(int, np.flatnonzero(row))) for row in both))


def without_influence(depends: Truths) -> tuple[int, ...]:
    """Return the columns on which only rows of the same group depend."""
    every = range(len(depends))
    needed = list(every)
    while free := [i for i in needed if not depends[np.ix_(needed, [i])].any()]:
        needed = [i for i in needed if i not in free]
    return tuple(i for i in every if i not in needed)


SURE = 3.0  # times the cost of a pair that is sure, other pairs cost at least


@dataclass(frozen=True, eq=False)
class Step:
    """How the eigenvalues of one matrix continue as those of another one.

    Attributes:
        partners: For each eigenvalue of the first matrix, its index in the second one.
        cost: How far the eigenvalues are from where the change of the matrix moves them, to first
            order and from both sides, (n, n).
    """

    partners: tuple[int, ...]
    cost: Vector

    @classmethod
    def between(cls, first: Spectrum, second: Spectrum, change: Vector) -> "Step":
        """Return the step for a change of the matrix, (n, n)."""
        cost = np.abs(first.moved(change)[:, None] - second.values)
        cost += np.abs(second.moved(-change) - first.values[:, None])
        return cls(tuple(_improved(cost, _nearest(cost))), cost)

    def is_sure(self, first: Vector, second: Vector) -> bool:
        """Tell whether it is sure which eigenvalues change sides.

        Args:
            first, second: Sides of the eigenvalues of both matrices: -1, 0 or 1, (n,).
        """
        later, every = second[list(self.partners)], range(len(first))
        return not any(
            first[i] != first[k] and later[i] != later[k] and self._exchanged(i, k) < SURE
            for i in every
            for k in every
            if i < k
        )

    def _exchanged(self, i: int, k: int) -> float:
        """Return the cost of two pairs with their partners exchanged, relative to their own."""
        j, m = self.partners[i], self.partners[k]
        other, own = self.cost[i, m] + self.cost[k, j], self.cost[i, j] + self.cost[k, m]
        return float(other / own) if own else np.inf


def _nearest(cost: Vector) -> list[int]:
    """Return a column for each row, the pairs of least cost first."""
    left, chosen = cost.copy(), [0] * len(cost)
    for _ in chosen:
        i, j = divmod(int(left.argmin()), len(cost))
        chosen[i] = j
        left[i, :] = left[:, j] = np.inf
    return chosen


def _improved(cost: Vector, chosen: list[int]) -> list[int]:
    """Exchange the columns of two rows as long as that lowers the sum of the costs."""
    pairs = [(i, k) for k in range(len(chosen)) for i in range(k)]
    changed = True
    while changed:
        changed = False
        for i, k in pairs:
            now = cost[i, chosen[i]] + cost[k, chosen[k]]
            if cost[i, chosen[k]] + cost[k, chosen[i]] < now * (1 - 1e-9):
                chosen[i], chosen[k] = chosen[k], chosen[i]
                changed = True
    return chosen
