"""What slopes of constraints determine, against numpy's singular values."""

import numpy as np
import pytest
from casadi import DM

from casadi_models.mechanics.slopes import determined, first_repeating


@pytest.mark.parametrize("seed", range(20))
def test_columns_that_are_determined_have_full_rank_and_the_first_repeating_row_is_found(seed):
    rng = np.random.default_rng(seed)
    m, n = int(rng.integers(1, 5)), int(rng.integers(4, 7))
    slopes = rng.normal(size=(m, n))
    columns, left = determined(DM(slopes))
    assert len(columns) == m
    assert left == []
    assert np.linalg.matrix_rank(slopes[:, columns]) == m
    assert first_repeating(DM(slopes), -1) == -1

    place = int(rng.integers(1, m + 1))
    again = rng.normal(size=place) @ slopes[:place]
    columns, left = determined(DM(np.insert(slopes, place, again, axis=0)))
    assert (len(columns), len(left)) == (m, 1)
    assert first_repeating(DM(np.insert(slopes, place, again, axis=0)), -1) == place


def test_row_without_an_entry_is_left_over():
    assert determined(DM([[0, 0], [1, 2]])) == ([1], [0])
    assert first_repeating(DM([[1, 2], [0, 0]]), -1) == 1
