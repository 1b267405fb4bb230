"""Diagrams of mechanisms: frames and positive directions at the start values, and an icon.

Pillow draws them, so that an export does not load matplotlib; the same model gives the same bytes.
"""

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cosim.arrays import Vector
from cosim.colors import FRAME_AXES, INK, LOAD, TURN
from cosim.drawing.camera import Camera, View, camera_for, scale_of
from cosim.drawing.meshes import mesh_of
from cosim.drawing.pose import Poses, StartPose

DIAGRAM_SIZE = (640, 480)  # pixels
ICON_SIZE = (128, 128)
_FINER = 2  # pictures are drawn so many times larger, then averaged
_COLORS = 64
_FAR_AWAY = 100.0  # distance of the camera, in sizes of the scene: hardly any perspective
_FRAME, _ARROW = 0.13, 0.2  # lengths over the size of the mechanism

Frame = tuple[str, Vector, Vector]  # name, origin (3,), rotation matrix (3, 3)
Box = tuple[float, float, float, float]  # left, top, right, bottom


@dataclass(frozen=True)
class Pointer:
    """An arrow between two points, m, (3,), with a text at its tip; angles have two heads."""

    start: Vector
    end: Vector
    color: str
    text: str
    double: bool = False


def pointers(pose: StartPose, size: float) -> Iterator[Pointer]:
    """Yield the axes of the bodies' frames and the positive directions of loads and angles.

    Their lengths follow from the size of the mechanism, m.
    """

    def pointer(at: Vector, along: Vector, length: float, *rest: object) -> Pointer:
        direction = along / max(float(np.linalg.norm(along)), 1e-300)
        return Pointer(at, at + length * size * direction, *rest)  # type: ignore[arg-type]

    for _, origin, rotation in distinct_frames(pose):
        for i, color in enumerate(FRAME_AXES):
            yield pointer(origin, rotation[:, i], _FRAME, color, str(i + 1))
    for sign in pose.signs:
        length, color = (1.35 * _ARROW, TURN) if sign.turns else (_ARROW, LOAD)
        yield pointer(sign.at, sign.direction, length, color, ", ".join(sign.names), sign.turns)


def distinct_frames(pose: StartPose) -> Iterator[Frame]:
    """Yield the frames of the bodies; those that coincide as one, with all their names."""
    left = list(pose.frames)
    while left:
        _, origin, rotation = left[0]
        here = [
            np.allclose(at, origin, rtol=0, atol=1e-6 * pose.size)
            and np.allclose(turned, rotation, atol=1e-3)
            for _, at, turned in left
        ]
        names = [name for (name, _, _), same in zip(left, here, strict=True) if same]
        yield ", ".join(names), origin, rotation
        left = [frame for frame, same in zip(left, here, strict=True) if not same]


def diagram(pose: StartPose) -> bytes:
    """Return the picture of a mechanism with its frames and positive directions, as PNG."""
    camera = _camera(pose.poses)
    corners, colors = _triangles(pose.poses)
    faces, shades = camera.faces(corners, colors)
    size = float(np.linalg.norm(np.ptp(corners.reshape(-1, 3) @ camera.axes[:2].T, axis=0)))
    arrows = [*pointers(pose, size or 1.0)]
    ends = [camera.seen(np.array([a.start, a.end]))[:, :2] for a in arrows]
    sheet = _Sheet(DIAGRAM_SIZE, np.vstack([faces.reshape(-1, 2), *ends]), margin=0.1)
    sheet.shapes(faces, shades)
    for arrow, both in zip(arrows, ends, strict=True):
        sheet.arrow(both[0], both[1], arrow.color, arrow.double)
    sheet.corner(camera, pose.poses.world.axes)
    texts = sorted(zip(arrows, ends, strict=True), key=lambda pair: -len(pair[0].text))
    for arrow, both in texts:  # short names last: they find a place most easily
        sheet.text(both[1], arrow.text, arrow.color)
    for name, origin, _ in distinct_frames(pose):
        sheet.text(camera.seen(origin)[:2], name, INK)
    return sheet.png(DIAGRAM_SIZE)


