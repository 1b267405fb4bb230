"""A run as poses: where every body of its model's drawing is at the times of the frames."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil, radians
from typing import Any

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Drawing
from casadi_models.dae.drawing import World
from casadi_models.units import convert
from cosim.arrays import Vector
from cosim.errors import UsageError
from cosim.present.playback import turning
from cosim.trajectory import Trajectory

FRAMES_PER_SECOND = 30.0
LARGEST_TURN = radians(60.0)  # of a body between two frames: beyond, a wheel seems to turn back
MOST_FRAMES = 6000


@dataclass(frozen=True)
class Prop:
    """A shape of a body, in numbers: m; its rotation in the body's axes, (3, 3)."""

    name: str
    body: int
    kind: str
    size: tuple[float, ...]
    at: Vector
    rotation: Vector
    colour: str


@dataclass(frozen=True)
class Load:
    """A force or torque: point (n, 3) and components (n, 3) in the world, SI."""

    name: str
    at: Vector
    vector: Vector
    unit: str
    display_unit: str
    meaning: str
    colour: str

    @property
    def largest(self) -> float:
        """The largest magnitude, SI."""
        return float(np.linalg.norm(self.vector, axis=1).max(initial=0.0))

    def shown(self, magnitude: float) -> str:
        """Write a magnitude in the display unit."""
        return f"{convert(magnitude, self.unit, self.display_unit):.3g} {self.display_unit}"


@dataclass(frozen=True)
class Path:
    """Where a point has been at every output time, (m, 3), m."""

    name: str
    points: Vector
    colour: str


@dataclass(frozen=True)
class Playback:
    """A run, ready to be drawn.

    Attributes:
        title: The model and what solved it.
        time: Of the frames, s, (n,).
        bodies: Names; the first is the world.
        places: Origins of the bodies, m, (n, bodies, 3).
        quaternions: Unit quaternions (w, x, y, z), body to world, (n, bodies, 4); no jump in sign.
        props, loads, paths: What is drawn.
        world: Up, axes, ground.
        labels: (text of what it is, display unit, values (n,)) of the chosen variables.
        invalid_from: From when on the run is outside its model, s; infinite when never.
        reasons: Why, a sentence each; or why the run ended early.
        notes: What of the drawing is left out, a sentence each.
    """

    title: str
    time: Vector
    bodies: tuple[str, ...]
    places: Vector
    quaternions: Vector
    props: tuple[Prop, ...]
    loads: tuple[Load, ...]
    paths: tuple[Path, ...]
    world: World
    labels: tuple[tuple[str, str, Vector], ...]
    invalid_from: float
    reasons: tuple[str, ...]
    notes: tuple[str, ...]

    def nearest(self, time: float) -> int:
        """Return the frame that is nearest to a time."""
        return int(np.argmin(np.abs(self.time - time)))

    def followed(self, follow: str | None = None) -> Vector:
        """Return the place that a camera looks at, (n, 3): a body, or the middle of all.

        Args:
            follow: Name of a body; that of the model when None; "" for a camera at rest.

        Raises:
            UsageError: There is no such body.
        """
        name = self.world.follow if follow is None else follow
        if not name:
            return np.zeros((len(self.time), 3))
        if name not in self.bodies:
            known = ", ".join(self.bodies[1:])
            raise UsageError(f"{self.title}: no body '{name}' to follow; there are {known}")
        place = self.places[:, self.bodies.index(name)]
        up = np.array(self.world.up)
        start = place - place[0]
        along: Vector = start - np.outer(start @ up, up)  # the ground keeps its height
        return along


