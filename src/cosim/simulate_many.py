"""Many variants of one model: in SIMD lanes where its equations are explicit, one by one else."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from casadi_models.dae import Dae
from cosim.codegen.lane_library import lane_library, processor_lanes
from cosim.compile import has_compiler
from cosim.consistent import start_values as single_start
from cosim.ensemble import Ensemble, RunState
from cosim.errors import (
    CosimError,
    InitialConditionError,
    Interrupted,
    ParameterError,
    SolverError,
    UnknownName,
    UsageError,
)
from cosim.grids import checked_grid, time_grid
from cosim.inputs import InputSeries
from cosim.integrate import simulate
from cosim.lane_runs import CAUSES, HALTED, OUTSIDE, LaneResults, lane_starts, run_lanes
from cosim.model.many_values import ManyValues, assign_many
from cosim.monitors import ON_INVALID
from cosim.observation import all_columns, wanted_names, watching
from cosim.solvers import Tolerance, method
from cosim.trajectory import Column
from cosim.values import Values, listed, number

Vector = NDArray[np.float64]


def simulate_many(
    dae: Dae,
    start_values: Mapping[str, ArrayLike] | None = None,
    *,
    start_time: float = 0.0,
    stop_time: float | None = None,
    output_interval: float | None = None,
    times: ArrayLike | None = None,
    outputs: Sequence[str] | None = None,
    solver: str | None = None,
    relative_tolerance: float | None = None,
    absolute_tolerance: float | None = None,
    step_size: float | None = None,
    inputs: InputSeries | None = None,
    on_invalid: str = "warn",
    threads: int | None = None,
    lanes: int | None = None,
) -> Ensemble:
    """Integrate many variants of a model.

    Explicit forms run in SIMD lanes with `dop853`, each variant with its own steps; what a variant
    yields does not depend, bit for bit, on the others, on their order or on the threads. Other
    models, other solvers, input series, and machines without a compiler run one by one.

    Args:
        dae: The model; SI units throughout.
        start_values: Arrays by name, (runs,), or numbers for all runs, that replace starts of
            states, parameters, or inputs.
        start_time, stop_time, output_interval: See `simulate`.
        times: Instead of an interval: increasing output times after or at `start_time`, s; the
            last one is the stop time. One by one these must be evenly spaced.
        outputs: Names to record, monitors among them; everything but those when None.
        solver: A name of `SOLVERS`; `dop853` in lanes where that is possible when None.
        relative_tolerance, absolute_tolerance, step_size, inputs: See `simulate`.
        on_invalid: What happens where a run leaves the model's limits: "warn" says so in
            `Ensemble.invalid`, "stop" ends that run there, "ignore" does neither.
        threads: How many at most; one per processor when None.
        lanes: 1, 2, 4 or 8; what the processor has when None. Sums are rounded alike whatever it
            is; sines may differ in the last bits.

    Returns:
        Every wanted output of every run, with how each run ended; runs that are refused or fail
        are rows like the others.

    Raises:
        UnknownName, UsageError, MissingTool: See `simulate`.
        ParameterError: Arrays differ in length, or times do not increase.
        Interrupted: Ctrl-C; `partial` is the ensemble with the runs that had ended.
    """
    began = perf_counter()
    if not isinstance(on_invalid, str) or on_invalid not in ON_INVALID:
        raise UnknownName.among("simulate_many", "answer to an invalid state", on_invalid, ON_INVALID)
    values = assign_many(dae, start_values)
    wanted = None if outputs is None else listed(f"{dae.full_name}: outputs", outputs)
    dae = watching(dae, wanted or ())
    names = wanted_names(dae, wanted)
    start_time = number("run", "start_time", start_time)
    if times is not None and (stop_time is not None or output_interval is not None):
        raise UsageError("give times, or stop_time and output_interval, not both")
    if times is None:
        grid = time_grid(
            start_time,
            start_time + dae.experiment.stop_time if stop_time is None else stop_time,
            dae.experiment.output_interval if output_interval is None else output_interval,
            numbers=len(values) * len(names),
        )
        first = 0
    else:
        grid, first = _times(start_time, times)
    relative = Tolerance().relative if relative_tolerance is None else relative_tolerance
    tolerance = Tolerance(relative, absolute_tolerance)
    chosen = solver or ("dop853" if _fits(dae, inputs, step_size, grid) else method(dae, None)[0])
    in_lanes = chosen == "dop853" and _fits(dae, inputs, step_size, grid)
    if in_lanes:
        ensemble, interrupted = _in_lanes(
            dae, values, names, grid, tolerance, on_invalid, threads or processors(), lanes
        )
    else:
        if lanes is not None:
            raise UsageError(
                f"{dae.full_name}: lanes are for explicit forms and dop853, compiled, without "
                "input series; leave lanes out"
            )
        settings = {
            "solver": chosen,
            "relative_tolerance": relative_tolerance,
            "absolute_tolerance": absolute_tolerance,
            "step_size": step_size,
            "inputs": inputs,
            "on_invalid": on_invalid,
        }
        ensemble, interrupted = _one_by_one(dae, values, names, grid, settings)
    ensemble = _without_first(ensemble, first)
    stats = {"solver": chosen, "relative_tolerance": relative, **ensemble.stats}
    ensemble = replace(ensemble, stats=stats | {"wall_time": perf_counter() - began})
    if interrupted:
        done = int(ensemble.complete.sum())
        raise Interrupted(
            f"{dae.full_name}: interrupted after {done} of {len(ensemble)} runs", ensemble
        )
    return ensemble


def processors() -> int:
    """Return how many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _times(start_time: float, times: ArrayLike) -> tuple[Vector, int]:
    """Return a grid that begins with the start time, and the position of the first wanted time."""
    try:
        wanted = np.atleast_1d(np.array(times, dtype=float))
    except (TypeError, ValueError) as error:
        raise ParameterError(f"times: {error}; give times in s") from error
    if wanted.size and wanted[0] == start_time:
        return (wanted, 0) if wanted.size == 1 else (checked_grid(wanted), 0)
    return checked_grid(np.concatenate(([start_time], wanted))), 1


