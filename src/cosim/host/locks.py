"""Locks between processes and threads, on a file that exists; they end with their process."""

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_BEYOND_THE_END = 2**30  # byte that Windows locks; the content remains readable
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EINVAL)  # of file systems without locks


@contextmanager
def exclusive(file: Path) -> Iterator[None]:
    """Hold the lock of a file; a file system without locks is used without.

    Raises:
        BlockingIOError: Another process or thread holds it.
        OSError: The file cannot be opened.
    """
    descriptor = os.open(file, os.O_RDWR)
    try:
        _lock(descriptor)
        yield
    finally:
        os.close(descriptor)  # which ends the lock


def _lock(descriptor: int) -> None:
    if sys.platform == "win32":
        import msvcrt

        os.lseek(descriptor, _BEYOND_THE_END, os.SEEK_SET)
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError as error:
            raise BlockingIOError(error.errno, error.strerror) from error
        return
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
