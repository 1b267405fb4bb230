"""An FMU in a child process: if its binary crashes, hangs or exits, the parent continues.

The child has the rights of its user: this guards against mistakes, not against malice.
"""

import os
import pickle
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from cosim import errors
from cosim.errors import CosimError, FmuError, Interrupted
from cosim.fmi.run.kept_rows import kept_run
from cosim.fmi.run.simulate import simulate_fmu
from cosim.host.child import be_confined, leave, own_folder, run_confined
from cosim.host.last_call import calls_noted_in, last_called
from cosim.host.limits import LIMITS_VARIABLE, chosen_limits
from cosim.host.progress import doing
from cosim.model.values import time_limit_from
from cosim.text import described
from cosim.trajectory import Trajectory

_REQUEST, _ANSWER = "request.pickle", "answer.pickle"
# what reading an answer raises that is missing or cut off
_BROKEN = (
    *(OSError, EOFError, ValueError, LookupError, TypeError, AttributeError),
    *(ImportError, RecursionError, pickle.UnpicklingError),
)


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
            if kept := kept_run(folder, "interrupted"):
                raise Interrupted(f"{path}: {kept.status}", kept) from None
            raise
        if sys.stderr is not None:
            sys.stderr.write(printed)
        part = last_called(folder)
        what = f"part '{part}'" if part else "the FMU"
        if code is None:
            why = f"{what} did not end within {limit:g} s and was stopped"
            raise FmuError(f"{path}: {why}", kept_run(folder, why))
        try:
            answer = _Answer(*pickle.loads((folder / _ANSWER).read_bytes()))
        except _BROKEN as error:
            raise FmuError(
                f"{path}: {what} {how_it_ended(code)} while it ran; do not use it"
            ) from error
    result = answer.result
    if isinstance(result, Trajectory):
        result = replace(result)  # whose arrays are read-only
    if not answer.error:
        return result
    more = {} if result is None else {"partial": result}
    raise getattr(errors, answer.error)(answer.message.replace(place, str(path)), **more)


class _Answer(NamedTuple):
    """What a child has computed: its result, or the name of an error with what is left of a run."""

    result: Any
    error: str = ""
    message: str = ""


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
            answer = _Answer(function(path, **options))
    except CosimError as error:
        partial = getattr(error, "partial", None)
        kept = partial if isinstance(partial, Trajectory) else None
        kind = next(one for one in type(error).__mro__ if one.__module__ == errors.__name__)
        answer = _Answer(kept, kind.__name__, str(error))
    except MemoryError:
        reason = f"{path}: the FMU exceeded the limit of memory ({LIMITS_VARIABLE})"
        answer = _Answer(None, "FmuError", reason)
    except BaseException as error:
        answer = _Answer(None, "FmuError", f"{path}: it cannot be run: {described(error)}")
    (folder / _ANSWER).write_bytes(pickle.dumps(tuple(answer)))
    leave()


if __name__ == "__main__":
    _main(Path(sys.argv[1]))
