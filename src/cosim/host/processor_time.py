"""The limit of processor time that a shell has set (`ulimit -t`), told before the kernel kills."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from time import process_time
from types import FrameType

_SHARE = 0.8  # of the limit; native code that runs just then must return before the kernel kills
_REACHED = "the limit of processor time (ulimit -t) is reached; raise it, or ask for less"


class OutOfTime(KeyboardInterrupt):
    """The limit is nearly reached; it ends a run as Ctrl-C does."""

    def __init__(self) -> None:
        super().__init__(_REACHED)


@contextmanager
def limited_time() -> Iterator[list[str]]:
    """Raise `OutOfTime` somewhat before the limit; yield what is then to be told."""
    told: list[str] = []

    def end(_number: int, _frame: FrameType | None) -> None:
        told.append(_REACHED)
        raise OutOfTime

    left = _left()
    if left is not None:
        signal.signal(signal.SIGPROF, end)
        signal.setitimer(signal.ITIMER_PROF, max(0.01, left))
    try:
        yield told
    finally:
        if left is not None:
            with suppress(OutOfTime):
                signal.setitimer(signal.ITIMER_PROF, 0)


def _left() -> float | None:
    try:
        import resource
    except ImportError:  # not on Windows
        return None
    soft, _ = resource.getrlimit(resource.RLIMIT_CPU)
    return None if soft == resource.RLIM_INFINITY else _SHARE * soft - process_time()
