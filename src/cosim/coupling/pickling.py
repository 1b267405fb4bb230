"""Pickled systems: their fields, and the contents of files that only live as long as they."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any


def pickled(system: Any, folders: Sequence[Path]) -> dict[str, Any]:
    """Return the state of a system without what belongs to its process.

    Args:
        system: The system.
        folders: That are removed with it.
    """
    own = {f.name: getattr(system, f.name) for f in fields(system) if not f.name.startswith("_")}
    held = [path for path in system.fmus if any(map(path.is_relative_to, folders))]
    return {"fields": own, "files": {path: path.read_bytes() for path in held}}


def with_files(
    parts: Mapping[str, Any], files: Mapping[Path, bytes], folder: Path
) -> dict[str, Any]:
    """Write files to a folder, and return the parts with their new places."""
    moved = dict[Path, Path]()
    for place, (path, content) in enumerate(files.items()):
        moved[path] = folder / f"{place}_{path.name}"
        moved[path].write_bytes(content)
    return {
        name: replace(part, subject=moved[part.subject]) if part.subject in moved else part
        for name, part in parts.items()
    }
