"""The scenes that come with the package."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cosim.scene.toml_file import read_toml


def shipped_scenes() -> tuple[Path, ...]:
    """Return the files of all scenes that come with the package, by name."""
    return tuple(sorted((Path(__file__).parent / "shipped").glob("*.toml")))


def scene_summaries() -> Iterator[dict[str, Any]]:
    """Yield a line of facts on each shipped scene, without loading its model."""
    for path in shipped_scenes():
        data = read_toml(path).data
        yield {
            "scene": path.name,
            "model": data["model"],
            "outputs": len(data.get("outputs", ())) or "all",
            "figures": len(data.get("figures", ())),
            "title": data["title"],
        }
