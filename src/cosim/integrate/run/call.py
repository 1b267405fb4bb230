"""One call of an engine: interruptible, without messages on the way, and what it reached."""

import io
from collections.abc import Sequence
from contextlib import nullcontext, redirect_stderr
from dataclasses import dataclass
from functools import partial
from time import perf_counter

import casadi as ca
import numpy as np

from cosim.arrays import Vector
from cosim.codegen.interruptible import interruptible
from cosim.host.progress import doing, looked_at
from cosim.integrate.engine import Counts, Engine

INTERRUPTED = "interrupted"


@dataclass(frozen=True)
class Reached:
    """What an engine computed.

    Attributes:
        states, algebraics: At the output times up to the last finite one, (nx, n) and (nz, n).
        counts: What it took.
        reason: Why it stopped before the last output time, `INTERRUPTED` after Ctrl-C; empty where
            it did not.
        solve_time: How long that took, s.
    """

    states: Vector
    algebraics: Vector
    counts: Counts
    reason: str
    solve_time: float


def call(engine: Engine, x0: Vector, z0: Vector, p: Vector, u: Vector) -> Reached:
    """Call an engine with start values, parameters and constant inputs."""
    n, apart = engine.points, engine.direct is None
    states, algebraics = (np.empty((n, len(start))) for start in (x0, z0))
    if apart or looked_at():  # CasADi writes column by column, and those after a failure not at all
        states.fill(np.nan)
        algebraics.fill(np.nan)
    if engine.repeat_u:
        u = np.tile(u, n)
    counts = Counts()
    began = perf_counter()
    told = io.StringIO()  # what SUNDIALS says: at which time and step it failed
    heard = redirect_stderr(told) if apart else nullcontext()
    with heard, interruptible(engine.library) as interrupts:
        try:
            with doing("solving", partial(_filled, states)):
                succeeded = _evaluated(engine, x0, z0, p, u, states, algebraics)
        except RuntimeError as error:  # CasADi has no narrower type
            reason = _flag(str(error))
        else:
            counts = engine.counts()
            cause = counts.cause or "step size too small, or too many steps"
            reason = "" if succeeded else cause
    took = perf_counter() - began
    if engine.kept is not None:
        states, algebraics = states[engine.kept], algebraics[engine.kept]
        n = len(states)
    reached = n if not (apart or reason) else finite_rows(states)
    if interrupts or "KeyboardInterrupt" in reason + told.getvalue():  # a failure, to CasADi
        reason = INTERRUPTED
    elif reason:
        last = told.getvalue().strip().rpartition("\n")[2].rstrip(". ")
        reason += f" ({last})" if last else ""
    elif reached < n:
        reason = "a state is not finite"
    return Reached(states[:reached].T, algebraics[:reached].T, counts, reason, took)


def finite_rows(rows: Vector) -> int:
    """Return how many rows are finite before one that is not."""
    finite = np.isfinite(rows)
    return len(rows) if finite.all() else int(np.argmin(finite.all(axis=1)))


def _evaluated(
    engine: Engine, x0: Vector, z0: Vector, p: Vector, u: Vector, states: Vector, algebraics: Vector
) -> bool:
    """Fill the results of an engine; tell whether it succeeded."""
    if engine.direct is not None:
        return engine.direct(x0, z0, p, u, states, algebraics)
    if engine.parameters is not None:
        extended = np.empty(engine.parameters.numel_out(0))
        call_on_arrays(engine.parameters, [p], [extended])
        p = extended
    return call_on_arrays(engine.function, (x0, z0, p, u), (states, algebraics))


def _filled(rows: Vector) -> float:
    """Return how much of a table has been written, from its start on, while it is."""
    first = rows.reshape(len(rows), -1)[:, 0]
    return float(np.argmax(~np.isfinite(first)) / len(first)) if len(first) else 0.0


def call_on_arrays(
    function: ca.Function, arguments: Sequence[Vector], results: Sequence[Vector]
) -> bool:
    """Evaluate a function on arrays; tell whether it succeeded.

    Args:
        function: Dense in all arguments and results.
        arguments: One array per argument; CasADi's columns are the rows.
        results: One C-ordered array per result, likewise; overwritten.
    """
    buffer, evaluate = function.buffer()
    held = [np.ascontiguousarray(array, dtype=float) for array in arguments]  # the buffer does not
    for i, array in enumerate(held):
        if array.size:
            buffer.set_arg(i, array.data)  # type: ignore[call-arg]  # stub and binding differ
    for i, array in enumerate(results):
        if array.size:
            buffer.set_res(i, array.data)  # type: ignore[call-arg]
    evaluate()
    return not buffer.ret()


def _flag(message: str) -> str:
    """Return the SUNDIALS flag, or the last line of CasADi's message."""
    flag = message.partition('returned "')[2].partition('"')[0]
    return flag or message.strip().splitlines()[-1][:200]
