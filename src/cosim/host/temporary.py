"""Temporary folders, which are removed even if the process that made them was killed.

The name of a folder holds its process; the next call removes the folders of dead processes.
"""

import hashlib
import os
import platform
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path

from cosim.errors import FmuError
from cosim.extensions import deferred_signals

_OLD = 7 * 86400  # s; older folders are removed even if a process has their number today
PREFIX = "cosim"


@contextmanager
def temporary_folder(parent: str | os.PathLike[str] | None = None) -> Iterator[Path]:
    """Yield a new folder (mode 0700) that is removed afterwards with its content.

    Args:
        parent: The folder to make it in; the system's temporary folder when None.

    Raises:
        OSError: The disk is full, or permission is missing.
    """
    place = Path(tempfile.gettempdir() if parent is None else parent)
    remove_leftovers(place)
    with deferred_signals():
        # Windows does not delete a loaded library, and fmpy keeps one loaded that failed to start
        folder = tempfile.TemporaryDirectory(
            prefix=f"{PREFIX}-{process_mark()}-", dir=place, ignore_cleanup_errors=True
        )
    try:
        yield Path(folder.name)
    finally:
        with deferred_signals():
            folder.cleanup()


@contextmanager
def fmu_folder() -> Iterator[Path]:
    """Yield a temporary folder for the files of an FMU.

    Raises:
        FmuError: It cannot be made.
    """
    with ExitStack() as held:
        try:
            folder = held.enter_context(temporary_folder())
        except OSError as error:
            raise FmuError(
                f"there is no folder for temporary files: {error}; set TMPDIR"
            ) from error
        yield folder


def loads_no_library(folder: str | os.PathLike[str]) -> bool:
    """Tell whether a folder's file system is mounted noexec."""
    return hasattr(os, "statvfs") and bool(os.statvfs(folder).f_flag & getattr(os, "ST_NOEXEC", 0))


def remove_leftovers(place: Path) -> int:
    """Remove the temporary folders of dead processes of this user; return their number."""
    folders = [entry for entry in leftovers(place, f"{PREFIX}-") if entry.is_dir()]
    for entry in folders:
        shutil.rmtree(entry.path, ignore_errors=True)
    return len(folders)


def leftovers(place: Path, prefix: str) -> list["os.DirEntry[str]"]:
    """Return what dead processes of this user have left in a folder, links excluded.

    Args:
        place: The folder.
        prefix: Start of the names, which go on with a `process_mark` and a hyphen.
    """
    with suppress(OSError), os.scandir(place) as entries:
        return [e for e in entries if e.name.startswith(prefix) and _is_left(e, prefix)]
    return []


def _is_left(entry: "os.DirEntry[str]", prefix: str) -> bool:
    where, process, rest = [*entry.name.removeprefix(prefix).split("-", 2), "", ""][:3]
    if not (process.isdecimal() and rest):
        return False
    try:
        facts = entry.stat(follow_symlinks=False)
    except OSError:
        return False
    if stat.S_ISLNK(facts.st_mode) or (os.name != "nt" and facts.st_uid != os.geteuid()):
        return False
    if time.time() - facts.st_mtime > _OLD:
        return True
    return where == _place_of_processes() and not is_alive(int(process))


def process_mark() -> str:
    """Return a text that identifies this process, for names of temporary files."""
    return f"{_place_of_processes()}-{os.getpid()}"


def is_alive(process: int) -> bool:
    """Tell whether a process of this machine runs."""
    if os.name == "nt":  # signal 0 would end it there
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


@cache
def _place_of_processes() -> str:
    """Return a text that identifies this machine, or this container, in names of folders."""
    try:
        numbers = str(Path("/proc/self/ns/pid").readlink())  # containers have numbers of their own
    except OSError:
        numbers = ""
    return hashlib.sha256(f"{platform.node()} {numbers}".encode()).hexdigest()[:8]
