"""Ctrl-C within one long call of a compiled library; see fmu/solvers/interrupt.h."""

import ctypes
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread


@contextmanager
def interruptible(library: ctypes.CDLL | None) -> Iterator[list[int]]:
    """Let Ctrl-C end what happens in between, though it is one C function.

    Yields:
        A list that then holds the signal. A handler of the user's own is called, too.
    """
    interrupts: list[int] = []
    handler = signal.getsignal(signal.SIGINT)
    if library is None or current_thread() is not main_thread() or not callable(handler):
        yield interrupts
        return
    library.cosim_watch()
    try:
        yield interrupts
    finally:
        signal.signal(signal.SIGINT, handler)
    if library.cosim_halted():
        interrupts.append(signal.SIGINT)
        if handler is not signal.default_int_handler:
            handler(signal.SIGINT, None)
