"""The user's cache: a private folder of limited size, whose entries are checked before use.

An entry is a plain file with the SHA-256 of its content: a library has it in its name, any other
entry in its first line. An entry that does not match is treated as missing.
"""

import os
import stat
import tempfile
import time
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from errno import EACCES
from pathlib import Path

from cosim.codegen.c_sources import cache_folder
from cosim.errors import CacheError
from cosim.files import opened_plain
from cosim.host.temporary import remove_leftovers
from cosim.memo import digest_of

LARGEST_CACHE = 2 * 10**9  # bytes, unless $COSIM_CACHE_SIZE is set
MOST_ENTRY = 2**30  # bytes
_LITTLE = 1e-6  # share of the largest cache up to which a new entry does not start a cleanup
IN_USE = 600  # s; entries used more recently stay, as another process may be about to load them
_ENTRY_HEAD = b"cosim-cache 1 "
_LOCK = ".lock"
_FOLDERS = ("references", "candidates", "fronts", "tradeoffs", "binaries", "made", "pictures")


@dataclass(frozen=True)
class Contents:
    """Content of the cache: number of files and their size in bytes."""

    folder: Path
    files: int
    size: int


def private_folder() -> Path:
    """Return the cache folder, which only this user can access; it is created if missing.

    If the platform's place for caches is read-only, a folder in that for temporary files is used.

    Raises:
        CacheError: The folder cannot be created, or another user could put files into it.
    """
    folder = cache_folder()
    try:
        return _opened(folder)
    except OSError as error:
        problem = f"cannot store compiled code in {folder}: {error.strerror or error}"
        if os.environ.get("COSIM_CACHE") or os.name == "nt":
            raise CacheError(f"{problem}; set COSIM_CACHE") from error
    spare = Path(tempfile.gettempdir(), f"cosim-cache-{os.geteuid()}")
    warnings.warn(f"{problem}; {spare} is used instead", RuntimeWarning, stacklevel=2)
    os.environ["COSIM_CACHE"] = str(spare)  # of this process and its children, too
    return private_folder()


def _opened(folder: Path) -> Path:
    """Return a folder that this user alone can access and write to; it is created if missing."""
    if not folder.is_dir():
        for missing in reversed([p for p in (folder, *folder.parents) if not p.exists()]):
            missing.mkdir(mode=0o700, exist_ok=True)
    if not os.access(folder, os.W_OK):
        raise PermissionError(EACCES, "it is read-only")
    if os.name != "nt":
        _reject_foreign(folder)
    return folder


def _reject_foreign(folder: Path) -> None:
    """Reject a cache that other users own or can write to; close it to its group."""
    place, me = Path(os.path.realpath(folder)), os.geteuid()
    remedy = "set COSIM_CACHE to a folder of your own, or fix its owner and permissions"
    for each in dict.fromkeys((place, *place.parents, *folder.absolute().parents)):
        facts = each.stat()
        if facts.st_uid != me and (facts.st_uid != 0 or each == place):
            raise CacheError(f"the cache {folder} is not used: {each} is another user's; {remedy}")
        is_open = facts.st_mode & stat.S_IWOTH
        if is_open and (each == place or not facts.st_mode & stat.S_ISVTX):  # /tmp is safe: sticky
            raise CacheError(
                f"the cache {folder} is not used: other users can write to {each}; {remedy}"
            )
    if stat.S_IMODE(place.stat().st_mode) & 0o077:
        place.chmod(0o700)


def content_of(name: str) -> bytes | None:
    """Return the content of an entry, by its path in the cache; None if it is missing.

    A corrupt entry is removed with a warning.
    """
    try:
        place = private_folder() / name
    except CacheError:
        return None
    stored = plain_file(place)
    if stored is None:
        return None
    head, _, content = stored.partition(b"\n")
    if head != _ENTRY_HEAD + digest_of([content]).encode():
        remove_damaged(place)
        return None
    return content


