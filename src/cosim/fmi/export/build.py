"""Binaries of an FMU: compiled for each platform and stored in the cache."""

import hashlib
import os
import re
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from threading import Event

from cosim.codegen.c_sources import cache_folder
from cosim.codegen.cache import content_of, private_folder, store
from cosim.codegen.compiler import FLAGS, compile_library, find_compiler
from cosim.errors import CacheError, ExportError
from cosim.fmi.platforms import Target
from cosim.fmi.shared_library import fat_library
from cosim.host.progress import doing
from cosim.host.signals import ended_by_signals
from cosim.host.temporary import temporary_folder

_INCLUDED = re.compile(rb'^#include "(.+\.c)"', re.MULTILINE)


def binaries(
    sources: Mapping[str, bytes], name: str, chosen: Mapping[str, tuple[Target, ...]]
) -> dict[str, bytes]:
    """Return the content of an FMU's `binaries/` by path.

    Raises:
        MissingTool: A compiler is missing or fails.
        ExportError: The cache folder cannot be written.
    """
    every = [target for members in chosen.values() for target in members]
    halted = Event()
    left = {target: folder for folder, members in chosen.items() for target in members}

    def library(target: Target) -> bytes:
        content = compiled_library(sources, name, target, halted)
        left.pop(target)
        return content

    with (
        doing(
            lambda: f"compiling for {', '.join(dict.fromkeys([*left.values()]))}",
            lambda: 1 - len(left) / len(every),
        ),
        ThreadPoolExecutor(os.cpu_count()) as pool,  # the threads wait for compilers
    ):
        try:
            compiled = dict(zip(every, pool.map(library, every), strict=True))
        finally:
            halted.set()  # if one fails, and after Ctrl-C, the other compilers end
    return {
        f"binaries/{folder}/{name}{members[0].suffix}": compiled[members[0]]
        if len(members) == 1
        else fat_library([compiled[target] for target in members])
        for folder, members in chosen.items()
    }


def compiled_library(
    sources: Mapping[str, bytes], name: str, target: Target, halted: Event | None = None
) -> bytes:
    """Return a shared library for one target, compiled if it is not in the cache.

    `halted` ends the compiler when it is set.
    """
    library = f"{name}{target.suffix}"
    given = target.command()
    command = given or find_compiler()
    options = target.options(library, command)
    maker = version("ziglang") if given else ""
    digest = hashlib.sha256(repr((command, maker, FLAGS, options, library)).encode())
    headers = fmi_headers()
    read = {path.name: path.read_bytes() for path in headers.glob("*.h")} | dict(sources)
    for file in sorted(read):
        digest.update(b"\0".join((file.encode(), str(len(read[file])).encode(), read[file])))
    entry = f"binaries/{digest.hexdigest()[:32]}"
    if known := content_of(entry):
        return known
    try:
        folder = private_folder()
        with ended_by_signals(), temporary_folder(folder) as build:
            for file, text in sources.items():
                (build / file).write_bytes(text)
            parts = {found.decode() for found in _INCLUDED.findall(sources["fmu.c"])}
            content = compile_library(
                sorted(file for file in build.glob("*.c") if file.name not in parts),
                build / library,
                include=[headers],
                options=[f"-ffile-prefix-map={build}=.", *options],
                command=command,
                halted=halted,
            ).read_bytes()
        store(entry, content)
    except CacheError as error:
        raise ExportError(f"cannot compile in {cache_folder()}: {error}") from error
    except OSError as error:
        raise ExportError(
            f"cannot compile in {cache_folder()}: {error.strerror or error}; set COSIM_CACHE to a "
            "folder that is writable and has free space"
        ) from error
    return content


def fmi_headers() -> Path:
    """Return the folder of the FMI headers, which are part of FMPy.

    Raises:
        ExportError: FMPy is missing.
    """
    found = find_spec("fmpy")
    if found is None or not found.submodule_search_locations:
        raise ExportError("the FMI headers are part of fmpy, which is missing; pip install fmpy")
    return Path(found.submodule_search_locations[0]) / "c-code"
