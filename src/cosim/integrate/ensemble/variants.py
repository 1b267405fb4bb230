"""The two ways to run many variants of a model: in SIMD lanes, and one by one."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.runge_kutta.lane_library import lane_library, processor_lanes
from cosim.errors import (
    InitialConditionError,
    Interrupted,
    ParameterError,
    SolverError,
    UsageError,
)
from cosim.integrate.ensemble.ensemble import Ensemble, RunState
from cosim.integrate.ensemble.lanes import (
    CAUSES,
    HALTED,
    OUTSIDE,
    LaneResults,
    lane_starts,
    run_lanes,
)
from cosim.integrate.initial_values import start_values
from cosim.integrate.run.outputs import all_columns
from cosim.integrate.simulate import simulate
from cosim.integrate.solver import Tolerance
from cosim.memo import kept_per_thread
from cosim.model.many_values import ManyValues
from cosim.model.values import Values
from cosim.trajectory import Column, Trajectory


def in_lanes(
    dae: Dae,
    values: ManyValues,
    names: tuple[str, ...],
    grid: Vector,
    tolerance: Tolerance,
    on_invalid: str,
    threads: int,
    lanes: int | None,
) -> tuple[Ensemble, bool]:
    """Run an explicit form in lanes; tell, too, whether Ctrl-C ended it.

    Args:
        dae: The model, its monitors among the outputs where they are wanted.
        values: Of every run.
        names: What is recorded.
        grid: Two or more output times, s, the start first.
        tolerance, on_invalid, threads, lanes: See `simulate_many`.
    """
    if on_invalid == "ignore":
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


@kept_per_thread(16)
def _unlimited(dae: Dae) -> Dae:
    """Return the DAE without limits: what nobody looks at need not be computed."""
    return replace(dae, limits=())


def _outcome(dae: Dae, result: LaneResults, i: int, grid: Vector) -> tuple[RunState, str, str]:
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


def _why_no_start(dae: Dae, t: float, values: ManyValues, run: int) -> str:
    try:
        start_values(dae, t, Values(values.x[run], values.p[run], values.u[run]))
    except InitialConditionError as error:
        return str(error)
    return f"{dae.full_name}: its calculated start values do not exist or leave their bounds"


def one_by_one(
    dae: Dae,
    values: ManyValues,
    names: tuple[str, ...],
    grid: Vector,
    settings: Mapping[str, Any],
    watch: Callable[[int], None] | None = None,
    unnamed: Mapping[str, Any] | None = None,
) -> tuple[Ensemble, bool]:
    """Run every variant by `simulate`; see `in_lanes`.

    Args:
        dae, values, names, grid: See `in_lanes`.
        settings: Of every run, by the names of `simulate`.
        watch: Called with the position of each run that begins.
        unnamed: Other settings where nobody has named the solver, which let `simulate` pass
            positions in which constraints lose rank.
    """
    runs, interrupted, notes = len(values), False, list[str]()
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
        if watch is not None:
            watch(run)
        given = {name: float(column[run]) for name, column in values.given.items()}
        try:
            found = _simulated(dae, settings, unnamed, start=given, outputs=names, **span)
            states[run] = RunState.COMPLETE
            del reasons[run]
        except SolverError as error:
            if error.partial is None:
                states[run], reasons[run] = RunState.FAILED, str(error)
                continue
            found, reasons[run] = cast(Trajectory, error.partial), error.partial.status
            stopped = "it is no longer true that" in error.partial.status
            states[run] = RunState.STOPPED if stopped else RunState.FAILED
        except Interrupted as error:
            found, interrupted = cast(Trajectory, error.partial), True
        except (ParameterError, InitialConditionError) as error:
            states[run], reasons[run] = RunState.REFUSED, str(error)
            continue
        table[run, : len(found)] = found.values
        counts[:, run] = (len(found), *(found.stats.get(k, 0) for k in ("steps", "rhs_calls")))
        if "invalid" in found.stats:
            invalid[run] = found.stats["invalid"][0]
        if found.stats["solver"] != settings["solver"].name:
            notes.append(f"run {run}: {found.stats['note']}")
    ensemble = Ensemble(
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
        stats={"note": "; ".join(notes)} if notes else {},
    )
    return ensemble, interrupted


def _simulated(
    dae: Dae, settings: Mapping[str, Any], unnamed: Mapping[str, Any] | None, **options: Any
) -> Trajectory:
    """Run a variant; where that fails, or leaves limits, as `simulate` does with other settings.

    Raises:
        CosimError: See `simulate`.
    """
    found: Trajectory | SolverError
    try:
        found = simulate(dae, **options, **settings)
    except SolverError as error:
        found = error
    left = isinstance(found, SolverError) or "invalid" in found.stats
    if left and unnamed is not None:
        with suppress(SolverError):
            other = simulate(dae, **options, **{**settings, **unnamed})
            if other.stats["solver"] != settings["solver"].name:
                return other
    if isinstance(found, SolverError):
        raise found
    return found


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