def _fits(dae: Dae, inputs: InputSeries | None, step_size: float | None, grid: Vector) -> bool:
    """Tell whether lanes can run this."""
    explicit = not dae.algebraics and bool(dae.states)
    return explicit and inputs is None and step_size is None and len(grid) > 1 and has_compiler()


def _in_lanes(
    dae: Dae,
    values: ManyValues,
    names: tuple[str, ...],
    grid: Vector,
    tolerance: Tolerance,
    on_invalid: str,
    threads: int,
    lanes: int | None,
) -> tuple[Ensemble, bool]:
    compiled = lane_library(dae, names, lanes or processor_lanes())
    refused, runs = dict(values.refused), len(values)
    x = np.ascontiguousarray(values.x)
    possible = lane_starts(compiled, dae, x, np.ascontiguousarray(values.p))
    for i in np.flatnonzero(~possible):
        if int(i) not in refused:
            refused[int(i)] = _why_no_start(dae, values, int(i))
    going = np.array([i for i in range(runs) if i not in refused], dtype=np.int64)
    table = (x, values.u, values.p)
    result = run_lanes(
        compiled,
        len(names),
        table if len(going) == runs else [rows[going] for rows in table],
        grid,
        tolerance.pair,
        threads=threads,
        stop_outside=on_invalid == "stop",
    )
    states = [RunState.REFUSED] * runs
    reasons: dict[int, str] = refused
    invalid: dict[int, str] = {}
    for position, run in enumerate(going.tolist()):
        states[run], reason, outside = _outcome(dae, result, position, grid)
        if reason:
            reasons[run] = reason
        if outside and on_invalid != "ignore":
            invalid[run] = outside
    everything = result.values
    if len(going) < runs:
        everything = np.full((runs, *result.values.shape[1:]), np.nan)
        everything[going] = result.values

    def by_run(numbers: NDArray[Any], missing: float = 0) -> NDArray[Any]:
        column = np.full(runs, missing, dtype=numbers.dtype)
        column[going] = numbers
        return column

    ensemble = Ensemble(
        dae.full_name,
        grid,
        _columns(dae, names),
        everything,
        values.given,
        tuple(states),
        reasons,
        invalid,
        reached=by_run(result.good),
        steps=by_run(result.steps),
        rhs_calls=by_run(result.rhs_calls),
        error=by_run(result.error * (tolerance.relative or 1.0), np.nan),
        stats={"lanes": compiled.lanes, "solve_time": result.solve_time},
    )
    return ensemble, result.interrupted


