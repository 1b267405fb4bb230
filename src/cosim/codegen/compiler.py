"""C code to a shared library, through whatever compiler the machine has, kept in a cache.

The compiler is $CC, else cc, gcc, clang, else the one in the package `ziglang`.
"""

import ctypes
import hashlib
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from types import MappingProxyType

from cosim.codegen.c_sources import cache_folder
from cosim.codegen.cache import alone, plain_file, private_folder, prune, remove_damaged
from cosim.codegen.pieces import in_pieces
from cosim.errors import CompilerExhausted, CompilerTimeout, MissingTool, UsageError
from cosim.host.bounded import physical_memory, run_bounded
from cosim.host.progress import doing
from cosim.host.temporary import loads_no_library, temporary_folder

SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
FLAGS = ("-O2", "-fPIC", "-shared", "-g0")
TIMEOUT = 600  # s, for one compiler call
MOST_MEMORY = 4 * 10**9  # bytes, of one compiler; three quarters of the machine's where it has less

# Of generated code; hidden symbols can be inlined. In one long function, a Jacobian, -O2 takes
# five times as long to compile as -O1 and gains nothing.
_SHORT, _LONG, _LENGTH = "-O3", "-O1", 200_000  # characters
_HIDE_SYMBOLS = ("-fvisibility=hidden", "-DGCC_HASCLASSVISIBILITY")  # but what CasADi exports

# Products and sums stay apart, so that a processor with fused instructions computes the numbers of
# one without. GCC fuses alternating sums and differences of products (vfmaddsub) in straight-line
# code whatever -ffp-contract says; its vectorizer of such code is what has to be switched off.
_APART = ("-ffp-contract=off", "-fno-tree-slp-vectorize")

_SPENT: ContextVar[float] = ContextVar("time_compiling", default=0.0)  # s
# What compilers say, or their driver of them, when there is no more memory
_EXHAUSTED = re.compile(
    r"out of memory|memory exhausted|cannot allocate memory|bad_alloc|OutOfMemory"
    r"|Killed signal|signal 9",
    re.IGNORECASE,
)

_NOTHING: Mapping[str, str] = MappingProxyType({})
# What CasADi declares of a function that others are to link
_CALLED = re.compile(r"^int (\w+)\(const casadi_real\*\* arg, [^)]*\);", re.MULTILINE)

_HOW = 'install gcc or clang, or the bundled one: pip install "cosim-rigid[zig]"'


def find_compiler() -> tuple[str, ...]:
    """Return the command of a C compiler.

    Raises:
        MissingTool: There is none, or $CC names none.
    """
    if chosen := os.environ.get("CC"):
        try:
            command = _split_command(chosen)
        except ValueError as error:
            raise MissingTool(f"CC = {chosen} cannot be read: {error}; unset CC") from error
        if not command or shutil.which(command[0]) is None:
            raise MissingTool(f"CC names '{chosen}', which is not there; unset CC, or {_HOW}")
        return tuple(command)
    for name in ("cc", "gcc", "clang"):
        if found := shutil.which(name):
            return (found,)
    if find_spec("ziglang"):
        return (sys.executable, "-P", "-m", "ziglang", "cc")  # -P: not one of the current folder
    raise MissingTool(f"no C compiler found (tried $CC, cc, gcc, clang, ziglang); {_HOW}")


def has_compiler() -> bool:
    """Tell whether code can be compiled here.

    Raises:
        MissingTool: $CC names a compiler that is not there.
    """
    try:
        find_compiler()
    except MissingTool:
        if os.environ.get("CC"):
            raise
        return False
    return True


