"""The part of a system that was called last, readable after the process has crashed.

A child process notes in a file, shared as memory, which part it calls; its parent reads the file.
"""

import ctypes
import json
import mmap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

_NAMES, _PLACE = "parts.json", "called_part"
_FOLDER: ContextVar[Path | None] = ContextVar("folder", default=None)


@contextmanager
def calls_noted_in(folder: Path) -> Iterator[None]:
    """Have `noted_calls` within this context write to a folder."""
    token = _FOLDER.set(folder)
    try:
        yield
    finally:
        _FOLDER.reset(token)


def noted_in() -> Path | None:
    """Return the folder of `calls_noted_in`; None elsewhere."""
    return _FOLDER.get()


@contextmanager
def noted_calls(names: Sequence[str]) -> Iterator[ctypes.c_longlong]:
    """Yield a number that whoever calls a part sets to its place among the names; -1 for none.

    It is shared with the parent within `calls_noted_in`, and an ordinary number elsewhere.
    """
    folder = noted_in()
    if folder is None:
        yield ctypes.c_longlong(-1)
        return
    (folder / _NAMES).write_text(json.dumps(list(names)))
    (folder / _PLACE).write_bytes((-1).to_bytes(8, "little", signed=True))
    with (folder / _PLACE).open("r+b") as file:
        shared = mmap.mmap(file.fileno(), 8)
        yield ctypes.c_longlong.from_buffer(shared)


def last_called(folder: Path) -> str | None:
    """Return the part that a child process called last; None if it noted none."""
    with suppress(OSError, ValueError):
        names = json.loads((folder / _NAMES).read_text())
        place = int.from_bytes((folder / _PLACE).read_bytes(), "little", signed=True)
        if 0 <= place < len(names):
            return str(names[place])
    return None
