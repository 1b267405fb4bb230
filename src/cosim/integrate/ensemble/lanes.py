"""Runs of one model in SIMD lanes and threads, by a compiled solver."""

import ctypes
import os
from collections.abc import Sequence
from dataclasses import replace
from threading import Condition, Thread
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from casadi_models.dae import Dae
from cosim.arrays import Integers, Truths, Vector
from cosim.codegen.initialization import DEFECT_LIMIT
from cosim.codegen.runge_kutta.lane_library import Batch, lane_library, processor_lanes
from cosim.errors import InitialConditionError
from cosim.integrate.ensemble.ensemble import Ensemble, RunState
from cosim.integrate.growth import growing_starts
from cosim.integrate.initial_values import start_values
from cosim.integrate.outputs import recorded_columns, watching
from cosim.memo import cached_per_thread
from cosim.model.growth import controlled_half
from cosim.model.many_values import ManyValues
from cosim.model.request import OnInvalid, RunRequest
from cosim.model.solver import Tolerance
from cosim.model.state_path import SHORTEST
from cosim.model.values import Values, error_sizes
from cosim.text import Ending, EndKind, Violation, violated

CAUSES = {  # by code of the library
    1: "too many steps",
    2: "step size too small",
    4: "a state or an output is not finite",
    5: "interrupted",
    6: "outside the model's validity conditions",
}
STUCK, HALTED, OUTSIDE = 1, 5, 6


# Report of a run. code: 0 for success, or a key of `CAUSES`; good: number of valid output times;
# ended: time at which the run ended, s; error: sum of the estimated errors of the steps, in units
# of the tolerance; left: time from which a validity condition is violated, s, infinite for none;
# limit: position of that condition; calm: whether the motion begins as a line in time.
_FIELDS = ("code", "steps", "rhs_calls", "good", "ended", "error", "left", "limit", "calm")
_REPORT = np.dtype([(name, float) for name in _FIELDS])


def lane_starts(
    library: ctypes.CDLL, dae: Dae, t: float, x: Vector, u: Vector, p: Vector
) -> Truths:
    """Compute initial values in place, and return which runs have valid ones, (runs,).

    Args:
        library: The model's library.
        dae: The model.
        t: Start of the runs, s.
        x: Initial values, or guesses if they are calculated, SI, (runs, nx); overwritten.
        u, p: Inputs and parameters, SI, (runs, nu) and (runs, np).
    """
    defect = np.zeros(len(x))
    if dae.start_rules:
        addresses = (row.ctypes.data for row in (x, u, p, defect))
        library.lanes_start(len(x), t, *addresses)
    return within_bounds(dae, x) & (defect < DEFECT_LIMIT)


def within_bounds(dae: Dae, x: Vector) -> Truths:
    """Return which initial values, SI, (runs, nx), are within the bounds of a model's states."""
    low = np.array([v.minimum for v in dae.states])
    high = np.array([v.maximum for v in dae.states])
    return np.asarray(((x >= low) & (x <= high)).all(axis=1))


