"""An FMU in a process of its own: where its binary crashes, hangs or exits, ours goes on.

The child has the rights of its user: this guards against mistakes, not against malice.
"""

import json
import os
import signal
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from cosim import errors
from cosim.errors import CosimError, FmuError, UsageError
from cosim.host.child import own_folder, run_confined
from cosim.host.inside import be_confined, leave
from cosim.host.limits import LIMITS_VARIABLE, Limits
from cosim.host.progress import doing
from cosim.model.inputs import InputSeries
from cosim.model.values import number
from cosim.text.escaping import sentence
from cosim.trajectory import Trajectory

_REQUEST, _ANSWER, _VALUES = "request.json", "answer.json", "values.npz"
_SUNDIALS = "[ERROR][rank"  # how fmpy's solver begins what its error says, too


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
    with own_folder() as folder:
        place = str(Path(path).absolute())
        told = {"path": place, "options": options, "inputs": _written(inputs)}
        (folder / _REQUEST).write_text(json.dumps(told))
        with doing(f"running {Path(path).name}"):
            code, printed = run_confined(__name__, [str(folder)], folder, timeout)
        if sys.stderr is not None:
            others = (n for n in printed.splitlines(keepends=True) if not n.startswith(_SUNDIALS))
            sys.stderr.writelines(others)
        if code is None:
            raise FmuError(f"{path}: the FMU did not end within {timeout:g} s and was stopped")
        try:
            return _read_answer(folder, place, str(path))
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
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
    be_confined()
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
    leave()


if __name__ == "__main__":
    _main(Path(sys.argv[1]))
