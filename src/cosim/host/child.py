"""Child processes: started, asked questions, confined, and ended with all that they started.

From inside, a child ends with its parent, limits itself and answers questions.
"""

import ctypes
import os
import secrets
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Self

from cosim.host.limits import LIMITS_VARIABLE, apply_limits, chosen_limits, waiting_time
from cosim.host.signals import ended_by_signals
from cosim.host.temporary import fmu_folder, remove_leftovers
from cosim.text import visible

MARK = "COSIM_RUN"  # of the environment: `/OURS/ITS/...`; children inherit it
_DIE_WITH_PARENT, _ADOPT_ORPHANS = 1, 36  # PR_SET_PDEATHSIG and PR_SET_CHILD_SUBREAPER of Linux


@contextmanager
def ending_orphans() -> Iterator[None]:
    """End every child of this process afterwards, and on Linux their orphans.

    Only for a process that has no other children.
    """
    _control(_ADOPT_ORPHANS, 1)
    try:
        yield
    finally:
        while children := _children():
            for child in children:
                with suppress(OSError):
                    os.kill(child, signal.SIGKILL)
                with suppress(OSError):
                    os.waitpid(child, 0)


def die_with_parent() -> None:
    """Have Linux end this process when the thread that started it is gone."""
    if hasattr(signal, "SIGKILL"):
        _control(_DIE_WITH_PARENT, signal.SIGKILL)


def _children() -> list[int]:
    found = list[int]()
    for file in Path("/proc/self/task").glob("*/children"):
        with suppress(OSError):  # a thread may have ended
            found += map(int, file.read_text().split())
    return found


def _control(option: int, value: int) -> None:
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(option, value)


MOST_OUTPUT = 10_000  # bytes of what a confined child prints
PATH = "COSIM_PATH"  # where a child that is not confined looks for modules at last
ENVIRONMENT = (
    *("PATH", "CC", "HOME", "LANG", "LC_ALL", "PYTHONPATH", "LD_LIBRARY_PATH"),
    *("DYLD_LIBRARY_PATH", "SYSTEMROOT", "USERPROFILE", "XDG_CACHE_HOME", "LOCALAPPDATA"),
    LIMITS_VARIABLE,
)


