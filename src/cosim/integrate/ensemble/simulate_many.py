"""`simulate_many`: many variants of one model, in SIMD lanes or one by one."""

import ctypes
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from threading import Condition, Thread
from time import perf_counter
from typing import Unpack, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from casadi_models.dae import Dae
from cosim.arrays import Truths, Vector
from cosim.codegen.compiler import has_compiler
from cosim.codegen.initialization import DEFECT_LIMIT
from cosim.codegen.pulses import pulse_within_a_step
from cosim.codegen.runge_kutta.lane_library import Batch, LaneLibrary, lane_library, processor_lanes
from cosim.codegen.runge_kutta.lanes import fits_lanes
from cosim.errors import InitialConditionError, Interrupted, ParameterError, SolverError, UsageError
from cosim.integrate.ensemble.ensemble import Ensemble, RunState, shared_rows
from cosim.integrate.families.explicit import Dop853
from cosim.integrate.initial_values import start_values
from cosim.integrate.keywords import SharedKeywords, requested
from cosim.integrate.modes import hybrid
from cosim.integrate.outputs import all_columns, watching
from cosim.integrate.run import run
from cosim.integrate.solvers import chosen_solver, with_largest_step
from cosim.memo import cached_per_thread
from cosim.model.many_values import ManyValues, assign_many
from cosim.model.request import OnInvalid, RunRequest
from cosim.model.solver import Solver, Tolerance
from cosim.model.values import Values, assign, numbers_of, own_sizes
from cosim.trajectory import Column, Trajectory


def in_lanes(
    request: RunRequest, values: ManyValues, tolerance: Tolerance, threads: int, lanes: int | None
) -> Ensemble:
    """Run an explicit formulation in lanes.

    Args:
        request: The run; its values are ignored.
        values: Values of every run.
        tolerance: Tolerance and largest step of the solver.
        threads, lanes: See `simulate_many`.
    """
    on_invalid = request.policy.on_invalid
    names = request.outputs or request.dae.observed
    dae = watching(request.dae, names)
    grid = request.times.grid(dae, len(values) * len(names))
    if on_invalid is OnInvalid.IGNORE:
        dae = _unlimited(dae)
    compiled = lane_library(dae, names, lanes or processor_lanes())
    refused, runs = dict(values.refused), len(values)
    x = np.ascontiguousarray(values.x)
    known = (np.ascontiguousarray(rows) for rows in (values.u, values.p))
    possible = lane_starts(compiled, dae, float(grid[0]), x, *known)
    for i in np.flatnonzero(~possible):
        if int(i) not in refused:
            refused[int(i)] = _why_no_start(dae, float(grid[0]), values, int(i))
    going = np.array([i for i in range(runs) if i not in refused], dtype=np.int64)
    declared = tolerance.absolute is not None  # a requested one is of the declared values
    sizes = own_sizes(dae, np.zeros_like(x) if declared else x)
    nominal = np.array(2.0 ** np.round(np.log2(sizes)), dtype=float)
    table = (x, nominal, values.u, values.p)
    result = run_lanes(
        compiled,
        len(names),
        table if len(going) == runs else [rows[going] for rows in table],
        grid,
        (*tolerance.pair, tolerance.max_step or np.inf),
        threads=threads,
        stop_outside=on_invalid is OnInvalid.STOP,
    )
    states = [RunState.REFUSED] * runs
    reasons: dict[int, str] = refused
    invalid: dict[int, str] = {}
    for position, number in enumerate(going.tolist()):
        states[number], reason, outside = _outcome(dae, result.report[position], grid)
        if reason:
            reasons[number] = reason
        if outside and on_invalid is not OnInvalid.IGNORE:
            invalid[number] = outside
    everything, report = result.values, result.report
    if len(going) < runs:
        everything = np.full((runs, *result.values.shape[1:]), np.nan)
        everything[going] = result.values
        report = np.zeros(runs, report.dtype)
        report["error"] = np.nan
        report[going] = result.report
    output_times = request.times.requested if request.times.own else grid
    rows = np.searchsorted(grid, output_times)
    return Ensemble(
        dae.full_name,
        output_times,
        _columns(dae, names),
        everything if len(rows) == len(grid) else everything[:, rows],
        values.given,
        tuple(states),
        reasons,
        invalid,
        reached=np.searchsorted(rows, report["good"]),
        steps=report["steps"].astype(np.int64),
        rhs_calls=report["rhs_calls"].astype(np.int64),
        error=report["error"] * (tolerance.relative or 1.0),
        stats={"lanes": compiled.lanes, "solve_time": result.solve_time},
    )


