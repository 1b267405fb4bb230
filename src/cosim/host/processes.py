"""Ending what a process has started, also where that has left its group."""

import ctypes
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

MARK = "COSIM_RUN"  # of the environment: `/OURS/ITS/...`; children inherit it
_DIE_WITH_PARENT, _ADOPT_ORPHANS = 1, 36  # PR_SET_PDEATHSIG and PR_SET_CHILD_SUBREAPER of Linux


# Exit codes of SIGKILL, for want of memory too, and of SIGTERM; on Windows those that its tools and
# Python give to `TerminateProcess`
_KILLED = {"posix": (-9, -15), "nt": (1, 15)}


def was_killed(code: int | None, system: str = os.name) -> bool:
    """Tell by its exit code whether a process was ended from outside.

    On Windows an error that nobody caught, whose exit code is 1, cannot be told from that.
    """
    return code in _KILLED.get(system, ())


def end_all(process: int, mark: str) -> None:
    """End a process, its group, and on Linux all that carry a mark in their environment.

    Args:
        process: Leader of its group.
        mark: How the value of the variable `MARK` begins.
    """
    with suppress(OSError):
        if hasattr(os, "killpg"):
            os.killpg(process, signal.SIGKILL)
        else:
            os.kill(process, signal.SIGTERM)  # Windows knows no other
    known = f"{MARK}={mark}".encode()
    for _ in range(10):  # as they may start others meanwhile
        found = False
        for entry in Path("/proc").glob("[0-9]*/environ"):
            with suppress(OSError):
                if any(line.startswith(known) for line in entry.read_bytes().split(b"\0")):
                    os.kill(int(entry.parent.name), signal.SIGKILL)
                    found = True
        if not found:
            return


@contextmanager
def ending_orphans() -> Iterator[None]:
    """End every child of this process afterwards, and on Linux what has lost its parent, too.

    Only for a process that has no other children.
    """
    _control(_ADOPT_ORPHANS, 1)
    try:
        yield
    finally:
        while children := _children():
            for child in children:
                with suppress(OSError):
                    os.kill(child, signal.SIGKILL)
                with suppress(OSError):
                    os.waitpid(child, 0)


def die_with_parent() -> None:
    """Have Linux end this process when the thread that started it is gone."""
    if hasattr(signal, "SIGKILL"):
        _control(_DIE_WITH_PARENT, signal.SIGKILL)


def _children() -> list[int]:
    lists = Path("/proc/self/task").glob("*/children")
    return [int(word) for file in lists for word in file.read_text().split()]


def _control(option: int, value: int) -> None:
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(option, value)