class Child:
    """A child process; as a context manager, it ends the process.

    Args:
        module: Run as `python -P -m MODULE`: no file of the current folder shadows a module.
        words: Its command line.
        asked: Whether it answers questions, see `ask`; what it prints to stderr is discarded.
        folder: For a confined child: it works in `work` there, writes temporary files to
            `temporary`, gets few variables of the environment, and its output is captured. The
            end of its standard input tells it that its parent has ended.
        environment: Additional variables.

    Raises:
        OSError: It cannot be started.
    """

    def __init__(
        self,
        module: str,
        words: Sequence[str] = (),
        *,
        asked: bool = False,
        folder: Path | None = None,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self._mark = f"{os.environ.get(MARK, '')}/{secrets.token_hex(16)}"
        pipe = subprocess.PIPE if asked or folder is not None else None
        silent = subprocess.DEVNULL if asked else None
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", module, *words],
            stdin=pipe,
            stdout=pipe,
            stderr=silent if folder is None else subprocess.STDOUT,
            cwd=None if folder is None else folder / "work",
            env={**_variables(folder), **(environment or {}), MARK: self._mark},
            start_new_session=True,  # Ctrl-C is for the parent
        )
        self._captured = bytearray()
        self._reader: threading.Thread | None = None
        if folder is not None:
            self._reader = threading.Thread(target=self._drain, daemon=True)
            self._reader.start()

    def wait(self, timeout: float | None = None) -> int | None:
        """Return the exit code, negative for a signal; None after the timeout, s."""
        try:
            return self._process.wait(waiting_time(timeout))
        except subprocess.TimeoutExpired:
            return None

    def ask(self, question: str) -> str:
        """Return the answer to a question, one line each; see `answer_questions`.

        Raises:
            OSError, EOFError: The child is gone.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"{question}\n".encode())
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        if not answer.endswith(b"\n"):
            raise EOFError
        return answer.decode()

    def kill(self) -> None:
        """End it with its group, and on Linux all processes that carry its mark."""
        with suppress(OSError):
            if hasattr(os, "killpg"):
                os.killpg(self._process.pid, signal.SIGKILL)
            else:
                os.kill(self._process.pid, signal.SIGTERM)  # Windows knows no other
        known = f"{MARK}={self._mark}".encode()
        for _ in range(10):  # they may start others meanwhile
            found = False
            for entry in Path("/proc").glob("[0-9]*/environ"):
                with suppress(OSError):
                    if any(line.startswith(known) for line in entry.read_bytes().split(b"\0")):
                        os.kill(int(entry.parent.name), signal.SIGKILL)
                        found = True
            if not found:
                return

    def end(self) -> int:
        """End it and all that it has started, and remove what it left; return its exit code."""
        self.kill()
        code = self._process.wait()
        remove_leftovers(Path(tempfile.gettempdir()))
        if self._reader is not None:
            self._reader.join(1.0)
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        return code

    @property
    def printed(self) -> str:
        """The beginning of what a confined child has printed, harmless for a terminal."""
        return visible(self._captured.decode(errors="replace"), lines=True)

    def _drain(self) -> None:
        assert self._process.stdout is not None
        with suppress(OSError, ValueError):  # closed by `end`, while a grandchild holds it open
            while chunk := os.read(self._process.stdout.fileno(), 65536):
                self._captured.extend(chunk[: MOST_OUTPUT - len(self._captured)])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()


def run_confined(
    module: str, words: Sequence[str], folder: Path, timeout: float | None
) -> tuple[int | None, str]:
    """Run a confined child; return its exit code, None after a timeout, and what it printed."""
    with Child(module, words, folder=folder) as child:
        code = child.wait(timeout)
    return code, child.printed


@contextmanager
def own_folder() -> Iterator[Path]:
    """Yield a folder for a confined child; it is removed afterwards, also after a signal.

    Raises:
        FmuError: It cannot be made.
    """
    with ended_by_signals(), fmu_folder() as folder:
        for name in ("work", "temporary"):
            (folder / name).mkdir()
        yield folder


def _variables(folder: Path | None) -> dict[str, str]:
    """Return the environment of a child: few variables for a confined one."""
    if folder is None:
        return os.environ | {PATH: os.pathsep.join(p or str(Path.cwd()) for p in sys.path)}
    own = {name: str(folder / "temporary") for name in ("TMPDIR", "TEMP", "TMP")}
    own["OPENBLAS_NUM_THREADS"] = "1"  # whose threads reserve memory
    if cache := os.environ.get("COSIM_CACHE"):
        own["COSIM_CACHE"] = str(Path(cache).absolute())
    return {name: os.environ[name] for name in ENVIRONMENT if name in os.environ} | own


# -- inside a child --------------------------------------------------------------------------------


def be_confined() -> None:
    """Apply the limits of `chosen_limits` to this process, and end it with its parent."""
    die_with_parent()
    threading.Thread(target=_end_with_input, daemon=True).start()
    apply_limits(chosen_limits())
    if hasattr(signal, "SIGXFSZ"):  # Python ignores it, and an FMU may not notice
        signal.signal(signal.SIGXFSZ, signal.SIG_DFL)


def leave() -> None:
    """End this process at once, even if foreign code has left threads or handlers."""
    with suppress(OSError, TypeError, AttributeError):  # Windows has no C library of this name
        ctypes.CDLL(None).fflush(None)
    os._exit(0)


def look_where_the_parent_does() -> None:
    """Add the module path of the parent behind the own one.

    A function that is passed by name is found, and no file of the current folder shadows a module.
    """
    places = os.environ.pop(PATH, "").split(os.pathsep)
    sys.path.extend(place for place in places if place and place not in sys.path)


def answer_questions(answer: Callable[[str], str]) -> None:
    """Answer each line on standard input by a line on standard output, until the parent ends.

    Other output goes to standard error. The process ends with its parent, on Linux even while it
    computes.
    """
    die_with_parent()
    with os.fdopen(os.dup(1), "w") as answers:
        os.dup2(2, 1)  # solvers and FMUs print, too
        for question in sys.stdin:
            print(answer(question), file=answers, flush=True)


def _end_with_input() -> None:
    """End this process, and every process that it has started, with its standard input."""
    with suppress(OSError):
        while os.read(0, 1):  # nothing is ever sent
            pass
    if hasattr(os, "killpg") and os.getpgrp() == os.getpid():  # its group is its own
        os.killpg(0, signal.SIGKILL)
    os._exit(1)
