"""Progress of long work on a terminal: a tqdm bar for each piece of work that takes a while.

`doing` costs nothing where nothing is displayed: in a pipe, in a library, in another thread.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from shutil import get_terminal_size
from time import time
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from tqdm import tqdm

DELAY = 0.7  # s, before a piece of work gets its bar
INTERVAL = 0.2  # s, between two updates
_SHARE = "{desc}: {percentage:.0f} %|{bar}| {elapsed}, {remaining} left"
_UNKNOWN_SHARE = "{desc}, {elapsed}"

Fraction = Callable[[], float]
What = str | Callable[[], str]


class _Work:
    """A piece of work, and its bar as soon as it takes longer than `DELAY`."""

    def __init__(self, what: What, fraction: Fraction | None) -> None:
        self._what, self._fraction = what, fraction
        self._began = time()
        self._bar: tqdm[Any] | None = None
        self._visible = False

    def refresh(self, terminal: TextIO) -> None:
        """Show what is being done and how much of it is done."""
        if time() - self._began < DELAY:
            return
        what = self._what if isinstance(self._what, str) else self._what()
        if self._bar is None:
            self._bar = _new_bar(terminal, what, known_share=self._fraction is not None)
            self._bar.start_t = self._began
        if self._fraction is not None:
            self._bar.n = min(max(self._fraction(), 0.0), 1.0)
        self._bar.ncols = get_terminal_size().columns
        self._bar.set_description_str(what)
        self._visible = True

    def clear(self) -> None:
        """Remove the bar until the next refresh."""
        if self._bar is not None and self._visible:
            self._bar.clear()
            self._visible = False

    def close(self) -> None:
        """Remove the bar."""
        if self._bar is not None:
            self._bar.close()


def _new_bar(terminal: TextIO, what: str, *, known_share: bool) -> tqdm[Any]:
    from tqdm import tqdm  # commands that end soon do without it

    tqdm.monitor_interval = 0  # `_Display` refreshes
    tqdm.set_lock(threading.RLock())  # its own one is shared between processes
    return tqdm(
        desc=what,
        total=1.0 if known_share else None,
        file=terminal,
        leave=False,
        ncols=get_terminal_size().columns,
        smoothing=0,
        bar_format=_SHARE if known_share else _UNKNOWN_SHARE,
    )


class _Display:
    """Bars at the end of a terminal's text; as standard error it prints above them."""

    def __init__(self, terminal: TextIO) -> None:
        self._terminal = terminal
        self._works: list[_Work] = []
        self._within_line = False  # of other text
        self._lock = threading.RLock()
        self._over = threading.Event()
        threading.Thread(target=self._refresh, daemon=True).start()

    @contextmanager
    def showing(self, work: _Work) -> Iterator[None]:
        """Show a piece of work, which may be part of the one shown last."""
        with self._lock:
            self._works.append(work)
        try:
            yield
        finally:
            with self._lock:
                self._works.remove(work)
                work.close()

    def write(self, text: str) -> int:
        """Print above the bars."""
        with self._lock:
            for work in self._works:
                work.clear()
            self._within_line = not text.endswith("\n")
            return self._terminal.write(text)

    def close(self) -> None:
        """Stop refreshing."""
        self._over.set()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._terminal, name)

    def _refresh(self) -> None:
        while not self._over.wait(INTERVAL):
            with self._lock:
                for work in () if self._within_line else self._works:
                    work.refresh(self._terminal)


_DISPLAY: ContextVar[_Display | None] = ContextVar("display", default=None)
_HIDDEN = nullcontext()


def looked_at() -> bool:
    """Tell whether progress is displayed."""
    return _DISPLAY.get() is not None


def doing(what: What, fraction: Fraction | None = None) -> AbstractContextManager[None]:
    """Show what is being done inside this context.

    Args:
        what: A few words, e.g. "compiling (once)", or a function that returns them.
        fraction: Returns how much of it is done, 0 to 1. Both are called from another thread.
    """
    display = _DISPLAY.get()
    return _HIDDEN if display is None else display.showing(_Work(what, fraction))


@contextmanager
def shown_on_terminal(quiet: bool) -> Iterator[None]:
    """Show on standard error what is being done inside this context, if that is a terminal."""
    terminal = sys.stderr
    if quiet or terminal is None or not terminal.isatty() or os.environ.get("TERM") == "dumb":
        yield
        return
    display = _Display(terminal)
    token = _DISPLAY.set(display)
    sys.stderr = display  # which has what print() needs
    try:
        yield
    finally:
        sys.stderr = terminal
        _DISPLAY.reset(token)
        display.close()