def run_lanes(
    library: ctypes.CDLL,
    lanes: int,
    outputs: int,
    starts: Sequence[Vector],
    grid: Vector,
    limits: tuple[float, float, float],
    *,
    threads: int,
    stop_outside: bool,
    steps: Vector | None = None,
) -> tuple[Vector, NDArray[np.void], float]:
    """Integrate every run over a grid of output times.

    Args:
        library: The model's library.
        lanes: Number of its lanes.
        outputs: Number of outputs that it records.
        starts: Consistent x0 and nominal values of the states, inputs u, parameters p, SI: (runs,
            nx) twice, (runs, nu), (runs, np).
        grid: Output times, s, (n,); the first is the start of the runs.
        limits: Relative and absolute tolerance (1), and the largest step, s.
        threads: Largest number of threads; results do not depend on it.
        stop_outside: Whether a run ends when a validity condition is violated.
        steps: Step sizes that runs begin with, s, (runs,), 0 where they are to be found; replaced
            by those that they would go on with.

    Returns:
        The outputs, SI, (runs, times, outputs), NaN after the last valid output time; how each run
        ended, (runs,), with the fields of `_REPORT`; and the time of all runs, s.
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
        SHORTEST * (grid[-1] - grid[0]),
        controlled_half(*limits[:2]),
        *(array.ctypes.data for array in (values, report, following, stop)),
        int(stop_outside),
        None if steps is None else steps.ctypes.data,
    )
    failed: list[bool] = []
    begun: list[bool] = []
    news = Condition()  # `Thread.join` returns too early after Ctrl-C (Python 3.11)

    def work() -> None:
        with news:
            if stop[0]:
                return
            begun.append(True)
        outcome = bool(library.lanes_run(ctypes.byref(batch)))
        with news:
            failed.append(outcome)
            news.notify_all()

    began = perf_counter()
    most = max(1, min(threads, runs // (2 * lanes)))
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
    report["code"][first:], report["left"][first:] = HALTED, np.inf
    values[first:] = np.nan
    return values, report, perf_counter() - began


def in_lanes(
    request: RunRequest, values: ManyValues, tolerance: Tolerance, threads: int, lanes: int | None
) -> tuple[Ensemble, Integers, Integers]:
    """Run an explicit formulation in lanes.

    Args:
        request: The run; its values are ignored.
        values: Values of every run.
        tolerance: Tolerance and largest step of the solver.
        threads, lanes: See `simulate_many`.

    Returns:
        The runs, and the positions of those in which a deviation grows that no step has seen, and
        of those that take too many steps.
    """
    on_invalid = request.policy.on_invalid
    names = request.outputs or request.dae.observed
    dae = watching(request.dae, names)
    grid = request.times.grid(dae, len(values) * len(names))
    if on_invalid is OnInvalid.IGNORE:
        dae = _unlimited(dae)
    lanes = lanes or processor_lanes()
    library = lane_library(dae, names, lanes)
    runs, x = len(values), np.ascontiguousarray(values.x)
    reasons = _without_start(library, dae, float(grid[0]), x, values)
    going = np.array([i for i in range(runs) if i not in reasons], dtype=np.int64)
    table = (x, nominal_sizes(dae, x, tolerance), values.u, values.p)
    found, ended, solve_time = run_lanes(
        library,
        lanes,
        len(names),
        table if len(going) == runs else [rows[going] for rows in table],
        grid,
        (*tolerance.pair, tolerance.max_step or np.inf),
        threads=threads,
        stop_outside=on_invalid is OnInvalid.STOP,
    )
    states = [RunState.REFUSED] * runs
    invalid: dict[int, str] = {}
    for position, number in enumerate(going.tolist()):
        states[number], reason, outside = batch_outcome(dae, ended[position], grid)
        if reason:
            reasons[number] = reason
        if outside and on_invalid is not OnInvalid.IGNORE:
            invalid[number] = outside
    everything, report = _among_all(runs, going, found, ended)
    output_times = request.times.requested if request.times.own else grid
    rows = np.searchsorted(grid, output_times)
    ensemble = Ensemble(
        dae.full_name,
        output_times,
        recorded_columns(dae, names)[0],
        everything if len(rows) == len(grid) else everything[:, rows],
        values.given,
        tuple(states),
        reasons,
        invalid,
        reached=np.searchsorted(rows, report["good"]),
        steps=report["steps"].astype(np.int64),
        rhs_calls=report["rhs_calls"].astype(np.int64),
        error=report["error"] * max(tolerance.pair),
        stats={"lanes": lanes, "solve_time": solve_time},
    )
    lines = going[ended["calm"] > 0]
    span = float(grid[0]), float(grid[-1])
    growing = growing_starts(dae, [rows[lines] for rows in table], span, tolerance.pair)
    return ensemble, lines[growing], going[ended["code"] == STUCK]


def _without_start(
    library: ctypes.CDLL, dae: Dae, t: float, x: Vector, values: ManyValues
) -> dict[int, str]:
    """Return why runs cannot begin, by position; x, (runs, nx), becomes consistent."""
    reasons = dict(values.refused)
    known = (np.ascontiguousarray(rows) for rows in (values.u, values.p))
    possible = lane_starts(library, dae, t, x, *known)
    for i in np.flatnonzero(~possible).tolist():
        if i not in reasons:
            reasons[i] = why_no_start(dae, t, values, i)
    return reasons


def _among_all(
    runs: int, going: Integers, values: Vector, report: NDArray[np.void]
) -> tuple[Vector, NDArray[np.void]]:
    """Return values and report of all runs, where some have none: NaN, and no steps."""
    if len(going) == runs:
        return values, report
    every_value = np.full((runs, *values.shape[1:]), np.nan)
    every_value[going] = values
    every_report = np.zeros(runs, report.dtype)
    every_report["error"] = np.nan
    every_report[going] = report
    return every_value, every_report


def nominal_sizes(dae: Dae, x: Vector, tolerance: Tolerance) -> Vector:
    """Return what errors of the states are measured by, powers of two, (runs, nx).

    Args:
        dae: The model.
        x: Initial values, SI, (runs, nx).
        tolerance: See `error_sizes`.
    """
    sizes = error_sizes(dae, x, tolerance.absolute)
    return np.array(2.0 ** np.round(np.log2(sizes)), dtype=float)


@cached_per_thread(16)
def _unlimited(dae: Dae) -> Dae:
    """Return the DAE without validity conditions, which are then not computed."""
    return replace(dae, limits=())


def batch_outcome(dae: Dae, report: np.void, grid: Vector) -> tuple[RunState, str, str]:
    """Return how a run in lanes ended, why, and the violated validity condition with its time."""
    code, good, left = int(report["code"]), int(report["good"]), float(report["left"])
    outside = ""
    if left < np.inf:
        meaning = dae.limits[int(report["limit"])][1]
        outside = Violation(left, violated(meaning))
    if not code:
        return RunState.COMPLETE, "", outside
    last = grid[good - 1] if good else None
    if code == OUTSIDE:
        return RunState.STOPPED, Ending(outside, EndKind.INVALID).after(last), outside
    state = RunState.INTERRUPTED if code == HALTED else RunState.FAILED
    at_time = "" if code == HALTED else f" at t = {report['ended']:g}"
    return state, Ending(f"{CAUSES[code]}{at_time}").after(last), outside


def why_no_start(dae: Dae, t: float, values: ManyValues, run: int) -> str:
    """Return why a run has no initial values that are consistent and within their bounds."""
    try:
        start_values(dae, t, Values(values.x[run], values.p[run], values.u[run]))
    except InitialConditionError as error:
        return str(error)
    return (
        f"{dae.full_name}: calculated start values do not exist or are out of bounds; change the "
        "other values"
    )


def processors() -> int:
    """Return how many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
