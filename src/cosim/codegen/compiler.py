"""Compilation of C code to shared libraries, which are stored in the cache.

The compiler is $CC, else cc, gcc, clang, else the one in the package `ziglang`. An optimization
level in $CC, as in CC="gcc -O0", replaces those of this package.
"""

import ctypes
import os
import platform
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from threading import Event
from time import perf_counter
from types import MappingProxyType

from cosim.codegen.c_sources import cache_folder
from cosim.codegen.cache import alone, plain_file, private_folder, prune, remove_damaged
from cosim.codegen.pieces import in_pieces
from cosim.errors import CompilerTimeout, MissingTool, UsageError
from cosim.host.progress import doing
from cosim.host.signals import ended_by_signals
from cosim.host.temporary import loads_no_library, temporary_folder
from cosim.memo import digest_of

# First bytes of libraries for Linux, Windows, macOS (of one and of several processors), and WASM
_BINARIES = (b"\x7fELF", b"MZ", b"\xcf\xfa\xed\xfe", b"\xca\xfe\xba\xbe", b"\0asm")
SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
FLAGS = ("-O2", "-fPIC", "-shared", "-g0")
TIMEOUT = 600  # s, for one compiler call

# Options for generated code. -O3 takes up to twice as long to compile as -O2, and for one long
# function, such as a Jacobian, -O2 five times as long as -O1; neither gains speed. Hidden symbols
# can be inlined.
_LONG, _LENGTH = "-O1", 200_000  # characters
_LEVEL = re.compile("-O.*")
_HIDE_SYMBOLS = ("-fvisibility=hidden", "-DGCC_HASCLASSVISIBILITY")  # except those CasADi exports

# Products and sums are not fused, so that every processor computes the same numbers. GCC fuses
# alternating sums and differences of products (vfmaddsub) in straight-line code in spite of
# -ffp-contract=off; the second option switches off its vectorizer for such code.
_APART = ("-ffp-contract=off", "-fno-tree-slp-vectorize")

# The bundled compiler first builds its own runtime library, which takes 8 s for each processor and
# which arithmetic with doubles does not need: without it, and with every missing function an error.
_NO_RUNTIME = ("-rtlib=none", "-Wl,-z,defs")

_SPENT: ContextVar[float] = ContextVar("time_compiling", default=0.0)  # s

# A second process waits for a pipe that closes when the caller ends, even by SIGKILL.
_ENDS_WITH_CALLER = """
exec 3<&0 </dev/null
( read -r _ <&3; kill -9 0 ) >/dev/null 2>&1 &
exec 3<&-
exec "$@"
"""

_NOTHING: Mapping[str, str] = MappingProxyType({})
# Declaration by CasADi of a function that another file defines
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
            raise MissingTool(f"CC names '{chosen}', which is no program; unset CC, or {_HOW}")
        return tuple(command)
    for name in ("cc", "gcc", "clang"):
        if found := shutil.which(name):
            return (found,)
    if find_spec("ziglang"):
        return (sys.executable, "-P", "-m", "ziglang", "cc")  # -P: ignore the current folder
    raise MissingTool(f"no C compiler found (tried $CC, cc, gcc, clang, ziglang); {_HOW}")


def has_compiler() -> bool:
    """Tell whether this machine has a C compiler.

    Raises:
        MissingTool: $CC names a compiler that does not exist.
    """
    try:
        find_compiler()
    except MissingTool:
        if os.environ.get("CC"):
            raise
        return False
    return True


def is_bundled(command: Sequence[str]) -> bool:
    """Tell whether a command is the compiler in `ziglang`, or the same one installed otherwise."""
    return any(Path(word).stem.startswith("zig") for word in command)


def where_compilers_are() -> tuple[str, ...]:
    """Return the environment variables that determine the compiler."""
    return tuple(os.environ.get(name, "") for name in ("CC", "PATH"))


