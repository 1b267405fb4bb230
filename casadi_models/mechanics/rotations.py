"""Rotation matrices, angle sequences and quaternions.

`R_AB` turns components: v in A = R_AB @ v in B. Angular velocities stand in the turned frame.
"""

from numbers import Integral

import casadi as ca
from casadi import SX, cos, sin


def about(axis: int, angle: SX | float) -> SX:
    """Return R_AB of a frame B turned in A about a common axis (1, 2 or 3), right-handed."""
    _reject_no_axis(axis)
    c, s = cos(angle), sin(angle)
    if axis == 1:
        return _rows((1, 0, 0), (0, c, -s), (0, s, c))
    if axis == 2:
        return _rows((c, 0, s), (0, 1, 0), (-s, 0, c))
    return _rows((c, -s, 0), (s, c, 0), (0, 0, 1))


def unit(axis: int) -> SX:
    """Return the unit vector along an axis (1, 2 or 3)."""
    _reject_no_axis(axis)
    return SX([float(i == axis) for i in (1, 2, 3)])


def body_fixed(axes: tuple[int, int, int], angles: SX, rates: SX) -> tuple[SX, SX]:
    """Return R_AB and the angular velocity in B of three successive body-fixed turns.

    Args:
        axes: E.g. (3, 1, 3).
        angles: (3, 1), rad.
        rates: Time derivatives of the angles, (3, 1), rad/s.
    """
    matrix, omega = SX.eye(3), SX.zeros(3)
    for axis, angle, rate in zip(axes, ca.vertsplit(angles), ca.vertsplit(rates), strict=True):
        turn = about(axis, angle)
        matrix = matrix @ turn
        omega = turn.T @ omega + rate * unit(axis)
    return matrix, omega


def from_quaternion(q: SX) -> SX:
    """Return R_AB of a unit quaternion (w, x, y, z), (4, 1)."""
    if getattr(q, "shape", None) != (4, 1):
        raise ValueError(f"{q} is no quaternion; give w, x, y and z, of shape (4, 1)")
    w, x, y, z = ca.vertsplit(q)
    return _rows(
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def quaternion_product(a: SX, b: SX) -> SX:
    """Return the Hamilton product of two quaternions (w, x, y, z): first a, then b in a's frame."""
    scalar = a[0] * b[0] - ca.dot(a[1:], b[1:])
    return ca.vertcat(scalar, a[0] * b[1:] + b[0] * a[1:] + ca.cross(a[1:], b[1:]))


def quaternion_about(axis: int, angle: SX | float) -> SX:
    """Return the quaternion of a turn about an axis (1, 2 or 3)."""
    return ca.vertcat(cos(angle / 2), sin(angle / 2) * unit(axis))


def _rows(*rows: tuple[SX | float, SX | float, SX | float]) -> SX:
    return ca.vertcat(*(ca.horzcat(*map(SX, row)) for row in rows))


def _reject_no_axis(axis: int) -> None:
    if not isinstance(axis, Integral) or axis not in (1, 2, 3):
        raise ValueError(f"axis {axis} does not exist; use 1, 2 or 3")