@cached_per_thread(16)
def _unlimited(dae: Dae) -> Dae:
    """Return the DAE without validity conditions, which are then not computed."""
    return replace(dae, limits=())


def _outcome(dae: Dae, report: np.void, grid: Vector) -> tuple[RunState, str, str]:
    """Return how a run in lanes ended, why, and the violated validity condition with its time."""
    code, good, at = (int(report[name]) for name in ("code", "good", "outside"))
    outside = ""
    if at >= 0:
        meaning = dae.limits[int(report["limit"])][1]
        outside = f"from {grid[at]:g} s on it is no longer true that {meaning}"
    if not code:
        return RunState.COMPLETE, "", outside
    last = f"{grid[good - 1]:g} s" if good else "the start"
    if code == OUTSIDE:
        return RunState.STOPPED, f"stopped after {last}: {outside}", outside
    state = RunState.INTERRUPTED if code == HALTED else RunState.FAILED
    at_time = "" if code == HALTED else f" at t = {report['ended']:g}"
    return state, f"stopped after {last}: {CAUSES[code]}{at_time}", outside


def _why_no_start(dae: Dae, t: float, values: ManyValues, run: int) -> str:
    try:
        start_values(dae, t, Values(values.x[run], values.p[run], values.u[run]))
    except InitialConditionError as error:
        return str(error)
    return (
        f"{dae.full_name}: calculated start values do not exist or are out of bounds; change the "
        "other values"
    )


def one_by_one(request: RunRequest, values: ManyValues) -> Ensemble:
    """Run every variant by `run`; see `in_lanes`.

    Args:
        request: The run; its values are ignored.
        values: Values of every run.
    """
    names = request.outputs or request.dae.observed
    dae = watching(request.dae, names)
    grid = request.times.grid(dae, len(values) * len(names))
    grid = request.times.requested if request.times.own else grid
    runs, interrupted = len(values), False
    table = np.full((runs, len(grid), len(names)), np.nan)
    states, reasons, invalid = [RunState.INTERRUPTED] * runs, dict[int, str](), dict[int, str]()
    counts, with_events = np.zeros((3, runs), dtype=np.int64), dict[int, Trajectory]()
    for number in range(runs):
        reasons[number] = "interrupted"
        if interrupted:
            continue
        if number in values.refused:
            states[number], reasons[number] = RunState.REFUSED, values.refused[number]
            continue
        given = {name: float(column[number]) for name, column in values.given.items()}
        try:
            found = run(replace(request, values=given))
            states[number] = RunState.COMPLETE
            del reasons[number]
        except SolverError as error:
            if error.partial is None:
                states[number], reasons[number] = RunState.FAILED, str(error)
                continue
            found, reasons[number] = cast(Trajectory, error.partial), error.partial.status
            stopped = "it is no longer true that" in error.partial.status
            states[number] = RunState.STOPPED if stopped else RunState.FAILED
        except Interrupted as error:
            found, interrupted = cast(Trajectory, error.partial), True
        except (ParameterError, InitialConditionError) as error:
            states[number], reasons[number] = RunState.REFUSED, str(error)
            continue
        n = shared_rows(found, grid)
        table[number, :n] = found.values[:n]
        if found.events:
            with_events[number] = found
        counts[:, number] = (n, *(found.stats.get(k, 0) for k in ("steps", "rhs_calls")))
        if "invalid" in found.stats:
            invalid[number] = found.stats["invalid"][0]
    return Ensemble(
        dae.full_name,
        grid,
        _columns(dae, names),
        table,
        values.given,
        tuple(states),
        reasons,
        invalid,
        reached=counts[0],
        steps=counts[1],
        rhs_calls=counts[2],
        error=np.full(runs, np.nan),
        with_events=with_events,
    )


