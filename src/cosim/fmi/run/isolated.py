"""An FMU in a process of its own: where its binary crashes, hangs or exits, ours goes on.

The child has the rights of its user: this guards against mistakes, not against malice.
"""

import ctypes
import json
import os
import secrets
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import IO, Any

import numpy as np

from cosim import errors
from cosim.errors import CosimError, FmuError, UsageError
from cosim.fmi.run.limits import LIMITS_VARIABLE, Limits
from cosim.host.processes import MARK, end_all
from cosim.host.progress import doing
from cosim.host.temporary import temporary_folder
from cosim.model.inputs import InputSeries
from cosim.model.values import number
from cosim.text.escaping import sentence, visible
from cosim.trajectory import Trajectory

_REQUEST, _ANSWER, _VALUES = "request.json", "answer.json", "values.npz"
_SUNDIALS = "[ERROR][rank"  # how fmpy's solver begins what its error says, too
MOST_OUTPUT = 10_000  # bytes of what an FMU prints
ENVIRONMENT = (
    *("PATH", "HOME", "LANG", "LC_ALL", "PYTHONPATH", "LD_LIBRARY_PATH"),
    *("DYLD_LIBRARY_PATH", "SYSTEMROOT", "USERPROFILE", LIMITS_VARIABLE),
)


def simulate_apart(
    path: str | os.PathLike[str], *, timeout: float | None = None, **options: Any
) -> Trajectory:
    """Simulate an FMU like `simulate_fmu`, in a child process with the limits of `Limits.chosen`.

    It works in an empty folder of its own, without our environment and open files, and is gone
    afterwards with all it started. What it prints goes to stderr, the first 10 kB of it.

    Args:
        path: The FMU.
        timeout: Wall time, s, after which the child is ended; None for no limit.
        options: Of `simulate_fmu`; of inputs, formulas and series.

    Raises:
        FmuError: The FMU crashed, ended the process, or took too long.
        CosimError: See `simulate_fmu`.
    """
    if timeout is not None:
        number(str(path), "timeout", timeout, positive=True)
    Limits.chosen()  # refuses before anything has been started
    inputs = options.pop("inputs", None) or {}
    if isinstance(inputs, InputSeries):
        inputs = dict.fromkeys(inputs.names, inputs)
    with ended_by_signals(), own_folder() as folder:
        place = str(Path(path).absolute())
        told = {"path": place, "options": options, "inputs": _written(inputs)}
        (folder / _REQUEST).write_text(json.dumps(told))
        with doing(f"running {Path(path).name}"):
            code, printed = _child(folder, timeout)
        if printed and sys.stderr is not None:
            sys.stderr.write(printed)
        if code is None:
            raise FmuError(f"{path}: the FMU did not end within {timeout:g} s and was stopped")
        try:
            return _read_answer(folder, place, str(path))
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            raise FmuError(
                f"{path}: the FMU {how_it_ended(code)} while it ran; do not use it"
            ) from error


def _written(inputs: Mapping[str, Any]) -> dict[str, Any]:
    """Return inputs as JSON has them: a series as its column's times and values."""
    columns = {name: (value, value.names.index(name)) for name, value in inputs.items()
               if isinstance(value, InputSeries)}  # fmt: skip
    lists = {n: [s.time.tolist(), s.values[:, i].tolist()] for n, (s, i) in columns.items()}
    return {**inputs, **lists}


def _read_back(inputs: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: InputSeries((name,), np.array(value[0]), np.array(value[1])[:, None])
        if isinstance(value, list)
        else value
        for name, value in inputs.items()
    }


@contextmanager
def own_folder() -> Iterator[Path]:
    """Yield a folder of the child's own with `work` and `temporary` in it; gone afterwards."""
    try:
        made = temporary_folder()
        folder = made.__enter__()
        for name in ("work", "temporary"):
            (folder / name).mkdir()
    except OSError as error:
        raise FmuError(f"there is no folder for temporary files: {error}; set TMPDIR") from error
    try:
        yield folder
    finally:
        made.__exit__(None, None, None)


