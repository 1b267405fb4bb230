"""The diagram and the icon of a model, drawn once and kept in the cache."""

import hashlib
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path

import numpy as np

from casadi_models.dae import Dae
from cosim.codegen.cache import content_of, keep
from cosim.errors import CacheError
from cosim.fmi.export.documents.diagram import diagram, icon
from cosim.fmi.export.documents.pose import Pose, start_pose
from cosim.memo import kept_per_thread

DIAGRAM = "documentation/diagram.png"
ICONS = {2: "model.png", 3: "terminalsAndIcons/icon.png"}


def pictures(dae: Dae, fmi: int) -> dict[str, bytes]:
    """Return diagram and icon by their paths in an FMU; nothing for a model without shapes.

    Args:
        dae: The model; it is seen at its start values.
        fmi: Version of FMI; each has a place of its own for the icon.
    """
    return dict(_pictures(dae, fmi))


@kept_per_thread(8)
def _pictures(dae: Dae, fmi: int) -> dict[str, bytes]:
    pose = start_pose(dae)
    if pose is None:
        return {}
    key, drawn = _key(dae, pose), {}
    for path, draw in ((DIAGRAM, diagram), (ICONS[fmi], icon)):
        entry = f"pictures/{key}_{draw.__name__}.png"
        drawn[path] = content_of(entry) or _kept(entry, draw(pose, dae.drawing.world))
    return drawn


def _key(dae: Dae, pose: Pose) -> str:
    digest = hashlib.sha256(f"{_way_of_drawing()} {dae.drawing.world}".encode())
    with np.printoptions(precision=12, threshold=100_000):
        digest.update(repr(pose).encode())
    return digest.hexdigest()[:32]


@cache
def _way_of_drawing() -> str:
    """Return what pictures depend on beside the model: a new way of drawing draws them anew."""
    code = b"".join(file.read_bytes() for file in sorted(Path(__file__).parent.glob("*.py")))
    return f"{version('pillow')} {hashlib.sha256(code).hexdigest()}"


def _kept(entry: str, content: bytes) -> bytes:
    with suppress(CacheError, OSError):  # where it cannot be kept, it is drawn again
        keep(entry, content)
    return content
