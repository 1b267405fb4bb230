"""The double pendulum in unit quaternions and body rates: an explicit ODE, regular everywhere."""

import casadi as ca

from casadi_models.dae import Dae
from casadi_models.double_pendulum import links, orientation
from casadi_models.double_pendulum.equations import add_motion
from casadi_models.mechanics import rotations


def build() -> Dae:
    """Return the ODE in unit quaternions and body rates, regular everywhere: 14 states."""
    model = links.FAMILY.formulation("quaternion", "unit quaternions")
    rod, (start_1, start_2) = links.parameters(model)
    w1, w2 = links.rate_states(model, 1, start_1), links.rate_states(model, 2, start_2)
    q1 = links.quaternion_states(model, 1, start_1, w1)
    q2 = links.quaternion_states(model, 2, start_2, w2)
    turns = (rotations.from_quaternion(q1), rotations.from_quaternion(q2))
    # R1^T R2 by a product of quaternions: cheaper than one of matrices
    relative = rotations.quaternion_product(orientation.conjugate(q1), q2)
    add_motion(model, rod, (w1, w2), turns, rotations.from_quaternion(relative))
    norms = ca.vertcat(links.norm_error(q1), links.norm_error(q2))
    model.invariant("position_drift", ca.vertcat(q1, q2), norms, "quaternions have length 1")
    return model.freeze()
