"""Poses as a picture: triangles, seen by a camera, drawn from the farthest to the nearest."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import tan
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from cosim.arrays import Vector
from cosim.present.playback.meshes import Mesh, arrow, joined, mesh_of
from cosim.present.playback.playback import Playback
from cosim.present.playback.turning import to_matrices
from cosim.present.scale import (
    arrow_text,
    invalid_at,
    label_text,
    scale_of,
    view_from,
)

_HALF_ANGLE = 0.36  # rad, of the camera
_GREY = np.array([0.6, 0.6, 0.6])
_PALE = 0.72  # how near to white ghosts are drawn
_SHAFT = 0.012  # radius of an arrow's shaft, in sizes of the scene


@dataclass(frozen=True)
class Camera:
    """Place of the eye, and directions to the right, upward and towards the eye, rows (3, 3)."""

    eye: Vector
    axes: Vector

    @classmethod
    def at(cls, eye: Vector, centre: Vector, up: Vector) -> "Camera":
        """Return the camera that looks from a point at another one."""
        back = (eye - centre) / np.linalg.norm(eye - centre)
        right = np.cross(up, back)
        right = right / np.linalg.norm(right)
        return cls(eye, np.array([right, np.cross(back, right), back]))

    def seen(self, points: Vector) -> Vector:
        """Return places in the picture and distances, (..., 3); the picture is -1 ... 1 high."""
        local = (points - self.eye) @ self.axes.T
        distance = -local[..., 2]
        near = np.maximum(distance, 1e-6)
        flat = local[..., :2] / (tan(_HALF_ANGLE) * near[..., None])
        return np.concatenate([flat, distance[..., None]], axis=-1)


class Stage:
    """Everything of some runs that does not change from frame to frame.

    Args:
        runs: The first in full colour, the others as pale ghosts.
        view: See `view_from`.
        follow: The body that stays in the middle; see `Playback.followed`.
        size: Of the picture, inches.
    """

    def __init__(
        self, runs: Sequence[Playback], view: str, follow: str | None, size: tuple[float, float]
    ) -> None:
        self.runs, self.scale = runs, scale_of(runs, follow)
        self.shift = runs[0].followed(follow)
        world = runs[0].world
        self.up = np.array(world.up) / np.linalg.norm(world.up)
        self.eye, self.centre = view_from(world, view, self.scale)
        self.width, self.inches = size[0] / size[1], size[0]
        self._fit()
        self.parts = [_parts(run) for run in runs]

    def camera(self, frame: int) -> Camera:
        """Return the camera of a frame."""
        return Camera.at(self.eye + self.shift[frame], self.centre + self.shift[frame], self.up)

    def _fit(self) -> None:
        """Move the camera so that the box of everything fills the picture."""
        for _ in range(8):
            seen = self.camera_at_start().seen(self.scale.corners)
            fill_of = np.abs(seen[:, :2]).max(axis=0) / (0.93 * self.width, 0.85)
            self.eye = self.centre + (self.eye - self.centre) * float(fill_of.max())

    def camera_at_start(self) -> Camera:
        """Return the camera where the followed body is at its start."""
        return Camera.at(self.eye, self.centre, self.up)

    def draw(self, axis: Axes, frames: Sequence[int]) -> None:
        """Draw the poses of some frames into one picture; text says those of the first."""
        camera = self.camera(frames[0])
        axis.clear()
        axis.set_axis_off()
        width = self.width
        axis.set_xlim(-width, width)
        axis.set_ylim(-1, 1)
        axis.set_aspect("equal")
        self._ground(axis, camera, width, frames[0])
        self._paths(axis, camera)
        self._bodies(axis, camera, frames)
        self._axes(axis, camera, width)
        self._texts(axis, frames, width)

    def _bodies(self, axis: Axes, camera: Camera, frames: Sequence[int]) -> None:
        triangles: list[Vector] = []
        colours: list[Vector] = []
        tops: list[tuple[float, float, str]] = []
        for i, (run, parts) in enumerate(zip(self.runs, self.parts, strict=True)):
            for k, frame in enumerate(frames):
                begin = len(triangles)
                pale = _PALE if i else _PALE * (1 - k / (len(frames) - 1)) if len(frames) > 1 else 0
                grey = run.time[frame] >= run.invalid_from
                for body, mesh, colour in parts:
                    turn = to_matrices(run.quaternions[frame, body])
                    placed = mesh.moved(run.places[frame, body], turn)
                    _add(triangles, colours, placed, _GREY if grey else colour, pale)
                for load in run.loads if i == 0 else ():
                    ends = self.scale.arrow(load, frame)
                    tip = arrow(*ends, _SHAFT * self.scale.pose)
                    _add(triangles, colours, tip, _parts_of(load.colour), pale)
                if len(frames) > 1 and i == 0:
                    flat = camera.seen(np.vstack(triangles[begin:]).reshape(-1, 3))
                    middle = (flat[:, 0].min() + flat[:, 0].max()) / 2
                    tops.append((middle, flat[:, 1].max() + 0.02, f"{run.time[frame]:.4g} s"))
        if all(abs(a[0] - b[0]) > 0.3 or abs(a[1] - b[1]) > 0.1 for a, b in combinations(tops, 2)):
            for x, y, text in tops:  # where they would overlap, the title has to do
                axis.text(x, y, text, fontsize=8, ha="center", zorder=6)
        corners, paint = np.vstack(triangles), np.vstack(colours)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        middle = corners.mean(axis=1)
        facing = ((camera.eye - middle) * normals).sum(axis=1) > 0
        seen = camera.seen(corners)
        facing &= (seen[..., 2] > 0).all(axis=1)
        light = 0.5 * self.up + 0.6 * camera.axes[2] - 0.4 * camera.axes[0]
        bright = 0.55 + 0.45 * np.clip(normals @ (light / np.linalg.norm(light)), 0, 1)
        order = np.argsort(-seen[facing].mean(axis=1)[:, 2])
        faces = seen[facing][order][..., :2]
        shaded = np.clip(paint * bright[:, None], 0, 1)[facing][order]
        axis.add_collection(
            PolyCollection(
                list(faces), facecolors=shaded, edgecolors=shaded, linewidths=0.2, zorder=3
            )
        )

    def _ground(self, axis: Axes, camera: Camera, width: float, frame: int) -> None:
        if not self.runs[0].world.ground:
            return
        normal = self.up
        first = np.eye(3)[int(np.argmin(np.abs(normal)))]
        a = np.cross(normal, first)
        b = np.cross(normal, a)
        cell, count = self.scale.cell, 40
        middle = self.centre + self.shift[frame]
        i0, j0 = np.round(middle @ a / cell), np.round(middle @ b / cell)
        lines = []
        fine = np.linspace(-count, count, 81)
        for k in np.arange(-count, count + 1):
            lines.append(np.outer(np.full(81, i0 + k), a) + np.outer(j0 + fine, b))
            lines.append(np.outer(i0 + fine, a) + np.outer(np.full(81, j0 + k), b))
        self._lines(axis, camera, cell * np.array(lines), "0.85", 0.5, 1)

    def _paths(self, axis: Axes, camera: Camera) -> None:
        for i, run in enumerate(self.runs):
            for path in run.paths:
                colour = _parts_of(path.colour)
                paint = tuple(colour + _PALE * (1 - colour) * (i > 0))
                self._lines(axis, camera, path.points[None], paint, 1.0, 2)

    def _lines(
        self, axis: Axes, camera: Camera, lines: Vector, colour: Any, width: float, order: int
    ) -> None:
        seen = camera.seen(lines)
        shown = np.where(seen[..., 2:] > 0.05 * self.scale.pose, seen[..., :2], np.nan)
        axis.add_collection(
            LineCollection(list(shown), colors=[colour], linewidths=width, zorder=order)
        )

    def _axes(self, axis: Axes, camera: Camera, width: float) -> None:
        """Draw the world's directions in the lower left corner."""
        corner = np.array([-width + 0.22, -0.66])
        for name, tip in zip(self.runs[0].world.axes, np.eye(3), strict=True):
            end = 0.13 * (camera.axes @ tip)[:2]
            style = {"arrowstyle": "->", "color": "0.25", "linewidth": 1.0}
            ends = tuple((corner + end).tolist()), tuple(corner.tolist())
            axis.annotate("", *ends, zorder=5, arrowprops=style)
            x, y = corner + end * (1 + 0.045 / max(float(np.linalg.norm(end)), 0.05))
            axis.text(x, y, name, fontsize=8, ha="center", va="center", color="0.25")

    def _texts(self, axis: Axes, frames: Sequence[int], width: float) -> None:
        first, place = self.runs[0], 1.0 - 0.06
        left = -width + 0.06
        lines = [first.title]
        if len(frames) == 1:
            lines.append(label_text(first, frames[0]))
        else:
            shown = ", ".join(f"{first.time[frame]:.4g}" for frame in frames)
            lines.append(f"t = {shown} s")
        lines += [f"pale: {run.title}" for run in self.runs[1:]]
        chars = max(20, int((self.inches - 0.25) * 15))  # at 8 points
        text = "\n".join(fill(line, chars) for line in lines)
        axis.text(left, place, text, fontsize=8, va="top", ha="left", zorder=6)
        worst = max(frames, key=lambda frame: first.time[frame])
        if wrong := invalid_at(self.runs, worst):
            warning = fill(wrong.strip(" |"), chars, max_lines=8, placeholder=" ...")
            box = {"facecolor": "#A02020", "edgecolor": "none", "pad": 3}
            axis.text(left, -0.97, warning, fontsize=8, va="bottom", color="white", zorder=7,
                      bbox=box)  # fmt: skip
        elif told := arrow_text(self.scale, self.runs):
            axis.text(width - 0.06, -0.97, told, fontsize=7, va="bottom", ha="right", color="0.35")


