"""Triangle meshes of shapes: vertices, m, (n, 3), in the shape's own axes, and faces (m, 3)."""

from collections.abc import Callable
from itertools import pairwise, product
from math import pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.arrays import Vector
from cosim.drawing.pose import Solid

Faces = NDArray[np.int_]

_AROUND = 20  # corners of a circle
_THIN = 0.004  # radius of a line over its length


class Mesh(NamedTuple):
    """Vertices (n, 3) and triangles between them (m, 3), counterclockwise seen from outside."""

    vertices: Vector
    faces: Faces

    def moved(self, at: Vector, rotation: Vector) -> "Mesh":
        """Return the mesh rotated, then shifted."""
        return Mesh(self.vertices @ rotation.T + at, self.faces)


def mesh_of(solid: Solid) -> Mesh:
    """Return the mesh of a shape in the axes of its body."""
    return _MAKERS[solid.kind](solid.size).moved(solid.at, onto(solid.along))


def onto(direction: Vector) -> Vector:
    """Return the smallest rotation, (3, 3), that turns the third axis into a direction, (3,)."""
    length = float(np.linalg.norm(direction))
    if not length > 0:
        return np.eye(3)
    x, y, z = direction / length
    if z < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    k = 1 / (1 + z)
    return np.array([[1 - k * x * x, -k * x * y, x], [-k * x * y, 1 - k * y * y, y], [-x, -y, z]])


def joined(parts: list[Mesh]) -> Mesh:
    """Return several meshes as one."""
    shifts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    faces = [part.faces + shift for part, shift in zip(parts, shifts, strict=True)]
    return Mesh(np.vstack([part.vertices for part in parts]), np.vstack(faces))


def box(size: tuple[float, ...]) -> Mesh:
    """Return a box of three lengths."""
    corners = np.array([*product((-0.5, 0.5), repeat=3)]) * size
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return Mesh(corners, np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]))


def cone(size: tuple[float, ...]) -> Mesh:
    """Return a cone of two radii (below, above) and a length along the third axis."""
    below, above, length = size
    angles = 2 * pi * np.arange(_AROUND) / _AROUND
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    rings = [
        np.column_stack([radius * circle, np.full(_AROUND, z)])
        for radius, z in ((below, -length / 2), (above, length / 2))
    ]
    centers = np.array([[0, 0, -length / 2], [0, 0, length / 2]])
    i = np.arange(_AROUND)
    j, n = (i + 1) % _AROUND, _AROUND
    faces = [
        np.column_stack([i, j, n + j]),
        np.column_stack([i, n + j, n + i]),
        np.column_stack([j, i, np.full(n, 2 * n)]),
        np.column_stack([n + i, n + j, np.full(n, 2 * n + 1)]),
    ]
    return Mesh(np.vstack([*rings, centers]), np.vstack(faces))


def cylinder(size: tuple[float, ...]) -> Mesh:
    """Return a cylinder of radius and length along the third axis."""
    return cone((size[0], size[0], size[1]))


def sphere(size: tuple[float, ...]) -> Mesh:
    """Return a sphere."""
    return _surface(lambda u, v: size[0] * _round(u, pi * v - pi / 2), 16, 8, closed=False)


def wheel(size: tuple[float, ...]) -> Mesh:
    """Return a tire around the third axis with six spokes."""
    radius, tire = size

    def torus(u: Vector, v: Vector) -> Vector:
        reach = radius - tire + tire * np.cos(2 * pi * v)
        circle = [reach * np.cos(2 * pi * u), reach * np.sin(2 * pi * u)]
        return np.stack([*circle, tire * np.sin(2 * pi * v)], axis=-1)

    parts = [_surface(torus, 36, 8, closed=True)]
    spoke = cylinder((0.25 * tire, 2 * (radius - tire)))
    for k in range(3):
        c, s = np.cos(pi * k / 3), np.sin(pi * k / 3)
        parts.append(spoke.moved(np.zeros(3), onto(np.array([c, s, 0.0]))))
    parts.append(cylinder((1.2 * tire, 3 * tire)))
    return joined(parts)


def line(points: tuple[float, ...]) -> Mesh:
    """Return a path between points as thin rods."""
    corners = np.array(points).reshape(-1, 3)
    gaps = np.diff(corners, axis=0)
    radius = _THIN * float(np.linalg.norm(gaps, axis=1).sum())
    return joined([_between(a, b, radius) for a, b in pairwise(corners)])


def axes(size: tuple[float, ...]) -> Mesh:
    """Return three thin rods along the axes."""
    ends = size[0] * np.eye(3)
    return joined([_between(np.zeros(3), end, 0.02 * size[0]) for end in ends])


def arrow(start: Vector, end: Vector, radius: float) -> Mesh:
    """Return an arrow; its head is at most half of its length."""
    length = float(np.linalg.norm(end - start))
    if not length > 0:
        return Mesh(np.empty((0, 3)), np.empty((0, 3), dtype=int))
    head = min(6 * radius, length / 2)
    turn = onto(end - start)
    shaft = cylinder((radius, length - head)).moved(
        np.array([0, 0, (length - head) / 2]), np.eye(3)
    )
    tip = cone((2.4 * radius, 0.0, head)).moved(np.array([0, 0, length - head / 2]), np.eye(3))
    return joined([shaft, tip]).moved(start, turn)


def _between(a: Vector, b: Vector, radius: float) -> Mesh:
    length = float(np.linalg.norm(b - a))
    return cylinder((radius, length)).moved((a + b) / 2, onto(b - a))


def _round(u: Vector, elevation: Vector) -> Vector:
    flat = np.cos(elevation)
    return np.stack(
        [flat * np.cos(2 * pi * u), flat * np.sin(2 * pi * u), np.sin(elevation)], axis=-1
    )


def _surface(
    place: Callable[[Vector, Vector], Vector], across: int, down: int, *, closed: bool
) -> Mesh:
    """Return a surface of two parameters in 0 ... 1, periodic in the first, in both if closed."""
    rows = down if closed else down + 1
    u, v = np.meshgrid(np.arange(across) / across, np.arange(rows) / down)
    vertices = place(u.ravel(), v.ravel())
    faces = []
    for j, i in product(range(down), range(across)):
        a, b = j * across + i, j * across + (i + 1) % across
        c, d = ((j + 1) % rows) * across + (i + 1) % across, ((j + 1) % rows) * across + i
        faces += [(a, b, c), (a, c, d)]
    return Mesh(vertices, np.array(faces))


_MAKERS: dict[str, Callable[[tuple[float, ...]], Mesh]] = {
    "box": box,
    "cylinder": cylinder,
    "sphere": sphere,
    "wheel": wheel,
    "line": line,
    "axes": axes,
}
