"""Many runs of one explicit form in SIMD lanes, on some threads: numbers in, numbers out."""

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
from cosim.codegen.runge_kutta.lane_library import RUN_REPORT, Batch, LaneLibrary

CAUSES = {  # the library's codes
    1: "too many steps",
    2: "step size too small",
    4: "a state or an output is not finite",
    5: "interrupted",
    6: "outside the model's limits",
}
HALTED, OUTSIDE = 5, 6


@dataclass(frozen=True)
class LaneResults:
    """What the lanes computed, by run.

    Attributes:
        values: (runs, times, outputs); not a number beyond the last good time.
        codes: 0 or a key of `CAUSES`.
        steps, rhs_calls, good: Steps, right-hand sides, good output times.
        ended: Time where the run ended, s.
        error: Sum of the estimated errors of the steps, in units of the tolerance.
        outside, limit: Position of the first output time outside a limit, and which; -1: none.
        solve_time: s.
        interrupted: Whether Ctrl-C ended it.
    """

    values: Vector
    codes: NDArray[np.int64]
    steps: NDArray[np.int64]
    rhs_calls: NDArray[np.int64]
    good: NDArray[np.int64]
    ended: Vector
    error: Vector
    outside: NDArray[np.int64]
    limit: NDArray[np.int64]
    solve_time: float
    interrupted: bool


def lane_starts(
    compiled: LaneLibrary, dae: Dae, t: float, x: Vector, u: Vector, p: Vector
) -> Truths:
    """Replace calculated start values; tell which runs have a start within its bounds, (runs,).

    Args:
        compiled: The model's library.
        dae: The model.
        t: Where the runs begin, s.
        x: Start values, guesses where they are calculated, (runs, nx); overwritten.
        u, p: Inputs and parameters, (runs, nu) and (runs, np).
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
    tolerances: tuple[float, float],
    *,
    threads: int,
    stop_outside: bool,
) -> LaneResults:
    """Integrate every run over a grid of times.

    Args:
        compiled: The model's library.
        outputs: Number of outputs that it records.
        starts: Consistent x0, inputs u, parameters p: (runs, nx), (runs, nu), (runs, np).
        grid: Output times, s, the start first.
        tolerances: Relative and absolute.
        threads: How many at most; what they compute does not depend on it.
        stop_outside: Whether a run ends where it leaves the limits.
    """
    runs, points = len(starts[0]), len(grid)
    x0, u, p = (np.ascontiguousarray(rows, dtype=float) for rows in starts)
    values, report = np.empty((runs, points, outputs)), np.empty((runs, RUN_REPORT))
    following, stop = np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int32)
    batch = Batch(
        runs,
        points,
        *(array.ctypes.data for array in (x0, u, p, grid)),
        *tolerances,
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
        raise MemoryError("no memory for the output times of a run in each lane")
    first = min(int(following[0]), runs)  # that no lane has begun
    report[first:] = 0
    report[first:, 0] = HALTED
    values[first:] = np.nan
    whole = report.astype(np.int64, casting="unsafe")
    return LaneResults(
        values,
        codes=whole[:, 0],
        steps=whole[:, 1],
        rhs_calls=whole[:, 2],
        good=whole[:, 3],
        ended=report[:, 4],
        error=report[:, 5],
        outside=np.where(np.arange(runs) < first, whole[:, 6], -1),
        limit=whole[:, 7],
        solve_time=perf_counter() - began,
        interrupted=interrupted,
    )
