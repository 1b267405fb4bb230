"""What an exported file depends on beside its model and options: tools, machine and this code."""

import hashlib
import platform
import shutil
import sys
from collections.abc import Iterator
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

from cosim.codegen.c_sources import license_texts, runtime_sources, solver_sources
from cosim.codegen.compiler import find_compiler, has_compiler, processor_abilities

_PACKAGES = ("cosim-rigid", "casadi", "numpy", "fmpy", "matplotlib", "pillow", "ziglang")
_OWN = ("casadi_models", "cosim")
_KINDS = (".py", ".toml", ".csv", ".json")


def made_with() -> str:
    """Return a hash of tools, machine and code; no package is imported for it."""
    command = find_compiler() if has_compiler() else ()
    compiler = [*map(_facts, filter(None, map(shutil.which, command[:1])))]
    tools = (*map(_version, _PACKAGES), sys.version, platform.platform(), processor_abilities())
    return hashlib.sha256(repr((command, compiler, tools, *_code())).encode()).hexdigest()


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def _code() -> Iterator[tuple[str, int, int]]:
    """Yield name, size and time of the files of this project."""
    found = (find_spec(package) for package in _OWN)
    folders = (Path(str(spec.origin)).parent for spec in found if spec is not None)
    own = (path for folder in folders for path in folder.rglob("*") if path.suffix in _KINDS)
    c = (Path(str(entry)) for entry in (*runtime_sources(), *solver_sources(), *license_texts()))
    for path in (*sorted(own), *c):
        with suppress(OSError):
            yield _facts(path)


def _facts(path: str | Path) -> tuple[str, int, int]:
    found = Path(path).resolve()
    facts = found.stat()
    return str(found), facts.st_size, facts.st_mtime_ns
