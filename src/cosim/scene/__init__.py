"""Scenes: TOML files that name a model, its values, the outputs to compute and the figures."""

from pathlib import Path


def shipped_scenes() -> tuple[Path, ...]:
    """Return the files of all scenes that come with the package, by name."""
    return tuple(sorted((Path(__file__).parent / "shipped").glob("*.toml")))
