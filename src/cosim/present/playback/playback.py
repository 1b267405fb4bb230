"""Playback: the poses of a run's bodies at the times of its frames."""

from collections.abc import Sequence
from dataclasses import replace
from math import ceil, floor, log10, pi, radians

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Drawing
from cosim.arrays import Vector
from cosim.drawing.pose import Poses, Values, motion, poses_at
from cosim.errors import UsageError
from cosim.series.samples import clipped_times, resample
from cosim.text import moment
from cosim.trajectory import Trajectory

FRAMES_PER_SECOND = 30.0
LARGEST_TURN = radians(60.0)  # of a body between two frames; beyond it wheels seem to run backward
MOST_FRAMES = 6000
# Of a playback, unless another speed is chosen
MOST_TURNS = 6 * pi  # rad/s, in which eyes can follow a body
SHORTEST, LONGEST = 2.0, 60.0  # s, to see what moves and to wait for the end
LONGEST_OF_TURNS = 20.0  # s, before the speed is rounded: fast turns are worth no longer playback


def playback(
    run: Trajectory,
    drawing: Drawing,
    *,
    times: Sequence[float] | None = None,
    labels: Sequence[str] = (),
    frames_per_second: float = FRAMES_PER_SECOND,
    speed: float | None = None,
) -> Poses:
    """Return the poses of a run.

    Args:
        run: A run that recorded the variables which place the bodies.
        drawing: What the model looks like, with the values of its parameters.
        times: Times of the frames, s, within the run; as many as a smooth motion needs if None.
        labels: Variables to write beside the picture.
        frames_per_second: Smallest number of frames in a second of playback; there are more where
            a body turns faster than 60 degrees a frame.
        speed: Seconds of the run in a second of playback; see `usual_speed` if None.

    Raises:
        UsageError: The model declares no shapes; or the run lacks variables that place the bodies,
            has no finite values of them, is empty, or would need more than 6000 frames.
        UnknownName: The run did not record a label.
    """
    if not drawing:
        raise UsageError(f"{run.model} declares no shapes; add some with model.shape(...)")
    if not len(run):
        raise UsageError(f"{run.model}: the run has no output times, so nothing can be drawn")
    values = Values(run.time, {**drawing.numbers, "time": run.time, **dict(run)})
    if missing := values.missing(motion(drawing)):
        raise UsageError(
            f"{run.model}: the run did not record {', '.join(missing)}, which place the bodies; "
            "add them to the outputs, or record all"
        )
    turn_rate = _turn_rate(values, motion(drawing)) if times is None else 0.0
    if speed is None:
        speed = usual_speed(float(np.ptp(run.time)), turn_rate)
    if times is None:
        frames = frame_times(run.time, turn_rate, frames_per_second / speed)
    else:
        frames = np.asarray(times, dtype=float)
    if not len(frames):
        raise UsageError(f"{run.model}: there is no time to draw; name one")
    clipped, inside = clipped_times(run.time, frames)
    if not inside.all():
        raise UsageError(
            f"{run.model}: {moment(frames[~inside][0], 6)} s lies outside the run, "
            f"{moment(run.time[0], 6)} ... {moment(run.time[-1], 6)} s"
        )
    poses = poses_at(drawing, values, clipped)
    placed = np.isfinite(poses.places.sum((1, 2)) + poses.rotations.sum((1, 2, 3)))
    if not placed.all():
        note = f"at {moment(frames[~placed][0], 6)} s the places of the bodies are not finite"
        if times is not None or not placed.any():
            raise UsageError(f"{run.model}: {note}; draw another time")
        poses = poses_at(drawing, values, clipped[placed])
        poses = replace(poses, notes=(*poses.notes, f"{note}; such times are left out"))
    start, reasons = run.validity
    facts = (run.model, run.stats.get("solver"), run.stats.get("variation"))
    return replace(
        poses,
        title=", ".join(str(fact) for fact in facts if fact),
        labels=tuple(_label(run, name, poses.time) for name in labels),
        invalid_from=start,
        reasons=reasons,
        speed=speed,
    )


