"""What a model looks like: bodies with shapes, arrows of loads, traces of points.

Everything is a CasADi expression of the model's variables, looked up by name when a picture
is drawn; until then it adds nothing to equations, simulations or FMUs.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from casadi import SX

from casadi_models.dae.packed import packed, unpacked

WORLD = "world"  # the body that rests

# Numbers that a kind of shape needs, m; None: points of a path, three numbers each
SIZES: dict[str, tuple[str, ...] | None] = {
    "box": ("length along 1", "length along 2", "length along 3"),
    "cylinder": ("radius", "length"),
    "sphere": ("radius",),
    "wheel": ("radius", "radius of the tyre"),
    "axes": ("length",),
    "line": None,
}


@dataclass(frozen=True, eq=False)  # CasADi's == builds an expression
class Body:
    """A moving frame: place of its origin, (3, 1), m, and R of its axes in the world, (3, 3)."""

    name: str
    place: SX
    rotation: SX


@dataclass(frozen=True, eq=False)
class Shape:
    """Something fixed in a body.

    Attributes:
        name, body: Its own name, and that of the body.
        kind: A key of `SIZES`.
        size: The numbers that `SIZES` names, m; of parameters.
        at: Its middle in the body's axes, (3, 1), m; of parameters.
        along: Its third axis (of a wheel, the axle) in the body's axes, (3, 1); of parameters.
        color: "#rrggbb".
    """

    name: str
    body: str
    kind: str
    size: SX
    at: SX
    along: SX
    color: str


@dataclass(frozen=True, eq=False)
class Arrow:
    """A force or a torque: its point and its components in the world, (3, 1) each."""

    name: str
    at: SX
    vector: SX
    unit: str
    display_unit: str
    meaning: str
    color: str


@dataclass(frozen=True, eq=False)
class Trace:
    """A point whose path is drawn, (3, 1), m, in the world."""

    name: str
    at: SX
    color: str


@dataclass(frozen=True)
class World:
    """How the world is shown.

    Attributes:
        up: Away from the ground, in world axes.
        forward: From the back of a picture's subject to its front, in world axes.
        axes: What the world's axes are called.
        ground: Whether the plane through the origin across `up` is the ground.
        follow: The body that a camera follows; the camera rests when empty.
    """

    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    forward: tuple[float, float, float] = (1.0, 0.0, 0.0)
    axes: tuple[str, str, str] = ("X", "Y", "Z")
    ground: bool = False
    follow: str = ""


@dataclass(frozen=True, eq=False)
class Drawing:
    """The shapes of a model; false while there are none.

    Attributes:
        bodies, shapes, arrows, traces, world: What is seen.
        numbers: Values of parameters and inputs by name, for what is no variable of a run.
    """

    bodies: tuple[Body, ...] = ()
    shapes: tuple[Shape, ...] = ()
    arrows: tuple[Arrow, ...] = ()
    traces: tuple[Trace, ...] = ()
    world: World = World()
    numbers: Mapping[str, float] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.shapes or self.arrows or self.traces)

    def with_numbers(self, numbers: Mapping[str, float]) -> "Drawing":
        """Return the drawing with values of parameters and inputs; these win over earlier ones."""
        return replace(self, numbers={**self.numbers, **numbers}) if self else self

    def __reduce__(self) -> tuple[Any, ...]:
        return unpacked, packed(self)