def playback(
    run: Trajectory,
    drawing: Drawing,
    *,
    times: Sequence[float] | None = None,
    labels: Sequence[str] = (),
    frames_per_second: float = FRAMES_PER_SECOND,
    speed: float = 1.0,
) -> Playback:
    """Return the poses of a run.

    Args:
        run: Has the variables that the drawing names.
        drawing: What the model looks like, with the values of its parameters.
        times: Of the frames, s, within the run; as many as a smooth motion needs when None.
        labels: Variables to write beside the picture.
        frames_per_second: At least; more where a body turns faster than 60 degrees a frame.
        speed: Seconds of the run in a second of playback.

    Raises:
        UsageError: The model declares no shapes; or the run lacks what they need, is empty, or
            would need more than 6000 frames.
        UnknownName: A label was not recorded.
    """
    if not drawing:
        raise UsageError(f"{run.model} declares no shapes; add some with model.shape(...)")
    if not len(run):
        raise UsageError(f"{run.model}: the run has no output times; there is nothing to show")
    known = _Known(run, drawing.numbers)
    motion = ca.vertcat(*(ca.vertcat(b.place, ca.vec(b.rotation)) for b in drawing.bodies))
    if missing := known.missing(motion):
        raise UsageError(
            f"{run.model}: its bodies stand where {', '.join(missing)} say, which the run did not "
            "record; run it with these among the outputs, or with all"
        )
    if times is None:
        frames = frame_times(run.time, _turn_rate(known, motion), frames_per_second / speed)
    else:
        frames = np.asarray(times, dtype=float)
    outside = (frames < run.time[0] - 1e-9) | (frames > run.time[-1] + 1e-9)
    if outside.any():
        raise UsageError(
            f"{run.model}: {frames[outside][0]:g} s lies outside the run, "
            f"{run.time[0]:g} ... {run.time[-1]:g} s"
        )
    places, quaternions = _poses(known, motion, frames)
    notes: list[str] = []
    drawn_loads, drawn_paths = [], []
    for arrow in drawing.arrows:
        expression = ca.vertcat(arrow.at, arrow.vector)
        if missing := known.missing(expression):
            notes.append(f"{arrow.name} is not drawn: the run did not record {', '.join(missing)}")
            continue
        values = known.evaluate(expression, frames)
        drawn_loads.append(Load(arrow.name, values[:, :3], values[:, 3:], arrow.unit,
                                arrow.display_unit, arrow.meaning, arrow.colour))  # fmt: skip
    for trace in drawing.traces:
        if missing := known.missing(trace.at):
            notes.append(f"{trace.name} is not drawn: the run did not record {', '.join(missing)}")
            continue
        drawn_paths.append(Path(trace.name, known.evaluate(trace.at, run.time), trace.colour))
    names = [body.name for body in drawing.bodies]
    start, reasons = run.validity
    facts = (run.model, run.stats.get("solver"), run.stats.get("variation"))
    return Playback(
        title=", ".join(str(fact) for fact in facts if fact),
        time=frames,
        bodies=tuple(names),
        places=places,
        quaternions=quaternions,
        props=tuple(_prop(shape, names, known) for shape in drawing.shapes),
        loads=tuple(drawn_loads),
        paths=tuple(drawn_paths),
        world=drawing.world,
        labels=tuple(_labelled_curve(run, name, frames) for name in labels),
        invalid_from=start,
        reasons=reasons,
        notes=tuple(notes),
    )


def frame_times(time: Vector, turn_rate: float, frames_per_second: float) -> Vector:
    """Return evenly spaced times of frames between which no body turns more than 60 degrees.

    Args:
        time: Output times of the run, s, (m,); frames are at some of them where that suffices.
        turn_rate: Of the body that turns fastest, rad/s.
        frames_per_second: At least so many frames for each second of the run.

    Raises:
        UsageError: These are more than 6000.
    """
    if len(time) < 2:
        return time
    gaps = np.diff(time)
    span, per_second = float(time[-1] - time[0]), max(frames_per_second, turn_rate / LARGEST_TURN)
    stride = int(1 / (gaps[0] * per_second) + 1e-9)
    if stride and np.ptp(gaps[:-1]) < 1e-6 * gaps[0] and gaps[-1] <= gaps[0] * (1 + 1e-6):
        chosen = time[::stride]
        if chosen[-1] < time[-1]:
            chosen = np.append(chosen, time[-1])
    else:
        chosen = np.linspace(time[0], time[-1], max(1, ceil(span * per_second - 1e-9)) + 1)
    if len(chosen) > MOST_FRAMES:
        raise UsageError(
            f"{len(chosen)} frames for {span:g} s are more than {MOST_FRAMES}; "
            "show a shorter span (stop_time) or a faster playback (speed)"
        )
    return chosen


