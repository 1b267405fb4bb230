"""The user's cache: a private folder of bounded size, whose entries are checked before their use.

An entry is a plain file that carries the SHA-256 of its content, a library in its name and all
else in its first line. What does not match is as good as not there.
"""

import hashlib
import os
import stat
import tempfile
import time
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from cosim.codegen.c_sources import cache_folder
from cosim.errors import CacheError
from cosim.host.temporary import remove_leftovers

LARGEST_CACHE = 2 * 10**9  # unless $COSIM_CACHE_SIZE says otherwise, in bytes
MOST_ENTRY = 2**30  # bytes
_LITTLE = 1e-6  # of that; an entry no larger than this share makes no difference
IN_USE = 600  # s; what was used within stays, as somebody may be about to load it
_ENTRY_HEAD = b"cosim-cache 1 "
_LOCK = ".lock"
_FOLDERS = ("references", "fronts", "tradeoffs", "binaries", "made", "exports", "pictures")
_OTHERS = stat.S_IWGRP | stat.S_IWOTH


@dataclass(frozen=True)
class Contents:
    """What the cache holds: files and their bytes."""

    folder: Path
    files: int
    size: int


def private_folder() -> Path:
    """Return the cache folder, made where it is missing, for this user alone.

    Raises:
        CacheError: It cannot be made, or another user could put files into it.
    """
    folder = cache_folder()
    try:
        if not folder.is_dir():
            for missing in reversed([p for p in (folder, *folder.parents) if not p.exists()]):
                missing.mkdir(mode=0o700, exist_ok=True)
        if os.name != "nt":
            _refuse_foreign(folder)
    except OSError as error:
        raise CacheError(
            f"cannot keep compiled code in {folder}: {error.strerror or error}; set COSIM_CACHE"
        ) from error
    return folder


def _refuse_foreign(folder: Path) -> None:
    place, me = Path(os.path.realpath(folder)), os.geteuid()
    way_out = "set COSIM_CACHE to a folder of your own, or mend its owner and permissions"
    for each in dict.fromkeys((place, *place.parents, *folder.absolute().parents)):
        facts = each.stat()
        if facts.st_uid != me and (facts.st_uid != 0 or each == place):
            raise CacheError(f"the cache {folder} is not used: {each} is another user's; {way_out}")
        shared = facts.st_mode & _OTHERS
        if shared == stat.S_IWGRP and _is_own_group(facts.st_gid):
            shared = 0
        if shared and (each == place or not facts.st_mode & stat.S_ISVTX):  # /tmp is safe: sticky
            raise CacheError(
                f"the cache {folder} is not used: other users can write to {each}; {way_out}"
            )
    if stat.S_IMODE(place.stat().st_mode) & 0o077:
        place.chmod(0o700)


def _is_own_group(number: int) -> bool:
    """Tell whether a group is its user's alone, as most Linux systems make one for everybody."""
    import grp
    import pwd

    try:
        group, user = grp.getgrgid(number), pwd.getpwuid(os.geteuid())
    except KeyError:
        return False
    return group.gr_name == user.pw_name and set(group.gr_mem) <= {user.pw_name}


def content_of(name: str) -> bytes | None:
    """Return the content of an entry, by its path in the cache; None where there is none.

    A damaged one is said, and gone.
    """
    try:
        place = private_folder() / name
    except CacheError:
        return None
    stored = plain_file(place)
    if stored is None:
        return None
    head, _, content = stored.partition(b"\n")
    if head != _ENTRY_HEAD + hashlib.sha256(content).hexdigest().encode():
        remove_damaged(place)
        return None
    return content


def keep(name: str, content: bytes) -> None:
    """Write an entry, whole or not at all.

    Raises:
        CacheError: See `private_folder`.
        OSError: It cannot be written.
    """
    place = private_folder() / name
    place.parent.mkdir(mode=0o700, exist_ok=True)
    head = _ENTRY_HEAD + hashlib.sha256(content).hexdigest().encode() + b"\n"
    _write_whole(place, head + content)
    if len(content) > _LITTLE * most_bytes():  # looking at every entry takes longer than writing
        prune()


def _write_whole(place: Path, content: bytes) -> None:
    """Write a file, whole or not at all; a link of its name is not followed."""
    handle, name = tempfile.mkstemp(dir=place.parent, prefix=".new-")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
        Path(name).replace(place)
    finally:
        Path(name).unlink(missing_ok=True)


def plain_file(place: Path) -> bytes | None:
    """Return the bytes of a file of the cache; None where it is missing, or no plain file of ours.

    Neither a link nor a pipe is opened for reading. What is read counts as used.
    """
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    try:
        handle = os.open(place, flags | getattr(os, "O_BINARY", 0))
    except (OSError, ValueError):
        return None
    try:
        facts = os.fstat(handle)
        own = os.name == "nt" or facts.st_uid == os.geteuid()
        if not own or not stat.S_ISREG(facts.st_mode) or facts.st_size > MOST_ENTRY:
            return None
        with os.fdopen(handle, "rb", closefd=False) as stream:
            content = stream.read()
    except OSError:
        return None
    finally:
        os.close(handle)
    with suppress(OSError):
        os.utime(place)
    return content


def remove_damaged(place: Path) -> None:
    """Remove an entry and say so, once."""
    with suppress(OSError):
        place.unlink()
    warnings.warn(f"{place} was damaged; it is made again", RuntimeWarning, stacklevel=2)


@contextmanager
def alone(folder: Path, key: str) -> Iterator[None]:
    """Wait until no other process makes what a key stands for; 8 hexadecimal digits of it count.

    Where files cannot be locked, two may make the same: each whole, the later one stays.
    """
    with ExitStack() as held:
        with suppress(ImportError, OSError):
            import fcntl

            file = held.enter_context((folder / _LOCK).open("ab"))
            fcntl.lockf(file, fcntl.LOCK_EX, 1, int(key[:8], 16))
        yield


def prune(most: int | None = None) -> None:
    """Remove the entries that were used longest ago where the cache has grown too large.

    Args:
        most: Bytes that may stay; $COSIM_CACHE_SIZE, else 2 GB, when None.
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
    """Return what the cache holds.

    Raises:
        CacheError: The user has no home folder.
    """
    folder = cache_folder()
    sizes = [facts.st_size for _, facts in _files(folder)]
    return Contents(folder, len(sizes), sum(sizes))


def clear() -> Contents:
    """Remove everything from the cache; return what it held.

    Raises:
        CacheError: See `private_folder`.
    """
    held = contents()
    if held.folder.is_dir():
        private_folder()
        remove_leftovers(held.folder)
        prune(-1)
    return held


def most_bytes() -> int:
    """Return the size that the cache may have, bytes.

    Raises:
        CacheError: $COSIM_CACHE_SIZE is not a number.
    """
    chosen = os.environ.get("COSIM_CACHE_SIZE", "")
    if chosen and not chosen.isdecimal():
        raise CacheError(f"COSIM_CACHE_SIZE = {chosen} is not a number of bytes; unset it")
    return int(chosen) if chosen else LARGEST_CACHE


def _files(folder: Path) -> Iterator[tuple[Path, os.stat_result]]:
    """Yield what the cache itself has made; nothing else is ever removed."""
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            with suppress(OSError):
                if entry.is_file(follow_symlinks=False) and entry.name != _LOCK:
                    yield Path(entry.path), entry.stat(follow_symlinks=False)
                elif entry.name in _FOLDERS and entry.is_dir(follow_symlinks=False):
                    yield from _files(Path(entry.path))
