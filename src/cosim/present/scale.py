"""Sizes of a picture that follow from what is in it: camera, arrows, labels."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from casadi_models.dae.drawing import World
from cosim.arrays import Vector
from cosim.errors import UnknownName
from cosim.present.playback.meshes import mesh_of
from cosim.present.playback.playback import Load, Playback
from cosim.present.playback.turning import to_matrices

VIEWS = ("iso", "front", "side", "top")
_LONGEST_ARROW = 0.5  # the longest arrow, in sizes of what moves


@dataclass(frozen=True)
class Scale:
    """Sizes, m.

    Attributes:
        corners: Of a box around everything that is seen, (8, 3), as the camera follows.
        size: Half the largest extent of that.
        pose: Half the largest extent of a single pose; arrows are measured by it.
        centre: The middle of the box, (3,), where the followed body is at its start.
        label_at: Where text stands, (3,): above it all.
        per_unit: Length of an arrow per SI unit of its load, by unit: m/N, m/(N.m).
        cell: Of the grid on the ground.
    """

    corners: Vector
    size: float
    pose: float
    centre: Vector
    label_at: Vector
    per_unit: dict[str, float]
    cell: float

    def arrow(self, load: Load, frame: int) -> tuple[Vector, Vector]:
        """Return both ends of an arrow: its length is the load times one scale for its unit."""
        start = load.at[frame]
        return start, start + self.per_unit[load.unit] * load.vector[frame]


def scale_of(runs: Sequence[Playback], follow: str | None) -> Scale:
    """Return the sizes of a scene of some runs."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    pose = 0.0
    shift = runs[0].followed(follow)
    stations = np.unique(np.linspace(0, len(shift) - 1, 60).astype(int))
    for run in runs:
        least, most = np.full((len(stations), 3), np.inf), np.full((len(stations), 3), -np.inf)
        for prop in run.props:
            vertices = mesh_of(prop).vertices
            corners = vertices[np.unique(np.vstack([vertices.argmin(0), vertices.argmax(0)]))]
            turns = to_matrices(run.quaternions[stations, prop.body])
            places = corners @ turns.swapaxes(1, 2) + run.places[stations, prop.body, None]
            seen = places - shift[stations, None]
            least, most = np.minimum(least, seen.min(axis=1)), np.maximum(most, seen.max(axis=1))
        low, high = np.minimum(low, least.min(axis=0)), np.maximum(high, most.max(axis=0))
        pose = max(pose, float((most - least).max()) / 2)
    up = np.array(runs[0].world.up)
    up = up / np.linalg.norm(up)
    centre, size = (low + high) / 2, float((high - low).max()) / 2 or 1.0
    largest: dict[str, float] = {}
    for load in (load for run in runs for load in run.loads):
        largest[load.unit] = max(largest.get(load.unit, 0.0), load.largest)
    longest = _LONGEST_ARROW * (pose or 1.0)
    per_unit = {u: longest / most if most else 0.0 for u, most in largest.items()}
    for load in runs[0].loads:
        tips = (load.at + per_unit[load.unit] * load.vector - shift)[stations]
        low, high = np.minimum(low, tips.min(axis=0)), np.maximum(high, tips.max(axis=0))
    return Scale(
        corners=np.array([*product(*zip(low, high, strict=True))]),
        size=size,
        pose=pose or 1.0,
        centre=centre,
        label_at=centre + up * (np.abs(up) @ (high - low) / 2 + 0.35 * size),
        per_unit=per_unit,
        cell=0.5 * float(10.0 ** np.round(np.log10(pose or 1.0))),
    )


def view_from(world: World, view: str, scale: Scale) -> tuple[Vector, Vector]:
    """Return where a camera stands, and what it looks at.

    Raises:
        UnknownName: It is none of `VIEWS`.
    """
    if view not in VIEWS:
        raise UnknownName.among("animate", "view", view, VIEWS)
    up, forward = (np.array(v) / np.linalg.norm(v) for v in (world.up, world.forward))
    right = np.cross(forward, up)
    directions = {
        "iso": 0.75 * forward + 1.0 * right + 0.55 * up,
        "front": forward,
        "side": right,
        "top": up + 1e-3 * right,
    }
    direction = directions[view] / np.linalg.norm(directions[view])
    return scale.centre + 2.6 * scale.size * direction, scale.centre


def label_text(run: Playback, frame: int) -> str:
    """Return time and chosen variables at a frame, in display units."""
    parts = [f"t = {run.time[frame]:.2f} s"]
    parts += [f"{name} = {values[frame]:.4g} {unit}" for name, unit, values in run.labels]
    return ", ".join(parts)


def invalid_at(runs: Sequence[Playback], frame: int) -> str:
    """Return what is wrong at a frame, by run; empty while all are valid."""
    found = []
    for run in runs:
        if run.reasons and run.time[frame] >= run.invalid_from:
            reason = run.reasons[0].removeprefix(f"from {run.invalid_from:g} s on ")
            since = f"INVALID from {run.invalid_from:g} s on"
            whose = f"{run.title}: " if len(runs) > 1 else ""
            found.append(f" | {whose}{since}: {reason}")
    return "".join(found)


def arrow_text(scale: Scale, runs: Sequence[Playback]) -> str:
    """Return how long the arrows are, in display units."""
    parts = []
    for unit, per_unit in scale.per_unit.items():
        if per_unit:
            load = next(load for run in runs for load in run.loads if load.unit == unit)
            length = _LONGEST_ARROW * scale.pose
            parts.append(f"{length:.2g} m for {load.shown(length / per_unit)}")
    return f"arrows: {', '.join(parts)}" if parts else ""
