"""An FMU in a child process: if its binary crashes, hangs or exits, the parent continues.

The child has the rights of its user: this guards against mistakes, not against malice.
"""

import json
import os
import pickle
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from cosim import errors
from cosim.errors import CosimError, FmuError, UsageError
from cosim.fmi.run.simulate import simulate_fmu
from cosim.host.child import be_confined, leave, own_folder, run_confined
from cosim.host.last_call import calls_noted_in, last_called
from cosim.host.limits import LIMITS_VARIABLE, chosen_limits
from cosim.host.progress import doing
from cosim.model.values import time_limit_from
from cosim.text import described
from cosim.trajectory import Trajectory

_REQUEST, _ANSWER, _VALUES = "request.pickle", "answer.json", "values.npz"
_RESULT = "result.pickle"  # other than a Trajectory
_BROKEN = (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, EOFError)


def run_apart(
    path: str | os.PathLike[str],
    *,
    timeout: float | None = None,
    function: Callable[..., Any] = simulate_fmu,
    **options: Any,
) -> Any:
    """Run `function(path, **options)` in a child process with the limits of `chosen_limits`.

    The child works in an empty folder of its own, without the environment and open files of the
    parent, and ends with every process that it started. The first 10 kB of its output go to stderr.

    Args:
        timeout: Wall time, s, after which the child is ended; None or infinity for no limit.
        function: What runs the file, of a module; `simulate_fmu` if it is not given.
        options: Of that function; of inputs, formulas and series.

    Raises:
        FmuError: The FMU crashed, ended the process, or took too long.
        CosimError: See `simulate_fmu`.
    """
    limit = time_limit_from(str(path), timeout)
    chosen_limits()  # refuses before anything has been started
    with own_folder() as folder:
        place = str(Path(path).absolute())
        (folder / _REQUEST).write_bytes(pickle.dumps((function, place, options)))
        try:
            with doing(f"running {Path(path).name}"):
                code, printed = run_confined(__name__, [str(folder)], folder, limit)
        except KeyboardInterrupt:
            if part := last_called(folder):
                print(f"{path}: part '{part}' was being called", file=sys.stderr)
            raise
        if sys.stderr is not None:
            sys.stderr.write(printed)
        part = last_called(folder)
        what = f"part '{part}'" if part else "the FMU"
        if code is None:
            raise FmuError(f"{path}: {what} did not end within {limit:g} s and was stopped")
        try:
            return _read_answer(folder, place, str(path))
        except (*_BROKEN, pickle.UnpicklingError) as error:
            raise FmuError(
                f"{path}: {what} {how_it_ended(code)} while it ran; do not use it"
            ) from error


def _read_answer(folder: Path, place: str, name: str) -> Any:
    answer = json.loads((folder / _ANSWER).read_text())
    if "error" in answer:
        kind = getattr(errors, answer["error"])
        message = answer["message"].replace(place, name)
        if answer["partial"]:
            raise kind(message, partial=Trajectory.from_npz(folder / _VALUES))
        raise kind(message)
    if (folder / _RESULT).exists():
        return pickle.loads((folder / _RESULT).read_bytes())
    try:
        return Trajectory.from_npz(folder / _VALUES)
    except UsageError as error:
        raise ValueError(str(error)) from error


def how_it_ended(code: int) -> str:
    """Describe an exit code: a signal by its name."""
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
    """Run in the child: answer the request in a folder."""
    be_confined()
    function, path, options = pickle.loads((folder / _REQUEST).read_bytes())
    try:
        with calls_noted_in(folder):
            run = function(path, **options)
    except CosimError as error:
        partial = getattr(error, "partial", None)
        if kept := isinstance(partial, Trajectory):
            partial.to_npz(folder / _VALUES)
        kind = next(one for one in type(error).__mro__ if one.__module__ == errors.__name__)
        answer = {"error": kind.__name__, "message": str(error), "partial": kept}
    except MemoryError:
        reason = f"{path}: the FMU exceeded the limit of memory ({LIMITS_VARIABLE})"
        answer = {"error": "FmuError", "message": reason, "partial": False}
    except BaseException as error:
        reason = f"{path}: it cannot be run: {described(error)}"
        answer = {"error": "FmuError", "message": reason, "partial": False}
    else:
        if isinstance(run, Trajectory):
            run.to_npz(folder / _VALUES)
        else:
            (folder / _RESULT).write_bytes(pickle.dumps(run))
        answer = {}
    (folder / _ANSWER).write_text(json.dumps(answer))
    leave()


if __name__ == "__main__":
    _main(Path(sys.argv[1]))
