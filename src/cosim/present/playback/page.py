"""Playback as one HTML file: bodies in three dimensions, curves, and, if requested, the solver.

The viewer is three.js as the package meshcat ships it, the curves are those of uPlot.
"""

import base64
import gzip
import html
import json
from collections.abc import Mapping, Sequence
from importlib.resources import files
from importlib.util import find_spec
from math import frexp, isfinite, ldexp
from pathlib import Path
from typing import Any

import numpy as np

from casadi_models.units import convert
from cosim.arrays import Vector
from cosim.colors import CURVES, INVALID_BODY
from cosim.drawing.camera import (
    HALF_ANGLE,
    LONGEST_ARROW,
    NOTHING,
    OUTWARD,
    PEAK,
    USUAL,
    Scale,
    View,
    camera_for,
    scale_of,
)
from cosim.drawing.pose import Poses
from cosim.errors import MissingTool
from cosim.series.samples import Column, resample
from cosim.trajectory import Trajectory

_SCRIPTS = ("scene.js", "curves.js", "live.js", "player.js")
_PACKAGES = {
    "meshcat": ("viewer/dist/main.min.js",),
    "uplot": ("static/uPlot.iife.js", "static/uPlot.min.css"),
}
_CURVES_AT_FIRST = 3
_SIMILAR = 10  # times the range of the first curve that further ones may have
DISTANCE = 3.2  # of the camera from the middle of what is seen, over half its size


def page(
    played: Sequence[Poses],
    runs: Sequence[Trajectory],
    *,
    follow: str | None = None,
    view: View = View.ISO,
    live: Mapping[str, Any] | None = None,
) -> str:
    """Return a self-contained page that plays runs; the first is in full color, others are ghosts.

    Args:
        played: The poses of each run.
        runs: The runs, whose variables are the curves.
        follow, view: See `animate`.
        live: What the page computes instead of playing the run; see `live_part`.

    Raises:
        MissingTool: meshcat or uplot-python is not installed.
    """
    three, plots, style = packages("live" if live else "animate")
    own = files("cosim.present.playback") / "page"
    scripts = [three, plots, *((own / name).read_text(encoding="utf-8") for name in _SCRIPTS)]
    facts = _facts(played, runs, scale_of(played, follow), view)
    leader = played[0].world.follow if follow is None else follow
    body = played[0].bodies.index(leader) if leader else -1
    facts |= {"follow": body, "middle": played[0].middle_of(body).tolist()}
    facts |= {"speed": played[0].speed, "live": live}
    names = [column.name for column in runs[0].columns]
    if live:
        facts["title"] = runs[0].model
    recorded = () if live else zip(played, runs, strict=True)
    facts["runs"] = [_run(poses, run, names) for poses, run in recorded] or [{}]
    content = {
        "TITLE": html.escape(runs[0].model if live else played[0].title),
        "STYLE": style + (own / "page.css").read_text(encoding="utf-8"),
        "DATA": json.dumps(facts, allow_nan=False).replace("<", "\\u003c"),
        "SCRIPTS": "\n".join(f"<script>{text}</script>" for text in scripts),
    }
    text = (own / "page.html").read_text(encoding="utf-8")
    for name, part in content.items():
        before, _, after = text.partition(f"@{name}@")
        text = f"{before}{part}{after}"
    return text


def packages(extra: str) -> list[str]:
    """Return three.js, uPlot and its style; the extra brings their packages.

    Raises:
        MissingTool: A package is not installed.
    """
    texts = []
    for package, names in _PACKAGES.items():
        found = find_spec(package)
        places = found.submodule_search_locations if found else None
        for name in names:
            path = Path(places[0] if places else "", name)
            if not path.is_file():
                raise MissingTool(
                    f"{package}, which pages need, is not installed; "
                    f'bring it with: pip install "cosim-rigid[{extra}]"'
                )
            texts.append(path.read_text(encoding="utf-8"))
    return texts


