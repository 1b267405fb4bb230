"""A model's drawing in numbers, at its start values: shapes, frames, what counts as positive."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae
from casadi_models.dae.drawing import Body, Shape
from cosim.arrays import Vector as Array
from cosim.codegen.initialization import usual_start


@dataclass(frozen=True)
class Solid:
    """A shape in the world: its kind and sizes, m; its middle (3,); R of its axes, (3, 3)."""

    kind: str
    size: Array
    middle: Array
    rotation: Array
    colour: str


@dataclass(frozen=True)
class Sign:
    """A direction that counts as positive, (3,), at a point of the world, (3,); a turn is about it.

    Attributes:
        names: Variables that are positive so.
        kind: "load" or "turn" (by the right hand).
    """

    names: tuple[str, ...]
    kind: str
    at: Array
    direction: Array


@dataclass(frozen=True)
class Pose:
    """What is seen of a model at its start.

    Attributes:
        solids: Shapes, world and bodies.
        frames: (name, origin (3,), R in the world (3, 3)) of each body that has a shape.
        signs: Directions that count as positive.
    """

    solids: tuple[Solid, ...]
    frames: tuple[tuple[str, Array, Array], ...]
    signs: tuple[Sign, ...]


def start_pose(dae: Dae) -> Pose | None:
    """Return the model's drawing at its start values; None where there is none to show.

    What a reduced model no longer computes counts as 0.
    """
    drawing = dae.drawing
    if not drawing.shapes:
        return None
    known = dict(drawing.numbers) | _start_values(dae)

    def number(expression: SX) -> Array:
        symbols = ca.symvar(expression)
        values = [known.get(symbol.name(), 0.0) for symbol in symbols]
        function = ca.Function("drawn", [ca.vertcat(SX(0, 1), *symbols)], [expression])
        return np.array(function(ca.DM(values)), dtype=float)

    bodies = {body.name: body for body in drawing.bodies}
    placed = {name: (number(b.place).ravel(), number(b.rotation)) for name, b in bodies.items()}
    solids = tuple(_solid(shape, *placed[shape.body], number) for shape in drawing.shapes)
    shown = [name for name in bodies if any(s.body == name for s in drawing.shapes)]
    frames = tuple((name, *placed[name]) for name in shown if ca.symvar(bodies[name].rotation))
    signs = [*_turns(dae, bodies, placed, number)]
    for arrow in drawing.arrows:
        at = number(arrow.at).ravel()
        for symbol in ca.symvar(arrow.vector):
            direction = number(ca.jacobian(arrow.vector, symbol)).ravel()
            if not ca.depends_on(ca.jacobian(arrow.vector, symbol), symbol):
                signs.append(Sign((symbol.name(),), "load", at, direction))
    pose = Pose(solids, frames, tuple(_merged(signs, [v.name for v in dae.variables])))
    everything = [s.middle for s in solids] + [s.size for s in solids] + [s.at for s in pose.signs]
    return pose if all(np.isfinite(part).all() for part in everything) else None


def _start_values(dae: Dae) -> dict[str, float]:
    values = {v.name: v.start or 0.0 for v in (*dae.parameters, *dae.inputs)}
    try:
        x, z, u, p = usual_start(dae)
        outputs = ca.Function("y", dae.arguments, [dae.outputs])(0.0, x, z, u, p)
    except RuntimeError:  # no solution; whoever runs the FMU is told why
        return values
    names = (v.name for v in (*dae.states, *dae.algebraics, *dae.output_variables))
    solved = np.concatenate([np.array(column).ravel() for column in (x, z, outputs)])
    return values | dict(zip(names, solved.tolist(), strict=True))


def _solid(shape: Shape, place: Array, rotation: Array, number: Callable[[SX], Array]) -> Solid:
    turn = rotation @ _onto(number(shape.along).ravel())
    middle = place + rotation @ number(shape.at).ravel()
    return Solid(shape.kind, number(shape.size).ravel(), middle, turn, shape.colour)


def _onto(direction: Array) -> Array:
    """Return the shortest turn of the third axis onto a direction."""
    a, b, c = direction / np.linalg.norm(direction)
    if c < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    cross = np.array([[0.0, 0.0, a], [0.0, 0.0, b], [-a, -b, 0.0]])
    turned: Array = np.eye(3) + cross + cross @ cross / (1 + c)
    return turned


def _turns(
    dae: Dae,
    bodies: dict[str, Body],
    placed: dict[str, tuple[Array, Array]],
    number: Callable[[SX], Array],
) -> Iterator[Sign]:
    """Yield the axis of each state that turns a body, at the body that fewest states turn."""
    for state in dae.states:
        turned: list[tuple[int, str, SX]] = []
        for name, body in bodies.items():
            symbols = {symbol.name(): symbol for symbol in ca.symvar(body.rotation)}
            if state.name in symbols:
                turned.append((len(symbols), name, symbols[state.name]))
        if not turned:
            continue
        _, name, symbol = min(turned, key=lambda found: found[0])
        rotation = bodies[name].rotation
        rate = number(ca.reshape(ca.jacobian(ca.vec(rotation), symbol), 3, 3))
        spin = rate @ placed[name][1].T  # the skew matrix of the angular velocity of a unit rate
        axis = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
        if abs(np.linalg.norm(axis) - 1) < 1e-6:  # no component of a quaternion
            yield Sign((state.name,), "turn", placed[name][0], axis)


def _merged(signs: Sequence[Sign], order: Sequence[str]) -> Iterator[Sign]:
    """Yield the signs of known variables, those of one point, direction and kind as one."""
    groups: dict[tuple[object, ...], list[Sign]] = {}
    for sign in signs:
        length = max(float(np.linalg.norm(sign.direction)), 1e-300)
        key = (sign.kind, *np.round(sign.at, 6) + 0.0, *np.round(sign.direction / length, 3) + 0.0)
        groups.setdefault(key, []).append(sign)
    for members in groups.values():
        names = {name for sign in members for name in sign.names}
        first = members[0]
        if known := tuple(n for n in order if n in names):
            yield Sign(known, first.kind, first.at, first.direction)