def icon(pose: StartPose) -> bytes:
    """Return the mechanism alone on a square, as PNG."""
    faces, shades = _camera(pose.poses).faces(*_triangles(pose.poses))
    sheet = _Sheet(ICON_SIZE, faces.reshape(-1, 2), margin=0.06)
    sheet.shapes(faces, shades)
    return sheet.png(ICON_SIZE)


def _camera(poses: Poses) -> Camera:
    return camera_for(poses.world, View.ISO, scale_of([poses], ""), _FAR_AWAY)


def _triangles(poses: Poses) -> tuple[Vector, Vector]:
    """Return the triangles of the shapes in the world, m, (n, 3, 3), and their colors (n, 3)."""
    corners, colors = [], []
    for solid in (solid for solid in poses.solids if solid.kind != "axes"):
        mesh = mesh_of(solid).moved(poses.places[0, solid.body], poses.rotations[0, solid.body])
        color = [int(solid.color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        corners.append(mesh.vertices[mesh.faces])
        colors.append(np.tile(color, (len(mesh.faces), 1)))
    return np.vstack(corners), np.vstack(colors)


class _Sheet:
    """A bitmap onto which points of a camera's picture are drawn."""

    def __init__(self, size: tuple[int, int], points: Vector, margin: float) -> None:
        from PIL import Image, ImageDraw, ImageFont

        self.size = np.array(size) * _FINER
        self.image = Image.new("RGB", (int(self.size[0]), int(self.size[1])), "white")
        self.pen = ImageDraw.Draw(self.image)
        self.font = ImageFont.load_default(13 * _FINER)
        low, high = points.min(axis=0), points.max(axis=0)
        self.middle = (low + high) / 2
        self.scale = float(((1 - 2 * margin) * self.size / np.maximum(high - low, 1e-9)).min())
        self.labels = Labels((float(self.size[0]), float(self.size[1])), 6 * _FINER)

    def place(self, points: Vector) -> list[tuple[float, float]]:
        """Return pixels, (x, y) each, y downward."""
        flat = (np.atleast_2d(points) - self.middle) * self.scale * [1, -1] + self.size / 2
        return [(round(float(x), 2), round(float(y), 2)) for x, y in flat]

    def shapes(self, faces: Vector, shades: Vector) -> None:
        """Draw shaded triangles, the first one behind."""
        pixels = self.place(faces.reshape(-1, 2))
        for i, shade in enumerate(np.round(255 * shades).astype(int).tolist()):
            self.pen.polygon(pixels[3 * i : 3 * i + 3], fill=tuple(shade), outline=tuple(shade))

    def arrow(self, start: Vector, end: Vector, color: str, double: bool = False) -> None:
        """Draw an arrow with one head or two."""
        (x0, y0), (x1, y1) = self.place(np.array([start, end]))
        self.pen.line([(x0, y0), (x1, y1)], fill=color, width=2 * _FINER)
        self.labels.line((x0, y0), (x1, y1))
        along = np.array([x1 - x0, y1 - y0])
        length = float(np.linalg.norm(along))
        if length < 4 * _FINER:  # toward the eye
            radius = 4 * _FINER
            circle = [x1 - radius, y1 - radius, x1 + radius, y1 + radius]
            self.pen.ellipse(circle, outline=color, width=_FINER)
            return
        along /= length
        across = np.array([-along[1], along[0]])
        for back in (0, 8 * _FINER) if double else (0,):
            tip = np.array([x1, y1]) - back * along
            wings = [tip - 9 * _FINER * along + side * 4 * _FINER * across for side in (1, -1)]
            self.pen.polygon([tuple(tip), *map(tuple, wings)], fill=color)

    def text(self, at: Vector, text: str, color: str) -> None:
        """Write near a point, where no other text is."""
        left, top, right, bottom = self.pen.textbbox((0, 0), text, font=self.font)
        place = self.labels.place(self.place(at)[0], right - left, bottom - top)
        self.pen.text(
            (place[0] - left, place[1] - top),
            text,
            fill=color,
            font=self.font,
            stroke_width=_FINER,
            stroke_fill="white",
        )

    def corner(self, camera: Camera, names: Sequence[str]) -> None:
        """Draw the world's axes in the lower left corner."""
        pixel = np.array([70 * _FINER, self.size[1] - 70 * _FINER])
        origin = self.middle + (pixel - self.size / 2) * [1, -1] / self.scale
        for name, axis in zip(names, np.eye(3), strict=True):
            end = origin + 45 * _FINER / self.scale * (camera.axes @ axis)[:2]
            self.arrow(origin, end, INK)
            self.text(end, name, INK)

    def png(self, size: tuple[int, int]) -> bytes:
        """Return the picture in its final size."""
        from PIL import Image

        small = self.image.resize(size, Image.Resampling.BOX)
        content = io.BytesIO()
        small.quantize(_COLORS, Image.Quantize.MEDIANCUT).save(content, "png", optimize=True)
        return content.getvalue()


_DIRECTIONS = 16
_RINGS = (1.0, 1.8, 2.8, 4.0)  # distances from the point, in gaps
_SAMPLE = 0.5  # distance of the points that stand for a line, in gaps
_ON_TEXT, _ON_LINE, _OUTSIDE, _FAR = 300.0, 8.0, 1000.0, 6.0  # costs


class Labels:
    """Places of texts: near their points, neither on each other nor on lines.

    Args:
        size: Width and height of the picture, pixels; y is downward.
        gap: Distance of a text from its point, pixels.

    Attributes:
        boxes: The places that are taken by texts.
    """

    def __init__(self, size: Sequence[float], gap: float) -> None:
        self._size, self._gap = np.array(size), gap
        self.boxes: list[Box] = []
        self._on_lines = np.zeros((0, 2))

    def line(self, start: Sequence[float], end: Sequence[float]) -> None:
        """Add a line that texts should not cover."""
        ends = np.array([start, end], dtype=float)
        count = 2 + int(np.linalg.norm(ends[1] - ends[0]) / (_SAMPLE * self._gap))
        share = np.linspace(0, 1, count)[:, None]
        points = ends[0] + share * (ends[1] - ends[0])
        self._on_lines = np.vstack([self._on_lines, points])

    def place(self, at: Sequence[float], width: float, height: float) -> Box:
        """Return the best place for a text of this size beside a point, and take it."""
        size = np.array([width, height])
        angles = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
        rays = np.column_stack([np.cos(angles), -np.sin(angles)])  # the one to the right first
        rings = np.repeat(_RINGS, _DIRECTIONS)
        away = np.tile(rays, (len(_RINGS), 1)) * (rings[:, None] * self._gap + size / 2)
        low = np.array(at) + away - size / 2
        best = low[np.argmin(self._costs(low, size) + _FAR * (rings - 1))]
        left, top, right, bottom = np.concatenate([best, best + size]).tolist()
        self.boxes.append((left, top, right, bottom))
        return self.boxes[-1]

    def _costs(self, low: Vector, size: Vector) -> Vector:
        """Return the cost of boxes with corners (n, 2) and a size: what they cover or leave."""
        high = low + size
        texts = np.zeros(len(low))
        for left, top, right, bottom in self.boxes:
            shared = np.minimum(high, (right, bottom)) - np.maximum(low, (left, top))
            texts += np.maximum(shared, 0.0).prod(axis=1)
        share = texts / size.prod()
        inside = (self._on_lines > low[:, None]) & (self._on_lines < high[:, None])
        covered = inside.all(axis=2).sum(axis=1)
        outside = (low < 0).any(axis=1) | (high > self._size).any(axis=1)
        on_text = np.where(share > 0, _ON_TEXT * (1 + share), 0.0)
        costs: Vector = on_text + _ON_LINE * covered + _OUTSIDE * outside
        return costs