def _child(folder: Path, timeout: float | None) -> tuple[int | None, str]:
    """Run a request; return the exit code, None after a timeout, and what was printed."""
    kept = bytearray()

    def drain(pipe: IO[bytes]) -> None:
        while chunk := os.read(pipe.fileno(), 65536):
            kept.extend(chunk[: MOST_OUTPUT - len(kept)])

    mark = secrets.token_hex(16)
    own = {name: str(folder / "temporary") for name in ("TMPDIR", "TEMP", "TMP")}
    own |= {MARK: mark, "OPENBLAS_NUM_THREADS": "1"}  # whose threads reserve memory
    with subprocess.Popen(
        [sys.executable, "-P", "-m", __name__, str(folder)],
        stdin=subprocess.PIPE,  # its end tells the child that we are gone
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        cwd=folder / "work",
        env={name: os.environ[name] for name in ENVIRONMENT if name in os.environ} | own,
        start_new_session=True,
    ) as process:
        assert process.stdout is not None
        reader = threading.Thread(target=drain, args=[process.stdout], daemon=True)
        reader.start()
        try:
            code: int | None = process.wait(timeout)
        except subprocess.TimeoutExpired:
            code = None
        finally:
            end_all(process.pid, mark)
            reader.join(1.0)
    printed = kept.decode(errors="replace").splitlines(keepends=True)
    others = (line for line in printed if not line.startswith(_SUNDIALS))
    return code, visible("".join(others), lines=True)


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """Remove folder and child before a signal ends this process, which it then does."""
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


def _read_answer(folder: Path, place: str, name: str) -> Trajectory:
    answer = json.loads((folder / _ANSWER).read_text())
    if "error" in answer:
        kind = getattr(errors, answer["error"])
        raise kind(answer["message"].replace(place, name))
    try:
        return Trajectory.from_npz(folder / _VALUES)
    except UsageError as error:
        raise ValueError(str(error)) from error


def how_it_ended(code: int) -> str:
    """Say what an exit code means: a signal by its name."""
    if code >= 0:
        return f"ended the process with exit code {code}"
    with suppress(ValueError):
        kind = signal.Signals(-code)
        limits = {"SIGXCPU": "time on the processor", "SIGXFSZ": "size of a file"}
        if kind.name in limits:
            return f"exceeded the limit of the {limits[kind.name]} ({LIMITS_VARIABLE})"
        return f"crashed ({kind.name})"
    return f"crashed (signal {-code})"


def _main(folder: Path) -> None:
    """Be the child: answer the request in a folder."""
    threading.Thread(target=end_with_parent, daemon=True).start()
    Limits.chosen().apply()
    if hasattr(signal, "SIGXFSZ"):  # which Python ignores, and an FMU may never notice
        signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
    request = json.loads((folder / _REQUEST).read_text())
    path = request["path"]
    try:
        from cosim.fmi.run.simulate import simulate_fmu

        run = simulate_fmu(path, inputs=_read_back(request["inputs"]), **request["options"])
    except CosimError as error:
        answer = {"error": type(error).__name__, "message": str(error)}
    except MemoryError:
        told = f"{path}: the FMU exceeded the limit of memory ({LIMITS_VARIABLE})"
        answer = {"error": "FmuError", "message": told}
    except BaseException as error:
        told = f"{path}: it cannot be run: {type(error).__name__}: {sentence(str(error))}"
        answer = {"error": "FmuError", "message": told}
    else:
        run.to_npz(folder / _VALUES)
        answer = {}
    (folder / _ANSWER).write_text(json.dumps(answer))
    with suppress(OSError, TypeError, AttributeError):  # Windows has no C library of this name
        ctypes.CDLL(None).fflush(None)
    os._exit(0)  # whatever threads and handlers the FMU has left


def end_with_parent() -> None:
    """End this process when standard input does, which its parent holds open."""
    with suppress(OSError):
        while os.read(0, 1):  # nothing is ever sent
            pass
    if hasattr(os, "killpg"):
        os.killpg(0, signal.SIGKILL)  # this process and all it started
    os._exit(1)


if __name__ == "__main__":
    _main(Path(sys.argv[1]))
