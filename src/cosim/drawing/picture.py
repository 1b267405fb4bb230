"""Pictures: poses drawn by matplotlib as shaded triangles, with ground, paths, arrows and texts."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from math import tan
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from casadi_models.units import convert
from cosim.arrays import Vector
from cosim.colors import GROUND, INVALID, INVALID_BODY
from cosim.drawing.camera import HALF_ANGLE, LONGEST_ARROW, Camera, View, camera_for, scale_of
from cosim.drawing.meshes import Mesh, arrow, joined, mesh_of
from cosim.drawing.pose import Poses, invalid_text
from cosim.plotting import Picture
from cosim.text import moment

SIZE = (6.4, 4.8)  # of a picture, inches
_PALE = 0.72  # share of white in the colors of ghosts
_SHAFT = 0.012  # radius of an arrow's shaft over `Scale.pose`
_SIDE, _ABOVE, _BELOW = 0.2, 0.55, 0.22  # margins around everything that is seen, inches
_LINE = 0.15  # height of a line of text, inches


class Stage:
    """Some runs in one scene: everything that does not change from frame to frame.

    Args:
        runs: The first in full color, the others as pale ghosts.
        view: Where the camera is at first.
        follow: Body that stays in the middle; see `Poses.followed`.
        size: Width and height of the picture, inches.
    """

    def __init__(
        self, runs: Sequence[Poses], view: View, follow: str | None, size: tuple[float, float]
    ) -> None:
        self.runs, self.scale = runs, scale_of(runs, follow)
        self.shift = runs[0].followed(follow)
        self.moved = [self.shift - run.followed(follow) for run in runs]  # beside the first run
        self.width, self.inches = size[0] / size[1], size[0]
        self.start = self._filling(camera_for(runs[0].world, view, self.scale))
        self.parts = [_parts(run) for run in runs]

    def _filling(self, camera: Camera) -> Camera:
        """Return the camera moved so that everything fills the picture."""
        away = camera.eye - self.scale.center
        reach = np.linalg.norm(self.scale.points - self.scale.center, axis=1).max()
        distance = max(float(np.linalg.norm(away)), 2 * float(reach))  # nothing is behind it
        camera = replace(camera, eye=self.scale.center + distance * camera.axes[2])
        inch = 2 * self.width / self.inches  # the picture is 2 high
        above = _ABOVE + _LINE * (len(self.runs) - 1)  # each ghost has a line of text
        room = np.array([self.width - _SIDE * inch, 1 - (above + _BELOW) / 2 * inch])
        shift = np.array([0.0, (_BELOW - above) * inch])
        for _ in range(8):
            seen = camera.seen(self.scale.points)[:, :2]
            low, high = seen.min(axis=0), seen.max(axis=0)
            move = tan(HALF_ANGLE) * distance * ((low + high - shift) / 2)
            center = camera.eye - distance * camera.axes[2] + move @ camera.axes[:2]
            distance *= float(((high - low) / 2 / room).max())
            camera = replace(camera, eye=center + distance * camera.axes[2])
        return camera

    def draw(self, axis: Axes, frames: Sequence[int]) -> None:
        """Draw the poses of some frames into one picture, seen by the camera of the first one."""
        camera = replace(self.start, eye=self.start.eye + self.shift[frames[0]])
        axis.clear()
        axis.set_axis_off()
        axis.set_xlim(-self.width, self.width)
        axis.set_ylim(-1, 1)
        axis.set_aspect("equal")
        self._ground(axis, camera, frames[0])
        self._paths(axis, camera, frames[0])
        self._bodies(axis, camera, frames)
        self._axes(axis, camera)
        self._texts(axis, frames)

    def _bodies(self, axis: Axes, camera: Camera, frames: Sequence[int]) -> None:
        corners: list[Vector] = []
        paint: list[Vector] = []
        tops: list[tuple[float, float, str]] = []

        def add(mesh: Mesh, color: Vector, pale: float) -> None:
            corners.append(mesh.vertices[mesh.faces])
            paint.append(np.tile(color + pale * (1 - color), (len(mesh.faces), 1)))

        for i, (run, parts) in enumerate(zip(self.runs, self.parts, strict=True)):
            for k, frame in enumerate(frames):
                begin = len(corners)
                pale = _PALE if i else _PALE * (1 - k / (len(frames) - 1)) if len(frames) > 1 else 0
                invalid = run.time[frame] >= run.invalid_from
                for body, mesh, color in parts:
                    place = run.places[frame, body] + self.moved[i][frame]
                    placed = mesh.moved(place, run.rotations[frame, body])
                    add(placed, _rgb(INVALID_BODY) if invalid else color, pale)
                for load in run.loads if i == 0 else ():
                    ends = self.scale.arrow(load, frame)
                    add(arrow(*ends, _SHAFT * self.scale.pose), _rgb(load.color), pale)
                if len(frames) > 1 and i == 0:
                    flat = camera.seen(np.vstack(corners[begin:]).reshape(-1, 3))
                    middle = (flat[:, 0].min() + flat[:, 0].max()) / 2
                    tops.append(
                        (middle, flat[:, 1].max() + 0.02, f"{moment(run.time[frame], 4)} s")
                    )
        if all(abs(a[0] - b[0]) > 0.3 or abs(a[1] - b[1]) > 0.1 for a, b in combinations(tops, 2)):
            for x, y, text in tops:  # if they would overlap, the title alone names the times
                axis.text(x, y, text, fontsize=8, ha="center", zorder=6)
        faces: Any  # matplotlib's stubs know lists only, which take longer
        faces, shades = camera.faces(np.vstack(corners), np.vstack(paint))
        axis.add_collection(
            PolyCollection(faces, facecolors=shades, edgecolors=shades, linewidths=0.2, zorder=3),
            autolim=False,
        )

    def _ground(self, axis: Axes, camera: Camera, frame: int) -> None:
        if not self.runs[0].world.ground:
            return
        a = np.cross(camera.up, np.eye(3)[int(np.argmin(np.abs(camera.up)))])
        b = np.cross(camera.up, a)
        cell, count = self.scale.cell, 40
        middle = self.scale.center + self.shift[frame]
        i0, j0 = np.round(middle @ a / cell), np.round(middle @ b / cell)
        lines = []
        fine = np.linspace(-count, count, 81)
        for k in np.arange(-count, count + 1):
            lines.append(np.outer(np.full(81, i0 + k), a) + np.outer(j0 + fine, b))
            lines.append(np.outer(i0 + fine, a) + np.outer(np.full(81, j0 + k), b))
        self._lines(axis, camera, cell * np.array(lines), GROUND, 0.5, 1)

    def _paths(self, axis: Axes, camera: Camera, frame: int) -> None:
        for i, run in enumerate(self.runs):
            for path in run.paths:
                color = _rgb(path.color)
                paint = tuple(color + _PALE * (1 - color) * (i > 0))
                points = path.points + self.moved[i][frame]
                self._lines(axis, camera, points[None], paint, 1.0, 2)

    def _lines(
        self, axis: Axes, camera: Camera, lines: Vector, color: Any, width: float, order: int
    ) -> None:
        seen = camera.seen(lines)
        shown = np.where(seen[..., 2:] > 0.05 * self.scale.pose, seen[..., :2], np.nan)
        axis.add_collection(
            LineCollection(list(shown), colors=[color], linewidths=width, zorder=order),
            autolim=False,
        )

    def _axes(self, axis: Axes, camera: Camera) -> None:
        """Draw the world's directions in the lower left corner."""
        corner = np.array([-self.width + 0.22, -0.66])
        for name, tip in zip(self.runs[0].world.axes, np.eye(3), strict=True):
            end = 0.13 * (camera.axes @ tip)[:2]
            style = {"arrowstyle": "->", "color": "0.25", "linewidth": 1.0}
            ends = tuple((corner + end).tolist()), tuple(corner.tolist())
            axis.annotate("", *ends, zorder=5, arrowprops=style)
            x, y = corner + end * (1 + 0.045 / max(float(np.linalg.norm(end)), 0.05))
            axis.text(x, y, name, fontsize=8, ha="center", va="center", color="0.25")

    def _texts(self, axis: Axes, frames: Sequence[int]) -> None:
        first, left = self.runs[0], -self.width + 0.06
        lines = [first.title]
        if len(frames) == 1 or first.labels:
            lines += [first.label_text(frame) for frame in frames]
        else:
            shown = ", ".join(moment(first.time[frame], 4) for frame in frames)
            lines.append(f"t = {shown} s")
        lines += [f"pale: {run.title}" for run in self.runs[1:]]
        letters = max(20, int((self.inches - 0.25) * 15))  # in a line at 8 points
        text = "\n".join(fill(line, letters) for line in lines)
        axis.text(left, 0.94, text, fontsize=8, va="top", ha="left", zorder=6)
        last = max(frames, key=lambda frame: first.time[frame])
        if invalid := invalid_text(self.runs, last):
            warning = fill(invalid, letters, max_lines=8, placeholder=" ...")
            box = {"facecolor": INVALID, "edgecolor": "none", "pad": 3}
            axis.text(left, -0.97, warning, fontsize=8, va="bottom", color="white", zorder=7,
                      bbox=box)  # fmt: skip
        elif text := self._arrow_text():
            axis.text(self.width - 0.06, -0.97, text, fontsize=7, va="bottom", ha="right",
                      color="0.35")  # fmt: skip

    def _arrow_text(self) -> str:
        """Return how long the arrows are, in display units."""
        parts = []
        for unit, per_unit in self.scale.per_unit.items():
            if per_unit:
                load = next(load for run in self.runs for load in run.loads if load.unit == unit)
                length = LONGEST_ARROW * self.scale.pose
                size = convert(length / per_unit, load.unit, load.display_unit)
                parts.append(f"{length:.2g} m for {size:.3g} {load.display_unit}")
        return f"arrows: {', '.join(parts)}" if parts else ""


def draw_pose(
    runs: Sequence[Poses],
    frames: Sequence[int],
    *,
    view: View = View.ISO,
    follow: str | None = None,
    size: tuple[float, float] = SIZE,
) -> Figure:
    """Return a figure of one or more poses in one scene; see `Stage`.

    `frames` are positions in `Poses.time`; earlier poses are pale.
    """
    figure, axis = canvas(size)
    Stage(runs, view, follow, size).draw(axis, frames)
    return figure


def canvas(size: tuple[float, float]) -> tuple[Figure, Axes]:
    """Return a figure that is filled by one pair of axes."""
    figure = Picture(figsize=size, facecolor="white")
    return figure, figure.add_axes((0, 0, 1, 1))


def _parts(run: Poses) -> list[tuple[int, Mesh, Vector]]:
    """Return body, mesh and color of the shapes; those of one body and color are joined."""
    groups: dict[tuple[int, str], list[Mesh]] = {}
    for solid in run.solids:
        groups.setdefault((solid.body, solid.color), []).append(mesh_of(solid))
    return [(body, joined(m), _rgb(color)) for (body, color), m in groups.items()]


def _rgb(color: str) -> Vector:
    return np.array(to_rgb(color))
