"""What a child process does for its own sake: end with its parent, keep to limits, answer."""

import ctypes
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from queue import SimpleQueue
from typing import IO

from cosim.host.child import LENGTH, PATH, receive
from cosim.host.limits import Limits
from cosim.host.processes import die_with_parent


def be_confined() -> None:
    """Be a confined child: keep to the limits of `Limits.chosen`, end with the parent."""
    die_with_parent()
    threading.Thread(target=_end_with_input, daemon=True).start()
    Limits.chosen().apply()
    if hasattr(signal, "SIGXFSZ"):  # which Python ignores, and an FMU may never notice
        signal.signal(signal.SIGXFSZ, signal.SIG_DFL)


def leave() -> None:
    """End at once, whatever threads and handlers foreign code has left."""
    with suppress(OSError, TypeError, AttributeError):  # Windows has no C library of this name
        ctypes.CDLL(None).fflush(None)
    os._exit(0)


def look_where_the_parent_does() -> None:
    """Find modules where the parent does, too, after all other places.

    A function that came by its name is found, and a file of the current folder shadows nothing.
    """
    places = os.environ.pop(PATH, "").split(os.pathsep)
    sys.path.extend(place for place in places if place and place not in sys.path)


class Conversation:
    """Questions on standard input, answers on what was standard output.

    What is printed goes to standard error. The process ends when nobody can ask any more, even
    while it computes.
    """

    def __init__(self) -> None:
        die_with_parent()
        own = os.dup(1)
        os.dup2(2, 1)  # what solvers and FMUs print is no answer
        if sys.platform == "win32":
            import msvcrt

            msvcrt.setmode(own, os.O_BINARY)
            msvcrt.setmode(0, os.O_BINARY)
        self._answers: IO[bytes] = os.fdopen(own, "wb")
        self._asked: SimpleQueue[bytes] = SimpleQueue()
        threading.Thread(target=self._listen, daemon=True).start()

    def questions(self) -> Iterator[bytes]:
        """Yield what is asked."""
        while True:
            yield self._asked.get()

    def answer(self, content: bytes) -> None:
        """Answer the last question."""
        with suppress(BrokenPipeError):  # nobody listens any more
            self._answers.write(LENGTH.pack(len(content)) + content)
            self._answers.flush()

    def _listen(self) -> None:
        with suppress(OSError, EOFError):
            while True:
                self._asked.put(receive(sys.stdin.buffer))
        _end()


def _end_with_input() -> None:
    with suppress(OSError):
        while os.read(0, 1):  # nothing is ever sent
            pass
    _end()


def _end() -> None:
    """End this process and all that it has started."""
    if hasattr(os, "killpg") and os.getpgrp() == os.getpid():  # its group is its own
        os.killpg(0, signal.SIGKILL)
    os._exit(1)
