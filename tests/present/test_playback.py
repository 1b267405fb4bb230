"""Poses of a run: where bodies are, how fast they may turn between frames, what is missing."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import spinning

import cosim
from cosim.errors import UsageError
from cosim.present.playback.playback import frame_times, playback, usual_speed


@pytest.mark.parametrize("rate", [1.0, 20.0, 90.0, 80 * np.pi, 400.0])
@pytest.mark.parametrize("interval", [0.01, 0.05, 0.25])
def test_no_body_turns_more_than_sixty_degrees_between_frames(rate, interval):
    run = cosim.simulate(spinning(rate), stop_time=1.0, output_interval=interval, compiled=False)
    played = playback(run, run.drawing)
    change = np.linalg.norm(np.diff(played.rotations, axis=0), axis=(-2, -1))
    turns = 2 * np.arcsin(change / np.sqrt(8))
    assert np.degrees(turns.max()) <= 60.0 * (1 + 1e-6)
    total = turns[:, 1].sum()
    assert total == pytest.approx(rate * 1.0, rel=1e-6)  # no turn is lost, none runs backward


def test_frames_are_output_times_where_these_suffice():
    time = np.arange(2001) * 0.01
    frames = frame_times(time, 1.0, 30.0)
    assert set(frames) <= set(time)
    assert frames[[0, -1]].tolist() == [0.0, 20.0]
    assert np.diff(frames).max() <= 1 / 30


@pytest.mark.parametrize(
    ("time", "frames"),
    [
        ([0.0, 0.01], [0.0, 0.01]),
        ([0.0, 0.0, 0.05, 0.1], [0.0, 0.05, 0.1]),
        ([3.0, 3.0], [3.0]),
        ([3.0], [3.0]),
    ],
)
def test_frames_of_few_times_and_of_a_time_that_occurs_twice(time, frames):
    assert frame_times(np.array(time), 0.0, 20.0).tolist() == frames


def test_too_many_frames_are_rejected():
    with pytest.raises(UsageError, match="more than 6000"):
        frame_times(np.linspace(0, 1000, 100_001), 1.0, 30.0)


@pytest.mark.slow
def test_run_without_what_its_bodies_need_is_rejected_with_the_names():
    run = cosim.simulate(cosim.load("bicycle"), stop_time=0.1, outputs=["phi", "delta"])
    with pytest.raises(UsageError, match=r"did not record xP, psi, yP.*place the bodies"):
        playback(run, run.drawing)


def test_loads_that_were_not_recorded_are_left_out_and_named():
    names = ["phi", "delta", "psi", "theta", "thetaR", "thetaF", "xP", "yP", "fx_P", "fy_P", "fz_P"]
    run = cosim.simulate(cosim.load("bicycle"), stop_time=0.1, outputs=names)
    played = playback(run, run.drawing)
    assert [load.name for load in played.loads] == ["force at P"]
    assert played.notes == ("force at Q is not drawn: the run did not record fx_Q, fy_Q, fz_Q",)


def test_model_without_shapes_is_rejected():
    run = cosim.simulate(spinning(1.0, drawn=False), stop_time=0.1, compiled=False)
    with pytest.raises(UsageError, match=r"declares no shapes; add some with model\.shape"):
        playback(run, run.drawing)


def test_times_outside_the_run_are_rejected():
    run = cosim.simulate(spinning(1.0), stop_time=1.0, compiled=False)
    with pytest.raises(UsageError, match=r"3 s lies outside the run, 0 \.\.\. 1 s"):
        playback(run, run.drawing, times=[0.5, 3.0])


@pytest.mark.parametrize(("begin", "span"), [(0.0, 1e-9), (1e9, 1.0), (-5.0, 1e-3)])
def test_times_of_a_picture_are_those_of_the_run_up_to_rounding(begin, span):
    run = cosim.simulate(spinning(1.0), stop_time=1.0, compiled=False)
    run = replace(run, time=begin + span * run.time)
    end = begin + span
    played = playback(run, run.drawing, times=[begin, np.nextafter(end, np.inf)])
    assert played.time.tolist() == [begin, run.time[-1]]
    for outside in (begin - 0.1 * span, end + 0.1 * span, np.nan):
        with pytest.raises(UsageError, match="lies outside the run"):
            playback(run, run.drawing, times=[outside])


@pytest.mark.parametrize(
    ("times", "frame", "text"),
    [
        ([0.0, 0.04, 0.08], 2, "t = 0.08 s"),
        ([1.5], 0, "t = 1.50 s"),
        ([0.0, 0.0], 0, "t = 0.00 s"),
        ([0.0, 2e-9, 4e-9], 1, "t = 0.000000002 s"),
    ],
)
def test_time_beside_a_picture_has_the_digits_that_tell_it_from_the_next(times, frame, text):
    run = cosim.simulate(spinning(1.0), stop_time=2.0, compiled=False)
    assert playback(run, run.drawing, times=times).label_text(frame) == text


def test_labels_are_in_display_units():
    run = cosim.simulate(cosim.load("bicycle"), stop_time=0.1, compiled=False)
    played = playback(run, run.drawing, labels=["phi"])
    name, unit, values = played.labels[0]
    assert (name, unit) == ("phi", "deg")
    assert values[-1] == pytest.approx(np.degrees(run["phi"][-1]))


@pytest.mark.slow
def test_run_outside_its_model_says_since_when_and_why():
    run = cosim.simulate(cosim.load("bicycle"), start_values={"phi_dot": 2.5}, stop_time=1.0)
    played = playback(run, run.drawing)
    first = np.flatnonzero(run["fz_P"] >= 0)[0]
    assert run.time[first - 1] < played.invalid_from <= run.time[first]
    assert played.reasons[0] == "the rear wheel would lift off"


def test_camera_follows_along_the_ground_only():
    run = cosim.simulate(cosim.load("bicycle"), stop_time=1.0, compiled=False)
    played = playback(run, run.drawing)
    shift = played.followed()
    assert shift[-1, 0] > 4.0
    np.testing.assert_allclose(shift[:, 2], 0, atol=1e-12)
    assert not played.followed("").any()
    with pytest.raises(UsageError, match="no body 'cart' to follow; there are rear wheel"):
        played.followed("cart")


@pytest.mark.parametrize(
    ("span", "turn_rate", "expected"),
    [
        (20.0, 0.0, 1.0),
        (20.0, 15.4, 1.0),  # the bicycle's wheels
        (4.0, 90.0, 0.2),  # the crank shaft; 0.21 would be three turns a second
        (4.0, 6 * np.pi, 1.0),
        (4.0, 6.1 * np.pi, 0.5),
        (10.0, 1e4, 0.5),  # however fast a body turns, the playback lasts 20 s
        (0.03, 0.0, 0.01),
        (2.0, 0.0, 1.0),
        (0.0, 0.0, 1.0),
        (60.0, 1.0, 1.0),
        (61.0, 400.0, 2.0),
        (4e10, 0.0, 1e9),
        (4e-14, 0.0, 2e-14),
        (4e20, 0.0, 1e19),
    ],
)
def test_usual_speed_lets_eyes_follow(span, turn_rate, expected):
    assert usual_speed(span, turn_rate) == pytest.approx(expected)


def test_a_fast_crank_is_played_slowly_and_a_chosen_speed_counts():
    run = cosim.simulate(spinning(90.0), stop_time=4.0, compiled=False)
    assert playback(run, run.drawing).speed == pytest.approx(0.2)
    assert playback(run, run.drawing, speed=1.0).speed == 1.0
