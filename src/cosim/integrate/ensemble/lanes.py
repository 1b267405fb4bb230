"""`run_lanes`: integrate many runs of one explicit formulation in SIMD lanes and threads."""

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from threading import Condition, Thread
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from casadi_models.dae import Dae
from cosim.arrays import Truths, Vector
from cosim.codegen.initialization import DEFECT_LIMIT
from cosim.codegen.runge_kutta.lane_library import Batch, LaneLibrary

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
