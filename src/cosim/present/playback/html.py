"""Playback as one HTML file: a scene that viser records, with viser's own viewer inside.

The viewer has play, pause, slider, speed, orbit, and a scene tree with a switch for every node.
While the file is written, viser opens a port of this machine.
"""

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.arrays import Vector
from cosim.colors import INVALID_BODY
from cosim.drawing.camera import Scale, View, camera_for, scale_of
from cosim.drawing.meshes import mesh_of
from cosim.drawing.pose import Load, Poses, invalid_text
from cosim.host.optional_packages import optional_module

_GHOST = 0.35  # opacity of the runs after the first


def html(
    runs: Sequence[Poses], *, follow: str | None = None, view: View = View.ISO, speed: float = 1.0
) -> str:
    """Return a self-contained page that plays runs with the same number of frames; see `animate`.

    The first run is in full color, the others are ghosts.
    """
    viser = optional_module("viser", "animate")
    with _server(viser) as server:
        scene = _Scene(server.scene, runs, follow)
        camera = camera_for(runs[0].world, view, scene.scale)
        server.scene.set_up_direction(tuple(map(float, runs[0].world.up)))
        server.initial_camera.position = tuple(map(float, camera.eye))
        server.initial_camera.look_at = tuple(map(float, scene.scale.center))
        scene.show(0)
        recording = server.get_scene_serializer()
        waits = np.diff(runs[0].time, append=runs[0].time[-1]) / speed
        for frame, wait in enumerate(waits):
            if frame:
                scene.show(frame)
            recording.insert_sleep(float(wait))
        page: str = recording.as_html()
    return page.replace("<title>Viser</title>", f"<title>{runs[0].title}</title>")


class _Scene:
    """The nodes of a viser scene, moved from frame to frame."""

    def __init__(self, scene: Any, runs: Sequence[Poses], follow: str | None) -> None:
        first = runs[0]
        self.runs, self.scale = runs, scale_of(runs, follow)
        self.shift = -first.followed(follow)
        self.root = scene.add_frame("/scene", show_axes=False)
        self.moving = [
            _Actor(scene, run, "" if i == 0 else f"ghost {i}", self.scale)
            for i, run in enumerate(runs)
        ]
        size = self.scale.pose
        if first.world.ground:
            _ground(scene, first, self.scale)
        world = scene.add_frame("/scene/frames/world", axes_length=0.25 * size,
                                axes_radius=0.006 * size)  # fmt: skip
        for name, tip in zip(first.world.axes, np.eye(3), strict=True):
            scene.add_label(f"{world.name}/{name}", name, position=tuple(0.28 * size * tip))
        self.text = scene.add_label("/scene/time", "", position=tuple(self.scale.label_at))

    def show(self, frame: int) -> None:
        self.root.position = tuple(self.shift[frame].tolist())
        for actor in self.moving:
            actor.show(frame)
        texts = self.runs[0].label_text(frame), invalid_text(self.runs, frame)
        self.text.position = tuple((self.scale.label_at - self.shift[frame]).tolist())
        self.text.text = " | ".join(filter(None, texts))


class _Actor:
    """One run: its bodies, axes, arrows and paths."""

    def __init__(self, scene: Any, run: Poses, ghost: str, scale: Scale) -> None:
        self.run, self.scale = run, scale
        prefix = f"/scene/{ghost}" if ghost else "/scene"
        self.frames, self.meshes = [], []
        for i, name in enumerate(run.bodies):
            body = scene.add_frame(f"{prefix}/bodies/{name}", show_axes=False)
            parts: dict[str, int] = {}
            for solid in (solid for solid in run.solids if solid.body == i):
                mesh = mesh_of(solid)
                number = parts[solid.name] = parts.get(solid.name, 0) + 1
                node = f"{body.name}/{solid.name}" + (f" {number}" if number > 1 else "")
                handle = scene.add_mesh_simple(
                    node,
                    mesh.vertices.astype(np.float32),
                    mesh.faces.astype(np.uint32),
                    color=_rgb(solid.color),
                    opacity=_GHOST if ghost else None,
                    flat_shading=False,
                )
                self.meshes.append(handle)
            moving = [body]
            if not ghost and i:
                axes = scene.add_frame(f"{prefix}/frames/{name}", axes_length=0.3 * scale.pose,
                                       axes_radius=0.008 * scale.pose, visible=False)  # fmt: skip
                moving.append(axes)
            self.frames.append(moving)
        self.loads = [] if ghost else [self._arrow(scene, prefix, load) for load in run.loads]
        for path in run.paths:
            points = _thinned(path.points)
            scene.add_line_segments(
                f"{prefix}/traces/{path.name}",
                np.stack([points[:-1], points[1:]], axis=1).astype(np.float32),
                _rgb(path.color),
                thickness=1.0 if ghost else 2.0,
                thickness_units="screen",
            )

    def show(self, frame: int) -> None:
        run = self.run
        for i, nodes in enumerate(self.frames):
            for node in nodes if i else ():
                node.position = tuple(run.places[frame, i].tolist())
                node.wxyz = tuple(run.quaternions[frame, i].tolist())
        for load, node in zip(run.loads, self.loads, strict=bool(self.loads)):
            node.points = self._ends(load, frame)
        if run.time[frame] >= run.invalid_from and self.meshes:
            for mesh in self.meshes:
                mesh.color = _rgb(INVALID_BODY)
            self.meshes = []  # their color does not change again

    def _arrow(self, scene: Any, prefix: str, load: Load) -> Any:
        size = self.scale.pose
        return scene.add_arrows(
            f"{prefix}/forces/{load.name}",
            self._ends(load, 0),
            _rgb(load.color),
            shaft_radius=0.008 * size,
            head_radius=0.02 * size,
            head_length=0.05 * size,
        )

    def _ends(self, load: Load, frame: int) -> NDArray[np.float32]:
        start, end = self.scale.arrow(load, frame)
        return np.array([[start, end]], dtype=np.float32)


def _rgb(color: str) -> tuple[int, int, int]:
    """Return red, green and blue of "#rrggbb", 0 ... 255."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def _thinned(points: Vector, most: int = 1000) -> Vector:
    """Return about `most` evenly chosen points of a path, including the last one."""
    step = max(1, len(points) // most)
    return np.vstack([points[:-1:step], points[-1:]])


def _ground(scene: Any, run: Poses, scale: Scale) -> None:
    up = np.array(run.world.up)
    plane = {0: "yz", 1: "xz", 2: "xy"}[int(np.argmax(np.abs(up)))]
    scene.add_grid("/scene/ground", plane=plane, cell_size=scale.cell, section_size=4 * scale.cell,
                   infinite_grid=True, fade_distance=40 * scale.pose)  # fmt: skip


@contextmanager
def _server(viser: Any) -> Iterator[Any]:
    with redirect_stdout(io.StringIO()):  # viser prints its address, which is of no use here
        server = viser.ViserServer(host="127.0.0.1", verbose=False)
        try:
            yield server
        finally:
            server.stop()
