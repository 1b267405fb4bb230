"""What a call of an engine leaves: rows up to where it came, and nothing that was there before."""

import numpy as np
import pytest

from cosim.integrate import call as module
from cosim.integrate.call import call, finite_rows
from cosim.integrate.engine import Counts, Engine, Filled
from cosim.text import Ending


def engine(points, reached):
    def direct(x0, z0, p, u, states, algebraics, left):
        states.fill(7.0)  # as memory may hold, from earlier runs
        states[:reached] = np.arange(reached)[:, None]
        return Filled(reached == points, reached)

    return Engine(
        None, points, False, lambda: Counts(cause=Ending("it was told to")), direct=direct
    )


@pytest.mark.parametrize(("reached", "reason"), [(3, "it was told to"), (10, "")])
def test_what_was_not_reached_is_not_kept(reached, reason):
    found = call(engine(10, reached), np.zeros(2), np.zeros(0), np.zeros(0), np.zeros(0))
    assert found.reason == reason
    np.testing.assert_array_equal(found.states, np.tile(np.arange(reached), (2, 1)))


@pytest.mark.parametrize("lost", [None, 0, 3, 4, 5, 11])
def test_rows_are_looked_at_up_to_one_that_is_not_finite(lost, monkeypatch):
    monkeypatch.setattr(module, "_BLOCK", 4)
    rows = np.zeros((12, 3))
    if lost is not None:
        rows[lost, 1] = np.nan
    assert finite_rows(rows) == (12 if lost is None else lost)
