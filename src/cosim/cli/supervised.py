"""A command in a child process: where a user's own code loops, crashes or exits, it is said."""

import os
import signal
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from cosim.files import MOST_TEXT, read_plain
from cosim.host.child import Child
from cosim.host.processes import ending_orphans
from cosim.host.temporary import remove_leftovers

OWN_CODE = "cosim.cli.own_code"  # what the child runs
GRACE = 5.0  # s, that a child has to end after Ctrl-C
_PAUSE = 0.03  # s, between two looks


def names_own_code(word: str) -> bool:
    """Tell whether a word is `PATH.py:FUNCTION`, or a scene that names one."""
    if ".py:" in word:
        return True
    if not word.endswith(".toml"):
        return False
    try:
        return b".py:" in read_plain(word, MOST_TEXT)
    except (OSError, ValueError):
        return False  # which is told when it is read


def supervised(words: Sequence[str], what: str, timeout: float | None) -> int:
    """Return the exit code of a command line; 1 where its process did not come to one.

    Args:
        words: The command line.
        what: Whose code it runs, for messages.
        timeout: s; None for no limit.
    """
    reader, writer = os.pipe()
    told: list[int] = []
    shared = [] if sys.platform == "win32" else [writer]  # where the exit code is all there is
    with ending_orphans(), Child(OWN_CODE, [str(writer), *words], descriptors=shared) as child:
        os.close(writer)
        with _forwarded(child, told):
            status = _waited(child, timeout, told)
    code = os.read(reader, 1)
    os.close(reader)
    if code:
        return code[0]
    if sys.platform == "win32" and status is not None:
        return status
    remove_leftovers(Path(tempfile.gettempdir()))
    return _sentence(what, status, timeout, told)


def _sentence(what: str, status: int | None, timeout: float | None, told: list[int]) -> int:
    """Say how a child ended that came to no exit code; return ours."""
    if told and told[0] != signal.SIGINT:
        signal.signal(told[0], signal.SIG_DFL)
        os.kill(os.getpid(), told[0])
    if told:
        print("interrupted", file=sys.stderr)
        return 130
    if status is None:
        print(f"{what} did not end within {timeout:g} s and was stopped", file=sys.stderr)
    elif status < 0:
        name = signal.Signals(-status).name
        print(f"{what} crashed ({name}); look for the cause there", file=sys.stderr)
    else:
        ended = f"ended the process with exit code {status}"
        print(f"{what} {ended}; it must return instead", file=sys.stderr)
    return 1


def _waited(child: Child, timeout: float | None, told: list[int]) -> int | None:
    """Return the exit code of a child that has ended; None where its time is over."""
    end = None if timeout is None else time.monotonic() + timeout
    grace: float | None = None
    while (status := child.wait(_PAUSE)) is None:
        now = time.monotonic()
        if told and grace is None:
            grace = now + (GRACE if told[0] == signal.SIGINT else 0.5)
        if (end is not None and now > end) or (grace is not None and now > grace):
            return None
    return status


@contextmanager
def _forwarded(child: Child, told: list[int]) -> Iterator[None]:
    """Pass signals on to a child; keep which they were."""

    def forward(number: int, _frame: FrameType | None) -> None:
        told.append(number)
        child.send(number)

    names = ("SIGINT", "SIGTERM", "SIGHUP")
    kinds = [getattr(signal, name) for name in names if hasattr(signal, name)]
    usual = {kind: signal.signal(kind, forward) for kind in kinds}
    try:
        yield
    finally:
        for kind, handler in usual.items():
            signal.signal(kind, handler)
