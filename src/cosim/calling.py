"""One call of an engine: interruptible, without messages on the way, and what it reached."""

import io
from collections.abc import Callable
from contextlib import redirect_stderr
from dataclasses import dataclass
from threading import Thread
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from cosim.buffers import on_arrays
from cosim.engines import Engine

Vector = NDArray[np.float64]
T = TypeVar("T")


@dataclass(frozen=True)
class Reached:
    """What an engine computed.

    Attributes:
        states, algebraics: At the output times up to the last finite one, (nx, n) and (nz, n).
        stats: What it took.
        reason: Why it stopped before the last output time; empty where it did not.
    """

    states: Vector
    algebraics: Vector
    stats: dict[str, Any]
    reason: str


def call(engine: Engine, x0: Vector, z0: Vector, p: Vector, u: Vector) -> Reached:
    """Call an engine with start values, parameters and constant inputs."""
    n = engine.function.size2_out(0)
    # CasADi writes column by column, and those after a failure not at all
    states, algebraics = (np.full((n, len(start)), np.nan) for start in (x0, z0))
    if engine.parameters is not None:
        p = np.array(engine.parameters(p)).ravel()
    arguments = [x0, z0, p, np.tile(u, n) if engine.repeat_u else u]
    evaluate = on_arrays(engine.function, arguments, (states, algebraics))

    def work() -> tuple[str, dict[str, Any]]:
        try:
            succeeded = evaluate()
        except RuntimeError as error:  # CasADi has no narrower type
            return _flag(str(error)), {}
        stats = engine.stats()
        doubt = "step size too small, or too many steps"
        cause = "" if succeeded else stats.pop("cause", doubt)
        return cause, stats

    told = io.StringIO()
    with redirect_stderr(told):  # SUNDIALS says there at which time and step it failed
        reason, stats = _interruptible(work, engine.halt)
    if "KeyboardInterrupt" in reason + told.getvalue():  # CasADi took Ctrl-C for a failure
        raise KeyboardInterrupt
    finite = np.isfinite(states).all(axis=1)
    reached = n if finite.all() else int(np.argmin(finite))
    if reason:
        last = told.getvalue().strip().rpartition("\n")[2].rstrip(". ")
        reason += f" ({last})" if last else ""
    elif reached < n:
        reason = "a state is not finite"
    return Reached(states[:reached].T, algebraics[:reached].T, stats, reason)


def _flag(message: str) -> str:
    """Return the SUNDIALS flag, or the last line of CasADi's message."""
    flag = message.partition('returned "')[2].partition('"')[0]
    return flag or message.strip().splitlines()[-1][:200]


def _interruptible(work: Callable[[], T], halt: Callable[[bool], None] | None) -> T:
    """Do work that Ctrl-C ends.

    CasADi looks for Ctrl-C between evaluations, in the main thread. Where the work is one C
    function, it runs in another thread, which is halted.
    """
    if halt is None:
        return work()
    halt(False)
    results: list[T] = []
    thread = Thread(target=lambda: results.append(work()))
    thread.start()
    try:
        thread.join()
    except BaseException:
        halt(True)
        thread.join()
        raise
    return results[0]
