"""A process of Python that ends when ours does, with all that it has started.

Whatever runs apart is a `Child`: an FMU and its trials (`confined`), a user's own program, the
workers of a sweep and of a campaign. What a child does for its own sake is in `inside`.
"""

import os
import secrets
import signal
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType, TracebackType
from typing import IO, Final, Self

from cosim.errors import FmuError
from cosim.host.limits import LIMITS_VARIABLE
from cosim.host.processes import MARK, end_all
from cosim.host.temporary import temporary_folder
from cosim.text.escaping import visible

MOST_OUTPUT = 10_000  # bytes of what a confined child prints
PATH = "COSIM_PATH"  # where a child that is not confined looks for modules at last
ENVIRONMENT = (
    *("PATH", "HOME", "LANG", "LC_ALL", "PYTHONPATH", "LD_LIBRARY_PATH"),
    *("DYLD_LIBRARY_PATH", "SYSTEMROOT", "USERPROFILE", LIMITS_VARIABLE),
)
LENGTH: Final = struct.Struct("<Q")  # before each question and answer

Streams = tuple[int | None, int | None, int | None]  # standard input, output and error
OURS: Streams = (None, None, None)
ASKED: Streams = (subprocess.PIPE, subprocess.PIPE, None)
ASKED_SILENTLY: Streams = (subprocess.PIPE, subprocess.PIPE, subprocess.DEVNULL)
_CAPTURED: Streams = (subprocess.PIPE, subprocess.PIPE, subprocess.STDOUT)


class Child:
    """A child process; as a context, it is gone afterwards.

    Args:
        module: Run as `python -P -m MODULE`: nothing of the current folder shadows what is ours.
        words: Its command line.
        streams: `OURS`, or `ASKED` for `ask`. Where its standard input is a pipe, the end of that
            tells the child that we are gone.
        folder: For a confined child: it works in `work` there, has `temporary` for temporary
            files, few variables of our environment, and what it prints is kept.
        environment: Variables that it gets besides.
        descriptors: Open files that it inherits; not on Windows.

    Raises:
        OSError: It cannot be started.
    """

    def __init__(
        self,
        module: str,
        words: Sequence[str] = (),
        *,
        streams: Streams = OURS,
        folder: Path | None = None,
        environment: Mapping[str, str] | None = None,
        descriptors: Sequence[int] = (),
    ) -> None:
        self._mark = f"{os.environ.get(MARK, '')}/{secrets.token_hex(16)}"
        given = _all_variables() if folder is None else _few_variables(folder)
        stdin, stdout, stderr = streams if folder is None else _CAPTURED
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", module, *words],
            stdin=stdin,
            stdout=stdout,
            stderr=stderr,
            cwd=None if folder is None else folder / "work",
            env={**given, **(environment or {}), MARK: self._mark},
            start_new_session=True,  # Ctrl-C is for the process that asked
            pass_fds=tuple(descriptors),
        )
        self._kept = bytearray()
        self._reader: threading.Thread | None = None
        if folder is not None:
            self._reader = threading.Thread(target=self._drain, daemon=True)
            self._reader.start()

    def wait(self, timeout: float | None = None) -> int | None:
        """Return the exit code, negative for a signal; None where it runs still after that, s."""
        try:
            return self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            return None

    def ask(self, question: bytes) -> bytes:
        """Return the answer to a question; see `inside.questions`.

        Raises:
            OSError, EOFError: The child is gone.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(LENGTH.pack(len(question)) + question)
        self._process.stdin.flush()
        return receive(self._process.stdout)

    def send(self, number: int) -> None:
        """Pass a signal on; on Windows a console does that itself."""
        if os.name != "nt":
            with suppress(OSError):
                os.kill(self._process.pid, number)

    def kill(self) -> None:
        """End it and all that it has started."""
        end_all(self._process.pid, self._mark)

    def end(self) -> int:
        """End it and all that it has started, close its pipes; return its exit code."""
        self.kill()
        code = self._process.wait()
        if self._reader is not None:
            self._reader.join(1.0)
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        return code

    @property
    def printed(self) -> str:
        """What a confined child has printed, the beginning of it, harmless for a terminal."""
        return visible(self._kept.decode(errors="replace"), lines=True)

    def _drain(self) -> None:
        assert self._process.stdout is not None
        with suppress(OSError, ValueError):  # closed by `end`, while a grandchild holds it open
            while chunk := os.read(self._process.stdout.fileno(), 65536):
                self._kept.extend(chunk[: MOST_OUTPUT - len(self._kept)])

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.end()


def run_confined(
    module: str, words: Sequence[str], folder: Path, timeout: float | None
) -> tuple[int | None, str]:
    """Run a confined child; return its exit code, None after a timeout, and what it printed."""
    with Child(module, words, folder=folder) as child:
        code = child.wait(timeout)
    return code, child.printed


def receive(stream: IO[bytes]) -> bytes:
    """Read a question or an answer.

    Raises:
        EOFError: The other side is gone.
    """
    head = stream.read(LENGTH.size)
    if len(head) < LENGTH.size:
        raise EOFError
    (length,) = LENGTH.unpack(head)
    content = stream.read(length)
    if len(content) < length:
        raise EOFError
    return content


@contextmanager
def own_folder() -> Iterator[Path]:
    """Yield a folder for a confined child; gone afterwards, also where a signal ends us.

    Raises:
        FmuError: There is no room for it.
    """
    with _ended_by_signals():
        try:
            made = temporary_folder()
            folder = made.__enter__()
            for name in ("work", "temporary"):
                (folder / name).mkdir()
        except OSError as error:
            told = f"there is no folder for temporary files: {error}; set TMPDIR"
            raise FmuError(told) from error
        try:
            yield folder
        finally:
            made.__exit__(None, None, None)


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """Have a signal that ends this process end what is within first."""
    kinds = [getattr(signal, n) for n in ("SIGTERM", "SIGHUP") if hasattr(signal, n)]
    usual = threading.current_thread() is threading.main_thread()
    kinds = [k for k in kinds if usual and signal.getsignal(k) is signal.SIG_DFL]

    def end(number: int, _frame: FrameType | None) -> None:
        raise _Ended(number)

    for kind in kinds:
        signal.signal(kind, end)
    try:
        yield
    except _Ended as ended:
        signal.signal(ended.number, signal.SIG_DFL)
        os.kill(os.getpid(), ended.number)
        raise
    finally:
        for kind in kinds:
            signal.signal(kind, signal.SIG_DFL)


class _Ended(BaseException):
    """A signal that ends the process."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def _all_variables() -> dict[str, str]:
    path = os.pathsep.join(entry or str(Path.cwd()) for entry in sys.path)
    return os.environ | {PATH: path}


def _few_variables(folder: Path) -> dict[str, str]:
    own = {name: str(folder / "temporary") for name in ("TMPDIR", "TEMP", "TMP")}
    own["OPENBLAS_NUM_THREADS"] = "1"  # whose threads reserve memory
    return {name: os.environ[name] for name in ENVIRONMENT if name in os.environ} | own
