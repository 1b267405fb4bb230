"""Saved states of systems: going on from them, and states that a session cannot take."""

import numpy as np
import pytest
from helpers.detours import sample_after_another_begin
from helpers.session_systems import EVERY_WAY, LINUX, balls, lags

import cosim
from cosim.errors import FmuError, UsageError
from cosim.session.saved import packed, unpacked

pytestmark = LINUX


@pytest.mark.parametrize(
    ("own", "others"),
    [
        ({"macro_step": 0.1}, {"macro_step": 0.01}),
        ({"macro_step": 0.01}, {"macro_step": 0.1}),
        ({"macro_step": 0.1}, {}),
        ({"macro_step": 0.1}, {"macro_step": 0.1, "method": "jacobi"}),
        ({"macro_step": 0.1}, {"macro_step": 0.1, "relative_tolerance": 1e-3}),
        ({"accuracy": 1e-3}, {"accuracy": 1e-9}),
    ],
)
def test_states_of_sessions_with_other_settings_are_rejected(own, others, files):
    system = lags(files)
    with cosim.open(system, **own) as first, cosim.open(system, **others) as second:
        first.advance(to=0.2)
        with pytest.raises(UsageError, match="or with another macro_step, method, accuracy or to"):
            second.restore(first.save())
        assert second.time == 0.0
        second.advance(to=0.1)  # it goes on


def test_a_state_of_parts_with_other_abilities_changes_nothing(files):
    """A part for model exchange has another state than one for co-simulation."""
    part, way = {"ball": files["ball"]}, {"macro_step": 0.1}
    exchange = cosim.couple(part, {}, abilities={"ball": "no co-simulation"})
    with cosim.open(cosim.couple(part, {}), **way) as first, cosim.open(exchange, **way) as second:
        second.advance(to=0.1)
        height = second["ball.h"]
        with pytest.raises(UsageError, match="saved by another session or system"):
            second.restore(first.save())
        assert (second.time, second["ball.h"]) == (0.1, height)


@EVERY_WAY
def test_state_saved_at_an_event_goes_on_behind_it(way, files):
    """The first sample is at 0.05, the second at 0.18; the control is -v/2 = 9.81 t/2 at first."""
    with cosim.open(balls(files, "ball"), **way) as session:
        before = session.save()
        (first,) = session.advance(to=0.05)
        assert (first.name, first.time) == ("ball: control", pytest.approx(0.05, abs=1e-16))
        assert session["ball.pull"] == pytest.approx(9.81 * 0.05 / 2, abs=1e-9)
        at, pull = session.save(), session["ball.pull"]
        (second,) = session.advance(to=0.2)
        assert second.time == pytest.approx(0.18, abs=1e-12)
        after = session["ball.pull"]
        session.restore(at)
        assert (session["ball.pull"], session.advance(0)) == (pull, ())
        (again,) = session.advance(to=0.2)
        assert (again.time, session["ball.pull"]) == (second.time, after)
        session.restore(before)
        assert (session.time, session["ball.pull"]) == (0.0, 0.0)
        assert [event.time for event in session.advance(to=0.2)] == [first.time, second.time]
        assert session["ball.pull"] == pytest.approx(after, abs=1e-6)


@EVERY_WAY
def test_state_from_before_a_reset_to_another_time_goes_on_with_the_same_bits(way, files):
    with cosim.open(lags(files), **way) as session:
        session.advance(to=0.1)
        saved = session.save()
        session.advance(to=0.523)
        expected = session.get()
        session.reset(start_time=5.003)
        session.restore(saved)
        session.advance(to=0.523)
        np.testing.assert_array_equal(session.get(), expected)


def test_state_that_a_part_rejects_is_an_error(files):
    with cosim.open(balls(files, "ball")) as session:
        content = session.save()
        owner, clock, notes, size = unpacked("balls", content, has_sum=False)
        damaged = bytearray(content[:size])
        damaged[-100] ^= 1
        saved = packed(owner, clock, notes, bytes(damaged), has_sum=False)
        with pytest.raises(FmuError, match=r"part 'ball': .*rejects the saved state"):
            session.restore(saved)
        session.reset()
        assert session.time == 0.0


@EVERY_WAY
def test_state_of_another_begin_brings_no_event_of_this_one(way, files):
    with cosim.open(balls(files, "ball"), **way) as session:
        assert sample_after_another_begin(session) == ("ball: control", 0.05)


def test_states_of_other_systems_and_damaged_ones_are_rejected(files):
    with cosim.open(lags(files)) as session, cosim.open(balls(files, "ball")) as other:
        saved = session.save()
        with pytest.raises(UsageError, match="saved by another session or system"):
            other.restore(saved)
        for place in range(0, len(saved), 7):
            damaged = bytearray(saved)
            damaged[place] ^= 1 << place % 8
            with pytest.raises(UsageError, match="damaged"):
                session.restore(bytes(damaged))
