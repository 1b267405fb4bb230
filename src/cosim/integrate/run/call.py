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
_BLOCK = 65_536  # rows


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
    if apart:  # CasADi writes column by column, and those after a failure not at all
        states.fill(np.nan)
        algebraics.fill(np.nan)
    elif looked_at():
        _marks(states).fill(np.nan)
    if engine.repeat_u:
        u = np.tile(u, n)
    counts, reached = Counts(), None
    began = perf_counter()
    told = io.StringIO()  # what SUNDIALS says: at which time and step it failed
    heard = redirect_stderr(told) if apart else nullcontext()
    with heard, interruptible(engine.library) as interrupts:
        try:
            with doing("solving", partial(_filled, states)):
                succeeded, reached = _evaluated(engine, x0, z0, p, u, states, algebraics)
        except RuntimeError as error:  # CasADi has no narrower type
            reason = _flag(str(error))
        else:
            counts = engine.counts()
            cause = counts.cause or "step size too small, or too many steps"
            reason = "" if succeeded else cause
    took = perf_counter() - began
    if reached is None:
        reached = finite_rows(states)
    states, algebraics = states[:reached], algebraics[:reached]
    if engine.kept is not None:
        n, kept = len(engine.kept), engine.kept[engine.kept < reached]
        states, algebraics = states[kept], algebraics[kept]
    if interrupts or "KeyboardInterrupt" in reason + told.getvalue():  # a failure, to CasADi
        reason = INTERRUPTED
    elif reason:
        last = told.getvalue().strip().rpartition("\n")[2].rstrip(". ")
        reason += f" ({last})" if last else ""
    elif len(states) < n:
        reason = "a state is not finite"
    return Reached(states.T, algebraics.T, counts, reason, took)


def finite_rows(rows: Vector) -> int:
    """Return how many rows are finite before one that is not."""
    for begin in range(0, len(rows), _BLOCK):  # what a run did not reach may be far the most
        finite = np.isfinite(rows[begin : begin + _BLOCK])
        if not finite.all():
            return begin + int(np.argmin(finite.all(axis=1)))
    return len(rows)


def _evaluated(
    engine: Engine, x0: Vector, z0: Vector, p: Vector, u: Vector, states: Vector, algebraics: Vector
) -> tuple[bool, int | None]:
    """Fill the results of an engine.

    Returns:
        Whether it succeeded, and how many times it reached; None where it does not say.
    """
    if engine.direct is not None:
        return engine.direct(x0, z0, p, u, states, algebraics)
    function, parameters = engine.functions
    if parameters is not None:
        extended = np.empty(parameters.numel_out(0))
        call_on_arrays(parameters, [p], [extended])
        p = extended
    return call_on_arrays(function, (x0, z0, p, u), (states, algebraics)), None


def _marks(rows: Vector) -> Vector:
    """Return numbers of a table that tell how much of it has been written, 1000 at most."""
    return rows[:: len(rows) // 1000 + 1, :1]


def _filled(rows: Vector) -> float:
    """Return how much of a table has been written, from its start on, while it is."""
    marks = _marks(rows)
    return float(np.argmax(~np.isfinite(marks)) / len(marks)) if marks.size else 0.0


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
