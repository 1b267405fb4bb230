import re

import casadi as ca
import numpy as np
import pytest
from casadi import SX
from helpers.support import value
from scipy.spatial.transform import Rotation

from casadi_models.mechanics import rotations as ro

AXES = (1, 2, 3)
RNG = np.random.default_rng(7)
ROUNDING = 4e-15  # a few units in the last place of numbers up to 5; measured 1.3e-15


@pytest.mark.parametrize("axis", AXES)
def test_turn_about_an_axis_is_right_handed(axis):
    following = np.eye(3)[axis % 3]  # 1 -> 2, 2 -> 3, 3 -> 1
    quarter = value(ro.about(axis, np.pi / 2)) @ following
    np.testing.assert_allclose(quarter, np.eye(3)[(axis + 1) % 3], rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("axes", [(3, 1, 3), (1, 2, 3), (3, 2, 1), (2, 1, 2)])
def test_body_fixed_turns_equal_those_of_scipy(axes):
    angles = RNG.uniform(-np.pi, np.pi, 3)
    matrix, _ = ro.body_fixed(axes, SX(angles), SX.zeros(3))
    sequence = "".join("XYZ"[axis - 1] for axis in axes)  # upper case: about turned axes
    expected = Rotation.from_euler(sequence, angles).as_matrix()
    np.testing.assert_allclose(value(matrix), expected, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("axes", [(3, 1, 3), (1, 2, 3), (3, 2, 1)])
def test_angular_velocity_is_the_rate_of_the_rotation_matrix(axes):
    angles, rates = SX.sym("angles", 3), SX.sym("rates", 3)
    matrix, omega = ro.body_fixed(axes, angles, rates)
    matrix_dot = ca.reshape(ca.jtimes(ca.vec(matrix), angles, rates), 3, 3)
    residual = matrix_dot - matrix @ ca.skew(omega)  # Poisson: dR/dt = R [omega]x
    for _ in range(20):
        at = (angles, RNG.uniform(-np.pi, np.pi, 3)), (rates, RNG.uniform(-2, 2, 3))
        np.testing.assert_allclose(value(residual, *at), 0, atol=ROUNDING)


def test_quaternion_gives_the_matrix_that_scipy_gives():
    for turn in Rotation.random(20, random_state=3):
        x, y, z, w = turn.as_quat()
        matrix = value(ro.from_quaternion(SX([w, x, y, z])))
        np.testing.assert_allclose(matrix, turn.as_matrix(), rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("axis", AXES)
def test_quaternion_about_an_axis_gives_the_matrix_about_it(axis):
    turn = ro.from_quaternion(ro.quaternion_about(axis, SX(0.7)))
    np.testing.assert_allclose(value(turn), value(ro.about(axis, 0.7)), rtol=0, atol=ROUNDING)


def test_product_of_quaternions_gives_the_product_of_matrices():
    for a, b in zip(RNG.normal(size=(20, 4)), RNG.normal(size=(20, 4)), strict=True):
        a, b = SX(a / np.linalg.norm(a)), SX(b / np.linalg.norm(b))
        both = ro.from_quaternion(ro.quaternion_product(a, b))
        expected = value(ro.from_quaternion(a)) @ value(ro.from_quaternion(b))
        np.testing.assert_allclose(value(both), expected, rtol=0, atol=ROUNDING)


def quaternion_rate(q: SX, omega: SX) -> SX:
    """Return dq/dt for the angular velocity resolved in the turned frame."""
    return ro.quaternion_product(q, ca.vertcat(0, omega / 2))


def test_rate_of_a_quaternion_turns_the_matrix_by_the_angular_velocity():
    q, omega = SX.sym("q", 4), SX.sym("omega", 3)
    matrix = ro.from_quaternion(q)
    rate = ca.jtimes(ca.vec(matrix), q, quaternion_rate(q, omega))
    residual = ca.reshape(rate, 3, 3) - matrix @ ca.skew(omega)  # Poisson
    for unit_q in Rotation.random(20, random_state=5).as_quat():
        at = (q, unit_q[[3, 0, 1, 2]]), (omega, RNG.uniform(-2, 2, 3))
        np.testing.assert_allclose(value(residual, *at), 0, atol=ROUNDING)


def test_rate_of_a_quaternion_keeps_its_length():
    q, omega = SX.sym("q", 4), SX.sym("omega", 3)
    growth = ca.dot(q, quaternion_rate(q, omega))
    at = (q, RNG.normal(size=4)), (omega, RNG.normal(size=3))
    np.testing.assert_allclose(value(growth, *at), 0, atol=ROUNDING)


@pytest.mark.parametrize("axis", [0, 4, -1, 1.0, "x", None, np.ones((1, 1)), SX.sym("a")])
def test_axis_that_does_not_exist_is_refused(axis):
    named = re.escape(f"axis {axis} does not exist; use 1, 2 or 3")
    for function in (ro.about, ro.quaternion_about):
        with pytest.raises(ValueError, match=named):
            function(axis, SX(0.1))
    with pytest.raises(ValueError, match=named):
        ro.unit(axis)


def test_sequence_and_angles_of_different_length_are_refused():
    with pytest.raises(ValueError, match="shorter"):
        ro.body_fixed((3, 1, 3), SX.zeros(2), SX.zeros(3))


@pytest.mark.parametrize("wrong", [None, "x", [1, 0, 0, 0], 1.0, SX.zeros(3), SX.zeros(1, 4)])
def test_what_is_no_quaternion_is_rejected(wrong):
    with pytest.raises(ValueError, match=r"no quaternion; give w, x, y and z, of shape \(4, 1\)"):
        ro.from_quaternion(wrong)