def where_compilers_are() -> tuple[str, ...]:
    """Return what the environment says of compilers."""
    return tuple(os.environ.get(name, "") for name in ("CC", "PATH"))


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
        target: The library, replaced when the compiler succeeds; its folder takes what the
            compiler writes meanwhile.
        include: Folders of headers.
        options: Further compiler options.
        command: The compiler; `find_compiler()` when None.

    Raises:
        MissingTool: There is no compiler, or it fails; the last lines it printed are quoted.
    """
    compiler = tuple(command or find_compiler())
    flags, libraries = FLAGS, ("-lm",)
    if sys.platform == "win32" and "ziglang" not in compiler:  # Clang refuses both there
        flags, libraries = tuple(flag for flag in FLAGS if flag != "-fPIC"), ()
    arguments = [*flags, *(f"-I{folder}" for folder in include), *options]
    call = [*compiler, *arguments, *map(str, sources), "-o", str(target), *libraries]
    memory = most_memory()
    try:
        failed, output = run_bounded(call, TIMEOUT, memory, target.parent)
    except subprocess.TimeoutExpired as error:
        raise CompilerTimeout(
            f"{compiler[0]} was stopped after {TIMEOUT} s; use another compiler (CC=...), or {_HOW}"
        ) from error
    except OSError as error:
        raise MissingTool(f"{compiler[0]} could not be run: {error}; {_HOW}") from error
    if failed and _EXHAUSTED.search(output):
        raise CompilerExhausted(
            f"{compiler[0]} needs more than {memory / 1e9:.3g} GB of memory; give it more "
            "(COSIM_COMPILER_MEMORY, in bytes)"
        )
    if failed or not target.exists():
        tail = "\n".join(output.splitlines()[-20:])
        raise MissingTool(
            f"{shlex.join(call)} failed:\n{tail}\nuse another compiler (CC=...), or {_HOW}"
        )
    return target


def compile_with_less(
    sources: Sequence[Path],
    target: Path,
    *,
    include: Sequence[Path] = (),
    options: Sequence[str] = (),
    command: Sequence[str] | None = None,
) -> Path:
    """Compile as `compile_library` does, without optimising where that takes too much memory.

    Raises:
        MissingTool: See `compile_library`.
    """
    try:
        return compile_library(sources, target, include=include, options=options, command=command)
    except CompilerTimeout:
        raise
    except CompilerExhausted as error:
        warnings.warn(f"{error}; it goes on without optimising", RuntimeWarning, stacklevel=2)
    options = [*options, "-O0"]
    return compile_library(sources, target, include=include, options=options, command=command)


def most_memory() -> int:
    """Return the memory that a compiler may take, bytes.

    Raises:
        MissingTool: $COSIM_COMPILER_MEMORY is not a number.
    """
    chosen = os.environ.get("COSIM_COMPILER_MEMORY", "")
    if chosen and not chosen.isdecimal():
        raise MissingTool(f"COSIM_COMPILER_MEMORY = {chosen} is not a number of bytes; unset it")
    return int(chosen) if chosen else min(MOST_MEMORY, physical_memory() * 3 // 4)


class NotKept(MissingTool):
    """A library that the cache does not hold, where nothing shall be compiled."""


_only_kept = ContextVar("only_kept", default=False)


@contextmanager
def only_kept() -> Iterator[None]:
    """Let `cached_library` refuse what it would have to compile, with `NotKept`."""
    before = _only_kept.set(True)
    try:
        yield
    finally:
        _only_kept.reset(before)


def cached_library(
    key: str, generate: Callable[[], str], beside: Mapping[str, str] = _NOTHING
) -> Path:
    """Return the shared library of some C code from the cache, made first where it is missing.

    Args:
        key: What the code depends on; the same key must always mean the same code.
        generate: Returns the C code; called only where the library is missing.
        beside: Further C files, by name; see `sources_beside`.

    Raises:
        MissingTool: There is no compiler, or it fails, or the cache cannot be written.
        UsageError: The code calls what is nowhere defined.
    """
    command = find_compiler()
    own, processor = _own_processor()
    settings = (*command, *FLAGS, *_HIDE_SYMBOLS, *own, processor, _SHORT, _LONG, str(_LENGTH))
    more = (text for file in beside.items() for text in file)
    digest = hashlib.sha256("\0".join((key, *settings, *more)).encode()).hexdigest()[:32]
    folder = cache_folder()
    try:
        private_folder()
        if found := _kept(folder, digest):
            return found
        if _only_kept.get():
            raise NotKept(f"{folder} does not hold {key.partition(' ')[0]}")
        _refuse_noexec(folder)
        with compiling(), alone(folder, digest), temporary_folder(folder) as build:
            if found := _kept(folder, digest):  # made by another process meanwhile
                return found
            library, code = build / f"code{SUFFIX}", in_pieces(generate())
            refuse_unlinked(code, beside)
            files = {"code.c": code, **beside}
            for name, text in files.items():
                (build / name).write_text(text, encoding="utf-8")
            options = (*_HIDE_SYMBOLS, *own, _SHORT if len(code) < _LENGTH else _LONG)
            sources = [build / name for name in files]
            compile_with_less(sources, library, options=options, command=command)
            target = folder / f"{digest}-{_checksum(library.read_bytes())}{SUFFIX}"
            _keep_library(library, target)
        prune()
    except NotKept:
        raise
    except MissingTool as error:
        raise type(error)(f"{error}, or do not compile (--interpreted)") from error
    except OSError as error:
        raise MissingTool(
            f"cannot keep compiled code in {folder}: {error.strerror or error}; set COSIM_CACHE"
        ) from error
    return target


def refuse_unlinked(code: str, beside: Mapping[str, str]) -> None:
    """Refuse generated code that calls a function of which there is no code.

    It could be compiled, and would end the process at the first call.

    Raises:
        UsageError: Names the function.
    """
    for name in _CALLED.findall(code):
        own = re.search(rf"^\w.*\b{name}\(.*\{{", code, re.MULTILINE)
        if not own and not any(re.search(rf"\b{name}\b", text) for text in beside.values()):
            raise UsageError(f"generated code calls '{name}', of which there is no C code")


@contextmanager
def compiling() -> Iterator[None]:
    """Say and clock that code is generated and compiled in here."""
    began = perf_counter()
    try:
        with doing("compiling (once)"):
            yield
    finally:
        _SPENT.set(_SPENT.get() + perf_counter() - began)


def time_compiling() -> float:
    """Return for how long this thread has been compiling so far, s."""
    return _SPENT.get()


def _kept(folder: Path, digest: str) -> Path | None:
    """Return the library of a digest that is whole and loads; remove those that are not.

    A library's name holds the SHA-256 of its bytes: one that lost or changed a bit would crash, or
    give wrong numbers. A link, a folder or a pipe of such a name is none of ours.
    """
    for place in sorted(folder.glob(f"{digest}-*{SUFFIX}")):
        content = plain_file(place)
        if content is None:
            continue
        if place.stem != f"{digest}-{_checksum(content)}":
            remove_damaged(place)
        elif _loads(place):
            return place
    return None


def _checksum(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


@cache
def _own_processor() -> tuple[tuple[str, ...], str]:
    """Return compiler options for this processor alone, and by what it is told from others."""
    abilities = processor_abilities()
    return (("-march=native", *_APART), abilities) if abilities else (_APART, "")


def processor_abilities() -> str:
    """Return what an x86-64 processor says of itself to Linux; empty elsewhere."""
    try:
        known = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        known = []
    abilities = next((line for line in known if line.startswith("flags")), "")
    return abilities if platform.machine() == "x86_64" else ""


def _split_command(command: str) -> list[str]:
    """Split a command as the machine's shell does; Windows writes paths with backslashes."""
    if sys.platform == "win32":
        return [word.strip('"') for word in shlex.split(command, posix=False)]
    return shlex.split(command)


def _refuse_noexec(folder: Path) -> None:
    if loads_no_library(folder):
        raise MissingTool(
            f"{folder} lies on a file system mounted noexec, from which no compiled code can be "
            "loaded; set COSIM_CACHE to another folder"
        )


def _keep_library(library: Path, target: Path) -> None:
    try:
        library.replace(target)
    except PermissionError:  # of Windows, where another process has made and loaded it meanwhile
        if not _loads(target):
            raise


def _loads(library: Path) -> bool:
    """Tell whether a library can be loaded on this machine."""
    try:
        ctypes.CDLL(str(library))
    except OSError:
        return False
    return True
