"""The part of `Model` that declares what a system looks like."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
from casadi import SX

from casadi_models.dae.declaring import Declaring
from casadi_models.dae.drawing import SIZES, WORLD, Arrow, Body, Drawing, Shape, Trace, World
from casadi_models.dae.expressions import no_expression, quoted, reject_faulty
from casadi_models.units import convert, represented

_COLOR = re.compile(r"#[0-9a-fA-F]{6}")
_PATH = re.compile(r"[A-Za-z][A-Za-z0-9_ ']*")

BLUE, ORANGE, GREEN, PINK, YELLOW, SKY, GRAY, DARK = [
    "#0072B2",
    "#D55E00",
    "#009E73",
    "#CC79A7",
    "#E69F00",
    "#56B4E9",
    "#9A9A9A",
    "#444444",
]  # Okabe and Ito's colors, which color-blind readers can tell apart, and two grays


class Scenery(Declaring):
    """Bodies, shapes, arrows and traces; `Model` inherits it.

    Expressions may hold the symbols of the model's variables, or stand-ins for them that `named`
    returns before they are declared. They add nothing to equations, runs or FMUs.
    """

    def __init__(self, *named: Any) -> None:
        super().__init__(*named)
        self._stand_ins: dict[str, SX] = {}
        self._bodies: dict[str, Body] = {WORLD: Body(WORLD, SX.zeros(3), SX.eye(3))}
        self._shapes: list[Shape] = []
        self._arrows: list[Arrow] = []
        self._traces: list[Trace] = []
        self._world = World()

    def named(self, name: str) -> SX:
        """Return a symbol that stands for the variable of that name, outputs included.

        The variable may be declared later, so that formulations which calculate the same
        quantities in different ways can share one drawing; `freeze` refuses a name that stays
        undeclared. For `body`, `shape`, `arrow` and `trace` only.
        """
        return SX(self._stand_ins.setdefault(name, SX.sym(name)))

    def world(
        self,
        *,
        up: Sequence[float] = (0, 0, 1),
        forward: Sequence[float] = (1, 0, 0),
        axes: Sequence[str] = ("X", "Y", "Z"),
        ground: bool = False,
        follow: str = "",
    ) -> None:
        """Say how the world is shown; see `World`."""
        for what, direction in (("up", up), ("forward", forward)):
            if len(direction) != 3 or not any(direction):
                raise self._refusal(f"{what} is {tuple(direction)}; give a direction (3,)")
        if not isinstance(follow, str):
            raise self._refusal(f"follow is {represented(follow)}; give the name of a body")
        if len(axes) != 3:
            raise self._refusal(f"axes are {tuple(axes)}; give three names")
        u, f = (tuple(float(c) for c in direction) for direction in (up, forward))
        self._world = World((u[0], u[1], u[2]), (f[0], f[1], f[2]), (axes[0], axes[1], axes[2]),
                            ground, follow)  # fmt: skip

    def body(self, name: str, place: Any, rotation: Any = None) -> str:
        """Declare a moving frame for shapes; return its name.

        Args:
            name: Of the body; BODY/PART for a part of one, whose own axes are not shown.
            place: Its origin in the world, (3, 1), m.
            rotation: R of its axes in the world, (3, 3); it does not turn when None.
        """
        self._free(name, self._bodies, "body")
        turn = self._matrix(f"rotation of '{name}'", SX.eye(3) if rotation is None else rotation, 3)
        self._bodies[name] = Body(name, self._matrix(f"place of '{name}'", place, 1), turn)
        return name

    def shape(
        self,
        name: str,
        kind: str,
        size: Any,
        *,
        body: str = WORLD,
        at: Any = (0, 0, 0),
        along: Any = (0, 0, 1),
        color: str = BLUE,
    ) -> None:
        """Declare something that is fixed in a body, or in the world.

        Args:
            name: E.g. "handlebar".
            kind: "box", "cylinder", "sphere", "wheel", "axes" or "line".
            size: Its lengths, m, of parameters: see `SIZES`; of a line, points (3, n).
            body: What `body` returned.
            at: Its middle in the body's axes, (3, 1), m; of parameters.
            along: Its third axis in the body's axes (the axle of a wheel), (3, 1); of parameters.
            color: "#rrggbb".
        """
        self._free(f"{body}/{name}", [f"{s.body}/{s.name}" for s in self._shapes], "shape")
        if body not in self._bodies:
            raise self._refusal(f"shape '{name}': there is no body '{body}'; call body() first")
        if kind not in SIZES:
            raise self._refusal(f"shape '{name}': no kind '{kind}'; there are {', '.join(SIZES)}")
        lengths = ca.vec(_dense(size))
        sizes = SIZES[kind]
        count = lengths.numel()
        if (count < 6 or count % 3) if sizes is None else count != len(sizes):
            expected = "two or more points (3, n)" if sizes is None else f"{', '.join(sizes)}"
            raise self._refusal(f"shape '{name}': {count} numbers; a {kind} has {expected}")
        self._shapes.append(
            Shape(
                name,
                body,
                kind,
                lengths,
                self._matrix(f"place of '{name}'", at, 1),
                self._matrix(f"direction of '{name}'", along, 1),
                self._color(name, color),
            )
        )

    def rod(
        self,
        name: str,
        ends: Sequence[Any],
        radius: Any,
        *,
        body: str = WORLD,
        color: str = BLUE,
    ) -> None:
        """Declare a cylinder between two points, (3, 1) each, in a body's axes."""
        start, end = (self._matrix(f"end of '{name}'", point, 1) for point in ends)
        size = ca.vertcat(SX(radius), ca.norm_2(end - start))
        middle = (start + end) / 2
        self.shape(name, "cylinder", size, body=body, at=middle, along=end - start, color=color)

    def arrow(
        self,
        name: str,
        at: Any,
        vector: Any,
        meaning: str,
        *,
        unit: str = "N",
        color: str = ORANGE,
    ) -> None:
        """Declare a force or a torque: the point where it acts and its components in the world.

        Args:
            name: E.g. "force at P".
            at: The point, (3, 1), m, in the world.
            vector: The components, (3, 1), in the world.
            meaning: What acts on what.
            unit: Of the components: "N" or "N.m".
            color: "#rrggbb".
        """
        self._free(name, [arrow.name for arrow in self._arrows], "arrow")
        shown = self._display_of(unit)
        try:
            convert(1.0, unit, shown)
        except ValueError as error:
            raise self._refusal(f"arrow '{name}': {error}") from error
        place = self._matrix(f"point of '{name}'", at, 1)
        components = self._matrix(f"components of '{name}'", vector, 1)
        color = self._color(name, color)
        self._arrows.append(Arrow(name, place, components, unit, shown, meaning, color))

    def trace(self, name: str, at: Any, *, color: str = GRAY) -> None:
        """Declare a point whose path is drawn, (3, 1), m, in the world."""
        self._free(name, [trace.name for trace in self._traces], "trace")
        place = self._matrix(f"point of '{name}'", at, 1)
        self._traces.append(Trace(name, place, self._color(name, color)))

    def _drawing(self, symbols: SX, parameters: SX, names: Mapping[str, Any]) -> Drawing:
        """Return the drawing; `ValueError` for expressions of what the model does not have."""
        missing = [name for name in self._stand_ins if name not in names]
        if missing:
            raise ValueError(f"a drawing needs {quoted(missing)}, which the model does not declare")
        stand_ins = ca.vertcat(SX(0, 1), *self._stand_ins.values())
        known = {symbol.name() for symbol in ca.vertsplit(parameters)}
        fixed = [name for name in self._stand_ins if name in known]
        moving = [
            *((f"body '{b.name}'", ca.vertcat(b.place, ca.vec(b.rotation)))
              for b in self._bodies.values()),
            *((f"arrow '{a.name}'", ca.vertcat(a.at, a.vector)) for a in self._arrows),
            *((f"trace '{t.name}'", t.at) for t in self._traces),
        ]  # fmt: skip
        still = [(f"shape '{s.name}'", ca.vertcat(s.size, s.at, s.along)) for s in self._shapes]
        constant = ca.vertcat(parameters, *(self._stand_ins[name] for name in fixed))
        reject_faulty(moving, ca.vertcat(symbols, stand_ins), "declared symbols")
        reject_faulty(still, constant, "parameters")
        if self._world.follow and self._world.follow not in self._bodies:
            raise ValueError(f"world: there is no body '{self._world.follow}' to follow")
        if not (self._shapes or self._arrows or self._traces):
            return Drawing()
        return Drawing(
            tuple(self._bodies.values()),
            tuple(self._shapes),
            tuple(self._arrows),
            tuple(self._traces),
            self._world,
        )

    def _matrix(self, what: str, value: Any, columns: int) -> SX:
        try:
            matrix = _dense(value)
        except Exception as error:  # of CasADi: wrong type of argument
            raise self._refusal(no_expression(what, value)) from error
        if matrix.shape != (3, columns):
            raise self._refusal(f"{what} has shape {matrix.shape}; give shape (3, {columns})")
        return matrix

    def _free(self, name: str, taken: Any, what: str) -> None:
        if not isinstance(name, str) or not all(map(_PATH.fullmatch, name.split("/"))):
            raise self._refusal(
                f"{represented(name)} cannot name a {what}: use letters, digits, _ and blanks"
            )
        if name in taken:
            raise self._refusal(f"{what} '{name}' is declared twice; choose another name")

    def _color(self, name: str, color: str) -> str:
        if not isinstance(color, str) or not _COLOR.fullmatch(color):
            raise self._refusal(f"'{name}' has color {represented(color)}; write it as '#rrggbb'")
        return color


def _dense(value: Any) -> SX:
    if isinstance(value, Sequence) and not isinstance(value, str):
        value = ca.vertcat(*value)
    return ca.densify(SX(value))
