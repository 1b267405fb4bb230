"""Small lean and steer of the nonlinear bicycle against the published linear equations.

Upright at forward speed v the nonlinear equations reduce to M q'' + v C1 q' + (g K0 + v^2 K2) q = f
with q = (lean, steer) and f = (roll torque, steer torque); both sides by automatic differentiation.
"""

import casadi as ca
import numpy as np
import pytest
from helpers.bicycle_oracles import (
    BENCHMARK,
    C1,
    CAPSIZE_SPEED,
    DOUBLE_ROOT_SPEED,
    K0,
    K2,
    WEAVE_FREQUENCY,
    WEAVE_SPEED,
    M,
    published,
)
from helpers.equations import Equations
from scipy.optimize import brentq

import casadi_models

LEAN_AND_STEER = ("phi", "delta", "phi_dot", "delta_dot")
G, REAR_RADIUS = BENCHMARK["g"], BENCHMARK["rR"]


@pytest.fixture(scope="module")
def dae():
    return casadi_models.load("bicycle/independent")


@pytest.fixture(scope="module")
def linear(dae):
    """Return v -> (A, B) of x' = A x + B f at forward speed v, x = (lean, steer, rates)."""
    names = [variable.name for variable in dae.states]
    rows = [names.index(name) for name in LEAN_AND_STEER]
    inputs = [variable.name for variable in dae.inputs]
    torques = [inputs.index(name) for name in ("roll_torque", "steer_torque")]
    blocks = [ca.jacobian(dae.ode, dae.x)[rows, rows], ca.jacobian(dae.ode, dae.u)[rows, torques]]
    jacobians = ca.Function("jacobians", [dae.x, dae.u, dae.p], blocks, {"cse": True})
    parameters = [variable.start for variable in dae.parameters]

    def at(speed):
        x = [-speed / REAR_RADIUS if name == "thetaR_dot" else 0.0 for name in names]
        return tuple(block.full() for block in jacobians(x, 0, parameters))

    return at


def eigenvalues(matrix):
    return np.sort_complex(np.linalg.eigvals(matrix))


def test_mass_damping_and_stiffness_are_the_published_ones(linear):
    mass = np.linalg.inv(linear(0.0)[1][2:])
    at_rest, moving = (mass @ linear(speed)[0][2:] for speed in (0.0, 1.0))
    found = (mass, -moving[:, 2:], -at_rest[:, :2] / G, at_rest[:, :2] - moving[:, :2])
    for matrix, expected in zip(found, (M, C1, K0, K2), strict=True):
        # Measured 2e-14; zeros are zero to 1e-14 of the largest entry
        size = np.abs(expected).max()
        np.testing.assert_allclose(matrix, expected, rtol=1e-11, atol=1e-14 * size)


@pytest.mark.parametrize("speed", [2.5, 5.0, 10.0])
def test_coefficients_are_polynomials_of_the_speed(linear, speed):
    np.testing.assert_allclose(linear(speed)[0], published(speed), rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("speed", np.arange(0.0, 10.5, 0.5))
def test_eigenvalues_are_the_published_ones(linear, speed):
    found, expected = eigenvalues(linear(speed)[0]), eigenvalues(published(speed))
    assert np.abs(found - expected).max() < 1e-11 * np.abs(expected).max()  # 2e-14


def weave(matrix):
    """Return the eigenvalue of the weave above the double root: the one that oscillates."""
    return max(eigenvalues(matrix), key=lambda root: root.imag)


def test_weave_becomes_stable_at_the_published_speed_and_frequency(linear):
    speed = brentq(lambda v: weave(linear(v)[0]).real, 4.0, 4.6, xtol=1e-14)
    assert speed == pytest.approx(WEAVE_SPEED, rel=1e-11)  # measured 3e-15
    assert weave(linear(speed)[0]).imag == pytest.approx(WEAVE_FREQUENCY, rel=1e-11)


def test_capsize_becomes_unstable_at_the_published_speed(linear):
    speed = brentq(lambda v: np.linalg.det(linear(v)[0]), 5.0, 7.0, xtol=1e-14)
    assert speed == pytest.approx(CAPSIZE_SPEED, rel=1e-11)  # measured 3e-15


def test_two_real_roots_become_the_weave_at_the_published_speed(linear):
    def separation(speed):
        """Square of the difference of the two rightmost roots: negative when they oscillate."""
        first, second = sorted(eigenvalues(linear(speed)[0]), key=lambda root: root.real)[-2:]
        return ((first - second) ** 2).real

    speed = brentq(separation, 0.6, 0.8, xtol=1e-14)
    assert speed == pytest.approx(DOUBLE_ROOT_SPEED, rel=1e-11)  # measured 6e-15


def test_first_accelerations_follow_from_the_published_damping(dae):
    # At phi = delta = 0 the remaining terms are of even order in roll and steer
    rates = Equations(dae).rates()
    expected = -np.linalg.solve(M, 15.3333333 * REAR_RADIUS * C1 @ [0.5, 0.0])
    np.testing.assert_allclose([rates["phi_dot"], rates["delta_dot"]], expected, rtol=1e-11)
