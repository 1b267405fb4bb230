"""Scenes: TOML files that name a model, its values, the outputs to compute and the figures."""

import os
from pathlib import Path

from cosim.errors import UnknownName, UsageError
from cosim.files import is_file
from cosim.toml_file import TomlFile, read_toml


def shipped_scenes() -> tuple[Path, ...]:
    """Return the files of all scenes that come with the package, by name."""
    return tuple(sorted((Path(__file__).parent / "shipped").glob("*.toml")))


def find_scene(path: str | os.PathLike[str]) -> Path:
    """Return the file of a scene: in the file system, else among the shipped ones.

    Raises:
        UnknownName: There is no such file, and no shipped scene of that name.
    """
    UsageError.reject("read_scene", path, str | os.PathLike, "the name of a TOML file")
    requested = Path(path)
    # unlike `Path.exists`, no error for a name that is too long
    if os.path.exists(path) or len(requested.parts) > 1:  # noqa: PTH110
        return requested
    shipped = {entry.name: entry for entry in shipped_scenes()}
    if requested.name not in shipped:
        near = UnknownName.among("the working directory or cosim", "scene", requested.name, shipped)
        raise UnknownName(f"{near} (all: cosim info)")
    return shipped[requested.name]


def figures_file(file: TomlFile) -> TomlFile:
    """Return the file with the figures of a scene: itself, or the scene that `figures` names."""
    named = file.data.get("figures")
    if not isinstance(named, str):
        return file
    with file.naming("figures"):
        place = file.path.parent / named
        return read_toml(find_scene(place if is_file(place) else named))
