"""Signals that end one long call of a compiled library; see fmu/solvers/interrupt.h."""

import ctypes
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread

# Ctrl-C; a limit of processor time (not on Windows)
_SIGNALS = (signal.SIGINT, *([signal.SIGPROF] if hasattr(signal, "SIGPROF") else []))


@contextmanager
def interruptible(library: ctypes.CDLL | None) -> Iterator[list[int]]:
    """Let Ctrl-C end what happens in between, though it is one C function.

    A limit of processor time that somebody handles ends it, too.

    Yields:
        A list that then holds the signal. A handler of the user's own is called, too.
    """
    interrupts: list[int] = []
    handlers = {number: signal.getsignal(number) for number in _SIGNALS}
    watched = {number: handler for number, handler in handlers.items() if callable(handler)}
    if library is None or current_thread() is not main_thread():
        yield interrupts
        return
    for number in watched:
        library.cosim_watch(number)
    try:
        yield interrupts
    finally:
        for number, handler in watched.items():
            signal.signal(number, handler)
    if number := library.cosim_halted():
        interrupts.append(number)
        handler = watched[signal.Signals(number)]
        if handler is not signal.default_int_handler:
            handler(number, None)
