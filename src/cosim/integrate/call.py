"""`call`: run an engine once, interruptibly and without printed messages; `RunStats`."""

import io
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, fields
from functools import partial
from time import perf_counter
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from cosim.arrays import Vector
from cosim.host.progress import doing
from cosim.host.recorded_errors import recorded_errors
from cosim.host.signals import interrupt_noticed, interruptible
from cosim.integrate.engine import Counts, Crossing, Engine, EngineBuffer, Filled, Left
from cosim.text import Ending, EndKind


@dataclass(frozen=True, kw_only=True)
class RunStats(Mapping[str, Any]):
    """Statistics of a run: attributes, and a mapping of those that are known.

    Attributes:
        solver: Name of the solver.
        relative_tolerance: Relative tolerance of an adaptive solver (1).
        step_size: Largest step of a solver with fixed steps, s; None for the output interval.
        solve_time: Time of the solver, s.
        steps, rhs_calls, jacobian_calls: Numbers of steps and of calls of the equations.
        compiled: Whether the equations were compiled.
        wall_time: Total time of the run, s.
        compile_time: Time for compiling equations that were not in the cache, s, a part of it.
        invalid: Violated validity conditions of the model or of its fixed step, with their times.
        note: Fallbacks and settings that differ from the request.
        invalid_from: Time from which a validity condition is violated, s; None if none is.
        stop: The condition that ended the run, and the time from which it is true.
        stop_time: That time, s.
        accuracy: Requested largest global error of the outputs, in nominal values.
        budget: Requested largest time of the solver, s.
        configuration: Solver and tolerance that were chosen for the accuracy or the budget.
        predicted_error: Error of that configuration where it was measured, in nominal values.
        checked_by: The second method that this run was compared with.
        error_estimate: Largest difference between the two methods, in nominal values.
        error_estimate_of: The variable with that difference.
    """

    solver: str
    relative_tolerance: float | None = None
    step_size: float | None = None
    solve_time: float | None = None
    steps: int | None = None
    rhs_calls: int | None = None
    jacobian_calls: int | None = None
    compiled: bool
    wall_time: float
    compile_time: float | None = None
    invalid: tuple[str, ...] = ()
    note: str | None = None
    invalid_from: float | None = None
    stop: str | None = None
    stop_time: float | None = None
    accuracy: float | None = None
    budget: float | None = None
    configuration: str | None = None
    predicted_error: float | None = None
    checked_by: str | None = None
    error_estimate: float | None = None
    error_estimate_of: str | None = None

    def _known(self) -> dict[str, Any]:
        found = {field.name: getattr(self, field.name) for field in fields(self)}
        found["invalid"] = list(self.invalid) or None
        return {name: value for name, value in found.items() if value is not None}

    def __getitem__(self, name: str) -> Any:
        return self._known()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._known())

    def __len__(self) -> int:
        return len(self._known())

    def __or__(self, more: Mapping[str, Any]) -> dict[str, Any]:
        return self._known() | dict(more)


INTERRUPTED = Ending("interrupted", EndKind.INTERRUPTED)
_KINDS = {  # by the end of the flags of SUNDIALS
    "IDA_CONV_FAIL": EndKind.SINGULAR,
    "TOO_MUCH_WORK": EndKind.TOO_MANY_STEPS,
}
_TIME = re.compile(r"\b([th]) = ([-+.\de]*\d)")  # as SUNDIALS prints the time and the step
_BLOCK = 65_536  # rows


@dataclass(frozen=True)
class Reached:
    """Result of an engine.

    Attributes:
        states: States at the output times up to the last finite one, (nx, n).
        algebraics: Algebraic unknowns at these times, (nz, n).
        counts: Numbers of steps and calls.
        reason: Why it stopped before the last output time, `INTERRUPTED` after Ctrl-C.
        solve_time: Time of the solver, s.
        crossing: Time and relation at which it ended; the last columns are the values there.
        watched: Whether it would have ended at a relation that leaves its mode.
        events: Those that it went through; see `Filled`.
    """

    states: Vector
    algebraics: Vector
    counts: Counts
    reason: Ending
    solve_time: float
    crossing: Crossing | None = None
    watched: bool = False
    events: NDArray[np.void] | None = None


def call(
    engine: Engine,
    x0: Vector,
    z0: Vector,
    p: Vector,
    u: Vector,
    left: Left | None = None,
    begin: float = 0.0,
    length: float = 1.0,
) -> Reached:
    """Call an engine with initial values, parameters and inputs, and what events have left.

    Args:
        engine: The engine.
        x0, z0, p, u: Its arguments.
        left: What events have left.
        begin, length: Span of an engine in its own time, s, which messages need.
    """
    n, by_casadi, unit = engine.points, engine.direct is None, length * engine.time_unit
    states, algebraics = (np.empty((n, len(start))) for start in (x0, z0))
    if by_casadi:  # it writes column by column, and no column after a failure
        states.fill(np.nan)
        algebraics.fill(np.nan)
    else:
        _marks(states).fill(np.nan)
    if engine.repeat_u:
        u = np.tile(u, n)
    counts, filled = Counts(), Filled(False)
    began = perf_counter()
    # SUNDIALS writes the time and the step of a failure
    recording = recorded_errors() if by_casadi else nullcontext(io.StringIO())
    with recording as messages, interruptible(engine.library) as interrupts:
        try:
            with doing("solving", partial(_written_share, states)):
                filled = _evaluated(engine, (x0, z0, p, u), states, algebraics, left)
        except RuntimeError as error:  # CasADi has no narrower type
            reason, counts = _flag(str(error)), engine.counts()
        else:
            counts = engine.counts()
            cause = counts.cause or Ending("step size too small, or too many steps")
            reason = Ending() if filled.succeeded else cause
    solve_time = perf_counter() - began
    _, reached, crossing, events = filled
    if reached is None:
        reached = finite_rows(states)
    rows: slice | NDArray[np.intp] = slice(reached + (crossing is not None))
    if engine.selected is not None:
        n, rows = len(engine.selected), engine.selected[engine.selected < reached]
        rows = rows if crossing is None else np.append(rows, reached)
    states, algebraics = states[rows], algebraics[rows]
    if interrupts or "KeyboardInterrupt" in reason + messages.getvalue():  # to CasADi, a failure
        interrupt_noticed()
        reason = INTERRUPTED
    elif reason:
        reason = _with_cause(reason, messages.getvalue(), begin, unit)
    elif len(states) < n and crossing is None:
        reason = Ending("a state is not finite")
    transposed = states.T, algebraics.T
    watched = engine.watches and left is not None
    return Reached(*transposed, counts, reason, solve_time, crossing, watched, events)