def _columns(dae: Dae, names: Sequence[str]) -> tuple[Column, ...]:
    known = {column.name: column for column in all_columns(dae)}
    return tuple(known[name] for name in names)


CAUSES = {  # by code of the library
    1: "too many steps",
    2: "step size too small",
    4: "a state or an output is not finite",
    5: "interrupted",
    6: "outside the model's validity conditions",
}
HALTED, OUTSIDE = 5, 6


# Report of a run. code: 0 for success, or a key of `CAUSES`; good: number of valid output times;
# ended: time at which the run ended, s; error: sum of the estimated errors of the steps, in units
# of the tolerance; outside: position of the first output time that violates a validity condition,
# -1 for none; limit: position of that condition.
_FIELDS = ("code", "steps", "rhs_calls", "good", "ended", "error", "outside", "limit")
_REPORT = np.dtype([(name, float) for name in _FIELDS])


@dataclass(frozen=True)
class LaneResults:
    """Results of the lanes.

    Attributes:
        values: Outputs, SI, (runs, times, outputs); NaN after the last valid output time.
        report: How each run ended, (runs,), with the fields of `_REPORT`.
        solve_time: Time of all runs, s.
    """

    values: Vector
    report: NDArray[np.void]
    solve_time: float


def lane_starts(
    compiled: LaneLibrary, dae: Dae, t: float, x: Vector, u: Vector, p: Vector
) -> Truths:
    """Compute initial values in place, and return which runs have valid ones, (runs,).

    Args:
        compiled: The model's library.
        dae: The model.
        t: Begin of the runs, s.
        x: Initial values, or guesses if they are calculated, SI, (runs, nx); overwritten.
        u, p: Inputs and parameters, SI, (runs, nu) and (runs, np).
    """
    defect = np.zeros(len(x))
    if dae.start_rules:
        addresses = (row.ctypes.data for row in (x, u, p, defect))
        compiled.library.lanes_start(len(x), t, *addresses)
    low = np.array([v.minimum for v in dae.states])
    high = np.array([v.maximum for v in dae.states])
    good: Truths = ((x >= low) & (x <= high)).all(axis=1) & (defect < DEFECT_LIMIT)
    return good


