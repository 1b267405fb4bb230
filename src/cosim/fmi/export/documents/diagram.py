"""A picture of the mechanism with its frames and signs, and an icon; same model, same bytes.

Seen from far away (no perspective). Shapes are drawn as their outlines, the farthest first.
"""

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from casadi_models.dae.drawing import World
from cosim.arrays import Vector as Array
from cosim.fmi.export.documents.labels import Labels
from cosim.fmi.export.documents.pose import Pose, Solid

DIAGRAM_SIZE = (640, 480)  # of the diagram, pixels
ICON = 128  # edge of the icon
_FINER = 2  # drawn so many times larger, and averaged
_COLOURS = 32
_AXES = ("#B03030", "#207020", "#2040B0")  # of frames: 1, 2, 3
_LOAD, _TURN, _INK = "#A04A00", "#7A2A6A", "#303030"
_FRAME, _ARROW = 0.13, 0.2  # lengths in sizes of the scene


@dataclass(frozen=True)
class View:
    """From where the scene is seen: directions to the right, upward, towards the eye, (3, 3)."""

    axes: Array

    @classmethod
    def of(cls, world: World) -> "View":
        """Return the view from the right, from before and from above."""
        up, forward = (np.array(v) / np.linalg.norm(v) for v in (world.up, world.forward))
        back = 0.75 * forward + np.cross(forward, up) + 0.55 * up
        back /= np.linalg.norm(back)
        right = np.cross(up, back)
        right /= np.linalg.norm(right)
        return cls(np.array([right, np.cross(back, right), back]))

    def seen(self, points: Array) -> Array:
        """Return places in the picture and nearness, (n, 3)."""
        return np.atleast_2d(points) @ self.axes.T


@dataclass(frozen=True)
class Patch:
    """An outline, (n, 2), filled or a line of a width, and how near it is."""

    outline: Array
    colour: str
    near: float
    width: float = 0.0


def patches(pose: Pose, view: View) -> list[Patch]:
    """Return what is seen of the shapes, the farthest first, m."""
    found = [_patch(solid, view) for solid in pose.solids if solid.kind != "axes"]
    return sorted(found, key=lambda patch: patch.near)


def _patch(solid: Solid, view: View) -> Patch:
    local, width = _points(solid)
    seen = view.seen(solid.middle + local @ solid.rotation.T)
    near = float(seen[:, 2].mean())
    if width is not None:
        return Patch(seen[:, :2], solid.colour, near, width)
    return Patch(_hull(seen[:, :2]), solid.colour, near)


def _points(solid: Solid) -> tuple[Array, float | None]:
    """Return points of a shape's surface in its own axes, and the width where it is a line."""
    size = solid.size
    angle = np.linspace(0, 2 * np.pi, 61)
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    if solid.kind == "wheel":
        return size[0] * circle, 2 * float(size[1])
    if solid.kind == "line":
        return size.reshape(-1, 3), 0.0
    if solid.kind == "cylinder":
        end = np.array([0, 0, size[1] / 2])
        return np.vstack([size[0] * circle - end, size[0] * circle + end]), None
    if solid.kind == "sphere":
        rings = [circle[:, order] for order in ([0, 1, 2], [2, 0, 1], [1, 2, 0])]
        tilted = [np.cos(t) * rings[0] + [0, 0, np.sin(t)] for t in (0.4, 0.8, -0.4, -0.8)]
        return size[0] * np.vstack([*rings, *tilted]), None
    corners = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T
    return corners * size, None