def _outcome(
    dae: Dae, result: LaneResults, i: int, grid: Vector
) -> tuple[RunState, str, str]:
    """Return how a run in lanes ended, why, and where it left the limits."""
    code, good, at = int(result.codes[i]), int(result.good[i]), int(result.outside[i])
    outside = ""
    if at >= 0:
        meaning = dae.limits[int(result.limit[i])][1]
        outside = f"from {grid[at]:g} s on it is no longer true that {meaning}"
    if not code:
        return RunState.COMPLETE, "", outside
    last = f"{grid[good - 1]:g} s" if good else "the start"
    if code == OUTSIDE:
        return RunState.STOPPED, f"stopped after {last}: {outside}", outside
    state = RunState.INTERRUPTED if code == HALTED else RunState.FAILED
    at_time = "" if code == HALTED else f" at t = {result.ended[i]:g}"
    return state, f"stopped after {last}: {CAUSES[code]}{at_time}", outside


def _why_no_start(dae: Dae, values: ManyValues, run: int) -> str:
    try:
        single_start(dae, Values(values.x[run], values.p[run], values.u[run]))
    except InitialConditionError as error:
        return str(error)
    return f"{dae.full_name}: its calculated start values do not exist or leave their bounds"


def _one_by_one(
    dae: Dae,
    values: ManyValues,
    names: tuple[str, ...],
    grid: Vector,
    settings: Mapping[str, Any],
) -> tuple[Ensemble, bool]:
    runs, interrupted = len(values), False
    table = np.full((runs, len(grid), len(names)), np.nan)
    states, reasons, invalid = [RunState.INTERRUPTED] * runs, dict[int, str](), dict[int, str]()
    counts = np.zeros((3, runs), dtype=np.int64)
    span = {"start_time": grid[0], "stop_time": grid[-1], "output_interval": _interval(grid)}
    for run in range(runs):
        reasons[run] = "interrupted"
        if interrupted:
            continue
        if run in values.refused:
            states[run], reasons[run] = RunState.REFUSED, values.refused[run]
            continue
        given = {name: float(column[run]) for name, column in values.given.items()}
        try:
            found = simulate(dae, start=given, outputs=names, **span, **settings)
            states[run] = RunState.COMPLETE
            del reasons[run]
        except SolverError as error:
            if error.partial is None:
                states[run], reasons[run] = RunState.FAILED, str(error)
                continue
            found, reasons[run] = error.partial, error.partial.status
            stopped = "it is no longer true that" in error.partial.status
            states[run] = RunState.STOPPED if stopped else RunState.FAILED
        except Interrupted as error:
            found, interrupted = error.partial, True
        except (ParameterError, InitialConditionError) as error:
            states[run], reasons[run] = RunState.REFUSED, str(error)
            continue
        table[run, : len(found)] = found.values
        counts[:, run] = (len(found), *(found.stats.get(k, 0) for k in ("steps", "rhs_calls")))
        if "invalid" in found.stats:
            invalid[run] = found.stats["invalid"][0]
    ensemble = Ensemble(
        dae.full_name,
        grid,
        _columns(dae, names),
        table,
        values.given,
        tuple(states),
        reasons,
        invalid,
        *counts,
        error=np.full(runs, np.nan),
    )
    return ensemble, interrupted


def _interval(grid: Vector) -> float | None:
    if len(grid) < 2:
        return None
    steps = np.diff(grid)
    if np.ptp(steps) > 1e-9 * (grid[-1] - grid[0]):
        raise UsageError(
            "times that are not evenly spaced are for lanes (explicit forms, dop853, a compiler); "
            "give an output_interval"
        )
    return float(steps.mean())


def _columns(dae: Dae, names: Sequence[str]) -> tuple[Column, ...]:
    known = {column.name: column for column in all_columns(dae)}
    return tuple(known[name] for name in names)


def _without_first(ensemble: Ensemble, first: int) -> Ensemble:
    """Leave out the start where it was not asked for."""
    if not first:
        return ensemble
    return replace(
        ensemble,
        time=ensemble.time[first:],
        values=ensemble.values[:, first:],
        reached=np.maximum(ensemble.reached - first, 0),
    )
