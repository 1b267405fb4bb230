"""Ending what a process has started, also where that has left its group."""

import os
import signal
from contextlib import suppress
from pathlib import Path

MARK = "COSIM_RUN"  # of the environment; children inherit it


def end_all(process: int, mark: str) -> None:
    """End a process, its group, and on Linux all that carry a mark in their environment.

    Args:
        process: Leader of its group.
        mark: Value of the variable `MARK`.
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
                if known in entry.read_bytes().split(b"\0"):
                    os.kill(int(entry.parent.name), signal.SIGKILL)
                    found = True
        if not found:
            return