def _hull(points: Array) -> Array:
    """Return the convex outline of points, (n, 2) (Andrew's monotone chain)."""
    ordered = sorted({(float(x), float(y)) for x, y in points})

    def chain(sequence: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
        kept: list[tuple[float, float]] = []
        for x, y in sequence:
            while len(kept) > 1:
                (ax, ay), (bx, by) = kept[-2:]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0:
                    break
                kept.pop()
            kept.append((x, y))
        return kept[:-1]

    return np.array(chain(ordered) + chain(ordered[::-1]) or ordered)


@dataclass(frozen=True)
class Pointer:
    """An arrow in the picture, m, with what stands at its tip."""

    start: Array
    end: Array
    colour: str
    text: str
    double: bool = False


def pointers(pose: Pose, view: View, size: float) -> Iterator[Pointer]:
    """Yield the frames of the bodies, and the positive directions of loads and turns."""

    def pointer(at: Array, along: Array, length: float, *rest: object) -> Pointer:
        direction = along / max(float(np.linalg.norm(along)), 1e-300)
        ends = view.seen(np.array([at, at + length * size * direction]))[:, :2]
        return Pointer(ends[0], ends[1], *rest)  # type: ignore[arg-type]

    for _, origin, rotation in _triads(pose):
        for i, colour in enumerate(_AXES):
            yield pointer(origin, rotation[:, i], _FRAME, colour, str(i + 1))
    for sign in pose.signs:
        turn = sign.kind == "turn"
        length = 1.35 * _ARROW if turn else _ARROW
        colour = _TURN if turn else _LOAD
        yield pointer(sign.at, sign.direction, length, colour, ", ".join(sign.names), turn)


def _triads(pose: Pose) -> Iterator[tuple[str, Array, Array]]:
    """Yield the frames, those that coincide as one, with the names of all of them."""
    left = list(pose.frames)
    while left:
        _, origin, rotation = left[0]
        here = [_coincide(frame, left[0]) for frame in left]
        names = [name for (name, _, _), same in zip(left, here, strict=True) if same]
        yield ", ".join(names), origin, rotation
        left = [frame for frame, same in zip(left, here, strict=True) if not same]


def _coincide(one: tuple[str, Array, Array], other: tuple[str, Array, Array]) -> bool:
    near = np.allclose(one[1], other[1], atol=1e-6)
    return near and np.allclose(one[2], other[2], atol=1e-3)


def diagram(pose: Pose, world: World) -> bytes:
    """Return the picture of a mechanism as PNG."""
    view = View.of(world)
    shapes = patches(pose, view)
    outline = np.vstack([patch.outline for patch in shapes])
    size = float(np.linalg.norm(np.ptp(outline, axis=0))) or 1.0
    arrows = [*pointers(pose, view, size)]
    ends = np.vstack([outline, *(np.array([a.start, a.end]) for a in arrows)])
    sheet = _Sheet(DIAGRAM_SIZE, ends, margin=0.1)
    for patch in shapes:
        sheet.patch(patch)
    for arrow in arrows:
        sheet.arrow(arrow.start, arrow.end, arrow.colour, arrow.double)
    sheet.corner(view, world.axes)
    for arrow in sorted(arrows, key=lambda arrow: -len(arrow.text)):  # axes have most freedom left
        sheet.text(arrow.end, arrow.text, arrow.colour)
    for name, origin, _ in _triads(pose):
        sheet.text(view.seen(origin)[0, :2], name, _INK)
    return sheet.png(DIAGRAM_SIZE)


def icon(pose: Pose, world: World) -> bytes:
    """Return the mechanism alone on a square, as PNG."""
    shapes = patches(pose, View.of(world))
    sheet = _Sheet((ICON, ICON), np.vstack([patch.outline for patch in shapes]), margin=0.06)
    for patch in shapes:
        sheet.patch(patch)
    return sheet.png((ICON, ICON))


class _Sheet:
    """A bitmap onto which points in metres are drawn."""

    def __init__(self, size: tuple[int, int], points: Array, margin: float) -> None:
        from PIL import Image, ImageDraw, ImageFont

        self.size = np.array(size) * _FINER
        self.image = Image.new("RGB", (int(self.size[0]), int(self.size[1])), "white")
        self.pen = ImageDraw.Draw(self.image)
        self.font = ImageFont.load_default(13 * _FINER)
        low, high = points.min(axis=0), points.max(axis=0)
        self.middle = (low + high) / 2
        room = np.maximum(high - low, 1e-9)
        self.scale = float(((1 - 2 * margin) * self.size / room).min())
        self.labels = Labels((float(self.size[0]), float(self.size[1])), 6 * _FINER)

    def place(self, points: Array) -> list[tuple[float, float]]:
        """Return pixels, (x, y) each, y downward."""
        flat = (np.atleast_2d(points) - self.middle) * self.scale * [1, -1] + self.size / 2
        return [(round(float(x), 2), round(float(y), 2)) for x, y in flat]

    def patch(self, patch: Patch) -> None:
        """Draw a filled outline, or a line."""
        pixels = self.place(patch.outline)
        if patch.width or len(pixels) < 3:
            width = max(2 * _FINER, round(patch.width * self.scale))
            self.pen.line(pixels, fill=patch.colour, width=width, joint="curve")
        else:
            self.pen.polygon(pixels, fill=patch.colour)
            self.pen.line([*pixels, pixels[0]], fill=_darker(patch.colour), width=_FINER)

    def arrow(self, start: Array, end: Array, colour: str, double: bool = False) -> None:
        """Draw an arrow; a turn has two heads."""
        (x0, y0), (x1, y1) = self.place(np.array([start, end]))
        self.pen.line([(x0, y0), (x1, y1)], fill=colour, width=2 * _FINER)
        self.labels.line((x0, y0), (x1, y1))
        along = np.array([x1 - x0, y1 - y0])
        length = float(np.linalg.norm(along))
        if length < 4 * _FINER:  # towards the eye
            self.pen.ellipse(
                [x1 - 4 * _FINER, y1 - 4 * _FINER, x1 + 4 * _FINER, y1 + 4 * _FINER],
                outline=colour,
                width=_FINER,
            )
            return
        along /= length
        across = np.array([-along[1], along[0]])
        for back in (0, 8 * _FINER) if double else (0,):
            tip = np.array([x1, y1]) - back * along
            wings = [tip - 9 * _FINER * along + side * 4 * _FINER * across for side in (1, -1)]
            self.pen.polygon([tuple(tip), *map(tuple, wings)], fill=colour)

    def text(self, at: Array, text: str, colour: str) -> None:
        """Write beside a point, where room is."""
        left, top, right, bottom = self.pen.textbbox((0, 0), text, font=self.font)
        place = self.labels.place(self.place(at)[0], right - left, bottom - top)
        self.pen.text(
            (place[0] - left, place[1] - top),
            text,
            fill=colour,
            font=self.font,
            stroke_width=_FINER,
            stroke_fill="white",
        )

    def corner(self, view: View, names: Sequence[str]) -> None:
        """Draw the world's axes in the lower left corner."""
        pixel = np.array([70 * _FINER, self.size[1] - 70 * _FINER])
        origin = self.middle + (pixel - self.size / 2) * [1, -1] / self.scale
        for name, axis in zip(names, np.eye(3), strict=True):
            end = origin + 45 * _FINER / self.scale * view.seen(axis)[0, :2]
            self.arrow(origin, end, _INK)
            self.text(end, name, _INK)

    def png(self, size: tuple[int, int]) -> bytes:
        """Return the picture in its final size."""
        from PIL import Image

        small = self.image.resize(size, Image.Resampling.BOX)
        content = io.BytesIO()
        small.quantize(_COLOURS, Image.Quantize.MEDIANCUT).save(content, "png", optimize=True)
        return content.getvalue()


def _darker(colour: str) -> str:
    parts = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return "#" + "".join(f"{round(0.7 * part):02x}" for part in parts)
