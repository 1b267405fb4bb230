"""Signals: Ctrl-C while native code runs, the end of a process, and the time limit of a command."""

import ctypes
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, Thread, Timer, current_thread, main_thread
from types import FrameType
from typing import Any

from cosim.host.limits import waiting_time

_AGAIN = 2.0  # s, after which an exception that was lost is raised again


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
    library.cosim_watch(isinstance(_owner_of(signal.SIGTERM), Insistence))
    try:
        yield interrupts
    finally:
        number = library.cosim_halted()
    if number:
        interrupts.append(number)
        owner = _owner_of(number)
        if isinstance(owner, TimeLimit | Insistence):  # the run ends, with what it computed
            owner.notice(number)
        elif signal.getsignal(number) is not signal.default_int_handler:
            signal.raise_signal(number)


def _owner_of(number: int) -> object:
    """Return the object whose method handles a signal; None if that is no method."""
    return getattr(signal.getsignal(number), "__self__", None)


class TimeLimitReached(KeyboardInterrupt):
    """The time limit of a command was reached; a run ends as it does after Ctrl-C."""


class TimeLimit:
    """Raises `TimeLimitReached` in the main thread after a time, s; never for None or infinity.

    An interval timer does it; on Windows, which has none, a thread. The time may be over as soon as
    it begins.

    Attributes:
        reached: Whether it has interrupted the work.
    """

    def __init__(self, seconds: float | None) -> None:
        self.reached, self._raised, self._over = False, False, False
        self._seconds = waiting_time(seconds)
        self._by_timer = hasattr(signal, "setitimer")
        self._kind = signal.SIGALRM if self._by_timer else signal.SIGINT
        self._thread = Timer(self._seconds or 0.0, self.expire)
        self._thread.daemon = True
        self._usual_timer = 0.0, 0.0

    def __enter__(self) -> "TimeLimit":
        if self._seconds is None:
            return self
        self._usual = signal.signal(self._kind, self.interrupt)
        try:
            if self._by_timer:
                self._usual_timer = signal.setitimer(signal.ITIMER_REAL, self._seconds, _AGAIN)
            else:
                self._thread.start()
        except TimeLimitReached:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._over = True
        if self._seconds is None:
            return
        if self._by_timer:
            signal.setitimer(signal.ITIMER_REAL, *self._usual_timer)
        self._thread.cancel()
        signal.signal(self._kind, self._usual)

    def expire(self) -> None:
        """Interrupt the main thread by SIGINT."""
        self.reached = True
        signal.raise_signal(signal.SIGINT)

    def notice(self, number: int) -> None:
        """Note the signal of the timer, or Ctrl-C."""
        self.reached = self.reached or number != signal.SIGINT

    def interrupt(self, number: int, _frame: FrameType | None) -> None:
        """Handle one of these signals."""
        if self._over:
            return
        self.notice(number)
        if self._raised and _handled():
            return
        self._raised = True
        raise TimeLimitReached if self.reached else KeyboardInterrupt


class Insistence:
    """Handler of the signals that end a command: the exception is raised until it arrives.

    Native code and a bare `except` in an imported module can lose it: while nothing handles it and
    no solver has ended by the signal, it is raised again every 2 s.

    Attributes:
        received: The first signal.
    """

    def __init__(self) -> None:
        self.received: list[int] = []
        self._over, self._again = Event(), False
        self._usual_hook = sys.unraisablehook

    def interrupt(self, number: int, _frame: FrameType | None) -> None:
        """Handle a signal."""
        again, self._again = self._again, False
        if again and (self._over.is_set() or _handled()):
            return
        if not again and number != signal.SIGINT:
            signal.signal(number, signal.SIG_DFL)  # a second one ends it at once
        if not self.received:
            self.received.append(number)
            sys.unraisablehook = self._lost
            Thread(target=self._insist, daemon=True).start()
        raise KeyboardInterrupt

    def notice(self, number: int | None = None) -> None:
        """Raise nothing again: what runs ends by itself."""
        self.received += [] if number is None or self.received else [number]
        self.leave()

    def leave(self) -> None:
        """Raise nothing again."""
        self._over.set()
        sys.unraisablehook = self._usual_hook

    def _lost(self, lost: "sys.UnraisableHookArgs") -> None:
        if not issubclass(lost.exc_type, KeyboardInterrupt):
            self._usual_hook(lost)

    def _insist(self) -> None:
        while not self._over.wait(_AGAIN):
            self._again = True
            if hasattr(signal, "pthread_kill"):  # ends its waiting, too
                signal.pthread_kill(main_thread().ident or 0, signal.SIGINT)
            else:
                signal.raise_signal(signal.SIGINT)


def _handled() -> bool:
    """Return whether an interrupt is being handled, by what cleans up after it."""
    error = sys.exception()
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None


def interrupt_noticed() -> None:
    """Say that what runs ends by itself after a signal, which native code has received."""
    owner = _owner_of(signal.SIGINT)
    if isinstance(owner, Insistence):
        owner.notice()


@contextmanager
def ended_by_signals(*, command: bool = False) -> Iterator[None]:
    """Leave this context, as after Ctrl-C, before SIGTERM or SIGHUP ends the process.

    Args:
        command: Whether Ctrl-C is for nothing but what runs here; it is then insisted on.
    """
    kinds = [getattr(signal, n) for n in ("SIGTERM", "SIGHUP") if hasattr(signal, n)]
    usual: dict[int, Any] = dict.fromkeys(kinds, signal.SIG_DFL)
    if command:
        usual[signal.SIGINT] = signal.default_int_handler
    in_main = current_thread() is main_thread()
    before = {k: v for k, v in usual.items() if in_main and signal.getsignal(k) is v}
    end = Insistence()
    for kind in before:
        signal.signal(kind, end.interrupt)
    try:
        yield
    finally:
        end.leave()
        for kind, handler in before.items():
            signal.signal(kind, handler)
        for number in end.received[:1]:
            if number != signal.SIGINT:
                os.kill(os.getpid(), number)
