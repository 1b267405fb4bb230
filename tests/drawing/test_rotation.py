"""Rotations: matrices and quaternions."""

import numpy as np
import pytest

from cosim.drawing import rotation


def rotations(n=500):
    generator = np.random.default_rng(1)
    q = generator.normal(size=(n, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def test_matrices_and_quaternions_are_each_others_inverse():
    q = rotations()
    again = rotation.to_quaternions(rotation.to_matrices(q))
    np.testing.assert_allclose(np.abs((q * again).sum(axis=1)), 1, atol=1e-14)


def test_half_turns_have_quaternions():
    for axis in range(3):
        matrix = 2.0 * np.outer(np.eye(3)[axis], np.eye(3)[axis]) - np.eye(3)
        np.testing.assert_allclose(
            rotation.to_matrices(rotation.to_quaternions(matrix[None]))[0], matrix, atol=1e-15
        )


def test_signs_of_quaternions_do_not_jump():
    angle = np.linspace(0, 6 * np.pi, 200)
    half = np.zeros((200, 4))
    half[:, 0], half[:, 3] = np.cos(angle / 2), np.sin(angle / 2)
    jumping = half * np.where(np.arange(200) % 3, 1, -1)[:, None]
    steady = rotation.continuous(jumping)
    assert ((steady[1:] * steady[:-1]).sum(axis=1) > 0.9).all()


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -1), (1, 2, 3), (0, -1, 0), (0, 0, 0)])
def test_third_axis_is_turned_onto_a_direction(direction):
    matrix = rotation.onto(np.array(direction, dtype=float))
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(matrix) == pytest.approx(1)
    if any(direction):
        wanted = np.array(direction) / np.linalg.norm(direction)
        np.testing.assert_allclose(matrix[:, 2], wanted, atol=1e-14)
