"""Where the files are that come with the package, and where it may keep its own."""

import os
import sys
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

from cosim.errors import CacheError


def runtime_sources() -> tuple[Traversable, ...]:
    """Return the C sources and headers of the FMU runtime, by name."""
    folder = files("cosim._fmu") / "runtime"
    found = (entry for entry in folder.iterdir() if entry.name.endswith((".c", ".h")))
    return tuple(sorted(found, key=lambda entry: entry.name))


def solver_source(name: str) -> str:
    """Return a C source of the explicit solvers, e.g. "dop853.h"."""
    return (files("cosim._fmu") / "solvers" / name).read_text(encoding="utf-8")


def cache_folder() -> Path:
    """Return the folder for compiled code: $COSIM_CACHE, else the platform's place for caches.

    Raises:
        CacheError: The user has no home folder.
    """
    if chosen := os.environ.get("COSIM_CACHE"):
        return Path(chosen)
    try:
        if sys.platform == "win32":
            base = os.environ.get("LOCALAPPDATA") or str(Path.home() / "AppData" / "Local")
        elif sys.platform == "darwin":
            base = str(Path.home() / "Library" / "Caches")
        else:
            base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    except RuntimeError as error:
        raise CacheError(
            "there is no home folder to keep compiled code in; set COSIM_CACHE to a folder"
        ) from error
    return Path(base) / "cosim"
