"""Camera: one projection and one shading for all pictures, its standard views, and sizes."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import product
from math import tan

import numpy as np

from casadi_models.dae.drawing import World
from cosim.arrays import Vector
from cosim.drawing.meshes import mesh_of
from cosim.drawing.pose import Load, Poses

LONGEST_ARROW = 0.5  # length of the longest arrow over `Scale.pose`
PEAK = 4.0  # times the usual load of a unit that an arrow shows; larger ones are as long
USUAL = 0.9  # share of the times at which loads are not above the usual one
NOTHING = 1e-6  # share of the largest load below which none acts
HALF_ANGLE = 0.36  # rad, from the middle of a picture to its upper edge
OUTWARD = np.array([*product((-1, 0, 1), repeat=3)])  # outermost points are sought along these
_LONG_PATH = 2.0  # extent of a path that is shown as a whole, over that of the poses
_NEAR = 2.6  # distance of a camera from the center over `Scale.size`


class View(StrEnum):
    """Direction from which a camera looks at first."""

    ISO = "iso"
    FRONT = "front"
    SIDE = "side"
    TOP = "top"


@dataclass(frozen=True)
class Camera:
    """A camera that looks from a point at another one.

    Attributes:
        eye: Where it stands, m, (3,).
        axes: Directions to the right, upward and toward the eye, rows (3, 3).
        up: The world's upward direction, (3,).
    """

    eye: Vector
    axes: Vector
    up: Vector

    def seen(self, points: Vector) -> Vector:
        """Return places in the picture and distances, (..., 3); the picture is -1 ... 1 high."""
        local = (points - self.eye) @ self.axes.T
        distance = -local[..., 2]
        near = np.maximum(distance, 1e-6 * np.abs(distance).max(initial=1e-300))
        flat = local[..., :2] / (tan(HALF_ANGLE) * near[..., None])
        return np.concatenate([flat, distance[..., None]], axis=-1)

    def faces(self, corners: Vector, colors: Vector) -> tuple[Vector, Vector]:
        """Return the visible triangles in the picture, the farthest first, and their shades.

        Args:
            corners: Triangles, counterclockwise seen from outside, m, (n, 3, 3).
            colors: Their colors, red, green and blue in 0 ... 1, (n, 3).

        Returns:
            Triangles (m, 3, 2) and colors (m, 3).
        """
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        seen = self.seen(corners)
        facing = ((self.eye - corners.mean(axis=1)) * normals).sum(axis=1) > 0
        facing &= (seen[..., 2] > 0).all(axis=1)
        light = 0.5 * self.up + 0.6 * self.axes[2] - 0.4 * self.axes[0]
        bright = np.clip(0.65 + 0.6 * normals @ (light / np.linalg.norm(light)), 0.65, 1)
        order = np.argsort(-seen[facing].mean(axis=1)[:, 2])
        shades = (colors * bright[:, None])[facing][order]
        return seen[facing][order][..., :2], shades


@dataclass(frozen=True)
class Scale:
    """Sizes of a scene, m.

    Attributes:
        points: Outermost points of everything that is seen while the camera follows, (n, 3).
        size: Half the largest extent of these points.
        pose: Half the largest extent of a single pose; arrows are measured by it.
        center: Center of these points at the start of the run, (3,).
        per_unit: Length of an arrow per SI unit of its load, by unit: m/N, m/(N.m).
        cell: Edge of a cell of the grid on the ground.
    """

    points: Vector
    size: float
    pose: float
    center: Vector
    per_unit: dict[str, float]
    cell: float

    def arrow(self, load: Load, frame: int) -> tuple[Vector, Vector]:
        """Return both ends of an arrow: its length is the load times one scale for its unit.

        Short peaks and loads outside the validity range may be of any size: no arrow is longer
        than `LONGEST_ARROW`.
        """
        start, along = load.at[frame], self.per_unit[load.unit] * load.vector[frame]
        return start, start + _bounded(along, LONGEST_ARROW * self.pose)


def scale_of(runs: Sequence[Poses], follow: str | None) -> Scale:
    """Return the sizes of a scene of runs with the same number of frames.

    Each run counts as if the camera followed it, and only while it is valid. A path counts as a
    whole if it is not much larger than the poses, else between the first and the last of them.
    """
    points, pose = [], 0.0
    for run in runs:
        shift = run.followed(follow)
        valid = np.flatnonzero(run.valid)
        stations = valid[np.unique(np.linspace(0, len(valid) - 1, 60).astype(int))]
        clouds = []
        for solid in run.solids:
            vertices = mesh_of(solid).vertices
            corners = vertices[np.unique((vertices @ OUTWARD.T).argmax(axis=0))]
            turns = run.rotations[stations, solid.body]
            places = corners @ turns.swapaxes(1, 2) + run.places[stations, solid.body, None]
            clouds.append(places - shift[stations, None])
        cloud = np.concatenate(clouds, axis=1)
        pose = max(pose, float(np.ptp(cloud, axis=1).max()) / 2)
        points.append(cloud.reshape(-1, 3))
    poses = np.concatenate(points)
    largest = _largest_loads(runs)
    longest = LONGEST_ARROW * (pose or 1.0)
    per_unit = {u: longest / most if most else 0.0 for u, most in largest.items()}
    first, shift = runs[0], runs[0].followed(follow)
    for load in first.loads:
        tips = load.at + _bounded(per_unit[load.unit] * load.vector, longest) - shift
        points.append(tips[first.valid])
    if not shift.any():  # a path stays in the picture only if the camera does not follow
        reach = _LONG_PATH * float(np.ptp(poses, axis=0).max())
        points += [part for run in runs for part in _framed_paths(run, reach)]
    everything = np.concatenate(points)
    everything = everything[np.isfinite(everything).all(axis=1)]
    low, high = everything.min(axis=0), everything.max(axis=0)
    return Scale(
        points=everything,
        size=float((high - low).max()) / 2 or 1.0,
        pose=pose or 1.0,
        center=(low + high) / 2,
        per_unit=per_unit,
        cell=0.5 * float(10.0 ** np.round(np.log10(pose or 1.0))),
    )


def _bounded(along: Vector, longest: float) -> Vector:
    """Return arrows, (..., 3), none longer than a length, m."""
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    found: Vector = along * (longest / np.maximum(length, longest))
    return found


def _largest_loads(runs: Sequence[Poses]) -> dict[str, float]:
    """Return the load of the longest arrow by unit, SI: the largest one, short peaks aside."""
    found = {}
    for unit in dict.fromkeys(load.unit for run in runs for load in run.loads):
        sizes: list[float] = []
        for run in runs:
            loads = [load.vector[run.valid] for load in run.loads if load.unit == unit]
            sizes += np.linalg.norm(loads, axis=2).max(axis=0).tolist() if loads else []
        most = max((size for size in sizes if size > 0), default=0.0)
        acting = [size for size in sizes if size > NOTHING * most] or [0.0]
        found[unit] = min(most, PEAK * float(np.quantile(acting, USUAL, method="lower")))
    return found


def _framed_paths(run: Poses, reach: float) -> Iterator[Vector]:
    """Yield the parts of the paths that the picture must show: all of them, m, (n, 3), if shorter.

    Args:
        run: A run.
        reach: Largest extent of a path that is shown as a whole, m.
    """
    for path in run.paths:
        finite = np.isfinite(path.points).all(axis=1)
        spanned = (path.time >= run.time.min()) & (path.time <= run.time.max())
        points = path.points[finite]
        if len(points) and np.ptp(points, axis=0).max() > reach:
            points = path.points[finite & spanned]
        yield points


def camera_for(world: World, view: View, scale: Scale, distance: float = _NEAR) -> Camera:
    """Return the camera of a view; it looks at the center of the scene.

    Its distance is over `Scale.size`; from far away parallel lines stay parallel.
    """
    up, forward = (np.array(v) / np.linalg.norm(v) for v in (world.up, world.forward))
    right = np.cross(forward, up)
    direction = {
        View.ISO: 0.75 * forward + 1.0 * right + 0.55 * up,
        View.FRONT: forward,
        View.SIDE: right,
        View.TOP: up + 1e-3 * right,
    }[view]
    direction = direction / np.linalg.norm(direction)
    eye = scale.center + distance * scale.size * direction
    back = (eye - scale.center) / np.linalg.norm(eye - scale.center)
    right = np.cross(up, back)
    right = right / np.linalg.norm(right)
    return Camera(eye, np.array([right, np.cross(back, right), back]), up)
