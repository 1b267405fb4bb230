"""Meshes: the rotation that turns their third axis."""

import numpy as np
import pytest

from cosim.drawing.meshes import onto


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -1), (1, 2, 3), (0, -1, 0), (0, 0, 0)])
def test_third_axis_is_turned_onto_a_direction(direction):
    matrix = onto(np.array(direction, dtype=float))
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(matrix) == pytest.approx(1)
    if any(direction):
        wanted = np.array(direction) / np.linalg.norm(direction)
        np.testing.assert_allclose(matrix[:, 2], wanted, atol=1e-14)
