"""`run`: execute a request natively: integrate a DAE and return a `Trajectory`."""

from dataclasses import replace
from functools import partial
from time import perf_counter

import numpy as np

from casadi_models.dae import Dae, Drawing
from cosim.arrays import Vector
from cosim.codegen.compiler import time_compiling
from cosim.errors import CosimError, Interrupted, SolverError
from cosim.host.progress import doing
from cosim.integrate.call import INTERRUPTED, RunStats
from cosim.integrate.fallbacks import next_request
from cosim.integrate.families.explicit import Dop853
from cosim.integrate.families.plugin import MOST_STEPS
from cosim.integrate.preparation import Prepared, prepare
from cosim.integrate.solution import Solution, solve
from cosim.integrate.solvers import SOLVERS, with_largest_step
from cosim.memo import cached_per_thread
from cosim.model.request import RunRequest
from cosim.model.times import Times
from cosim.model.values import Values, numbers_of
from cosim.trajectory import Trajectory

_TOO_MANY_STEPS = ("TOO_MUCH_WORK", "too many steps at")  # as SUNDIALS and our solvers report it


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
        note = "; ".join(filter(None, (*notes, found.stats.note)))
        found = replace(found, stats=replace(found.stats, note=note))
    if request.policy.record_events:
        found = found.with_events()
    if prepared.solver.adaptive:
        ends = float(prepared.problem.grid[-1]), float(found.time[-1])
        found = replace(found, again=partial(run_at, request, ends))
    return found


def run_at(request: RunRequest, ends: tuple[float, float], times: Vector) -> Trajectory:
    """Compute a run at other output times, with the same begin and end and thus the same steps.

    Args:
        request: The run.
        ends: Its stop time, and when it ended, s; a stop may come earlier by rounding now.
        times: Output times, s, (m,).
    """
    own = Times.at(times, request.times.start, stop=ends[0])
    policy = replace(request.policy, record_events=False)
    found = run(replace(request, times=own, policy=policy))
    rows = np.searchsorted(found.time, times).clip(max=len(found.time) - 1)
    rows[times >= ends[1]] = -1
    return replace(found, time=times, values=found.values[rows])


def _run_once(prepared: Prepared, request: RunRequest) -> Trajectory:
    """Run once, without a fallback."""
    began, compiling = perf_counter(), time_compiling()
    dae, values, status = prepared.problem.dae, request.numbers, "complete"
    with doing(dae.full_name):
        solution = solve(prepared, values)
    compile_time = time_compiling() - compiling
    stats = _stats(prepared, solution, perf_counter() - began, compile_time)
    if solution.reason:
        last = "the start" if solution.reached is None else f"{solution.reached:g} s"
        status = f"stopped after {last}: {solution.reason}"
    numbers, drawing = _numbers(dae, values.p.tobytes(), values.u.tobytes())
    found = Trajectory(
        dae.full_name,
        solution.time,
        prepared.columns,
        solution.table,
        stats,
        status,
        drawing=drawing,
        numbers=dict(numbers),
        events=solution.events,
    )
    if solution.reason == INTERRUPTED:
        raise Interrupted(f"{dae.full_name}: {found.status}", found)
    if solution.reason:
        raise _failure(prepared, values, solution, found)
    return found


def _failure(
    prepared: Prepared, values: Values, solution: Solution, found: Trajectory
) -> SolverError:
    """Return the error of a run that stopped early, with the time, the cause and the remedies."""
    dae, solver = prepared.problem.dae, prepared.solver
    what = f"{dae.full_name}: {solver.name} {found.status}"
    if solution.reason in solution.invalid:
        return SolverError(f"{what}; on_invalid='warn' goes on from there", found)
    if "; " in solution.reason:  # it names the remedy
        return SolverError(what, found)
    others = [n for n, s in SOLVERS.items() if s.solves_dae and n != solver.name]
    which = f" ({', '.join(others)})" if dae.algebraics else ""
    if dae.algebraics and dae.invariants and not prepared.problem.project:
        which += f'; {Dop853.name} with drift_control="projection" passes singular configurations'
    closer = ""
    if any(words in solution.reason for words in _TOO_MANY_STEPS):
        closer = f", or closer output times (for {MOST_STEPS:,} steps from one to the next)"
    return SolverError(
        f"{what} ({solver.settings}); look for a "
        "singularity near that state, or use another tolerance or step, formulation or "
        f"solver{which}{closer}",
        found,
    )


@cached_per_thread(64)
def _numbers(dae: Dae, p: bytes, u: bytes) -> tuple[dict[str, float], Drawing]:
    """Return parameters and inputs by name, and the model's drawing with these values."""
    numbers = numbers_of(dae, Values(np.empty(0), np.frombuffer(p), np.frombuffer(u)))
    return numbers, dae.drawing.with_numbers(numbers)


def _stats(
    prepared: Prepared, solution: Solution, wall_time: float, compile_time: float
) -> RunStats:
    solver, inner = prepared.solver, prepared.inner
    tight = f"{inner.name} ran at {inner.settings}, because the errors of its steps add up"
    problem = prepared.problem
    gaps = problem.inputs.gaps(*problem.grid[[0, -1]]) if problem.inputs else ""
    return RunStats(
        solver=solver.name,
        relative_tolerance=getattr(solver, "relative_tolerance", None),
        step_size=getattr(solver, "step_size", None),
        solve_time=solution.solve_time,
        steps=solution.counts.steps,
        rhs_calls=solution.counts.rhs_calls,
        jacobian_calls=solution.counts.jacobian_calls,
        compiled=problem.compiled,
        wall_time=wall_time,
        compile_time=compile_time or None,
        invalid=solution.invalid,
        note="; ".join(filter(None, (tight if inner != solver else "", gaps, prepared.note)))
        or None,
        invalid_from=solution.invalid_from,
        stop=(solution.stop and f"{solution.stop} from {solution.time[-1]:.12g} s on") or None,
        stop_time=float(solution.time[-1]) if solution.stop else None,
    )
