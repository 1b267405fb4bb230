"""Road one: a DAE through CasADi's integrators, CVODES and IDAS first, to a `Trajectory`."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import Any, TypedDict, TypeVar, Unpack

import numpy as np

from casadi_models.dae import Dae, Drawing
from cosim.arrays import Vector
from cosim.codegen.compiler import time_compiling
from cosim.errors import (
    CompilerExhausted,
    CosimError,
    Interrupted,
    SolverError,
    UnknownName,
    UsageError,
)
from cosim.host.progress import doing
from cosim.integrate.across import across
from cosim.integrate.diagnosis.crossing import times_between
from cosim.integrate.diagnosis.kinks import nearest_kink
from cosim.integrate.diagnosis.validity import ON_INVALID
from cosim.integrate.drift_control import controlled
from cosim.integrate.engine import Problem
from cosim.integrate.families.explicit import Dop853
from cosim.integrate.families.fixed_step import FixedStep
from cosim.integrate.families.plugin import MOST_STEPS
from cosim.integrate.plan import Asked, Plan, Times, plan
from cosim.integrate.run.call import INTERRUPTED
from cosim.integrate.run.pieces import pieces_of
from cosim.integrate.run.run_stats import RunStats
from cosim.integrate.run.solution import Solution, solve
from cosim.integrate.run.worthwhile import Choice, worthwhile
from cosim.integrate.solver import Solver
from cosim.integrate.solvers import NUMBERS, SOLVERS, engine_of
from cosim.integrate.tightened import said
from cosim.memo import kept_per_thread
from cosim.model.inputs import InputSeries
from cosim.model.values import Values, assign, listed, numbers_of
from cosim.trajectory import Trajectory

Given = TypeVar("Given")
TOO_MANY_STEPS = ("TOO_MUCH_WORK", "too many steps at")  # SUNDIALS' words, and our solvers'


class Shorthand(TypedDict, total=False):
    """Other ways to say what `solver` and `start_values` say; see `simulate`."""

    relative_tolerance: float | None
    absolute_tolerance: float | None
    step_size: float | None
    start: Mapping[str, float] | None


def simulate(
    dae: Dae,
    *,
    start_time: float = 0.0,
    stop_time: float | None = None,
    output_interval: float | Vector | None = None,
    solver: str | Solver | None = None,
    start_values: Mapping[str, float] | None = None,
    inputs: InputSeries | None = None,
    outputs: Sequence[str] | None = None,
    compiled: bool | None = None,
    on_invalid: str = "warn",
    drift_control: str | None = None,
    **shorthand: Unpack[Shorthand],
) -> Trajectory:
    """Integrate a DAE with CVODES, or with IDAS when it has algebraic unknowns.

    Args:
        dae: The model; SI units throughout.
        start_time: Begin of the run, s.
        stop_time: End of the run, s; the model's own span after `start_time` when None.
        output_interval: Distance of the output times, s; the model's own when None. The last
            output is at `stop_time` in any case. An array holds the times themselves, (n,).
        solver: A solver with its numbers, as `cosim.solvers.Dop853(relative_tolerance=1e-10)`, or
            the name of one; CVODES, or IDAS for a DAE, when None.
        start_values: Values by name that replace starts of states, parameters, or inputs.
        inputs: Time series of some inputs, piecewise linear; the others keep their start value.
        outputs: Names to record, monitors among them; everything but those when None.
        compiled: Whether to compile the equations. When None, small ones are, and large ones once
            that pays for the runs so far; `stats["note"]` says where it does not yet.
        on_invalid: What happens where a run leaves the model's limits, or a fixed step is too long
            for the motion: "warn" says so in `stats["invalid"]`, "stop" ends the run there,
            "ignore" looks at neither.
        drift_control: "none", "baumgarte" (the model's closing rate) or "projection" after every
            step, which makes `dop853` the default solver; what the model has when None.
        shorthand: Numbers of a solver that is named or left out: `relative_tolerance`, error per
            step relative to each state's size (1), 1e-8 when None (of a tighter one, a solver that
            nobody named takes down to a thirtieth: its errors add up); `absolute_tolerance` in the
            nominal value of each unknown, which is 1 SI unit where the model says nothing; when
            None, a hundredth of the relative one, in nominal values that are found from the start
            and the run where the model says nothing; `step_size`, largest step of `rk4` and
            `ode8`, s, the output interval when None. And `start`, another name of `start_values`.

    Returns:
        Every state, algebraic unknown and output of `dae`, each of shape (n,), with its unit.

    Raises:
        UnknownName: `start_values`, `outputs`, `solver`, `on_invalid` or `drift_control` holds a
            name that does not exist.
        ParameterError: A value is not finite or out of its bounds, or asks for what cannot be.
        UsageError: The solver cannot integrate the model, or something is said twice.
        InitialConditionError: The start values contradict the constraints.
        SolverError: The solver gave up, or the run stopped at a limit; `partial` holds the outputs
            up to there. The time in its `status` may lie after the last of them: where outputs are
            far apart, a form with constraints is looked at between them, too.
        Interrupted: Ctrl-C, a `KeyboardInterrupt` whose `partial` holds the run up to there.
        MissingTool: `compiled` is True and no compiler works.

    References:
        Hindmarsh et al., SUNDIALS, ACM TOMS 2005, doi:10.1145/1089014.1089020.
    """
    began = perf_counter()
    refuse_unknown(shorthand, Shorthand.__optional_keys__)
    if not isinstance(on_invalid, str) or on_invalid not in ON_INVALID:
        raise UnknownName.among("simulate", "answer to an invalid state", on_invalid, ON_INVALID)
    given = dae
    dae, project = controlled(dae, drift_control)
    values = assign(dae, one_of(dae, start_values, shorthand.get("start")))
    asked = Asked(
        None if outputs is None else listed(f"{dae.full_name}: outputs", outputs),
        Times(start_time, stop_time, output_interval),
        solver,
        tuple([shorthand.get(name) for name in NUMBERS]),  # type: ignore[misc]  # all are numbers
        inputs,
        compiled,
        project,
    )
    own = plan(dae, asked)
    if on_invalid != "ignore" and not (project or isinstance(own.solver, FixedStep)):
        closer = times_between(own.problem.dae, own.problem.grid)
        if closer is not None:
            whole = partial(
                simulate,
                given,
                output_interval=closer,
                solver=solver,
                start_values=start_values,
                inputs=inputs,
                outputs=outputs,
                compiled=compiled,
                on_invalid=on_invalid,
                drift_control=drift_control,
                **shorthand,
            )
            return _at(own.problem.grid, whole)
    before = time_compiling()
    with doing(own.problem.dae.full_name):
        computed = _computed(own, values, on_invalid, insisting=bool(compiled))
    stats = _stats(own.solver, computed, perf_counter() - began, time_compiling() - before)
    run = _trajectory(own, values, computed, stats)
    if computed.reason == INTERRUPTED:
        raise Interrupted(f"{run.model}: {run.status}", run)
    why_not = ""
    if solver is None and drift_control is None and compiled is not False:
        start = one_of(dae, start_values, shorthand.get("start"))
        again = partial(simulate, given, start_values=start, inputs=inputs, compiled=compiled)
        again = partial(again, on_invalid=on_invalid)
        try:
            other = across(own.problem, own.solver, values, computed.first, again, outputs)
        except Interrupted as stopped:
            raise Interrupted(f"{run.model}: {run.status}; interrupted", run) from stopped
        except CosimError as error:
            why_not = f" (tried, and not taken: {error})"
            told = "; ".join(filter(None, (stats.note, f"{Dop853.name} with projection{why_not}")))
            run = replace(run, stats=replace(stats, note=told))
        else:
            if other is not None:
                return other
    if computed.reason:
        raise _failure(own, values, computed, run, why_not)
    return run


def _at(times: Vector, run: Callable[[], Trajectory]) -> Trajectory:
    """Return a run at some of its output times, and so what it leaves where it fails."""

    def some(whole: Trajectory) -> Trajectory:
        kept = np.isin(whole.time, times)
        return replace(whole, time=whole.time[kept], values=whole.values[kept])

    try:
        return some(run())
    except (SolverError, Interrupted) as error:
        if isinstance(error.partial, Trajectory):
            error.partial = some(error.partial)
        raise


@dataclass(frozen=True)
class _Computed:
    """What a run computed.

    Attributes:
        first: The run over the whole grid, which says how it ended.
        last: The run up to the last good time: what is recorded.
        choice: Whether it was compiled.
        solver: The one that computed it, with its numbers.
    """

    first: Solution
    last: Solution
    choice: Choice
    solver: Solver

    @property
    def reason(self) -> str:
        """Why it ended early; Ctrl-C counts while a failure is looked at, too."""
        return INTERRUPTED if self.last.reason == INTERRUPTED else self.first.reason


def _computed(own: Plan, values: Values, on_invalid: str, *, insisting: bool) -> _Computed:
    """Compute a run; interpreted where a compiler gives up that nobody insists on."""
    problem, choice = own.problem, own.choice or _worthwhile(own.problem, own.solver)
    if problem.compiled is not choice.compiled:
        problem = replace(problem, compiled=choice.compiled)
    solver = own.inner
    try:
        first = solve(problem, solver, values, on_invalid, own.places)
    except CompilerExhausted as error:
        if insisting or own.solver.compiled_only or problem.project:
            raise
        choice = Choice(False, f"interpreted: {error}")
        problem = replace(problem, compiled=False)
        first = solve(problem, solver, values, on_invalid, own.places)
    if solver != own.solver and first.failed and first.reason != INTERRUPTED:
        solver = own.solver
        first = solve(problem, solver, values, on_invalid, own.places)
    choice.add(first.solve_time)
    # A run that failed is repeated up to its last good time: what is kept then equals, bit for bit,
    # a run that was to stop there (solvers look ahead to the stop time).
    last = first
    while last.reason not in ("", INTERRUPTED) and 0 < len(last.table) < len(last.grid):
        last = solve(problem.until(len(last.table)), solver, values, on_invalid, own.places)
    return _Computed(first, last, choice, solver)


def _trajectory(own: Plan, values: Values, computed: _Computed, stats: RunStats) -> Trajectory:
    """Return what was computed with what is known of it."""
    dae, reason, table = own.problem.dae, computed.reason, computed.last.table
    time, status = computed.first.grid[: len(table)], "complete"
    if reason:
        last = f"{time[-1]:g} s" if len(time) else "the start"
        status = f"stopped after {last}: {reason}"
    numbers, drawing = _numbers(dae, values.p.tobytes(), values.u.tobytes())
    return Trajectory(
        dae.full_name,
        time,
        own.columns,
        table,
        stats,
        status,
        drawing=drawing,
        numbers=dict(numbers),
    )


def _failure(
    own: Plan, values: Values, computed: _Computed, run: Trajectory, why_not: str
) -> SolverError:
    """Say why a run stopped, and what else there is; `why_not` follows the last of it."""
    dae, solver = own.problem.dae, own.solver
    others = [n for n, s in SOLVERS.items() if s.solves_dae and n != solver.name]
    which = f" ({', '.join(others)})" if dae.algebraics else ""
    if dae.algebraics and dae.invariants and not own.problem.project:
        which += f"; {Dop853.name} with projection steps across positions where loops lose rank"
    kink = _kink(dae, run.time, computed.last.last, values)
    closer = ""
    if any(words in computed.first.reason for words in TOO_MANY_STEPS):
        closer = f", or closer output times (for {MOST_STEPS:,} steps from one to the next)"
    return SolverError(
        f"{dae.full_name}: {solver.name} {run.status} ({solver.settings}){kink}; look for a "
        "singularity near that state, or use another tolerance or step, formulation or "
        f"solver{which}{why_not}{closer}",
        run,
    )


def _worthwhile(problem: Problem, solver: Solver) -> Choice:
    points = len(problem.grid)
    return worthwhile(problem.dae, solver, points, lambda: engine_of(pieces_of(problem)[0], solver))


def refuse_unknown(given: Mapping[str, Any], known: Collection[str]) -> None:
    """Refuse keywords that a call does not have, as Python does.

    Raises:
        TypeError: There is one.
    """
    for name in given:
        if name not in known:
            raise TypeError(f"simulate() got an unexpected keyword argument '{name}'")


def one_of(
    dae: Dae, start_values: Mapping[str, Given] | None, start: Mapping[str, Given] | None
) -> Mapping[str, Given] | None:
    """Return the start values, given by one of their two names.

    Raises:
        UsageError: Both are given.
    """
    if start_values is not None and start is not None:
        raise UsageError(
            f"{dae.full_name}: start_values and start are two names of one thing; give one of them"
        )
    return start if start_values is None else start_values


def _kink(dae: Dae, time: Vector, last: tuple[Vector, Vector], values: Values) -> str:
    """Say what switches at the last good time."""
    if not len(time):
        return ""
    found = nearest_kink(dae, time[-1], *last, values.u, values.p)
    return f"; {found}" if found else ""


@kept_per_thread(64)
def _numbers(dae: Dae, p: bytes, u: bytes) -> tuple[dict[str, float], Drawing]:
    """Return parameters and inputs by name, and what the model looks like with them."""
    numbers = numbers_of(dae, Values(np.empty(0), np.frombuffer(p), np.frombuffer(u)))
    return numbers, dae.drawing.with_numbers(numbers)


def _stats(solver: Solver, computed: _Computed, wall_time: float, compile_time: float) -> RunStats:
    first, last, choice = computed.first, computed.last, computed.choice
    inner = said(solver, computed.solver)
    return RunStats(
        solver=solver.name,
        relative_tolerance=getattr(solver, "relative_tolerance", None),
        step_size=getattr(solver, "step_size", None),
        solve_time=last.solve_time,
        steps=last.counts.steps,
        rhs_calls=last.counts.rhs_calls,
        jacobian_calls=last.counts.jacobian_calls,
        compiled=choice.compiled,
        wall_time=wall_time,
        compile_time=compile_time or None,
        invalid=tuple([breach.text for breach in first.invalid]),
        note="; ".join(filter(None, (inner, first.note, choice.note))) or None,
        invalid_from=float(first.grid[first.invalid[0].position]) if first.invalid else None,
    )