def compile_library(
    sources: Sequence[Path],
    target: Path,
    *,
    include: Sequence[Path] = (),
    options: Sequence[str] = (),
    command: Sequence[str] | None = None,
    halted: Event | None = None,
) -> Path:
    """Compile C sources to a shared library.

    Args:
        target: The library, replaced when the compiler succeeds; the compiler's temporary files
            go to its folder.
        command: The compiler; `find_compiler()` when None.
        halted: Ends the compiler when it is set, for one that runs in another thread.

    Raises:
        MissingTool: There is no compiler, or it fails; the message quotes its last lines.
    """
    compiler = tuple(command or find_compiler())
    flags: tuple[str, ...] = FLAGS
    libraries: tuple[str, ...] = ("-lm",)
    if target.suffix == ".wasm":  # a program without `main`
        flags = tuple(flag for flag in FLAGS if flag != "-shared")
    elif sys.platform == "win32" and not is_bundled(compiler):  # Clang rejects both there
        flags, libraries = tuple(flag for flag in FLAGS if flag != "-fPIC"), ()
    arguments = [*flags, *(f"-I{folder}" for folder in include), *options]
    if any(_LEVEL.fullmatch(word) for word in compiler):
        arguments = [word for word in arguments if not _LEVEL.fullmatch(word)]
    call = [*compiler, *arguments, *map(str, sources), "-o", str(target), *libraries]
    try:
        failed = 1
        if is_bundled(compiler) and target.suffix in (".so", ".dylib"):
            failed, output = _output_of([*call, *_NO_RUNTIME], target.parent, halted)
        if failed:
            failed, output = _output_of(call, target.parent, halted)
    except subprocess.TimeoutExpired as error:
        raise CompilerTimeout(
            f"{call[0]} was stopped after {TIMEOUT} s; use another compiler (CC=...), or {_HOW}"
        ) from error
    except OSError as error:
        raise MissingTool(f"{call[0]} could not be run: {error}; {_HOW}") from error
    if failed or not target.exists():
        last = [line for line in output.splitlines() if line.strip()][-20:]
        why = "\n".join((":", *last, "")) if last else " without a message; "
        raise MissingTool(f"{shlex.join(call)} failed{why}use another compiler (CC=...), or {_HOW}")
    with target.open("rb") as stream:
        if not stream.read(4).startswith(_BINARIES):
            raise MissingTool(
                f"{shlex.join(call)} wrote something else than a shared library; use another "
                f"compiler (CC=...), or {_HOW}"
            )
    return target


def _output_of(call: Sequence[str], folder: Path, halted: Event | None) -> tuple[int, str]:
    """Run a compiler, which ends with its caller; return its exit code and its output."""
    watched = sys.platform != "win32"
    held, end = os.pipe() if watched else (subprocess.DEVNULL, subprocess.DEVNULL)
    command = ["/bin/sh", "-c", _ENDS_WITH_CALLER, "sh", *call] if watched else call
    places = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder))
    with tempfile.TemporaryFile() as output:  # a pipe would stay open while a child holds it
        process = subprocess.Popen(
            command, stdin=held, stdout=output, stderr=subprocess.STDOUT,
            start_new_session=True, env=os.environ | places,
        )  # fmt: skip
        try:
            _wait(process, halted)
        finally:  # done, too late, or interrupted: children may be left
            with suppress(OSError):
                os.killpg(process.pid, signal.SIGKILL) if watched else process.kill()
            process.wait()
            for pipe in (held, end) if watched else ():
                os.close(pipe)
        output.seek(0)
        printed = output.read().decode(errors="replace")
    if watched and process.returncode in (126, 127):  # of a shell: no program, or not found
        raise OSError(printed.strip())
    return process.returncode, printed


def _wait(process: subprocess.Popen[bytes], halted: Event | None) -> None:
    if halted is None:
        process.wait(TIMEOUT)
        return
    began = perf_counter()
    while process.poll() is None and not halted.wait(0.02):
        if perf_counter() - began > TIMEOUT:
            raise subprocess.TimeoutExpired(process.args, TIMEOUT)