def _facts(
    played: Sequence[Poses], runs: Sequence[Trajectory], scale: Scale, view: View
) -> dict[str, Any]:
    """Return all but the numbers of the runs' bodies and curves."""
    first, world = played[0], played[0].world
    camera = camera_for(world, view, scale, DISTANCE)
    up = np.array(world.up) / np.linalg.norm(world.up)
    labels = [name for name, _, _ in first.labels]
    columns = runs[0].columns
    names = [column.name for column in columns]
    values = runs[0].values
    spans = np.fmax.reduce(values) - np.fmin.reduce(values)  # apart from what is not a number
    _, own = np.unique(values, axis=1, return_index=True)  # an input equals what it is connected to
    distinct = [int(i) for i in sorted(own)]
    moving = [i for i in distinct if spans[i] > 0] or distinct
    similar = [i for i in moving if columns[i].unit == columns[moving[0]].unit
             and not spans[i] >= _SIMILAR * spans[moving[0]] > 0]  # fmt: skip
    chosen = [names.index(name) for name in labels] or similar[:_CURVES_AT_FIRST]
    return {
        "title": first.title,
        "bodies": first.bodies,
        "solids": [
            _plain(s, "name", "body", "kind", "color") | {"numbers": len(s.size)}
            for s in first.solids
        ],
        "flat": not any(any(s.size) for s in first.solids),
        "loads": [
            _plain(load, "name", "meaning", "color")
            | {"unit": load.display_unit, "factor": convert(1.0, load.unit, load.display_unit)}
            | {"per_unit": scale.per_unit[load.unit]}
            for load in first.loads
        ],
        "paths": [_plain(path, "name", "color") for path in first.paths],
        "world": _plain(world, "up", "axes", "ground"),
        "camera": {
            "eye": camera.eye.tolist(),
            "center": scale.center.tolist(),
            "field": float(np.degrees(2 * HALF_ANGLE)),
        },
        **_plain(scale, "size", "pose", "cell"),
        "framed": _outermost(scale.points),
        "longest": LONGEST_ARROW * scale.pose,
        "peak": PEAK,
        "usual": USUAL,
        "nothing": NOTHING,
        "floor": float((scale.points @ up).min()),
        "colors": CURVES,
        "invalid_color": INVALID_BODY,
        "labels": [names.index(name) for name in labels],
        "chosen": chosen,
        "columns": [column_facts(column) for column in columns],
    }


def _outermost(points: Vector) -> list[list[float]]:
    """Return those of the points, m, (n, 3), that a camera at any place must keep in its view."""
    rows = np.unique((points @ OUTWARD.T).argmax(axis=0))
    return [[float(f"{number:.5g}") for number in row] for row in points[rows]]


def _plain(value: object, *names: str) -> dict[str, Any]:
    """Return attributes by name."""
    return {name: getattr(value, name) for name in names}


def column_facts(column: Column) -> dict[str, Any]:
    """Return what a page knows of a variable."""
    return _plain(column, "name", "meaning") | {
        "unit": column.shown_unit if column.shown_unit != "1" else "",
        "factor": float(column.shown(np.ones(1), difference=True)[0]),
        "offset": float(column.shown(np.zeros(1))[0]),
    }


def _run(played: Poses, run: Trajectory, names: Sequence[str]) -> dict[str, Any]:
    """Return a recorded run; its numbers are those that scene.js and player.js read."""
    n = len(played.time)
    turns = played.rotations.swapaxes(2, 3).reshape(n, -1, 9)
    parts = [np.concatenate([played.places, turns], axis=2).reshape(n, -1)]
    parts += [np.hstack([load.at, load.vector]) for load in played.loads]
    parts += [resample(run.time, path.points, played.time)[0] for path in played.paths]
    rows = np.hstack(parts)
    known, missing = {**run}, np.full(len(run), np.nan)
    curves = (known.get(name, missing) for name in names)
    columns = [played.time, *rows.T, run.time, *curves]
    bases, sizes, numbers = zip(*map(_scaled, columns), strict=True)
    shapes = [[*s.size, *s.at.tolist(), *s.along.tolist()] for s in played.solids]
    return {
        "title": played.title,
        "packed": packed(np.concatenate(numbers).tobytes()),
        "bases": bases,
        "sizes": sizes,
        "n": n,
        "m": len(run.time),
        "width": rows.shape[1],
        "shapes": [number for shape in shapes for number in shape],
        "events": [[event.time, event.name] for event in run.events],
        "invalid_from": played.invalid_from if isfinite(played.invalid_from) else None,
        "reasons": played.reasons,
        "stopped": run.status != "complete",
    }


def _scaled(column: Vector) -> tuple[float, float, Vector]:
    """Return an offset, a size, and what remains of a column for 4-byte floats; 0 stays exact."""
    finite = column[np.isfinite(column)]
    least = float(finite[np.abs(finite).argmin()]) if finite.size else 0.0
    base = least if (np.sign(finite) == np.sign(least)).all() else 0.0
    most = float(np.abs(finite - base).max(initial=0.0))
    size = ldexp(1.0, frexp(most)[1] - 1) if most else 1.0  # a power of 2 adds no rounding
    return base, size, ((column - base) / size).astype("<f4")


def packed(content: bytes) -> str:
    """Return bytes as the page unpacks them; the same bytes give the same text."""
    return base64.b64encode(gzip.compress(content, mtime=0)).decode()
