"""Loads on the bicycle: weight of both gyrostats, torques of rider and drive.

A further load is a `kane.Load` here: a force along a velocity or a torque along a rate, each pair
in the same axes. Contact forces of the ground are no loads: rolling constraints determine them.
"""

from typing import NamedTuple

import casadi as ca
from casadi import SX

from casadi_models.bicycle.declaration import Torques
from casadi_models.mechanics import kane


class Carried(NamedTuple):
    """A gyrostat: mass, kg; velocity of its mass center, m/s, and N3 (down), in the same axes."""

    mass: SX
    velocity: SX
    down: SX


def loads(g: SX, torques: Torques, u: SX, rear: Carried, front: Carried) -> tuple[kane.Load, ...]:
    """Return all loads.

    Args:
        g: Gravity, m/s2.
        torques: The inputs, N.m.
        u: Rates of phi, thetaR, delta, psi, theta, thetaF, rad/s.
        rear, front: Rear frame with its wheel, and fork with its wheel.
    """
    phi_dot, thetaR_dot, delta_dot, _, _, _ = ca.vertsplit(u)
    return (
        kane.Load(rear.velocity, rear.mass * g * rear.down),
        kane.Load(front.velocity, front.mass * g * front.down),
        kane.Load(delta_dot, torques.steer),
        kane.Load(phi_dot, torques.roll),
        kane.Load(thetaR_dot, torques.rear_wheel),
    )
