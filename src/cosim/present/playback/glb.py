"""Playback as a binary glTF 2.0 file: meshes and keyframes, for slides, Blender and AR."""

from collections.abc import Sequence
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.arrays import Vector
from cosim.host.optional_packages import optional_module
from cosim.present.playback.meshes import Mesh, arrow, joined, mesh_of
from cosim.present.playback.playback import Load, Playback
from cosim.present.playback.turning import continuous, onto, to_matrices, to_quaternions
from cosim.present.scale import Scale, scale_of

_NEUTRAL = "#999999"
_FLOAT, _UNSIGNED, _VERTICES, _INDICES = 5126, 5125, 34962, 34963  # glTF's constants
_UNSEEN_SCALE = 1e-6  # scale of what is not seen: zero would have no inverse


def glb(runs: Sequence[Playback], *, follow: str | None = None, speed: float = 1.0) -> bytes:
    """Return the content of a GLB file.

    Each body is a node with translation and rotation keyframes; each load is an arrow that turns
    and stretches. glTF's Y is up: a root node turns the model's world. From the moment a run is
    invalid, grey copies of its bodies take the place of the coloured ones.

    Args:
        runs: With the same frames; the first in full colour, the others half transparent.
        follow: See `Playback.followed`.
        speed: Seconds of the run in a second of playback.

    Raises:
        MissingTool: pygltflib is not installed.
    """
    return _File(optional_module("pygltflib", "animate"), runs, follow, speed).content()