class _Known:
    """Values by name: what the run recorded, and parameters."""

    def __init__(self, run: Trajectory, numbers: Mapping[str, float]) -> None:
        self.run, self.numbers = run, numbers
        self.names = {"time", *run.names}

    def missing(self, expression: SX) -> list[str]:
        symbols = dict.fromkeys(symbol.name() for symbol in ca.symvar(expression))
        return [name for name in symbols if name not in self.names and name not in self.numbers]

    def evaluate(self, expression: SX, times: Vector) -> Vector:
        """Return a column's values, (times, rows); between outputs those of a straight line."""
        symbols = ca.symvar(expression)
        rows = self.rows(symbols, times)
        function = ca.Function("drawn", [ca.vertcat(SX(0, 1), *symbols)], [ca.vec(expression)])
        columns: Vector = np.array(function(rows), dtype=float)
        result: Vector = columns.reshape(expression.numel(), len(times)).T
        return result

    def rows(self, symbols: Sequence[SX], times: Vector) -> Vector:
        """Return the values of symbols, (symbols, times)."""
        rows = np.empty((len(symbols), len(times)))
        for i, symbol in enumerate(symbols):
            name = symbol.name()
            if name in self.names:
                rows[i] = np.interp(times, self.run.time, self.run[name])
            else:
                rows[i] = self.numbers[name]
        return rows

    def constant(self, expression: SX) -> Vector:
        """Return the values of an expression of parameters."""
        first: Vector = self.evaluate(expression, np.array([self.run.time[0]]))[0]
        return first


def _poses(known: _Known, motion: SX, times: Vector) -> tuple[Vector, Vector]:
    values = known.evaluate(motion, times).reshape(len(times), -1, 12)
    matrices = values[:, :, 3:].reshape(len(times), -1, 3, 3).swapaxes(2, 3)  # CasADi: by columns
    return values[:, :, :3], turning.continuous(turning.to_quaternions(matrices))


def _turn_rate(known: _Known, motion: SX) -> float:
    """Return how fast the fastest body turns, rad/s.

    From the rates of the variables, not from poses: between two outputs a wheel may make several
    turns and seem to stand still.
    """
    time = known.run.time
    if len(time) < 2:
        return 0.0
    symbols = ca.symvar(motion)
    rates = [SX.sym(f"{symbol.name()} rate") for symbol in symbols]
    moving = ca.jtimes(motion, ca.vertcat(SX(0, 1), *symbols), ca.vertcat(SX(0, 1), *rates))
    function = ca.Function("rates", [ca.vertcat(SX(0, 1), *symbols, *rates)], [ca.vec(moving)])
    values = known.rows(symbols, time)
    slopes = np.diff(values, axis=1) / np.diff(time)
    fastest = 0.0
    for ends in (values[:, :-1], values[:, 1:], (values[:, :-1] + values[:, 1:]) / 2):
        columns = np.array(function(np.vstack([ends, slopes])), dtype=float)
        turns = columns.reshape(-1, 12, len(slopes[0]) if len(slopes) else 1)[:, 3:]
        fastest = max(fastest, float(np.sqrt((turns**2).sum(axis=1) / 2).max(initial=0.0)))
    return fastest


def _prop(shape: Any, bodies: Sequence[str], known: _Known) -> Prop:
    return Prop(
        name=shape.name,
        body=bodies.index(shape.body),
        kind=shape.kind,
        size=tuple(known.constant(shape.size).tolist()),
        at=known.constant(shape.at),
        rotation=turning.onto(known.constant(shape.along)),
        colour=shape.colour,
    )


def _labelled_curve(run: Trajectory, name: str, times: Vector) -> tuple[str, str, Vector]:
    column = run.column(name)
    return name, column.shown_unit, column.shown(np.interp(times, run.time, run[name]))
