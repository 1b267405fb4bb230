"""What long work is doing, on one line of a terminal, for whoever waits there.

`doing` costs nothing where nobody looks: in pipes, in libraries, in other threads.
"""

import os
import shutil
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from dataclasses import dataclass
from time import monotonic
from typing import Any, TextIO

PATIENCE = 0.7  # s, before anything is said
INTERVAL = 0.2  # s
_LEAST = 0.02  # of the work, before it tells how long the rest takes

Fraction = Callable[[], float]
What = str | Callable[[], str]


@dataclass(frozen=True)
class Work:
    """Something that is being done: in a few words, how much of it is done, and since when [s]."""

    what: What
    fraction: Fraction | None
    began: float

    def told(self, now: float) -> str:
        """Return the words for it."""
        what = self.what if isinstance(self.what, str) else self.what()
        done = 0.0 if self.fraction is None else min(max(self.fraction(), 0.0), 1.0)
        if not done:
            return what
        passed = now - self.began
        left = f", {duration(passed * (1 - done) / done)} left" if done > _LEAST else ""
        return f"{what} {100 * done:.0f} %{left}"


def duration(seconds: float) -> str:
    """Write a time as people say it."""
    whole = round(seconds)
    return f"{whole} s" if whole < 100 else f"{round(seconds / 60)} min"


class Display:
    """A line at the end of a terminal's text. What others print goes above it."""

    def __init__(self, terminal: TextIO) -> None:
        self._terminal = terminal
        self._works: list[Work] = []
        self._length = 0  # of what stands there
        self._began = monotonic()
        self._lock = threading.RLock()
        self._over = threading.Event()
        threading.Thread(target=self._refresh, daemon=True).start()

    def add(self, work: Work) -> None:
        """Begin something within what is being done."""
        with self._lock:
            if not self._works:
                self._began = work.began
            self._works.append(work)

    def remove(self) -> None:
        """End what was begun last."""
        with self._lock:
            self._works.pop()

    def line(self, now: float) -> str:
        """Return what is being done, since when, how much is done, and what is left."""
        parts = ": ".join(work.told(now) for work in self._works)
        return f"{parts}, {duration(now - self._began)}" if parts else ""

    def write(self, text: str) -> int:
        """Print above the line."""
        with self._lock:
            self._show("")
            return self._terminal.write(text)

    def close(self) -> None:
        """Leave the terminal as it was."""
        self._over.set()
        with self._lock:
            self._show("")

    def __getattr__(self, name: str) -> Any:
        return getattr(self._terminal, name)

    def _refresh(self) -> None:
        while not self._over.wait(INTERVAL):
            now = monotonic()
            with self._lock:
                if not self._over.is_set():
                    late = self._works and now - self._began > PATIENCE
                    self._show(self.line(now) if late else "")

    def _show(self, line: str) -> None:
        line = line[: shutil.get_terminal_size().columns - 1]
        if line or self._length:
            self._terminal.write(f"\r{line.ljust(self._length)}\r{line}")
            self._terminal.flush()
        self._length = len(line)


_DISPLAY: ContextVar[Display | None] = ContextVar("display", default=None)
_UNSEEN = nullcontext()


def looked_at() -> bool:
    """Tell whether somebody looks."""
    return _DISPLAY.get() is not None


def doing(what: What, fraction: Fraction | None = None) -> AbstractContextManager[None]:
    """Say what is being done in here.

    Args:
        what: In a few words, e.g. "compiling (once)", or what returns them.
        fraction: Returns how much of it is done, 0 to 1. Both are called from another thread.
    """
    display = _DISPLAY.get()
    return _UNSEEN if display is None else _shown(display, what, fraction)


@contextmanager
def _shown(display: Display, what: What, fraction: Fraction | None) -> Iterator[None]:
    display.add(Work(what, fraction, monotonic()))
    try:
        yield
    finally:
        display.remove()


@contextmanager
def shown_on_terminal(quiet: bool) -> Iterator[None]:
    """Show on standard error what is being done in here, if that is a terminal."""
    terminal = sys.stderr
    if quiet or terminal is None or not terminal.isatty() or os.environ.get("TERM") == "dumb":
        yield
        return
    display = Display(terminal)
    token = _DISPLAY.set(display)
    sys.stderr = display  # which has what print() needs
    try:
        yield
    finally:
        sys.stderr = terminal
        _DISPLAY.reset(token)
        display.close()
