"""Poses: where the bodies, loads and paths of a model's drawing are, at one time or at many."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil, inf, log10

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae, Drawing
from casadi_models.dae.drawing import WORLD, Body, Shape, World
from casadi_models.dae.scenery import DARK
from cosim.arrays import Truths, Vector
from cosim.codegen.initialization import usual_start
from cosim.errors import UsageError
from cosim.series.samples import resample
from cosim.text import moment

# The drawing of a model without shapes, on pages that show its curves
POINT = Drawing(
    bodies=(Body(WORLD, SX.zeros(3, 1), SX(SX.eye(3))),),
    shapes=(Shape("point", WORLD, "sphere", SX(0), SX.zeros(3, 1), SX([0, 0, 1]), DARK),),
)


@dataclass(frozen=True)
class Solid:
    """A shape that is fixed in a body.

    Attributes:
        name: Name of the shape.
        body: Position of its body in `Poses.bodies`.
        kind: A key of `casadi_models.dae.drawing.SIZES`.
        size: The numbers that `SIZES` names, m.
        at: Its center in the body's axes, m, (3,).
        along: Its third axis in the body's axes, (3,).
        color: "#rrggbb".
    """

    name: str
    body: int
    kind: str
    size: tuple[float, ...]
    at: Vector
    along: Vector
    color: str


@dataclass(frozen=True)
class Load:
    """A force or torque: its point, m, (n, 3), and its components in the world, SI, (n, 3)."""

    name: str
    at: Vector
    vector: Vector
    unit: str
    display_unit: str
    meaning: str
    color: str


@dataclass(frozen=True)
class Path:
    """The path of a point: its places at all output times, m, (m, 3), and these times, s, (m,)."""

    name: str
    time: Vector
    points: Vector
    color: str


@dataclass(frozen=True)
class Poses:
    """A model's drawing at the times of some frames.

    Attributes:
        time: Times of the frames, s, (n,).
        bodies: Names of the bodies; the first is the world.
        places: Origins of the bodies, m, (n, bodies, 3).
        rotations: Rotation matrices, body to world, (n, bodies, 3, 3).
        solids: Shapes of the bodies.
        loads: Forces and torques.
        paths: Paths of points.
        world: Up, axes and ground.
        notes: One sentence for each part of the drawing that is left out.
        title: The model, and what computed the run.
        labels: (name, display unit, values (n,)) of the variables written beside the picture.
        invalid_from: Time from which the run is outside its validity range, s; infinite if never.
        reasons: Why, one sentence each; or why the simulation stopped early.
        speed: Seconds of the run in a second of playback.
    """

    time: Vector
    bodies: tuple[str, ...]
    places: Vector
    rotations: Vector
    solids: tuple[Solid, ...]
    loads: tuple[Load, ...]
    paths: tuple[Path, ...]
    world: World
    notes: tuple[str, ...] = ()
    title: str = ""
    labels: tuple[tuple[str, str, Vector], ...] = ()
    invalid_from: float = inf
    reasons: tuple[str, ...] = ()
    speed: float = 1.0

    def followed(self, follow: str | None = None) -> Vector:
        """Return how far the camera moves along with a body, m, (n, 3).

        Args:
            follow: Name of the body; the model's own choice if None; "" for a camera at rest.

        Raises:
            UsageError: There is no such body.
        """
        name = self.world.follow if follow is None else follow
        if not name:
            return np.zeros((len(self.time), 3))
        if name not in self.bodies:
            known = ", ".join(self.bodies[1:])
            raise UsageError(f"{self.title}: no body '{name}' to follow; there are {known}")
        body = self.bodies.index(name)
        middle = self.middle_of(body)
        place = self.places[:, body] + self.rotations[:, body] @ middle
        up = np.array(self.world.up)
        start = place - place[0]
        along: Vector = start - np.outer(start @ up, up)  # the ground keeps its height
        return along

    def middle_of(self, body: int) -> Vector:
        """Return the middle of a body's shapes in its own axes, m, (3,)."""
        centers = [solid.at for solid in self.solids if solid.body == body] or [np.zeros(3)]
        middle: Vector = (np.min(centers, axis=0) + np.max(centers, axis=0)) / 2
        return middle

    @property
    def valid(self) -> Truths:
        """The frames within the validity range, (n,); all of them if the run never is valid."""
        valid = self.time < self.invalid_from
        return valid if valid.any() else np.ones(len(self.time), dtype=bool)

    def label_text(self, frame: int) -> str:
        """Return the time and the labeled variables at a frame, in display units."""
        gap = np.diff(self.time[:2]).sum() or abs(self.time[frame]) or 1.0
        parts = [f"t = {self.time[frame]:.{max(2, ceil(-log10(gap)))}f} s"]
        parts += [f"{name} = {values[frame]:.4g} {unit}" for name, unit, values in self.labels]
        return ", ".join(parts)