def draw_pose(
    runs: Sequence[Playback],
    frames: Sequence[int],
    *,
    view: str = "iso",
    follow: str | None = None,
    size: tuple[float, float] = (6.4, 4.8),
) -> Figure:
    """Return a figure of one or more poses in one scene.

    Args:
        runs: The first in full colour, the others as pale ghosts.
        frames: Positions in `Playback.time`.
        view: "iso", "front", "side" or "top".
        follow: See `Playback.followed`.
        size: Of the picture, inches.
    """
    figure, axis = canvas(size)
    Stage(runs, view, follow, size).draw(axis, frames)
    return figure


def canvas(size: tuple[float, float]) -> tuple[Figure, Axes]:
    """Return a figure that is filled by one pair of axes."""
    figure = Figure(figsize=size, facecolor="white")
    return figure, figure.add_axes((0, 0, 1, 1))


def _parts(run: Playback) -> list[tuple[int, Mesh, Vector]]:
    """Return the shapes of a run: of each body those of one colour together."""
    groups: dict[tuple[int, str], list[Mesh]] = {}
    for prop in run.props:
        groups.setdefault((prop.body, prop.colour), []).append(mesh_of(prop))
    return [(body, joined(m), _parts_of(colour)) for (body, colour), m in groups.items()]


def _add(
    triangles: list[Vector], colours: list[Vector], mesh: Mesh, colour: Vector, pale: float
) -> None:
    if not len(mesh.faces):
        return
    triangles.append(mesh.vertices[mesh.faces])
    paint = colour + pale * (1 - colour)
    colours.append(np.tile(paint, (len(mesh.faces), 1)))


def _parts_of(colour: str) -> Vector:
    return np.array(to_rgb(colour))
