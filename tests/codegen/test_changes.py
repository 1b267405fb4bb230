"""Where functions bend: by bounds, and by samples in the cells alone that bounds leave open."""

import numpy as np
import pytest

from cosim.codegen.changes import bent_parts

CELLS = 1000
EDGES = np.linspace(0.0, 10.0, CELLS + 1)
PLACE, WIDTH = 7.3051, 4e-4  # of a bump that lies between two edges


def bump(at):
    return np.exp(-(((at - PLACE) / WIDTH) ** 2))


def bounds(begins, widths):
    """Return how far the bump is from a line in cells; unknown in those that hold its top."""
    is_near = (begins < PLACE + 5 * WIDTH) & (begins + widths > PLACE - 5 * WIDTH)
    return np.where(is_near, np.nan, 0.0)


@pytest.mark.parametrize("known", [bounds, None])
def test_a_bump_is_found_and_only_cells_without_bounds_are_sampled(known):
    places = []

    def values(at):
        places.append(at)
        return bump(at)

    (edges,) = bent_parts(values, known, EDGES, np.empty(0))
    assert PLACE - 4 * WIDTH < edges[0] < PLACE < edges[-1] < PLACE + 4 * WIDTH
    sampled = np.concatenate(places)
    far = sampled[np.abs(sampled - PLACE) > 0.02]  # two cells
    assert np.isin(far, EDGES).all() == (known is not None)
