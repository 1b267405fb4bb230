"""Signals that end one long call of a compiled library; see fmu/solvers/interrupt.h."""

import ctypes
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread


@contextmanager
def interruptible(library: ctypes.CDLL | None) -> Iterator[list[int]]:
    """Let Ctrl-C end what happens in between, though it is one C function.

    A limit of processor time that somebody handles ends it, too (not on Windows).

    Yields:
        A list that then holds the signal. A handler of the user's own is called, too.
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
        if signal.getsignal(number) is not signal.default_int_handler:
            signal.raise_signal(number)
