"""An FMU with its proof, taken from the cache where the very same one was made before."""

import hashlib
import os
import pickle
import platform
import sys
import warnings
from collections.abc import Iterator
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import casadi_models
from casadi_models.dae import Dae
from cosim import errors
from cosim.codegen.c_sources import license_texts, runtime_sources, solver_sources
from cosim.codegen.cache import content_of, keep
from cosim.codegen.compiler import find_compiler, has_compiler, processor_abilities
from cosim.errors import CacheError
from cosim.files import refuse_unwritable, write_atomically

_PACKAGES = ("cosim-rigid", "casadi", "numpy", "fmpy", "matplotlib", "pillow", "ziglang")


def export_kept(
    dae: Dae, target: str | os.PathLike[str], *, reference: bool = True, **options: Any
) -> Path:
    """Write what `export_with_proof` does, from the cache if it is there: the same bytes.

    What was exported with a warning is not kept: it is said each time.

    Args:
        dae, target, reference, options: See `export_with_proof`.

    Raises:
        CosimError: See `export_with_proof`.

    Warns:
        UserWarning: See `export_with_proof`.
    """
    refuse_unwritable(target)
    entry = f"exports/{export_key(dae, reference=reference, **options)}"
    if (content := content_of(entry)) is not None:
        from cosim.fmi.trust import remember

        remember(content)
        return write_atomically(target, content)
    from cosim.verify.reference_result import export_with_proof  # takes its time

    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        path = export_with_proof(dae, target, reference=reference, **options)
    for one in said:
        warnings.warn_explicit(one.message, one.category, one.filename, one.lineno)
    if not said:
        with suppress(OSError, CacheError):
            keep(entry, path.read_bytes())
    return path


def export_key(dae: Dae, **options: Any) -> str:
    """Return a hash of all that an exported file depends on: model, options, tools, this code."""
    command = find_compiler() if has_compiler() else ()
    tools = (*map(_version, _PACKAGES), sys.version, platform.platform(), processor_abilities())
    parts = (pickle.dumps(dae, protocol=5), repr(sorted(options.items())), command, tools)
    return hashlib.sha256(repr((*parts, *_code())).encode()).hexdigest()


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def _code() -> Iterator[tuple[str, int, int]]:
    """Yield name, size and time of the files of this project."""
    packages = (Path(str(package.__file__)).parent for package in (casadi_models, errors))
    python = sorted(path for folder in packages for path in folder.rglob("*.py"))
    c = (Path(str(entry)) for entry in (*runtime_sources(), *solver_sources(), *license_texts()))
    for path in (*python, *c):
        with suppress(OSError):
            facts = path.stat()
            yield str(path), facts.st_size, facts.st_mtime_ns
