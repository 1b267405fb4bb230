"""C code to a shared library, through whatever compiler the machine has, kept in a cache.

The compiler is $CC, else cc, gcc, clang, else the one in the package `ziglang`.
"""

import hashlib
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path

from cosim.errors import MissingTool
from cosim.resources import cache_folder

SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
FLAGS = ("-O2", "-fPIC", "-shared", "-g0")
TIMEOUT = 600  # s, for one compiler call

_HOW = "install gcc or clang, or the bundled one: pip install 'cosim-rigid[zig]'"


def find_compiler() -> tuple[str, ...]:
    """Return the command of a C compiler.

    Raises:
        MissingTool: There is none, or $CC names none.
    """
    if chosen := os.environ.get("CC"):
        command = shlex.split(chosen)
        if not command or shutil.which(command[0]) is None:
            raise MissingTool(f"CC names '{chosen}', which is not there; unset CC, or {_HOW}")
        return tuple(command)
    for name in ("cc", "gcc", "clang"):
        if found := shutil.which(name):
            return (found,)
    if find_spec("ziglang"):
        return (sys.executable, "-m", "ziglang", "cc")
    raise MissingTool(f"no C compiler found (tried $CC, cc, gcc, clang, ziglang); {_HOW}")


def has_compiler() -> bool:
    """Tell whether code can be compiled here."""
    try:
        find_compiler()
    except MissingTool:
        return False
    return True


def compile_library(
    sources: Sequence[Path],
    target: Path,
    *,
    include: Sequence[Path] = (),
    options: Sequence[str] = (),
    command: Sequence[str] | None = None,
) -> Path:
    """Compile C sources to a shared library.

    Args:
        sources: C files.
        target: The library, replaced when the compiler succeeds.
        include: Folders of headers.
        options: Further compiler options.
        command: The compiler; `find_compiler()` when None.

    Raises:
        MissingTool: There is no compiler, or it fails; the last lines it printed are quoted.
    """
    compiler = tuple(command or find_compiler())
    arguments = [*FLAGS, *(f"-I{folder}" for folder in include), *options]
    call = [*compiler, *arguments, *map(str, sources), "-o", str(target), "-lm"]
    try:
        done = subprocess.run(call, capture_output=True, text=True, timeout=TIMEOUT, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise MissingTool(f"{compiler[0]} could not be run: {error}; {_HOW}") from error
    if done.returncode:
        tail = "\n".join((done.stderr or done.stdout).splitlines()[-20:])
        raise MissingTool(
            f"{shlex.join(call)} failed:\n{tail}\nuse another compiler (CC=...), or {_HOW}"
        )
    return target


def cached_library(key: str, generate: Callable[[], str]) -> Path:
    """Return the shared library of some C code from the cache, made first where it is missing.

    Args:
        key: What the code depends on; the same key must always mean the same code.
        generate: Returns the C code; called only where the library is missing.

    Raises:
        MissingTool: There is no compiler, or it fails.
    """
    command = find_compiler()
    digest = hashlib.sha256("\0".join((key, *command, *FLAGS)).encode()).hexdigest()[:32]
    folder = cache_folder()
    target = folder / f"{digest}{SUFFIX}"
    if target.exists():
        return target
    try:
        folder.mkdir(parents=True, exist_ok=True)
        workplace = tempfile.TemporaryDirectory(dir=folder, prefix="build-")
    except OSError as error:
        raise MissingTool(
            f"cannot keep compiled code in {folder}: {error.strerror}; set COSIM_CACHE"
        ) from error
    with workplace as build:
        source = Path(build) / "code.c"
        source.write_text(generate(), encoding="utf-8")
        built = compile_library([source], Path(build) / f"code{SUFFIX}", command=command)
        built.replace(target)
    return target