def store(name: str, content: bytes) -> None:
    """Store an entry, completely or not at all; a link of the same name is not followed.

    Raises:
        CacheError: See `private_folder`.
        OSError: The entry cannot be written.
    """
    place = private_folder() / name
    place.parent.mkdir(mode=0o700, exist_ok=True)
    head = _ENTRY_HEAD + digest_of([content]).encode() + b"\n"
    handle, new = tempfile.mkstemp(dir=place.parent, prefix=".new-")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(head + content)
        Path(new).replace(place)
    finally:
        Path(new).unlink(missing_ok=True)
    if len(content) > _LITTLE * most_bytes():  # a cleanup takes longer than writing
        prune()


def store_if_possible(name: str, content: bytes) -> None:
    """Store an entry; without a cache, nothing happens."""
    with suppress(OSError, CacheError):
        store(name, content)


def plain_file(place: Path) -> bytes | None:
    """Return the bytes of a cache file; None if it is missing or no plain file of this user.

    Neither a link nor a pipe is opened for reading. Reading an entry marks it as used.
    """
    try:
        with opened_plain(place, MOST_ENTRY, links=False) as stream:
            if os.name != "nt" and os.fstat(stream.fileno()).st_uid != os.geteuid():
                return None
            content = stream.read()
    except (OSError, ValueError):
        return None
    with suppress(OSError):
        os.utime(place)
    return content


def remove_damaged(place: Path) -> None:
    """Remove a corrupt entry with a warning."""
    with suppress(OSError):
        place.unlink()
    warnings.warn(f"{place} was corrupt and has been rebuilt", RuntimeWarning, stacklevel=2)


@contextmanager
def alone(folder: Path, key: str) -> Iterator[None]:
    """Wait until no other process creates the entry of a key, by its first 8 hexadecimal digits.

    Where files cannot be locked, two processes may create the same entry; the later one remains.
    """
    with ExitStack() as opened:
        with suppress(ImportError, OSError):
            import fcntl

            file = opened.enter_context((folder / _LOCK).open("ab"))
            fcntl.lockf(file, fcntl.LOCK_EX, 1, int(key[:8], 16))
        yield


def prune(most: int | None = None) -> None:
    """Remove the least recently used entries of a cache that is too large.

    Args:
        most: Size limit, bytes; $COSIM_CACHE_SIZE, else 2 GB, when None.
    """
    limit = most_bytes() if most is None else most
    folder = cache_folder()
    files = list(_files(folder))
    size = sum(facts.st_size for _, facts in files)
    now = time.time()
    for place, facts in sorted(files, key=lambda each: each[1].st_mtime):
        if size <= limit or (most is None and now - facts.st_mtime < IN_USE):
            return
        with suppress(OSError):
            place.unlink()
            size -= facts.st_size


def contents() -> Contents:
    """Return the number and size of the cache's files.

    Raises:
        CacheError: The user has no home folder.
    """
    folder = cache_folder()
    sizes = [facts.st_size for _, facts in _files(folder)]
    return Contents(folder, len(sizes), sum(sizes))


def clear() -> Contents:
    """Remove everything from the cache; return its content before.

    Raises:
        CacheError: See `private_folder`.
    """
    before = contents()
    if before.folder.is_dir():
        private_folder()
        remove_leftovers(before.folder)
        prune(-1)
    return before


def most_bytes() -> int:
    """Return the size limit of the cache, bytes.

    Raises:
        CacheError: $COSIM_CACHE_SIZE is not a number.
    """
    chosen = os.environ.get("COSIM_CACHE_SIZE", "")
    if chosen and not chosen.isdecimal():
        raise CacheError(f"COSIM_CACHE_SIZE = {chosen} is not a number of bytes; unset it")
    return int(chosen) if chosen else LARGEST_CACHE


def _files(folder: Path) -> Iterator[tuple[Path, os.stat_result]]:
    """Yield the files that the cache created; no other file is ever removed."""
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            with suppress(OSError):
                if entry.is_file(follow_symlinks=False) and entry.name != _LOCK:
                    yield Path(entry.path), entry.stat(follow_symlinks=False)
                elif entry.name in _FOLDERS and entry.is_dir(follow_symlinks=False):
                    yield from _files(Path(entry.path))
