"""`simulate_many`: many variants of one model, in SIMD lanes or one by one."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import Unpack

import casadi as ca
import numpy as np
from casadi import SX
from numpy.typing import ArrayLike

from casadi_models.dae import Dae
from cosim.arrays import Integers, Vector
from cosim.codegen.compiler import has_compiler
from cosim.codegen.landmarks import landmarks
from cosim.codegen.runge_kutta.lanes import fits_lanes
from cosim.codegen.terms import pulse_within_a_step
from cosim.errors import (
    FmuError,
    InitialConditionError,
    Interrupted,
    ParameterError,
    SolverError,
    UsageError,
)
from cosim.integrate.call import RunStats
from cosim.integrate.ensemble.ensemble import Ensemble, LazyRuns, Row, RunState
from cosim.integrate.ensemble.event_blocks import EventBlocks, event_blocks
from cosim.integrate.ensemble.lanes import in_lanes, processors
from cosim.integrate.families.explicit import Dop853, NonStiffDop853
from cosim.integrate.growth import may_grow_again
from cosim.integrate.keywords import SharedKeywords, reject_driven, requested
from cosim.integrate.modes import hybrid
from cosim.integrate.outputs import recorded_columns, watching
from cosim.integrate.run import changes_in, run
from cosim.integrate.solvers import chosen_solver, with_largest_step
from cosim.model.many_values import ManyValues, assign_many
from cosim.model.request import OnInvalid, RunRequest
from cosim.model.solver import Solver, Tolerance
from cosim.model.times import Times
from cosim.model.values import MOST_COUNT, assign, numbers_of, settable_variable, whole
from cosim.text import one_note
from cosim.trajectory import Column, Trajectory

_MOST_LANES = 64
_Ended = tuple[RunState, str, Row | None]  # how, why if not complete, and what there is of a run


def simulate_many(
    dae: Dae | str | RunRequest,
    start_values: Mapping[str, ArrayLike] | None = None,
    *,
    threads: int | None = None,
    lanes: int | None = None,
    **keywords: Unpack[SharedKeywords],
) -> Ensemble:
    """Integrate many variants of a model.

    Explicit formulations run in SIMD lanes with `dop853`, or in blocks if they have events, each
    variant with its own steps; the result of a variant does not depend, bit for bit, on the others,
    on their order or on the threads. Variants of other models, with other solvers or with input
    series, variants that begin at an unstable equilibrium but for a tiny deviation, and variants on
    machines without a compiler run one by one, as do variants that are too stiff for `dop853`.

    Args:
        dae: The model, or a request whose fields are the defaults; SI units throughout.
        start_values: Arrays by name, (runs,), or numbers for all runs, that replace initial values
            of states, parameters, or inputs.
        threads: Largest number of threads; one per processor when None.
        lanes: Number of SIMD lanes: 1, 2, 4 or 8; that of the processor when None. Sums are rounded
            in the same way for each number; sines may differ in the last bits.
        keywords: See `simulate`; a goal and `stop_when` are rejected.

    Returns:
        Every output of every run, and how each run ended; runs that are rejected or fail are rows
        as well.

    Raises:
        UnknownName, UsageError, MissingTool: See `simulate`.
        ParameterError: Arrays differ in length, or times do not increase.
        Interrupted: Ctrl-C; `partial` is the ensemble with the runs that were complete.

    Example:
        >>> import cosim
        >>> gravity = {"g": [1.62, 9.81]}  # Moon, Earth
        >>> many = simulate_many(cosim.load("bicycle"), gravity, outputs=["phi"], stop_time=1)
        >>> many["phi"].shape
        (2, 101)
    """
    began = perf_counter()
    for name, count, most in (("threads", threads, MOST_COUNT), ("lanes", lanes, _MOST_LANES)):
        if count is not None:
            whole("simulate_many", name, count, most=most)
    request = with_largest_step(requested(dae, **keywords))
    if request.policy.stop_when is not None:
        raise UsageError(f"{request.dae.full_name}: stop_when is for single runs; leave it out")
    reject_driven(request.dae.full_name, keywords.get("inputs"), start_values)
    columns = {**request.values, **(start_values or {})} if request.values else start_values
    values = assign_many(request.dae, columns)
    request = request.without_series(start_values or ())
    chosen = usual_solver(request)
    solver = lane_solver(request)
    if solver is not None:
        chosen = solver
        workers = threads or processors()
        found, growing, stuck = in_lanes(request, values, solver.tolerance, workers, lanes)
        stuck = stuck if solver != request.solver else stuck[:0]
        alone = np.union1d(growing, _with_short_terms(request.dae, values.p))
        for own, runs in (replace(request, solver=solver), alone), (request, stuck):
            if len(runs) and not found.interrupted:
                found = found.with_runs(runs, _one_by_one(own, values.select(runs), solver))
    else:
        if lanes is not None:
            why = "explicit formulations and dop853, compiled, without input series"
            if hybrid(request.dae) is not None:
                why = "models without events, which happen at another time in each run"
            raise UsageError(f"{request.dae.full_name}: lanes are for {why}; leave lanes out")
        blocks = event_blocks(request, values, explicit_solver(request))
        chosen = chosen if blocks is None else blocks.solver
        found = _one_by_one(request, values, chosen, blocks)
    stats = {"solver": chosen.name, **chosen.numbers, **found.stats}
    again = changes = None
    if chosen.adaptive:
        again = partial(values_at, request, values.given, lanes)
        changes = partial(_changes_in_run, replace(request, solver=chosen), values.given)
    ensemble = replace(
        found,
        again=again,
        changes=changes,
        stats=stats | {"wall_time": perf_counter() - began},
        drawing=request.dae.drawing,
        numbers=numbers_of(request.dae, assign(request.dae)),
        units={name: settable_variable(request.dae, name).unit for name in values.given},
    )
    if ensemble.interrupted:
        done = int(ensemble.complete.sum())
        raise Interrupted(
            f"{request.dae.full_name}: interrupted after {done} of {len(ensemble)} runs", ensemble
        )
    return ensemble


def values_at(
    request: RunRequest,
    given: Mapping[str, Vector],
    lanes: int | None,
    times: Vector,
    runs: Integers,
) -> Vector:
    """Compute variants at other output times, with the same begin and end and thus the same steps.

    Args:
        request: The request of all variants.
        given: Their values by name.
        lanes: See `simulate_many`.
        times: Output times, s, (n,).
        runs: Positions of the variants, (m,).

    Returns:
        Values, (m, n, outputs); NaN where a variant fails.
    """
    stop = request.times.span(request.dae)[1]
    own = Times.at(times, request.times.start, stop=stop)
    policy = replace(request.policy, on_invalid=OnInvalid.IGNORE)
    asked = replace(request, times=own, policy=policy, values={})
    return simulate_many(asked, {n: rows[runs] for n, rows in given.items()}, lanes=lanes).values


def _changes_in_run(request: RunRequest, given: Mapping[str, Vector], run: int) -> Vector:
    """Return between which times recorded variables of a variant may change; see `changes_in`."""
    own = {name: float(rows[run]) for name, rows in given.items()}
    return changes_in(replace(request, values=own))


def runs_in_lanes(request: RunRequest) -> bool:
    """Return whether `simulate_many` runs variants of a request in lanes."""
    return lane_solver(request) is not None


def lane_solver(request: RunRequest) -> Dop853 | None:
    """Return the solver for lanes, with its tolerance; None if variants run one by one."""
    dae, policy, solver = request.dae, request.policy, explicit_solver(request)
    begin, end = request.times.span(dae)
    plain = request.inputs is None and policy.drift_control is None and not dae.algebraics
    if solver is None or not (plain and end > begin and fits_lanes(dae) and hybrid(dae) is None):
        return None
    resting = {v.name for v in dae.inputs}  # in each run
    if {*landmarks(dae).moving, *landmarks(dae).passed} - resting:
        return None
    longest = request.max_step or end - begin
    if pulse_within_a_step(dae, request.numbers.p, begin, end, longest):
        return None
    return solver


def _with_short_terms(dae: Dae, p: Vector) -> Integers:
    """Return the positions of the runs whose parameters, (runs, np), make a term short."""
    gentle = landmarks(dae).gentle
    sizes = ca.Function("sizes", [dae.p], [ca.vertcat(SX(1), *gentle.values())])
    return np.flatnonzero((np.array(sizes(p.T)) <= 0).any(axis=0))


def usual_solver(request: RunRequest) -> Solver:
    """Return the solver of single runs of a request."""
    return chosen_solver(request.dae, request.solver, projected=request.policy.projects)[0]


def explicit_solver(request: RunRequest) -> Dop853 | None:
    """Return the compiled solver of many variants; None if another one is requested or better."""
    dae, solver = request.dae, request.solver
    if not dae.states or request.policy.compiled is False or not has_compiler():
        return None
    if may_grow_again(dae):
        return None  # a run that has lost digits is repeated
    if isinstance(solver, Dop853):
        return solver
    if not dae.algebraics and (solver is None or isinstance(solver, Tolerance)):
        kind = Dop853 if hybrid(dae) is None else NonStiffDop853
        return kind(**(solver or Tolerance()).numbers)
    return None


def _one_by_one(
    request: RunRequest, values: ManyValues, solver: Solver, blocks: EventBlocks | None = None
) -> Ensemble:
    """Run every variant in blocks or by `run`; see `in_lanes`.

    Args:
        request: The run; its values are ignored.
        values: Values of every run.
        solver: The solver of all variants; a note says which of them have another one.
        blocks: Runs that are computed together; None if there are none.
    """
    names = request.outputs or request.dae.observed
    dae = watching(request.dae, names)
    grid = request.times.grid(dae, len(values) * len(names))
    usual = usual_solver(request)

    def alone(given: dict[str, float]) -> Trajectory:
        found = run(replace(request, values=given))
        if solver.name == usual.name:
            return found
        assert isinstance(found.stats, RunStats)
        other = f"computed by {usual.name}, not {solver.name}"
        note = one_note(other, found.stats.note)
        return replace(found, stats=replace(found.stats, note=note))

    return one_by_one(
        dae.full_name,
        request.times.requested if request.times.own else grid,
        recorded_columns(dae, names)[0],
        values.given,
        len(values),
        alone,
        values.refused,
        stops=request.policy.on_invalid is OnInvalid.STOP,
        blocks=blocks,
    )


def _ended(simulate: Callable[[], Row], time: Vector, stops: bool) -> _Ended:
    """Return the end of a run, complete or not.

    Args:
        simulate: Simulates.
        time, stops: See `one_by_one`.
    """
    try:
        return RunState.COMPLETE, "", simulate()
    except SolverError as error:
        if error.partial is None:
            return RunState.FAILED, str(error), None
        row = Row.of(error.partial, time)
        stopped = stops and row.invalid
        return RunState.STOPPED if stopped else RunState.FAILED, error.partial.status, row
    except KeyboardInterrupt as error:
        found = error.partial if isinstance(error, Interrupted) else None
        begun = None if found is None else Row.of(found, time)
        return RunState.INTERRUPTED, "interrupted", begun
    except FmuError as error:
        return RunState.FAILED, str(error), None
    except (ParameterError, InitialConditionError) as error:
        return RunState.REFUSED, str(error), None


def one_by_one(
    model: str,
    time: Vector,
    columns: tuple[Column, ...],
    given: Mapping[str, Vector],
    runs: int,
    simulate: Callable[[dict[str, float]], Trajectory],
    refused: Mapping[int, str],
    *,
    stops: bool,
    blocks: EventBlocks | None = None,
) -> Ensemble:
    """Simulate every run, whatever becomes of the others.

    Args:
        model: Its name.
        time: Output times, s, (times,).
        columns: The outputs.
        given: Values by name, (runs,) each.
        runs: Number of runs.
        simulate: Simulates with values by name.
        refused: Why runs are not possible, by position.
        stops: Whether a run ends when a validity condition is violated.
        blocks: Runs that are computed together; None if there are none.
    """
    table = np.full((runs, len(time), len(columns)), np.nan)
    states, reasons = [RunState.INTERRUPTED] * runs, dict[int, str]()
    counts, done = np.zeros((3, runs), dtype=np.int64), dict[int, Row]()

    def row_of(number: int) -> Row:
        known = blocks.take(number) if blocks else None
        own = {name: float(column[number]) for name, column in given.items()}
        return known or Row.of(simulate(own), time)

    interrupted = False
    for number in range(runs):
        ended: _Ended = RunState.INTERRUPTED, "interrupted", None
        if number in refused and not interrupted:
            ended = RunState.REFUSED, refused[number], None
        elif not interrupted:
            ended = _ended(partial(row_of, number), time, stops)
        states[number], reason, row = ended
        interrupted = states[number] is RunState.INTERRUPTED
        if reason:
            reasons[number] = reason
        if row is not None:
            n = len(row.values)
            table[number, :n] = row.values
            counts[:, number] = n, row.steps, row.rhs_calls
            done[number] = row._replace(values=table[number, :n])
    return Ensemble(
        model,
        time,
        columns,
        table,
        given,
        tuple(states),
        reasons,
        {i: row.invalid for i, row in done.items() if row.invalid},
        reached=counts[0],
        steps=counts[1],
        rhs_calls=counts[2],
        error=np.full(runs, np.nan),
        notes={i: row.note for i, row in done.items() if row.note},
        with_events=LazyRuns({i: row.run for i, row in done.items() if row.run is not None}),
    )
