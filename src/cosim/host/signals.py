"""Signals: Ctrl-C while native code runs, the end of a process, and the time limit of a command."""

import ctypes
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Timer, current_thread, main_thread
from types import FrameType

from cosim.host.limits import waiting_time


@contextmanager
def interruptible(library: ctypes.CDLL | None) -> Iterator[list[int]]:
    """Let Ctrl-C and a time limit end one long call of a compiled library.

    The library watches the signals meanwhile, see fmu/solvers/interrupt.h.

    Yields:
        A list that holds the signal afterwards. A handler that the user has installed is called.
    """
    interrupts: list[int] = []
    if library is None or current_thread() is not main_thread():
        yield interrupts
        return
    library.cosim_watch()
    try:
        yield interrupts
    finally:
        number = library.cosim_halted()
    if number:
        interrupts.append(number)
        handler = signal.getsignal(number)
        limit = getattr(handler, "__self__", None)
        if isinstance(limit, TimeLimit):  # the run ends as after Ctrl-C, with what it computed
            limit.reached = limit.reached or number != signal.SIGINT
        elif handler is not signal.default_int_handler:
            signal.raise_signal(number)


class TimeLimitReached(KeyboardInterrupt):
    """The time limit of a command was reached; a run ends as it does after Ctrl-C."""


class TimeLimit:
    """A time limit: `reached` tells whether it has interrupted the work."""

    def __init__(self) -> None:
        self.reached = False

    def expire(self) -> None:
        """Interrupt the main thread by SIGINT."""
        self.reached = True
        signal.raise_signal(signal.SIGINT)

    def interrupt(self, number: int, _frame: FrameType | None) -> None:
        """Handle the signal of the timer, or Ctrl-C."""
        self.reached = self.reached or number != signal.SIGINT
        raise TimeLimitReached if self.reached else KeyboardInterrupt


@contextmanager
def time_limit(seconds: float | None) -> Iterator[TimeLimit]:
    """Raise `TimeLimitReached` in the main thread after a time, s; never for None or infinity.

    An interval timer does it; on Windows, which has none, a thread.
    """
    limit, seconds = TimeLimit(), waiting_time(seconds)
    if seconds is None:
        yield limit
        return
    thread, by_timer = Timer(seconds, limit.expire), hasattr(signal, "setitimer")
    thread.daemon = True
    kind = signal.SIGALRM if by_timer else signal.SIGINT
    before = signal.signal(kind, limit.interrupt)
    if by_timer:  # again after 2 s: a callback of native code may have swallowed the exception
        timer = signal.setitimer(signal.ITIMER_REAL, seconds, 2.0)
    else:
        thread.start()
    try:
        yield limit
    finally:
        if by_timer:
            signal.setitimer(signal.ITIMER_REAL, *timer)
        thread.cancel()
        signal.signal(kind, before)


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """Leave this context, as after Ctrl-C, before SIGTERM or SIGHUP ends the process."""
    kinds = [getattr(signal, n) for n in ("SIGTERM", "SIGHUP") if hasattr(signal, n)]
    usual = current_thread() is main_thread()
    kinds = [k for k in kinds if usual and signal.getsignal(k) is signal.SIG_DFL]

    received: list[int] = []

    def end(number: int, _frame: FrameType | None) -> None:
        received.append(number)
        signal.signal(number, signal.SIG_DFL)  # a second one ends it at once
        raise KeyboardInterrupt

    for kind in kinds:
        signal.signal(kind, end)
    try:
        yield
    finally:
        for kind in kinds:
            signal.signal(kind, signal.SIG_DFL)
        for number in received[:1]:
            os.kill(os.getpid(), number)