def run_lanes(
    compiled: LaneLibrary,
    outputs: int,
    starts: Sequence[Vector],
    grid: Vector,
    limits: tuple[float, float, float],
    *,
    threads: int,
    stop_outside: bool,
) -> LaneResults:
    """Integrate every run over a grid of output times.

    Args:
        compiled: The model's library.
        outputs: Number of outputs that it records.
        starts: Consistent x0 and nominal values of the states, inputs u, parameters p, SI: (runs,
            nx) twice, (runs, nu), (runs, np).
        grid: Output times, s, (n,); the first is the begin of the runs.
        limits: Relative and absolute tolerance (1), and the largest step, s.
        threads: Largest number of threads; results do not depend on it.
        stop_outside: Whether a run ends when a validity condition is violated.
    """
    runs, points = len(starts[0]), len(grid)
    x0, nominal, u, p = (np.ascontiguousarray(rows, dtype=float) for rows in starts)
    values, report = np.empty((runs, points, outputs)), np.empty(runs, _REPORT)
    following, stop = np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int32)
    batch = Batch(
        runs,
        points,
        *(array.ctypes.data for array in (x0, nominal, u, p, grid)),
        *limits,
        *(array.ctypes.data for array in (values, report, following, stop)),
        int(stop_outside),
    )
    failed: list[bool] = []
    begun: list[bool] = []
    news = Condition()  # `Thread.join` returns too early after Ctrl-C (Python 3.11)

    def work() -> None:
        with news:
            if stop[0]:
                return
            begun.append(True)
        outcome = bool(compiled.library.lanes_run(ctypes.byref(batch)))
        with news:
            failed.append(outcome)
            news.notify_all()

    began = perf_counter()
    most = max(1, min(threads, runs // (2 * compiled.lanes)))
    workers = [Thread(target=work, daemon=True) for _ in range(most)]
    waiting, interrupted = iter(workers), False
    while True:
        try:
            for worker in () if interrupted else waiting:
                worker.start()
            with news:
                stop[0] = interrupted
                news.wait_for(lambda: len(failed) == (len(begun) if stop[0] else most))
            break
        except KeyboardInterrupt:
            interrupted = True
    if any(failed):
        raise MemoryError("not enough memory for one run in each lane; use fewer output times")
    first = min(int(following[0]), runs)  # the first run that no lane has begun
    report[first:] = 0
    report["code"][first:], report["outside"][first:] = HALTED, -1
    values[first:] = np.nan
    return LaneResults(values, report, perf_counter() - began)


def simulate_many(
    dae: Dae | str | RunRequest,
    start_values: Mapping[str, ArrayLike] | None = None,
    *,
    threads: int | None = None,
    lanes: int | None = None,
    **keywords: Unpack[SharedKeywords],
) -> Ensemble:
    """Integrate many variants of a model.

    Explicit formulations run in SIMD lanes with `dop853`, each variant with its own steps; the
    result of a variant does not depend, bit for bit, on the others, on their order or on the
    threads. Variants of other models, with other solvers or with input series, and variants on
    machines without a compiler run one by one.

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
    if threads is not None and (type(threads) is not int or threads < 1):
        raise UsageError.of_type("simulate_many: threads", threads, "a positive whole number")
    request = with_largest_step(requested(dae, **keywords))
    if request.policy.stop_when is not None:
        raise UsageError(f"{request.dae.full_name}: stop_when is for single runs; leave it out")
    columns = {**request.values, **(start_values or {})} if request.values else start_values
    values = assign_many(request.dae, columns)
    solver = _lane_solver(request)
    if solver is not None:
        chosen: Solver = solver
        found = in_lanes(request, values, solver.tolerance, threads or processors(), lanes)
    else:
        if lanes is not None:
            why = "explicit formulations and dop853, compiled, without input series"
            if hybrid(request.dae) is not None:
                why = "models without events, which happen at another time in each run"
            raise UsageError(f"{request.dae.full_name}: lanes are for {why}; leave lanes out")
        chosen, _ = chosen_solver(request.dae, request.solver, projected=request.policy.projects)
        found = one_by_one(request, values)
    numbers = {name: value for name, value in vars(chosen).items() if value is not None}
    stats = {"solver": chosen.name, **numbers, **found.stats}
    ensemble = replace(
        found,
        stats=stats | {"wall_time": perf_counter() - began},
        drawing=request.dae.drawing,
        numbers=numbers_of(request.dae, assign(request.dae)),
    )
    if ensemble.interrupted:
        done = int(ensemble.complete.sum())
        raise Interrupted(
            f"{request.dae.full_name}: interrupted after {done} of {len(ensemble)} runs", ensemble
        )
    return ensemble


def runs_in_lanes(request: RunRequest) -> bool:
    """Return whether `simulate_many` runs variants of a request in lanes."""
    return _lane_solver(request) is not None


def _lane_solver(request: RunRequest) -> Dop853 | None:
    """Return the solver for lanes; None if variants run one by one."""
    dae, solver, policy = request.dae, request.solver, request.policy
    begin, end = request.times.span(dae)
    explicit = not dae.algebraics and bool(dae.states) and fits_lanes(dae) and hybrid(dae) is None
    plain = request.inputs is None and policy.drift_control is None and policy.compiled is not False
    if not (explicit and plain and end > begin and has_compiler()):
        return None
    longest = request.max_step or end - begin
    if pulse_within_a_step(dae, request.numbers.p, begin, end, longest):
        return None
    if isinstance(solver, Dop853):
        return solver
    if solver is None or isinstance(solver, Tolerance):
        return Dop853(**(solver or Tolerance()).keywords)
    return None


def processors() -> int:
    """Return how many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
