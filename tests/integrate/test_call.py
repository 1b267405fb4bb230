"""What a call of an engine leaves: rows up to where it came, and nothing that was there before."""

import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Event

import numpy as np
import pytest

from cosim.host.recorded_errors import recorded_errors
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


def test_what_a_thread_writes_is_recorded_for_it_alone(capsys):
    """SUNDIALS says why a run failed by writing to standard error, in every thread."""
    one_begun, other_begun, one_ended = Event(), Event(), Event()

    def one():
        with recorded_errors() as text:
            one_begun.set()
            other_begun.wait(60)
            sys.stderr.write("one")
        one_ended.set()
        return text.getvalue()

    def other():
        one_begun.wait(60)
        with recorded_errors() as text:
            other_begun.set()
            one_ended.wait(60)
            sys.stderr.write("other")
        return text.getvalue()

    usual = sys.stderr
    with ThreadPoolExecutor(2) as pool:
        texts = [pool.submit(one), pool.submit(other)]
        other_begun.wait(60)
        print("neither", file=sys.stderr)
        assert [text.result() for text in texts] == ["one", "other"]
    assert sys.stderr is usual
    assert capsys.readouterr().err == "neither\n"
