"""Progress of long work on a terminal: a tqdm bar for each piece of work that takes a while.

`doing` costs nothing where nothing is displayed: in a pipe, in a library, in another thread.
"""

import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from shutil import get_terminal_size
from time import time
from typing import TextIO

DELAY = 0.7  # s, before a piece of work gets its bar
INTERVAL = 0.2  # s, between two updates
_SHARE = "{desc}: {percentage:.0f} %|{bar}| {elapsed}, {remaining} left"
_UNKNOWN_SHARE = "{desc}, {elapsed}"

Fraction = Callable[[], float]
What = str | Callable[[], str]

_TERMINAL: ContextVar[TextIO | None] = ContextVar("terminal", default=None)


@contextmanager
def doing(what: What, fraction: Fraction | None = None) -> Iterator[None]:
    """Show what is being done inside this context, which may be a part of what is shown already.

    Args:
        what: A few words, e.g. "compiling (once)", or a function that returns them.
        fraction: Returns how much of it is done, 0 to 1. Both are called from another thread.
    """
    terminal = _TERMINAL.get()
    if terminal is None:
        yield
        return
    over = threading.Event()
    thread = threading.Thread(target=_show, args=(terminal, what, fraction, over), daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def _show(terminal: TextIO, what: What, fraction: Fraction | None, over: threading.Event) -> None:
    """Show a bar, unless the work is over soon, and refresh it until then."""
    began = time()
    if over.wait(DELAY):
        return
    from tqdm import tqdm  # commands that end soon do without it
    from tqdm.contrib import DummyTqdmFile

    if sys.stderr is terminal:
        tqdm.monitor_interval = 0  # `_show` refreshes
        tqdm.set_lock(threading.RLock())  # its own one is shared between processes
        sys.stderr = DummyTqdmFile(terminal)  # prints above the bars
    width, height = get_terminal_size()
    with tqdm(
        desc=what if isinstance(what, str) else what(),
        total=None if fraction is None else 1.0,
        file=terminal,
        leave=False,
        ncols=width,
        nrows=height,
        smoothing=0,
        bar_format=_UNKNOWN_SHARE if fraction is None else _SHARE,
    ) as bar:
        bar.start_t = began
        while not over.wait(INTERVAL):
            bar.ncols = get_terminal_size().columns
            if fraction is not None:
                bar.n = min(max(fraction(), 0.0), 1.0)
            bar.set_description_str(what if isinstance(what, str) else what())


@contextmanager
def shown_on_terminal(quiet: bool) -> Iterator[None]:
    """Show on standard error what is being done inside this context, if that is a terminal."""
    terminal = sys.stderr
    if quiet or terminal is None or not terminal.isatty() or os.environ.get("TERM") == "dumb":
        yield
        return
    token = _TERMINAL.set(terminal)
    try:
        yield
    finally:
        sys.stderr = terminal
        _TERMINAL.reset(token)