def invalid_text(runs: Sequence[Poses], frame: int) -> str:
    """Return which runs are invalid at a frame and why; "" while all are valid."""
    found = []
    for run in runs:
        if run.reasons and run.time[frame] >= run.invalid_from:
            owner = f"{run.title}: " if len(runs) > 1 else ""
            found.append(f"{owner}invalid from {moment(run.invalid_from)} s: {run.reasons[0]}")
    return " | ".join(found)


class Values:
    """Values of variables over time.

    Args:
        time: Sample times, s, (n,).
        samples: By name, SI: samples, (n,), or a constant.
    """

    def __init__(self, time: Vector, samples: Mapping[str, Vector | float]) -> None:
        self.time = time
        self._samples = {name: np.broadcast_to(own, len(time)) for name, own in samples.items()}

    def missing(self, expression: SX) -> list[str]:
        """Return the names of an expression's variables that have no value."""
        names = dict.fromkeys(symbol.name() for symbol in ca.symvar(expression))
        return [name for name in names if name not in self._samples]

    def at(self, names: Sequence[str], times: Vector) -> Vector:
        """Return the values of variables, (len(names), len(times)), interpolated by `resample`."""
        samples = np.array([self._samples[name] for name in names])
        samples = samples.reshape(len(names), len(self.time)).T
        same = np.array_equal(times, self.time)
        return (samples if same else resample(self.time, samples, times)[0]).T

    def evaluate(self, expression: SX, times: Vector) -> Vector:
        """Return the elements of an expression, column by column, (times, elements)."""
        symbols = ca.symvar(expression)
        rows = self.at([symbol.name() for symbol in symbols], times)
        function = ca.Function("drawn", [ca.vertcat(SX(0, 1), *symbols)], [ca.vec(expression)])
        columns: Vector = np.array(function(rows), dtype=float)
        return columns.reshape(expression.numel(), len(times)).T

    def first(self, expression: SX) -> Vector:
        """Return an expression at the first time, in its own shape."""
        elements: Vector = self.evaluate(expression, self.time[:1])[0]
        return elements.reshape(expression.shape, order="F")


def motion(drawing: Drawing) -> SX:
    """Return the origin and the rotation matrix of every body, below each other."""
    return ca.vertcat(*(ca.vertcat(b.place, ca.vec(b.rotation)) for b in drawing.bodies))


def poses_at(drawing: Drawing, values: Values, times: Vector) -> Poses:
    """Return the drawing at times of frames, s, (n,).

    Loads and paths without values are left out and noted.
    """
    rows = values.evaluate(motion(drawing), times).reshape(len(times), -1, 12)
    notes: list[str] = []

    def available(name: str, expression: SX) -> bool:
        if missing := values.missing(expression):
            notes.append(f"{name} is not drawn: the run did not record {', '.join(missing)}")
        return not missing

    loads, paths = [], []
    for arrow in drawing.arrows:
        both = ca.vertcat(arrow.at, arrow.vector)
        if available(arrow.name, both):
            found = values.evaluate(both, times)
            found[~np.isfinite(found).all(axis=1), 3:] = 0.0  # is not drawn
            loads.append(Load(arrow.name, found[:, :3], found[:, 3:], arrow.unit,
                              arrow.display_unit, arrow.meaning, arrow.color))  # fmt: skip
    for trace in drawing.traces:
        if available(trace.name, trace.at):
            points = values.evaluate(trace.at, values.time)
            paths.append(Path(trace.name, values.time, points, trace.color))
    names = [body.name for body in drawing.bodies]
    return Poses(
        time=times,
        bodies=tuple(names),
        places=rows[:, :, :3],
        rotations=rows[:, :, 3:].reshape(len(times), -1, 3, 3).swapaxes(2, 3),  # CasADi: by columns
        solids=tuple(_solid(shape, names, values) for shape in drawing.shapes),
        loads=tuple(loads),
        paths=tuple(paths),
        world=drawing.world,
        notes=tuple(notes),
    )


def _solid(shape: Shape, bodies: Sequence[str], values: Values) -> Solid:
    size, at, along = (values.first(part).ravel() for part in (shape.size, shape.at, shape.along))
    body = bodies.index(shape.body)
    return Solid(shape.name, body, shape.kind, tuple(size.tolist()), at, along, shape.color)


@dataclass(frozen=True)
class Sign:
    """The positive direction of variables, (3,), at a point of the world, m, (3,).

    Attributes:
        names: The variables.
        turns: Whether they are angles about the direction (right-hand rule), and not loads along
            it.
        at: The point.
        direction: The direction.
    """

    names: tuple[str, ...]
    turns: bool
    at: Vector
    direction: Vector


@dataclass(frozen=True)
class StartPose:
    """A model at its start values, as its diagram shows it.

    Attributes:
        poses: Its bodies in one frame, without loads and paths.
        frames: (name, origin (3,), rotation matrix (3, 3)) of each body that turns and has a shape;
            not of parts of bodies.
        signs: Positive directions of loads and angles.
        size: About how large the mechanism is, m.
    """

    poses: Poses
    frames: tuple[tuple[str, Vector, Vector], ...]
    signs: tuple[Sign, ...]
    size: float