def cached_library(
    key: str, generate: Callable[[], str], beside: Mapping[str, str] = _NOTHING
) -> Path:
    """Return the shared library of C code from the cache, compiled first if it is missing.

    Args:
        key: Key of the code; the same key must always mean the same code.
        generate: Returns the C code; called only if the library is missing.
        beside: Further C files by name; see `sources_beside`.

    Raises:
        MissingTool: There is no compiler, or it fails, or the cache cannot be written.
        UsageError: The code calls a function that is not defined.
    """
    command = find_compiler()
    own, processor = _own_processor()
    settings = (*command, *FLAGS, *_HIDE_SYMBOLS, *own, processor, _LONG, str(_LENGTH))
    more = (text for file in beside.items() for text in file)
    digest = digest_of(map(str.encode, (key, *settings, *more)))[:32]
    folder = cache_folder()
    try:
        folder = private_folder()
        if found := _stored(folder, digest):
            return found
        if loads_no_library(folder):
            raise MissingTool(
                f"{folder} lies on a file system mounted noexec, from which no compiled code can "
                "be loaded; set COSIM_CACHE to another folder"
            )
        with compiling(), alone(folder, digest), temporary_folder(folder) as build:
            if found := _stored(folder, digest):  # compiled by another process meanwhile
                return found
            library, code = build / f"code{SUFFIX}", in_pieces(generate())
            reject_unlinked(code, beside)
            files = {"code.c": code, **beside}
            for name, text in files.items():
                (build / name).write_text(text, encoding="utf-8")
            options = (*_HIDE_SYMBOLS, *own, *([_LONG] * (len(code) >= _LENGTH)))
            sources = [build / name for name in files]
            compile_library(sources, library, options=options, command=command)
            checksum = digest_of([library.read_bytes()])
            target = folder / f"{digest}-{checksum}{SUFFIX}"
            _store_library(library, target)
        prune()
    except MissingTool as error:
        raise type(error)(f"{error}, or do not compile (--backend native-interpreted)") from error
    except OSError as error:
        raise MissingTool(
            f"cannot store compiled code in {folder}: {error.strerror or error}; set COSIM_CACHE"
        ) from error
    return target


def reject_unlinked(code: str, beside: Mapping[str, str]) -> None:
    """Reject generated code that calls an undefined function.

    Such code compiles, and the first call would end the process.

    Raises:
        UsageError: Names the function.
    """
    for name in _CALLED.findall(code):
        own = re.search(rf"^\w.*\b{name}\(.*\{{", code, re.MULTILINE)
        if not own and not any(re.search(rf"\b{name}\b", text) for text in beside.values()):
            raise UsageError(f"generated code calls '{name}', whose C code is missing")


def renamed_externals(code: str, beside: Mapping[str, str]) -> tuple[str, dict[str, str]]:
    """Return generated code and the C code of its external functions, none of them named as ours.

    In one unit with other code, a user's function called "reset" would be two.
    """
    names = "|".join(name for name in _CALLED.findall(code) if beside)
    if not names:
        return code, dict(beside)
    every = re.compile(rf"\b(?:{names})(?:_\w+)?\b")
    texts = (every.sub(r"external_\g<0>", text) for text in (code, *beside.values()))
    return next(texts), dict(zip(beside, texts, strict=True))


@contextmanager
def compiling() -> Iterator[None]:
    """Show progress while code is generated and compiled, and measure the time.

    SIGTERM leaves the context, and temporary folders inside it, before it ends the process.
    """
    began = perf_counter()
    try:
        with ended_by_signals(), doing("compiling (once)"):
            yield
    finally:
        _SPENT.set(_SPENT.get() + perf_counter() - began)


def time_compiling() -> float:
    """Return the time that this thread has spent compiling so far, s."""
    return _SPENT.get()


def _stored(folder: Path, digest: str) -> Path | None:
    """Return the stored library of a digest if it is intact and loads; remove corrupt ones.

    A library's name contains the SHA-256 of its bytes, since a changed bit could crash the process
    or give wrong numbers. Links, folders and pipes are ignored.
    """
    for place in sorted(folder.glob(f"{digest}-*{SUFFIX}")):
        content = plain_file(place)
        if content is None:
            continue
        if place.stem != f"{digest}-{digest_of([content])}":
            remove_damaged(place)
        elif _loads(place):
            return place
    return None


@cache
def _own_processor() -> tuple[tuple[str, ...], str]:
    """Return compiler options for this processor, and a text that identifies its abilities."""
    abilities = processor_abilities()
    return (("-march=native", *_APART), abilities) if abilities else (_APART, "")


def processor_abilities() -> str:
    """Return the abilities of an x86-64 processor as Linux lists them; empty elsewhere."""
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


def _store_library(library: Path, target: Path) -> None:
    try:
        library.replace(target)
    except PermissionError:  # on Windows, if another process has stored and loaded it meanwhile
        if not _loads(target):
            raise


def _loads(library: Path) -> bool:
    """Tell whether a library can be loaded on this machine."""
    try:
        ctypes.CDLL(str(library))
    except OSError:
        return False
    return True
