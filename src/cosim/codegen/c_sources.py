"""C sources and license texts of the package, and the location of the cache."""

import os
import re
import sys
from collections.abc import Iterable
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

from cosim.errors import CacheError

_INCLUDE = re.compile(r'^#include "(.+)"\n', re.MULTILINE)


@cache
def _sources_in(*folders: str) -> tuple[Traversable, ...]:
    entries = (e for folder in folders for e in (files("cosim._fmu") / folder).iterdir())
    found = (entry for entry in entries if entry.name.endswith((".c", ".h")))
    return tuple(sorted(found, key=lambda entry: entry.name))


def runtime_sources() -> tuple[Traversable, ...]:
    """Return the C sources and headers of the FMU runtime, by name."""
    return _sources_in("runtime")


def license_texts() -> tuple[Traversable, ...]:
    """Return the license of the C files and the notice for generated files, by name."""
    return tuple(files("cosim._fmu") / name for name in ("GENERATED.txt", "LICENSE.txt"))


def solver_sources() -> tuple[Traversable, ...]:
    """Return the headers of the explicit solvers and of the kernel of events, by name."""
    return _sources_in("solvers", "solvers/hybrid")


@cache
def solver_source(*names: str) -> str:
    """Return headers of the explicit solvers, e.g. "dop853.h", with their includes, as one text."""
    return _unfolded(solver_sources(), names)


def source_text(path: str) -> str:
    """Return a file of C, e.g. "page/page.c"."""
    return (files("cosim._fmu") / path).read_text(encoding="utf-8")


@cache
def master_source(*names: str) -> str:
    """Return headers of the FMU master, e.g. "co_simulation.h", with their includes."""
    return _unfolded(_sources_in("solvers", "solvers/hybrid", "master"), names)


def _unfolded(headers: Iterable[Traversable], names: Iterable[str]) -> str:
    texts = {e.name: e.read_text(encoding="utf-8") for e in headers}

    def unfolded(found: re.Match[str]) -> str:
        text = texts.pop(found[1], "")  # each header once
        return _INCLUDE.sub(unfolded, text)

    return _INCLUDE.sub(unfolded, "".join(f'#include "{name}"\n' for name in names))


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
            "there is no home folder to store compiled code in; set COSIM_CACHE to a folder"
        ) from error
    return Path(base) / "cosim"