def start_pose(dae: Dae) -> StartPose | None:
    """Return a model at its start values; None if it has no shapes or no finite start values.

    Variables that a reduced model no longer computes count as 0.
    """
    drawing = dae.drawing
    if not drawing.shapes:
        return None
    bodies = replace(drawing, arrows=(), traces=())
    parts = [motion(drawing), *(a.at for a in drawing.arrows), *(a.vector for a in drawing.arrows)]
    unknown = dict.fromkeys((symbol.name() for symbol in ca.symvar(ca.vertcat(*parts))), 0.0)
    values = Values(np.zeros(1), unknown | dict(drawing.numbers) | _start_values(dae))
    with np.errstate(invalid="ignore"):  # not a number: returned as None
        poses = poses_at(bodies, values, values.time)
    signs = [*_turns(dae, poses, values), *_positive_loads(dae, values)]
    size = _extent(poses)
    merged = tuple(_merged(signs, [v.name for v in dae.variables], size))
    numbers = [poses.places, poses.rotations, *(sign.at for sign in merged)]
    numbers += [part for solid in poses.solids for part in (np.array(solid.size), solid.at)]
    if not all(np.isfinite(part).all() for part in numbers):
        return None
    frames = tuple(
        (body.name, poses.places[0, i], poses.rotations[0, i])
        for i, body in enumerate(drawing.bodies)
        if ca.symvar(body.rotation)
        and any(solid.body == i for solid in poses.solids)
        and "/" not in body.name
    )
    return StartPose(poses, frames, merged, size)


def _extent(poses: Poses) -> float:
    """Return about how large a mechanism is, m; 1 if its shapes are points."""
    lengths = [np.abs(solid.size).max(initial=0.0) for solid in poses.solids]
    return float(max(np.ptp(poses.places[0], axis=0).max(initial=0.0), *lengths)) or 1.0


def _start_values(dae: Dae) -> dict[str, float]:
    values = {v.name: v.start or 0.0 for v in (*dae.parameters, *dae.inputs)}
    try:
        x, z, u, p = usual_start(dae)
        outputs = ca.Function("y", dae.arguments, [dae.outputs])(0.0, x, z, u, p)
    except RuntimeError:  # no consistent start values: simulating the FMU reports the reason
        return values
    names = (v.name for v in (*dae.states, *dae.algebraics, *dae.output_variables))
    solved = np.concatenate([np.array(column).ravel() for column in (x, z, outputs)])
    return values | dict(zip(names, solved.tolist(), strict=True))


def _positive_loads(dae: Dae, values: Values) -> Iterator[Sign]:
    """Yield the direction of each load component that enters its arrow linearly."""
    others = {v.name for v in (*dae.states, *dae.parameters)}
    for arrow in dae.drawing.arrows:
        at = values.first(arrow.at).ravel()
        for symbol in ca.symvar(arrow.vector):
            direction = ca.jacobian(arrow.vector, symbol)
            if symbol.name() not in others and not ca.depends_on(direction, symbol):
                yield Sign((symbol.name(),), False, at, values.first(direction).ravel())


def _turns(dae: Dae, poses: Poses, values: Values) -> Iterator[Sign]:
    """Yield the axis of each state that turns a body, at the body that fewest states turn."""
    for state in dae.states:
        turned: list[tuple[int, int, SX]] = []
        for i, body in enumerate(dae.drawing.bodies):
            symbols = {symbol.name(): symbol for symbol in ca.symvar(body.rotation)}
            if state.name in symbols:
                turned.append((len(symbols), i, symbols[state.name]))
        if not turned:
            continue
        _, i, symbol = min(turned, key=lambda found: found[0])
        rotation = dae.drawing.bodies[i].rotation
        rate = values.first(ca.reshape(ca.jacobian(ca.vec(rotation), symbol), 3, 3))
        spin = rate @ values.first(rotation).T  # skew matrix of the angular velocity of a unit rate
        axis = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
        if abs(np.linalg.norm(axis) - 1) < 1e-6:  # not a component of a quaternion
            yield Sign((state.name,), True, poses.places[0, i], axis)


def _merged(signs: Sequence[Sign], order: Sequence[str], size: float) -> Iterator[Sign]:
    """Yield the signs of the model's variables; those of one point and direction as one.

    Points are distinct if a millionth of the size of the mechanism, m, lies between them.
    """
    groups: dict[tuple[object, ...], list[Sign]] = {}
    for sign in signs:
        length = max(float(np.linalg.norm(sign.direction)), 1e-300)
        at, direction = sign.at / size, sign.direction / length
        key = (sign.turns, *np.round(at, 6) + 0.0, *np.round(direction, 3) + 0.0)
        groups.setdefault(key, []).append(sign)
    for members in groups.values():
        names = {name for sign in members for name in sign.names}
        if known := tuple(name for name in order if name in names):
            yield replace(members[0], names=known)
