"""A command in a child process: where a user's own code loops, crashes or exits, it is said.

Only on Linux; elsewhere the command runs as it is. Windows cannot split a process, and the windows
of macOS do not survive it.
"""

import os
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

GRACE = 5.0  # s, that a child has to end after Ctrl-C
_DIE_WITH_PARENT, _ADOPT_ORPHANS = 1, 36  # PR_SET_PDEATHSIG and PR_SET_CHILD_SUBREAPER of Linux


def can_supervise() -> bool:
    """Tell whether this system splits processes."""
    return sys.platform == "linux"


def supervised(work: Callable[[], int], what: str, timeout: float | None) -> int:
    """Return the exit code of some work, done in a child process; 1 where it did not come to one.

    Args:
        work: Returns an exit code.
        what: Whose code it runs, for messages.
        timeout: s; None for no limit.
    """
    reader, writer = os.pipe()
    _control(_ADOPT_ORPHANS, 1)
    child = os.fork()
    if child == 0:
        os.close(reader)
        _work(work, writer)
    os.close(writer)
    with suppress(OSError):
        os.setpgid(child, child)
    told: list[int] = []
    with _forwarded(child, told):
        status = _waited(child, timeout, told)
        _end_children()
    code = os.read(reader, 1)
    os.close(reader)
    if code:
        return code[0]
    remove_leftovers_of_temporary()
    if told and told[0] != signal.SIGINT:
        signal.signal(told[0], signal.SIG_DFL)
        os.kill(os.getpid(), told[0])
    if told:
        print("interrupted", file=sys.stderr)
        return 130
    if status is None:
        print(f"{what} did not end within {timeout:g} s and was stopped", file=sys.stderr)
    elif os.WIFSIGNALED(status):
        name = signal.Signals(os.WTERMSIG(status)).name
        print(f"{what} crashed ({name}); look for the cause there", file=sys.stderr)
    else:
        ended = f"ended the process with exit code {os.WEXITSTATUS(status)}"
        print(f"{what} {ended}; it must return instead", file=sys.stderr)
    return 1


def remove_leftovers_of_temporary() -> None:
    """Remove the temporary folders of a child that did not end by itself."""
    import tempfile

    from cosim.host.temporary import remove_leftovers

    remove_leftovers(Path(tempfile.gettempdir()))


def _work(work: Callable[[], int], writer: int) -> None:
    """Be the child."""
    with suppress(OSError):
        os.setpgid(0, 0)
    _control(_DIE_WITH_PARENT, signal.SIGKILL)
    code = 1
    try:
        code = work()
    except BaseException:  # of --debug
        traceback.print_exc()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os.write(writer, bytes([code]))
    os._exit(code)  # whatever threads are left


def _control(option: int, value: int) -> None:
    import ctypes

    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(option, value)


def _end_children() -> None:
    """End the child and all that it has started; what loses its parent becomes ours."""
    while True:
        lists = Path("/proc/self/task").glob("*/children")
        children = [int(word) for file in lists for word in file.read_text().split()]
        if not children:
            return
        for child in children:
            with suppress(OSError):
                os.kill(child, signal.SIGKILL)
            with suppress(OSError):
                os.waitpid(child, 0)


def _waited(child: int, timeout: float | None, told: list[int]) -> int | None:
    """Return the status of a child that has ended; None where its time is over."""
    end = None if timeout is None else time.monotonic() + timeout
    grace: float | None = None
    pause = 0.001
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return status
        now = time.monotonic()
        if told and grace is None:
            grace = now + (GRACE if told[0] == signal.SIGINT else 0.5)
        if (end is not None and now > end) or (grace is not None and now > grace):
            return None
        time.sleep(pause)
        pause = min(1.5 * pause, 0.03)


@contextmanager
def _forwarded(child: int, told: list[int]) -> Iterator[None]:
    """Pass signals on to a child; keep which they were."""

    def forward(number: int, _frame: FrameType | None) -> None:
        told.append(number)
        with suppress(OSError):
            os.kill(child, number)

    kinds = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    usual = {kind: signal.signal(kind, forward) for kind in kinds}
    try:
        yield
    finally:
        for kind, handler in usual.items():
            signal.signal(kind, handler)
