"""`run`: execute a request natively: integrate a DAE and return a `Trajectory`."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from math import inf, isfinite
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from casadi_models.dae import Dae, Drawing
from cosim.arrays import Vector
from cosim.codegen.compiler import time_compiling
from cosim.codegen.functions import equations
from cosim.errors import CosimError, Interrupted, SolverError
from cosim.host.progress import doing
from cosim.integrate.call import INTERRUPTED, RunStats
from cosim.integrate.engine import MOST_STEPS, Counts, Problem
from cosim.integrate.events import integrate
from cosim.integrate.fallbacks import next_request
from cosim.integrate.families.explicit import Dop853
from cosim.integrate.families.fixed_step import FixedStep
from cosim.integrate.initial_values import consistent_values, input_values
from cosim.integrate.limits import Again, first_left
from cosim.integrate.modes import hybrid
from cosim.integrate.motion import Motion
from cosim.integrate.nominal import InitialState
from cosim.integrate.outputs import Observed, all_columns, observe
from cosim.integrate.passed_over import changes_of, may_change, with_switching
from cosim.integrate.places import finer_than_steps, rows_between
from cosim.integrate.preparation import Prepared, prepare
from cosim.integrate.solvers import SOLVERS, with_largest_step
from cosim.integrate.validity import (
    PROJECTION,
    Breach,
    StepCheck,
    breaches,
    first_singular_configuration,
    step_check,
    with_singularity_margin,
)
from cosim.memo import cached_per_thread
from cosim.model.request import OnInvalid, RunRequest
from cosim.model.solver import AdaptiveSolver, Solver
from cosim.model.times import Times
from cosim.model.values import Values, numbers_of, own_sizes
from cosim.series.samples import uncontrolled
from cosim.text import Ending, EndKind, moment, one_note
from cosim.trajectory import Event, Trajectory

# Reciprocal condition number of the constraints below which a solver may have failed of it
_NEARLY_SINGULAR = 0.5
_MOST_SWITCHES = 50  # of conditions in outputs
_MOST_COMPILED_SWITCHES = 2_000  # with a solver that passes events in compiled code
_SHORTER = "give a smaller step_size, or a solver with error control"


class Integrated(NamedTuple):
    """What an integration found.

    Attributes:
        motion: The motion.
        again: Returns it with further rows.
        check: What half of its fixed steps tells.
    """

    motion: Motion
    again: Again
    check: StepCheck = StepCheck()


def _integrated(prepared: Prepared, numbers: Values) -> Integrated:
    """Integrate from initial values; without states, or with a single time, repeat these."""
    problem, solver = prepared.problem, prepared.inner
    dae, grid, n = problem.dae, problem.grid, len(problem.grid)
    first = replace(numbers, u=input_values(dae, grid[:1], numbers, problem.inputs)[:, 0])
    start = InitialState(*consistent_values(dae, float(grid[0]), first), first)
    if n == 1 or not (dae.states or hybrid(dae)):
        states, guesses = (np.tile(row[:, None], n) for row in (start.x, start.z))
        u = input_values(dae, grid, first, problem.inputs)
        motion = Motion(dae, grid, states, guesses, u, first.p, Counts())
        return Integrated(motion, lambda _: motion)
    found = integrate(problem, solver, start)

    def again(times: Vector) -> Motion:
        if isinstance(solver, FixedStep):  # rows would be ends of steps, of another motion
            return found
        closer = replace(problem, times=np.union1d(grid, times).tobytes())
        more = integrate(closer, solver, start)
        if more.reason == INTERRUPTED:
            raise KeyboardInterrupt
        return more

    if found.reason and (name := _rate_without_value(dae, float(grid[0]), start)):
        found.reason = Ending(
            f"the derivative of {name} is not a number at the start",
            remedy="start elsewhere, or write casadi.if_else where its equation divides by 0 or "
            "leaves the range of a function",
        )
    check = StepCheck()
    if prepared.checks_validity and isinstance(solver, FixedStep) and not found.reason:
        check, found.reason = _step_check(problem, solver, found, start)
    return Integrated(found, again, check)


def _rate_without_value(dae: Dae, t: float, start: InitialState) -> str:
    """Return the first state whose derivative is not finite at the start; empty if none."""
    values = start.values
    rates = equations(dae)(t, start.x, start.z, values.u, values.p)[0]
    missing = ~np.isfinite(np.array(rates).ravel())
    return dae.states[int(np.argmax(missing))].name if missing.any() else ""


def _evaluated(
    prepared: Prepared, integrated: Integrated
) -> tuple[Vector, int, Ending, list[Breach]]:
    """Evaluate the recorded variables while they are finite and, if requested, valid.

    Returns:
        Their values, SI, one row per time of the motion; the number of valid times; why the run
        stopped early, empty if it did not; and where validity conditions or fixed steps are
        violated.
    """
    motion, again, check = integrated
    problem, reason = prepared.problem, motion.reason
    dae, grid, n = motion.dae, motion.time, motion.states.shape[1]
    checked = prepared.checks_validity
    watched = with_singularity_margin(dae) if checked and not problem.project else dae
    watches_singularity = watched is not dae
    seen = observe(
        replace(motion, dae=watched), prepared.places, margins=checked, compiled=problem.compiled
    )
    seen.table.setflags(write=False)  # a result need not copy it
    if seen.first_not_finite < n:
        n, name = seen.first_not_finite, _not_finite(motion, seen, prepared.places)
        reason = reason or Ending(f"{name} is not finite at {moment(grid[n], 6)} s")
    found = list[Breach]()
    if watches_singularity:
        singular = first_singular_configuration(motion, seen, n)
        if singular is not None and dae.has_conditioned_multipliers:
            n, why = singular
            reason = Ending(why, EndKind.SINGULAR, PROJECTION)
        elif singular is not None:  # an explicit formulation goes on, with a warning
            found.append(singular)
    coarse = check.breach if check.breach and check.breach.position <= n else None
    if coarse:  # which may be the cause of what ends the run
        found.append(coarse)
    if checked:
        ended = motion.reason == INTERRUPTED  # a further integration would last
        found += breaches(motion, seen, n, {} if ended else first_left(motion, again))
        found.sort(key=lambda breach: (breach.position, breach != coarse, breach.reason.time))
        if found and prepared.on_invalid is OnInvalid.STOP:
            n, reason = found[0].position, Ending(found[0].reason, EndKind.INVALID)
    projectable = watches_singularity and dae.has_conditioned_multipliers and dae.invariants
    if coarse and check.diverges and coarse.position < n:
        n, reason = coarse.position, Ending(coarse.reason, remedy=_SHORTER)
    failed = n > 0 and motion.reason not in ("", INTERRUPTED)
    if failed and projectable and seen.margins[n - 1, -1] < _NEARLY_SINGULAR:
        near = f"a singular configuration near {moment(grid[n - 1], 4)} s may be the cause"
        reason = Ending(reason, reason.kind, f"{near}: {PROJECTION}")
    return seen.table, n, reason, found


def _both_sides(prepared: Prepared, motion: Motion) -> Iterator[Event]:
    """Yield events with all that is recorded, and the states, before and after each."""
    events = motion.events
    every = [side for pair in motion.instants for side in pair]
    x, z = (np.array(rows).T for rows in ([side.x for side in every], [side.z for side in every]))
    u = np.array([np.concatenate((side.u, side.modes)) for side in every]).T
    time = np.array([side.t for side in every])
    sides_alone = replace(motion, time=time, states=x, algebraics=z, u=u)
    seen = observe(sides_alone, prepared.places, margins=False, compiled=False)
    names = [c.name for c in prepared.columns] + [v.name for v in prepared.problem.dae.states]
    rows, sides = 2 * np.array([event.instant for event in events]), list[list[list[float]]]()
    for i, states in enumerate(([e.before for e in events], [e.after for e in events])):
        sides.append(np.hstack((seen.table[rows + i], np.array(states))).tolist())
    for event, *pair in zip(events, *sides, strict=True):
        yield Event(
            float(event.time), event.name, *(dict(zip(names, row, strict=True)) for row in pair)
        )


def _not_finite(motion: Motion, seen: Observed, places: tuple[int, ...]) -> str:
    """Return the name of the first variable that is not finite at the first such time."""
    row = np.concatenate(
        (motion.states[:, seen.first_not_finite], seen.unknowns[seen.first_not_finite])
    )
    numbers = dict(enumerate(row.tolist())) | dict(
        zip(places, seen.table[seen.first_not_finite].tolist(), strict=True)
    )
    place = min(place for place, value in numbers.items() if not isfinite(value))
    return all_columns(motion.dae)[place].name


def _step_check(
    problem: Problem, solver: FixedStep, found: Motion, start: InitialState
) -> tuple[StepCheck, Ending]:
    """Check the error of fixed steps by a second run with half the step.

    Returns:
        What it tells, and `INTERRUPTED` if Ctrl-C ended the second run.
    """
    step = solver.step(problem)
    half = replace(solver, step_size=step / 2)
    if half.exceeds(problem):
        note = "the error of its steps is not checked: half of them would be too many"
        return StepCheck(note=note), Ending()
    finer = integrate(problem, half, start)
    if finer.reason == INTERRUPTED:
        return StepCheck(), INTERRUPTED
    n = found.states.shape[1] if finer.reason else min(len(found.time), finer.states.shape[1])
    grid, states = found.time[:n], (found.states[:, :n], finer.states[:, :n])
    check = step_check(problem.dae, grid, *states, step)
    cause = finer_than_steps(found, problem.inputs) if check != StepCheck() else ""
    return check._replace(note=one_note(check.note, cause)), Ending()


def run(request: RunRequest) -> Trajectory:
    """Integrate a model.

    Args:
        request: The model, its values, times and settings; a `Goal` as solver is rejected.

    Returns:
        The requested variables of shape (n,), with their units; its method `at` computes the run
        at other times.

    Raises:
        UsageError: The solver cannot integrate the model.
        ParameterError: The output times do not increase, or no memory holds the results.
        InitialConditionError: The initial values contradict the constraints.
        SolverError: The solver failed, or the run stopped because a validity condition was violated
            or at a singular configuration; `partial` holds the outputs up to that time.
        Interrupted: Ctrl-C, a `KeyboardInterrupt`; `partial` holds the outputs up to that time.
        MissingTool: The equations must be compiled, and no compiler works.
    """
    request = with_largest_step(request)
    first: CosimError | None = None
    notes = list[str]()
    while True:
        prepared = prepare(request)
        try:
            found = _run_once(prepared, request)
            break
        except CosimError as failure:
            fallback = next_request(request, prepared, failure)
            first = first or failure
            if fallback is None:
                raise first from (None if first is failure else failure)
            request, note = fallback
            notes.append(note)
    if notes:
        assert isinstance(found.stats, RunStats)
        note = one_note(*notes, found.stats.note)
        found = replace(found, stats=replace(found.stats, note=note))
    if request.policy.record_events:
        found = found.with_events()
    return repeatable(found, request, prepared) if prepared.solver.adaptive else found


def repeatable(
    found: Trajectory,
    request: RunRequest,
    prepared: Prepared,
    simulate: Callable[[RunRequest], Trajectory] = run,
) -> Trajectory:
    """Return a run of an adaptive solver that can be computed at further times.

    Args:
        found: The run.
        request, prepared: Its request and plan.
        simulate: Computes the run of a request.
    """
    ends = float(prepared.problem.grid[-1]), float(found.time[-1])
    again = partial(run_at, simulate, request, ends)
    return replace(found, again=again, changes=partial(changes_in, request))


def changes_in(request: RunRequest) -> Vector:
    """Return between which times recorded variables may change within a part of a step, s.

    Conditions of outputs that switch very often are left out: all that is near them is looked at.
    """
    prepared = prepare(request)
    names, dae = tuple(c.name for c in prepared.columns), prepared.problem.dae
    switching = with_switching(dae, names)
    if not may_change(switching, names):
        return np.empty(0)
    passes_events = prepared.problem.compiled and prepared.inner.watches
    few = _MOST_COMPILED_SWITCHES if passes_events else _MOST_SWITCHES
    for own, most in {switching: few, dae: inf}.items():  # no limit if they are the same
        problem = replace(prepared.problem, dae=own, most_instants=most)
        motion, again, _ = _integrated(replace(prepared, problem=problem), request.numbers)
        if motion.reason == INTERRUPTED:
            raise KeyboardInterrupt
        if not motion.reason:
            return changes_of(own, names, motion, again)
    return np.empty(0)


def run_at(
    simulate: Callable[[RunRequest], Trajectory],
    request: RunRequest,
    ends: tuple[float, float],
    times: Vector,
) -> Trajectory:
    """Compute a run at other output times, with the same begin and end and thus the same steps.

    Args:
        simulate: Computes the run of a request.
        request: The run.
        ends: Its stop time, and when it ended, s; a stop may come earlier by rounding now.
        times: Output times, s, (m,).
    """
    own = Times.at(times, request.times.start, stop=ends[0])
    policy = replace(request.policy, record_events=False)
    found = simulate(replace(request, times=own, policy=policy))
    rows = np.searchsorted(found.time, times).clip(max=len(found.time) - 1)
    rows[times >= ends[1]] = -1
    return replace(found, time=times, values=found.values[rows])


class Recorded(NamedTuple):
    """What a run recorded.

    Attributes:
        time: Output times, s, (n,).
        table: Recorded values, SI, (n, columns).
        status: How the run ended.
        invalid: Where validity conditions or fixed steps are violated.
        note: What differs from the request; None if nothing does.
    """

    time: Vector
    table: Vector
    status: str
    invalid: Sequence[Breach]
    note: str | None


def _run_once(prepared: Prepared, request: RunRequest) -> Trajectory:
    """Run once, without a fallback."""
    began, compiling, values = perf_counter(), time_compiling(), request.numbers
    name = prepared.problem.dae.full_name
    with doing(name):
        integrated = _integrated(prepared, values)
        try:
            motion, recorded, reason = evaluated(prepared, integrated)
        except KeyboardInterrupt:  # what was computed is shown
            integrated.motion.reason = INTERRUPTED
            motion, recorded, reason = evaluated(prepared, integrated)
        times = perf_counter() - began, time_compiling() - compiling
        found = trajectory_of(prepared, motion, recorded, values, times)
    if reason == INTERRUPTED:
        raise Interrupted(f"{name}: {found.status}", found)
    if reason:
        raise _failure(prepared, reason, found)
    return found


def evaluated(prepared: Prepared, integrated: Integrated) -> tuple[Motion, Recorded, Ending]:
    """Return a motion up to its last good row, what it recorded, and why it stopped early."""
    motion = integrated.motion
    table, n, reason, invalid = _evaluated(prepared, integrated)
    if n < motion.states.shape[1]:  # what happened after the last good row is not a result
        events = [e for e in motion.events if n and e.time <= motion.time[n - 1]]
        motion = replace(motion, events=events, stop="")
    rows: slice | NDArray[np.intp] = slice(0, n)
    last, grid = n - 1 if motion.stop else n, prepared.problem.grid
    if prepared.rows is not None or not np.array_equal(motion.time[:last], grid[:last]):
        grid = grid if prepared.rows is None else grid[prepared.rows]
        recorded = np.flatnonzero(np.isin(motion.time[:n], grid))
        rows = np.union1d(recorded, [n - 1]) if motion.stop else recorded
    time, table = motion.time[rows], table[rows]
    table.setflags(write=False)  # a Trajectory need not copy it
    status = reason.after(motion.time[n - 1] if n else None) if reason else "complete"
    note = _note(prepared, integrated)
    return motion, Recorded(time, table, status, invalid, note), reason


def trajectory_of(
    prepared: Prepared,
    motion: Motion,
    recorded: Recorded,
    values: Values,
    times: tuple[float, float],
) -> Trajectory:
    """Return the result of a run.

    Args:
        prepared: The plan of the run.
        motion: Its motion, whose columns are not needed.
        recorded: What it recorded.
        values: Parameters, and inputs.
        times: That it took, and compilation as a part of that, s.
    """
    dae, stop, invalid = prepared.problem.dae, motion.stop, recorded.invalid
    stats = RunStats(
        solver=prepared.solver.name,
        relative_tolerance=getattr(prepared.solver, "relative_tolerance", None),
        step_size=getattr(prepared.solver, "step_size", None),
        solve_time=motion.solve_time,
        steps=motion.counts.steps,
        rhs_calls=motion.counts.rhs_calls,
        jacobian_calls=motion.counts.jacobian_calls,
        compiled=prepared.problem.compiled,
        wall_time=times[0],
        compile_time=times[1] or None,
        invalid=tuple(breach.reason for breach in invalid),
        note=recorded.note,
        invalid_from=invalid[0].reason.time if invalid else None,
        stop=f"{stop} from {recorded.time[-1]:.12g} s on" if stop else None,
        stop_time=float(recorded.time[-1]) if stop else None,
    )
    numbers, drawing = _numbers(dae, values.p.tobytes(), values.u.tobytes())
    return Trajectory(
        dae.full_name,
        recorded.time,
        prepared.columns,
        recorded.table,
        stats,
        recorded.status,
        drawing=drawing,
        numbers=dict(numbers),
        events=tuple(_both_sides(prepared, motion)) if motion.events else (),
    )


def _note(prepared: Prepared, integrated: Integrated) -> str | None:
    """Return what differs from the request, for the report; None if nothing does."""
    motion, again, check = integrated
    inner, problem = prepared.inner, prepared.problem
    tight = f"{inner.name} ran at {inner.settings}, because the errors of its steps add up"
    gaps = problem.inputs.gaps(*problem.grid[[0, -1]]) if problem.inputs else ""
    small = _small_states(problem.dae, inner, motion.states)
    if small and not motion.reason:
        seen = again(rows_between(motion, problem.grid))
        small = _small_states(problem.dae, inner, seen.states)
    changed = tight if inner != prepared.solver else ""
    return one_note(changed, gaps, prepared.note, small, motion.note, check.note) or None


def _small_states(dae: Dae, solver: Solver, states: Vector) -> str:
    """Return which states, (nx, n), are too small for a default absolute tolerance."""
    if not isinstance(solver, AdaptiveSolver) or solver.absolute_tolerance is not None:
        return ""
    if not states.size:
        return ""
    relative, absolute = solver.tolerance.pair
    sizes = own_sizes(dae, states[:, 0])
    columns = all_columns(dae)[: len(dae.states)]
    return uncontrolled(columns, states.T, relative, absolute * sizes)


def _failure(prepared: Prepared, reason: Ending, found: Trajectory) -> SolverError:
    """Return the error of a run that stopped early, with the time, the cause and the remedies."""
    dae, solver = prepared.problem.dae, prepared.solver
    what = f"{dae.full_name}: {solver.name} {found.status}"
    if reason.kind is EndKind.INVALID:
        return SolverError(f"{what}; on_invalid='warn' goes on from there", found, reason)
    if reason.remedy:
        return SolverError(what, found, reason)
    others = [n for n, s in SOLVERS.items() if s.solves_dae and n != solver.name]
    which = f" ({', '.join(others)})" if dae.algebraics else ""
    if dae.algebraics and dae.invariants and not prepared.problem.project:
        which += f'; {Dop853.name} with drift_control="projection" passes singular configurations'
    closer = ""
    if reason.kind is EndKind.TOO_MANY_STEPS:
        closer = f", or closer output times (for {MOST_STEPS:,} steps from one to the next)"
    return SolverError(
        f"{what} ({solver.settings}); look for a "
        "singularity near that state, or use another tolerance or step, formulation or "
        f"solver{which}{closer}",
        found,
        reason,
    )


@cached_per_thread(64)
def _numbers(dae: Dae, p: bytes, u: bytes) -> tuple[dict[str, float], Drawing]:
    """Return parameters and inputs by name, and the model's drawing with these values."""
    numbers = numbers_of(dae, Values(np.empty(0), np.frombuffer(p), np.frombuffer(u)))
    return numbers, dae.drawing.with_numbers(numbers)
