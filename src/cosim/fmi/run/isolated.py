"""An FMU in a process of its own: where its binary crashes, hangs or exits, ours goes on.

The child has the rights of its user: this guards against mistakes, not against malice.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from cosim import errors
from cosim.errors import CosimError, FmuError, UsageError
from cosim.model.values import number
from cosim.trajectory import Trajectory

_REQUEST, _ANSWER, _VALUES = "request.json", "answer.json", "values.npz"
MOST_OUTPUT = 10_000  # bytes of what an FMU prints
_ENVIRONMENT = (
    *("PATH", "HOME", "LANG", "LC_ALL", "TMPDIR", "PYTHONPATH", "LD_LIBRARY_PATH"),
    *("DYLD_LIBRARY_PATH", "SYSTEMROOT", "TEMP", "TMP", "USERPROFILE"),
)


def simulate_apart(
    path: str | os.PathLike[str], *, timeout: float | None = None, **options: Any
) -> Trajectory:
    """Simulate an FMU like `simulate_fmu`, in a child process.

    What the FMU prints goes to stderr, the first 10 kB of it.

    Args:
        path: The FMU.
        timeout: Wall time, s, after which the child is ended; None for no limit.
        options: Of `simulate_fmu`, but time series of inputs.

    Raises:
        FmuError: The FMU crashed, ended the process, or took too long.
        CosimError: See `simulate_fmu`.
    """
    if timeout is not None:
        number(str(path), "timeout", timeout, positive=True)
    with tempfile.TemporaryDirectory(prefix="cosim-", ignore_cleanup_errors=True) as name:
        folder, place = Path(name), str(Path(path).absolute())
        (folder / _REQUEST).write_text(json.dumps({"path": place, "options": options}))
        code, printed = _child(folder, timeout)
        sys.stderr.write(printed)
        if code is None:
            raise FmuError(f"{path}: the FMU did not end within {timeout:g} s and was stopped")
        try:
            return _answer(folder, place, str(path))
        except (OSError, ValueError, KeyError) as error:
            raise FmuError(f"{path}: the FMU {_end(code)} while it ran; do not use it") from error


def _child(folder: Path, timeout: float | None) -> tuple[int | None, str]:
    """Run a request; return the exit code, None after a timeout, and what was printed."""
    kept = bytearray()

    def drain(pipe: IO[bytes]) -> None:
        while chunk := os.read(pipe.fileno(), 65536):
            kept.extend(chunk[: MOST_OUTPUT - len(kept)])

    with subprocess.Popen(
        [sys.executable, "-m", __name__, str(folder)],
        stdin=subprocess.PIPE,  # its end tells the child that we are gone
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        cwd=folder,
        env={name: os.environ[name] for name in _ENVIRONMENT if name in os.environ},
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
            _stop(process)
            reader.join(1.0)
    return code, kept.decode(errors="replace")


def _stop(process: subprocess.Popen[bytes]) -> None:
    """End a child and what it started."""
    with suppress(OSError):
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()


def _answer(folder: Path, place: str, name: str) -> Trajectory:
    answer = json.loads((folder / _ANSWER).read_text())
    if "error" in answer:
        kind = getattr(errors, answer["error"])
        raise kind(answer["message"].replace(place, name))
    try:
        return Trajectory.from_npz(folder / _VALUES)
    except UsageError as error:
        raise ValueError(str(error)) from error


def _end(code: int) -> str:
    if code >= 0:
        return f"ended the process with exit code {code}"
    with suppress(ValueError):
        return f"crashed ({signal.Signals(-code).name})"
    return f"crashed (signal {-code})"


def _main(folder: Path) -> None:
    """Be the child: answer the request in a folder."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(ImportError):
        from resource import RLIMIT_CORE, setrlimit

        setrlimit(RLIMIT_CORE, (0, 0))
    from cosim.fmi.run.simulate import simulate_fmu

    request = json.loads((folder / _REQUEST).read_text())
    try:
        run = simulate_fmu(request["path"], **request["options"])
    except CosimError as error:
        answer = {"error": type(error).__name__, "message": str(error)}
    else:
        run.to_npz(folder / _VALUES)
        answer = {}
    (folder / _ANSWER).write_text(json.dumps(answer))


def _end_with_parent() -> None:
    while os.read(0, 1):  # nothing is ever sent
        pass
    os._exit(1)


if __name__ == "__main__":
    _main(Path(sys.argv[1]))
