"""Meshes: the rotation that turns their third axis."""

from dataclasses import replace

import numpy as np
import pytest

from cosim.drawing.camera import HALF_ANGLE, Camera
from cosim.drawing.meshes import onto


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -1), (1, 2, 3), (0, -1, 0), (0, 0, 0)])
def test_third_axis_is_turned_onto_a_direction(direction):
    matrix = onto(np.array(direction, dtype=float))
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(matrix) == pytest.approx(1)
    if any(direction):
        wanted = np.array(direction) / np.linalg.norm(direction)
        np.testing.assert_allclose(matrix[:, 2], wanted, atol=1e-14)


@pytest.mark.parametrize("length", [1e-20, 1e-9, 1.0, 1e9])
def test_picture_of_a_scene_does_not_depend_on_its_size(length):
    """A point at (1, 0.5) in a plane 2 lengths away, in half a height of 2 tan(half an angle)."""
    camera = Camera(np.array([0, 0, 2 * length]), np.eye(3), np.array([0, 1, 0]))
    seen = camera.seen(length * np.array([[1, 0.5, 0]]))
    np.testing.assert_allclose(seen[0, :2], np.array([0.5, 0.25]) / np.tan(HALF_ANGLE), rtol=1e-14)
    corners = length * np.array([[[0, 0, 0], [1, 0, 0.1], [0, 1, 0.2]]])
    _, shades = camera.faces(corners, np.ones((1, 3)))
    _, expected = replace(camera, eye=camera.eye / length).faces(corners / length, np.ones((1, 3)))
    np.testing.assert_allclose(shades, expected, rtol=1e-12)
