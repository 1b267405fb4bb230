"""Rotations as arrays: matrices and unit quaternions (w, x, y, z)."""

import numpy as np

from cosim.arrays import Vector


def to_quaternions(matrices: Vector) -> Vector:
    """Return unit quaternions (w, x, y, z), (..., 4), of rotation matrices, (..., 3, 3).

    Of the four formulas of Shepperd (1978) the one with the largest divisor is used.
    """
    m = matrices
    trace = np.trace(m, axis1=-2, axis2=-1)
    diagonal = np.diagonal(m, axis1=-2, axis2=-1)
    sizes = np.stack([trace, *(diagonal[..., i] for i in range(3))], axis=-1)
    table = np.empty((*trace.shape, 4, 4))
    table[..., 0, 0] = 1 + trace
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        table[..., 0, i + 1] = table[..., i + 1, 0] = m[..., k, j] - m[..., j, k]
        table[..., i + 1, i + 1] = 1 + 2 * diagonal[..., i] - trace
        table[..., i + 1, j + 1] = table[..., j + 1, i + 1] = m[..., j, i] + m[..., i, j]
    best = np.argmax(sizes, axis=-1)
    chosen = np.take_along_axis(table, best[..., None, None], axis=-2)[..., 0, :]
    result: Vector = chosen / np.linalg.norm(chosen, axis=-1, keepdims=True)
    return result


def continuous(quaternions: Vector) -> Vector:
    """Return the same rotations, (n, ..., 4), without jumps of sign along the first axis."""
    signs = np.sign((quaternions[1:] * quaternions[:-1]).sum(axis=-1))
    signs[signs == 0] = 1.0
    first = np.ones_like(quaternions[:1, ..., 0])
    every = np.concatenate([first, np.cumprod(signs, axis=0)])
    result: Vector = quaternions * every[..., None]
    return result


def to_matrices(quaternions: Vector) -> Vector:
    """Return rotation matrices, (..., 3, 3), of unit quaternions (w, x, y, z), (..., 4)."""
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def onto(direction: Vector) -> Vector:
    """Return the smallest rotation, (3, 3), that turns the third axis into a direction, (3,)."""
    length = float(np.linalg.norm(direction))
    if not length > 0:
        return np.eye(3)
    x, y, z = direction / length
    if z < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    k = 1 / (1 + z)
    return np.array([[1 - k * x * x, -k * x * y, x], [-k * x * y, 1 - k * y * y, y], [-x, -y, z]])
