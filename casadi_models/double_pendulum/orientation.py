"""Body-fixed 3-1-3 angles psi, theta, phi and their quaternions.

Source  Kane, Likins & Levinson, Spacecraft Dynamics, 1983, sections 1.6 and 1.7, appendix II.
"""

import casadi as ca
from casadi import SX, cos, sin

from casadi_models.mechanics.rotations import quaternion_about, quaternion_product

SINGULAR = 1e-15  # below, sin(theta) near pi has no correct digit


def conjugate(q: SX) -> SX:
    """Return the unit quaternion of the reverse turn."""
    return ca.vertcat(q[0], -q[1:])


def to_quaternion(angles: SX) -> SX:
    """Return the quaternion (w, x, y, z) of angles (3, 1), continuous in them."""
    psi, theta, phi = ca.vertsplit(angles)
    turn = quaternion_product(quaternion_about(3, psi), quaternion_about(1, theta))
    return quaternion_product(turn, quaternion_about(3, phi))


def from_quaternion(q: SX) -> SX:
    """Return the angles of which `to_quaternion` is q and not -q; theta is in 0 ... pi.

    Exact up to rounding at every theta; where it is 0 or pi, the angle that does not exist
    (psi - phi or psi + phi) is zero.
    """
    w, x, y, z = ca.vertsplit(q)
    half_sum, half_difference = ca.atan2(z, w), ca.atan2(y, x)  # of psi and phi
    theta = 2 * ca.atan2(ca.hypot(x, y), ca.hypot(w, z))
    return ca.vertcat(half_sum + half_difference, theta, half_sum - half_difference)


def defined(angles: SX) -> SX:
    """Return the angles (3, 1), or not a number where psi and phi do not exist separately."""
    _, theta, _ = ca.vertsplit(angles)
    return angles * ca.sqrt(ca.if_else(ca.fabs(sin(theta)) < SINGULAR, -1, 1))


def angle_rates(angles: SX, rate: SX) -> SX:
    """Return d/dt of angles (3, 1) for an angular velocity in the turned frame, (3, 1).

    Not finite where sin(theta) is zero. Inverts
    w = (psi' sin(theta) sin(phi) + theta' cos(phi),
         psi' sin(theta) cos(phi) - theta' sin(phi), psi' cos(theta) + phi').
    """
    _, theta, phi = ca.vertsplit(angles)
    psi_dot = (rate[0] * sin(phi) + rate[1] * cos(phi)) / sin(theta)
    theta_dot = rate[0] * cos(phi) - rate[1] * sin(phi)
    return ca.vertcat(psi_dot, theta_dot, rate[2] - psi_dot * cos(theta))
