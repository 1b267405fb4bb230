"""The free joint against the angular velocity of successive turns and of a rigid motion."""

import casadi as ca
import numpy as np
import pytest

from casadi_models.dae import Model
from casadi_models.mechanics import rotations
from casadi_models.mechanics.joints import free_joint

CYCLIC = {1: (2, 3, 1), 2: (3, 1, 2), 3: (1, 2, 3)}


def loose_body(axis, velocity_in="carrier"):
    model = Model("loose")
    angle = model.state("angle", "rad", 0.0, "angle")
    rate = model.state("rate", "rad/s", 0.0, "rate")
    joint = free_joint(model, "body", axis, angle, rate, "rate_dot", velocity_in=velocity_in)
    symbols = [ca.vertcat(angle, joint.q[:5]), joint.speeds]
    return joint, symbols


@pytest.mark.parametrize("axis", [1, 2, 3])
def test_angle_rates_return_the_angular_velocity(axis):
    joint, symbols = loose_body(axis)
    angles = joint.q[3:]
    matrix, omega = rotations.body_fixed(CYCLIC[axis], angles, joint.q_dot[3:])
    f = ca.Function("f", symbols, [matrix - joint.rotation, omega - joint.omega])
    rng = np.random.default_rng(axis)
    for _ in range(100):
        q, u = rng.uniform(-1.2, 1.2, 6), rng.normal(size=6)
        for difference in f(q, u):
            assert np.abs(difference.full()).max() < 1e-14  # measured 4e-16


@pytest.mark.parametrize("axis", [1, 2, 3])
def test_rotation_turns_as_its_angular_velocity_says(axis):
    joint, symbols = loose_body(axis)
    turning = ca.reshape(ca.jtimes(ca.vec(joint.rotation), joint.q, joint.q_dot), 3, 3)
    f = ca.Function("f", symbols, [turning - joint.rotation @ ca.skew(joint.omega)])
    rng = np.random.default_rng(axis)
    for _ in range(100):  # Poisson's equation; measured 1e-15
        residual = f(rng.uniform(-1.2, 1.2, 6), rng.normal(size=6))
        assert np.abs(residual.full()).max() < 1e-13


@pytest.mark.parametrize("velocity_in", ["body", "carrier"])
def test_velocity_is_the_rate_of_the_shift_in_the_axes_asked_for(velocity_in):
    joint, symbols = loose_body(3, velocity_in)
    f = ca.Function("f", symbols, [joint.q_dot[:3], joint.rotation, joint.velocity])
    rng = np.random.default_rng(0)
    values = f(rng.uniform(-1, 1, 6), rng.normal(size=6))
    shift_dot, rotation, velocity = (value.full() for value in values)
    expected = rotation @ velocity if velocity_in == "body" else velocity
    np.testing.assert_allclose(shift_dot, expected, rtol=1e-15)  # measured 0