class _File:
    def __init__(
        self, gltf: Any, runs: Sequence[Playback], follow: str | None, speed: float
    ) -> None:
        self.gltf, self.runs = gltf, runs
        self.data = bytearray()
        self.made = gltf.GLTF2(
            asset=gltf.Asset(version="2.0", generator="cosim"), scene=0, scenes=[gltf.Scene()]
        )
        self.made.animations = [gltf.Animation(name=runs[0].title)]
        self.materials: dict[tuple[str, bool], int] = {}
        time = (runs[0].time - runs[0].time[0]) / speed
        self.time = self._accessor(time[:, None].astype(np.float32), "SCALAR", bounds=True)
        scale = scale_of(runs, follow)
        up = np.array(runs[0].world.up) / np.linalg.norm(runs[0].world.up)
        root = self._node("scene", rotation=_quaternion(_onto_y(up)))
        self.made.scenes[0].nodes = [root]
        follower = self._node("camera follows", root)
        shift = -runs[0].followed(follow)
        if np.abs(shift).max(initial=0.0) > 0:
            self._animate(follower, "translation", shift)
        for i, run in enumerate(runs):
            group = self._node(run.title if i == 0 else f"ghost {i}: {run.title}", follower)
            self._bodies(group, run, ghost=i > 0)
            for load in run.loads if i == 0 else ():
                self._load(group, load, scale)

    def content(self) -> bytes:
        """Return the bytes of the file."""
        self.data += b"\0" * (-len(self.data) % 4)
        self.made.buffers = [self.gltf.Buffer(byteLength=len(self.data))]
        if not self.made.animations[0].channels:
            self.made.animations = []
        self.made.set_binary_blob(bytes(self.data))
        return b"".join(self.made.save_to_bytes())

    def _bodies(self, group: int, run: Playback, *, ghost: bool) -> None:
        invalid = run.time >= run.invalid_from if isfinite(run.invalid_from) else None
        for i, name in enumerate(run.bodies):
            props = [prop for prop in run.props if prop.body == i]
            if not props:
                continue
            body = self._node(name, group)
            if i:
                self._animate(body, "translation", run.places[:, i])
                turned = run.quaternions[:, i][:, [1, 2, 3, 0]]  # glTF: x, y, z, w
                self._animate(body, "rotation", turned)
            colours: dict[str, list[Mesh]] = {}
            for prop in props:
                colours.setdefault(prop.colour, []).append(mesh_of(prop))
            seen = self._node(f"{name}: shapes", body)
            self._mesh(seen, [(joined(m), colour) for colour, m in colours.items()], ghost)
            if invalid is not None and invalid.any():
                whole = joined([mesh for meshes in colours.values() for mesh in meshes])
                grey = self._node(f"{name}: invalid", body)
                self._mesh(grey, [(whole, _NEUTRAL)], ghost)
                self._show(seen, ~invalid)
                self._show(grey, invalid)

    def _load(self, group: int, load: Load, scale: Scale) -> None:
        lengths = scale.per_unit[load.unit] * np.linalg.norm(load.vector, axis=1)
        node = self._node(load.name, group)
        unit = arrow(np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.03)
        self._mesh(node, [(unit, load.colour)], ghost=False)
        turns = np.array([onto(vector) for vector in load.vector])
        self._animate(node, "translation", load.at)
        self._animate(node, "rotation", continuous(to_quaternions(turns))[:, [1, 2, 3, 0]])
        sizes = np.maximum(lengths, _UNSEEN_SCALE)[:, None]
        thick = np.minimum(sizes, 0.4 * scale.pose)
        self._animate(node, "scale", np.hstack([thick, thick, sizes]))

    def _show(self, node: int, seen: NDArray[np.bool_]) -> None:
        sizes = np.where(seen, 1.0, _UNSEEN_SCALE)[:, None] * np.ones(3)
        self._animate(node, "scale", sizes, interpolation="STEP")

    def _node(self, name: str, parent: int | None = None, **more: Any) -> int:
        self.made.nodes.append(self.gltf.Node(name=name, **more))
        index = len(self.made.nodes) - 1
        if parent is not None:
            self.made.nodes[parent].children.append(index)
        return index

    def _mesh(self, node: int, parts: Sequence[tuple[Mesh, str]], ghost: bool) -> None:
        primitives = []
        for mesh, colour in parts:
            corners, normals = _shaded(mesh)
            place = self._accessor(corners, "VEC3", target=_VERTICES, bounds=True)
            normal = self._accessor(normals, "VEC3", target=_VERTICES)
            order = np.arange(len(corners), dtype=np.uint32)[:, None]
            indices = self._accessor(order, "SCALAR", target=_INDICES, kind=_UNSIGNED)
            attributes = self.gltf.Attributes(POSITION=place, NORMAL=normal)
            primitives.append(
                self.gltf.Primitive(
                    attributes=attributes, indices=indices, material=self._material(colour, ghost)
                )
            )
        self.made.meshes.append(
            self.gltf.Mesh(name=self.made.nodes[node].name, primitives=primitives)
        )
        self.made.nodes[node].mesh = len(self.made.meshes) - 1

    def _material(self, colour: str, ghost: bool) -> int:
        if (colour, ghost) not in self.materials:
            parts = np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])
            linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
            look = self.gltf.PbrMetallicRoughness(
                baseColorFactor=[*np.round(linear, 6).tolist(), 0.35 if ghost else 1.0],
                metallicFactor=0.0,
                roughnessFactor=0.7,
            )
            self.made.materials.append(
                self.gltf.Material(
                    name=f"{colour}{' ghost' if ghost else ''}",
                    pbrMetallicRoughness=look,
                    alphaMode="BLEND" if ghost else "OPAQUE",
                    alphaCutoff=None,
                )
            )
            self.materials[colour, ghost] = len(self.made.materials) - 1
        return self.materials[colour, ghost]

    def _animate(self, node: int, path: str, rows: Vector, interpolation: str = "LINEAR") -> None:
        if len(self.runs[0].time) < 2:
            setattr(self.made.nodes[node], path, rows[0].tolist())
            return
        kind = "VEC4" if rows.shape[1] == 4 else "VEC3"
        output = self._accessor(rows.astype(np.float32), kind)
        animation = self.made.animations[0]
        animation.samplers.append(
            self.gltf.AnimationSampler(input=self.time, output=output, interpolation=interpolation)
        )
        target = self.gltf.AnimationChannelTarget(node=node, path=path)
        sampler = len(animation.samplers) - 1
        animation.channels.append(self.gltf.AnimationChannel(sampler=sampler, target=target))

    def _accessor(
        self,
        rows: NDArray[Any],
        shape: str,
        *,
        kind: int = _FLOAT,
        target: int | None = None,
        bounds: bool = False,
    ) -> int:
        content = np.ascontiguousarray(rows, dtype=np.uint32 if kind == _UNSIGNED else np.float32)
        view = self.gltf.BufferView(
            buffer=0, byteOffset=len(self.data), byteLength=content.nbytes, target=target
        )
        self.data += content.tobytes()
        self.made.bufferViews.append(view)
        accessor = self.gltf.Accessor(
            bufferView=len(self.made.bufferViews) - 1,
            componentType=kind,
            count=len(content),
            type=shape,
        )
        if bounds:
            accessor.min = content.min(axis=0).tolist()
            accessor.max = content.max(axis=0).tolist()
        self.made.accessors.append(accessor)
        return len(self.made.accessors) - 1


def _shaded(mesh: Mesh) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the corners of every triangle, and its normal at each, (3 m, 3)."""
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sizes = np.linalg.norm(normals, axis=1)
    real = sizes > 1e-14 * sizes.max(initial=0.0)
    normals = normals[real] / sizes[real, None]
    flat = corners[real].reshape(-1, 3)
    return flat.astype(np.float32), np.repeat(normals, 3, axis=0).astype(np.float32)


def _onto_y(up: Vector) -> Vector:
    """Return the rotation that turns a direction into glTF's Y."""
    return onto(np.array([0.0, 1.0, 0.0])) @ onto(up).T


def _quaternion(matrix: Vector) -> list[float]:
    w, x, y, z = to_quaternions(matrix[None])[0].tolist()
    assert np.allclose(to_matrices(np.array([[w, x, y, z]]))[0], matrix)
    return [x, y, z, w]
