"""Atomic writing and checked reading of files: a file is complete or absent."""

import errno
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from cosim.errors import ExportError, UsageError
from cosim.extensions import deferred_signals
from cosim.host.signals import ended_by_signals
from cosim.host.temporary import leftovers, process_mark

MOST_READ = 2**30  # bytes
MOST_TEXT = 2**28  # bytes, of what people write


def write_atomically(target: str | os.PathLike[str], content: bytes) -> Path:
    """Write a file so that its name always stands for the whole old or the whole new content.

    Links are followed; a device or a pipe is written to as it is.

    Raises:
        ExportError: The folder is missing or read-only, the disk is full, the name is a folder.
    """
    with written_atomically(target) as stream:
        stream.write(content)
    return Path(target)


@contextmanager
def written_atomically(target: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Write a file piece by piece, as `write_atomically` does at once.

    Yields:
        What is written to; where the block is left by an error, the old content stays.
    """
    with _explained(target), ended_by_signals():
        place = _place(target)
        if place.exists() and not place.is_file():
            with place.open("wb") as stream:
                yield stream
            return
        mode = stat.S_IMODE(place.stat().st_mode) if place.exists() else None
        for left in leftovers(place.parent, _prefix(place)):
            if left.is_file():
                Path(left).unlink(missing_ok=True)
        with _sibling(place, 0o666 if mode is None else 0o600) as temporary:
            with temporary.open("wb") as stream:
                yield stream
                stream.flush()
                os.fsync(stream.fileno())
            if mode is not None:
                temporary.chmod(mode)
            temporary.replace(place)


def opened_plain(
    source: str | os.PathLike[str], most_bytes: int = MOST_READ, *, links: bool = True
) -> BinaryIO:
    """Open a plain file for reading: no pipe, whose end may never come, and no device.

    Raises:
        OSError: It is missing, no plain file, a link without `links`, or larger than `most_bytes`.
    """
    if "\0" in os.fsdecode(source):  # a ValueError of Python's
        raise OSError(errno.EINVAL, "its name holds a null character")
    facts = Path(source).stat(follow_symlinks=links)
    if stat.S_ISDIR(facts.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(facts.st_mode):
        raise OSError(errno.EINVAL, "it is no plain file")
    if facts.st_size > most_bytes:
        raise OSError(errno.EFBIG, f"it has more than {most_bytes} bytes")
    return Path(source).open("rb")


def read_plain(source: str | os.PathLike[str], most_bytes: int = MOST_READ) -> bytes:
    """Return the content of a plain file."""
    with opened_plain(source, most_bytes) as stream:
        return stream.read()


def read_text(source: str | os.PathLike[str]) -> str:
    """Return the text of a plain UTF-8 file that people write; a byte order mark is tolerated.

    Raises:
        UsageError: It cannot be read, or is in another encoding.
    """
    try:
        return read_plain(source, MOST_TEXT).decode("utf-8-sig")
    except OSError as error:
        raise UsageError(f"cannot read {source}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{source} is not a UTF-8 text; save it in UTF-8") from error


def is_file(path: str | os.PathLike[str]) -> bool:
    """Tell whether there is a file; no file has a name that the system does not allow."""
    try:
        return Path(path).is_file()
    except OSError:
        return False


def reject_unwritable(target: str | os.PathLike[str]) -> None:
    """Reject a path that cannot be written, before anything is computed for it.

    Raises:
        ExportError: See `write_atomically`.
    """
    with _explained(target):
        place = _place(target)
        if not place.exists() or place.is_file():
            with _sibling(place):
                pass


def _place(target: str | os.PathLike[str]) -> Path:
    place = Path(os.path.realpath(target))
    if place.is_dir():
        raise ExportError(f"cannot write {target}: it is a directory; give a file name")
    if not place.exists() and Path(target).exists():
        return Path(target)  # /dev/stdout as a pipe, which has no name
    if place.exists() and not os.access(place, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    return place


def _prefix(place: Path) -> str:
    return f".{place.name[:40]}."


@contextmanager
def _sibling(place: Path, mode: int = 0o600) -> Iterator[Path]:
    """Yield a new file beside another one, removed afterwards; a signal may come at any moment."""
    name = f"{_prefix(place)}{process_mark()}-{secrets.token_hex(4)}"
    temporary = place.with_name(name)  # known before it exists
    try:
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_RDWR, mode))
        yield temporary
    finally:
        with deferred_signals():
            temporary.unlink(missing_ok=True)


@contextmanager
def _explained(target: str | os.PathLike[str]) -> Iterator[None]:
    try:
        yield
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        hint = _what_to_create(Path(target)) if isinstance(error, FileNotFoundError) else ""
        reason = getattr(error, "strerror", None) or error
        raise ExportError(f"cannot write {target}: {reason}{hint}") from error


def _what_to_create(target: Path) -> str:
    if not target.is_symlink():
        return f"; create {target.parent} first"
    place = Path(os.path.realpath(target))
    return f"; it is a link to {place}: create {place.parent} first"
