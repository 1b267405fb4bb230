"""Imports of extension modules, which a signal must not interrupt.

If a signal handler raises an exception while an extension module initializes itself, some of them
(those of pybind11 and nanobind) end the process by SIGABRT. So signals wait until it is loaded.
"""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from importlib.machinery import ExtensionFileLoader
from threading import current_thread, main_thread
from typing import Any

_KINDS = [
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGALRM")
    if hasattr(signal, name)
]


@contextmanager
def deferred_signals() -> Iterator[None]:
    """Call the signal handlers of Python at the end of this context, for signals that arrive in it.

    Signals without a handler of Python, and other threads, are not affected.
    """
    handlers = {kind: signal.getsignal(kind) for kind in _KINDS}
    handlers = {kind: handler for kind, handler in handlers.items() if callable(handler)}
    if current_thread() is not main_thread():
        handlers = {}
    arrived: list[int] = []
    try:
        for kind in handlers:
            signal.signal(kind, lambda number, _frame: arrived.append(number))
        yield
    finally:
        for kind, handler in handlers.items():
            signal.signal(kind, handler)
        for kind in dict.fromkeys(arrived):
            signal.raise_signal(kind)


def load_extensions_whole() -> None:
    """Defer signals while this process loads an extension module, from now on."""
    for name in ("create_module", "exec_module"):
        setattr(ExtensionFileLoader, name, _deferring(getattr(ExtensionFileLoader, name)))


def _deferring(load: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(load)
    def loaded(*arguments: Any) -> Any:
        with deferred_signals():
            return load(*arguments)

    return loaded
