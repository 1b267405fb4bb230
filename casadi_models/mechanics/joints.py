"""The joint with six freedoms: a body loose from its carrier, to be held by constraints.

Its coordinates measure what the real joint forbids (a displacement and two tilts, all zero where
it holds) and the one angle that it leaves free; its speeds are resolved in the axes in which the
joint acts. The constraints are then linear in the speeds with constant coefficients: integrators
keep linear invariants, so that the index-1 DAE does not drift beyond rounding.

Source  Body-fixed turns i, j, k in cyclic order; Kane, Likins & Levinson, Spacecraft Dynamics,
        1983, appendix II (1-2-3).
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import casadi as ca
from casadi import SX, cos, sin

from casadi_models.dae import Model
from casadi_models.mechanics import conditions, kane, rotations

_DISPLACED = 0.1  # nominal values, m, rad and per second, of what stays 0 but for errors


@dataclass(frozen=True)
class FreeJoint:
    """The motion of a body relative to its carrier; columns of three unless said otherwise.

    Attributes:
        shift: Displacement of a point of the body, in the carrier's axes, m.
        velocity: Its rate of change seen from the carrier, in the axes asked for, m/s.
        tilts: Angles about the other two axes, (2, 1), rad.
        rotation: R of the body in the carrier, (3, 3).
        omega: Angular velocity relative to the carrier, in the body's axes, rad/s.
        q, q_dot: Coordinates (shift, tilts, angle) and their rates, (6, 1).
        speeds, accelerations: Speeds (velocity, omega) and their unknown rates, (6, 1).
    """

    shift: SX
    velocity: SX
    tilts: SX
    rotation: SX
    omega: SX
    q: SX
    q_dot: SX
    speeds: SX
    accelerations: SX


def free_joint(
    model: Model,
    body: str,
    axis: int,
    angle: SX,
    rate: SX,
    acceleration: str,
    *,
    velocity_in: Literal["body", "carrier"],
) -> FreeJoint:
    """Declare the motion of a body loose from its carrier, with unknown accelerations.

    Args:
        model: Receives ten states, six algebraic unknowns and the derivatives of all twelve states.
        body: Begins the names of the new variables.
        axis: Of the angle (1, 2 or 3), in the body.
        angle: State, rad; regular while the tilts are below 90 deg.
        rate: State, rad/s; the angular velocity about `axis`, which is the angle's rate where
            the tilts rest.
        acceleration: Name for the unknown rate of `rate`.
        velocity_in: Whose axes resolve the velocity: those in which the joint's forces act.
    """
    i, j = axis % 3 + 1, (axis + 1) % 3 + 1  # i, j, axis are in cyclic order

    def states(names: list[str], unit: str, meaning: str) -> SX:
        """Declare states at rest; their names end with the axis."""
        declared = (
            model.state(f"{body}_{n}", unit, 0.0, f"{meaning} {n[-1]}", nominal=_DISPLACED)
            for n in names
        )
        return ca.vertcat(*declared)

    shift = states(["shift_1", "shift_2", "shift_3"], "m", f"displacement of {body} along axis")
    tilts = states([f"tilt_{i}", f"tilt_{j}"], "rad", f"tilt of {body} about axis")
    velocity = states(["v1", "v2", "v3"], "m/s", f"velocity of {body} along axis")
    w_tilts = states([f"w{i}", f"w{j}"], "rad/s", f"angular velocity of {body} about axis")
    accelerations = _accelerations(model, body, axis, acceleration)

    # Angular velocity of the turns i, j, axis, solved for the rates of the angles
    a, b = ca.vertsplit(tilts)
    w_i, w_j = ca.vertsplit(w_tilts)
    a_dot = (w_i * cos(angle) - w_j * sin(angle)) / cos(b)
    b_dot = w_i * sin(angle) + w_j * cos(angle)
    named = {i: w_i, j: w_j, axis: rate}
    omega = ca.vertcat(*(named[n] for n in (1, 2, 3)))
    q = ca.vertcat(shift, tilts, angle)
    rotation = rotations.about(i, a) @ rotations.about(j, b) @ rotations.about(axis, angle)
    shift_dot = rotation @ velocity if velocity_in == "body" else velocity
    q_dot = ca.vertcat(shift_dot, a_dot, b_dot, rate - a_dot * sin(b))
    speeds = ca.vertcat(velocity, omega)
    model.derivative(q, q_dot)
    model.derivative(speeds, accelerations)
    return FreeJoint(
        shift=shift,
        velocity=velocity,
        tilts=tilts,
        rotation=rotation,
        omega=omega,
        q=q,
        q_dot=q_dot,
        speeds=speeds,
        accelerations=accelerations,
    )


def watch_joints(model: Model, joints: Iterable[FreeJoint], system: kane.System) -> None:
    """Declare the condition monitors of a system of bodies that constraints hold."""
    mass = kane.mass_matrix(system)
    conditions.watch_masses(model, mass)
    conditions.watch_constraints(model, kane.constraint_matrix(system), mass)
    conditions.watch_singularity(model, *(cos(joint.tilts[1]) for joint in joints))


def _accelerations(model: Model, body: str, axis: int, about_axis: str) -> SX:
    linear = [
        model.algebraic(f"{body}_v{n}_dot", "m/s2", 0.0, f"rate of {body}_v{n}", nominal=10.0)
        for n in (1, 2, 3)
    ]
    angular = [
        model.algebraic(
            about_axis if n == axis else f"{body}_w{n}_dot",
            "rad/s2",
            0.0,
            f"angular acceleration of {body} about its axis {n}",
            nominal=50.0,
        )
        for n in (1, 2, 3)
    ]
    return ca.vertcat(*linear, *angular)