def _with_cause(reason: Ending, printed: str, begin: float, unit: float) -> Ending:
    """Return why a run has failed with the last line that SUNDIALS printed, in times of the run.

    Args:
        reason: Why, in the engine's own time.
        printed: All that SUNDIALS printed.
        begin: Of the run, s.
        unit: Of the engine's own time, s.
    """
    last = printed.strip().rpartition("\n")[2].rstrip(". ")
    text, origin = f"{reason} ({last})" if last else reason, {"t": begin, "h": 0.0}
    text = _TIME.sub(lambda m: f"{m[1]} = {origin[m[1]] + unit * float(m[2]):g}", text)
    return Ending(text, reason.kind)


def finite_rows(rows: Vector) -> int:
    """Return how many rows precede the first one that is not finite."""
    for begin in range(0, len(rows), _BLOCK):  # few may be finite: do not read them all
        finite = np.isfinite(rows[begin : begin + _BLOCK])
        if not finite.all():
            return begin + int(np.argmin(finite.all(axis=1)))
    return len(rows)


def _evaluated(
    engine: Engine,
    given: tuple[Vector, Vector, Vector, Vector],
    states: Vector,
    algebraics: Vector,
    left: Left | None,
) -> Filled:
    """Fill the results of an engine."""
    if engine.direct is not None:
        return engine.direct(*given, states, algebraics, left)
    x0, z0, p, u = given
    parameters = engine.functions.parameters
    if parameters is not None:
        extended = np.empty(parameters.numel_out(0))
        call_on_arrays(parameters.buffer(), [p], [extended])
        p = extended
    return Filled(call_on_arrays(engine.buffer, (x0, z0, p, u), (states, algebraics)))


def _marks(rows: Vector) -> Vector:
    """Return at most 1000 numbers of a table, which show how much of it has been written."""
    return rows[:: len(rows) // 1000 + 1, :1]


def _written_share(rows: Vector) -> float:
    """Return the share of a table that has been written so far, from its first row on."""
    marks = _marks(rows)
    return float(np.argmax(~np.isfinite(marks)) / len(marks)) if marks.size else 0.0


class Evaluator:
    """A function with arrays of its own, which is quick to call again and again; one per thread.

    Args:
        function: Dense in all arguments and results.
    """

    def __init__(self, function: ca.Function) -> None:
        buffer: EngineBuffer = function.buffer()
        self._buffer, self._evaluate = buffer
        self._arguments = [np.zeros(function.numel_in(i)) for i in range(function.n_in())]
        self._results = [np.zeros(function.numel_out(i)) for i in range(function.n_out())]
        for i, array in enumerate(self._arguments):
            if array.size:
                self._buffer.set_arg(i, array.data)
        for i, array in enumerate(self._results):
            if array.size:
                self._buffer.set_res(i, array.data)

    def __call__(self, *arguments: float | Vector) -> list[Vector]:
        """Return the results, (n,) each; NaN where the function fails."""
        for own, given in zip(self._arguments, arguments, strict=True):
            own[:] = given
        self._evaluate()
        failed = self._buffer.ret()
        return [np.full(r.size, np.nan) if failed else r.copy() for r in self._results]


def call_on_arrays(
    buffer_and_call: EngineBuffer, arguments: Sequence[Vector], results: Sequence[Vector]
) -> bool:
    """Evaluate a function on arrays and return whether it succeeded.

    Args:
        buffer_and_call: `buffer()` of a function that is dense in all arguments and results.
        arguments: One array per argument; CasADi's columns are the rows.
        results: One C-ordered array per result, of the same layout; overwritten.
    """
    buffer, evaluate = buffer_and_call
    arrays = [np.ascontiguousarray(array, dtype=float) for array in arguments]  # referenced here
    for i, array in enumerate(arrays):
        if array.size:
            buffer.set_arg(i, array.data)
    for i, array in enumerate(results):
        if array.size:
            buffer.set_res(i, array.data)
    evaluate()
    return not buffer.ret()


def _flag(message: str) -> Ending:
    """Return the SUNDIALS flag, or the last line of CasADi's message."""
    flag = message.partition('returned "')[2].partition('"')[0]
    kinds = (kind for end, kind in _KINDS.items() if flag.endswith(end))
    text = flag or message.strip().splitlines()[-1][:200]
    return Ending(text, next(kinds, EndKind.FAILED))