def usual_speed(span: float, turn_rate: float) -> float:
    """Return a speed of playback that eyes can follow: 1, or another one of 1, 2, 5, 10 ...

    A playback lasts 2 s to 60 s. It is slower than the run if a body turns more than three times a
    second, but lasts 20 s then at most, before its speed is rounded down.

    Args:
        span: Length of the run, s.
        turn_rate: Angular speed of the body that turns fastest, rad/s.
    """
    if span > LONGEST:
        return min(speed for speed in _speeds(span / LONGEST) if speed * LONGEST >= span)
    slow = max(MOST_TURNS / turn_rate, span / LONGEST_OF_TURNS) if turn_rate > 0 else 1.0
    limit = min(1.0, slow, span / SHORTEST) or 1.0
    return max(speed for speed in _speeds(limit) if speed <= limit * (1 + 1e-9))


def _speeds(near: float) -> list[float]:
    """Return the speeds of 1, 2, 5, 10 ... around a number."""
    power = floor(log10(near))
    return [digit * 10.0**n for n in range(power - 1, power + 2) for digit in (1, 2, 5)]


def frame_times(time: Vector, turn_rate: float, frames_per_second: float) -> Vector:
    """Return evenly spaced times of frames between which no body turns more than 60 degrees.

    Args:
        time: Output times of the run, s, (m,); the frames are some of them if these are dense
            enough.
        turn_rate: Angular speed of the body that turns fastest, rad/s.
        frames_per_second: Smallest number of frames in a second of the run.
    """
    time = np.unique(time)  # at an event, one may occur twice
    if len(time) < 2:
        return time
    gaps = np.diff(time)
    span, per_second = float(time[-1] - time[0]), max(frames_per_second, turn_rate / LARGEST_TURN)
    per_second = min(per_second, 2 * MOST_FRAMES / span)  # of which there are too many
    stride = int(1 / (gaps[0] * per_second) + 1e-9)
    uneven = np.abs(gaps[:-1] - gaps[0]).max(initial=0.0)
    if stride and uneven < 1e-6 * gaps[0] and gaps[-1] <= gaps[0] * (1 + 1e-6):
        chosen = time[::stride]
        if chosen[-1] < time[-1]:
            chosen = np.append(chosen, time[-1])
    else:
        chosen = np.linspace(time[0], time[-1], max(1, ceil(span * per_second - 1e-9)) + 1)
    if len(chosen) > MOST_FRAMES:
        raise UsageError(
            f"{len(chosen)} frames for {span:g} s are more than {MOST_FRAMES}; "
            "shorten the run (stop_time) or play it faster (speed)"
        )
    return chosen


def _turn_rate(values: Values, moving: SX) -> float:
    """Return the angular speed of the body that turns fastest, rad/s.

    It follows from the rates of the variables, not from poses: between two outputs a wheel may
    make several turns and seem to stand still.
    """
    time = values.time
    if len(time) < 2:
        return 0.0
    symbols = ca.symvar(moving)
    names = [symbol.name() for symbol in symbols]
    rates = [SX.sym(f"{name} rate") for name in names]
    change = ca.jtimes(moving, ca.vertcat(SX(0, 1), *symbols), ca.vertcat(SX(0, 1), *rates))
    function = ca.Function("rates", [ca.vertcat(SX(0, 1), *symbols, *rates)], [ca.vec(change)])
    samples = values.at(names, time)
    moves = np.diff(time) > 0  # a time that occurs twice is a jump
    slopes = np.diff(samples, axis=1)[:, moves] / np.diff(time)[moves]
    begin, end = samples[:, :-1][:, moves], samples[:, 1:][:, moves]
    fastest = 0.0
    for station in (begin, end, (begin + end) / 2):
        columns = np.array(function(np.vstack([station, slopes])), dtype=float)
        turns = columns.reshape(-1, 12, slopes.shape[1])[:, 3:]
        fastest = max(fastest, float(np.sqrt((turns**2).sum(axis=1) / 2).max(initial=0.0)))
    return fastest


def _label(run: Trajectory, name: str, times: Vector) -> tuple[str, str, Vector]:
    column = run.column(name)
    values, _ = resample(run.time, run[name][:, None], times)
    return name, column.shown_unit, column.shown(values[:, 0])
