"""Many variants of one model: in SIMD lanes where its equations are explicit, one by one else."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.compiler import has_compiler
from cosim.codegen.runge_kutta.lanes import fits_lanes
from cosim.errors import Interrupted, ParameterError, UnknownName, UsageError
from cosim.integrate.diagnosis.validity import ON_INVALID
from cosim.integrate.ensemble.ensemble import Ensemble
from cosim.integrate.ensemble.variants import in_lanes, one_by_one
from cosim.integrate.families.explicit import Dop853
from cosim.integrate.run.outputs import recording
from cosim.integrate.solver import Solver
from cosim.integrate.solvers import chosen_solver
from cosim.model.inputs import InputSeries
from cosim.model.many_values import assign_many
from cosim.model.rank import watches_rank
from cosim.model.time_grid import checked_grid, time_grid
from cosim.model.values import assign, number, numbers_of


def simulate_many(
    dae: Dae,
    start_values: Mapping[str, ArrayLike] | None = None,
    *,
    start_time: float = 0.0,
    stop_time: float | None = None,
    output_interval: float | None = None,
    times: ArrayLike | None = None,
    outputs: Sequence[str] | None = None,
    solver: str | Solver | None = None,
    relative_tolerance: float | None = None,
    absolute_tolerance: float | None = None,
    step_size: float | None = None,
    inputs: InputSeries | None = None,
    on_invalid: str = "warn",
    threads: int | None = None,
    lanes: int | None = None,
    watch: Callable[[int], None] | None = None,
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
        solver: As of `simulate`; `dop853` in lanes where that is possible when None.
        relative_tolerance, absolute_tolerance, step_size, inputs: See `simulate`.
        on_invalid: What happens where a run leaves the model's limits: "warn" says so in
            `Ensemble.invalid`, "stop" ends that run there, "ignore" does neither.
        threads: How many at most; one per processor when None.
        lanes: 1, 2, 4 or 8; what the processor has when None. Sums are rounded alike whatever it
            is; sines may differ in the last bits.
        watch: Called with the position of each run that begins, where they go one by one.

    Returns:
        Every wanted output of every run, with how each run ended; runs that are refused or fail
        are rows like the others.

    Raises:
        UnknownName, UsageError, MissingTool: See `simulate`.
        ParameterError: Arrays differ in length, or times do not increase.
        Interrupted: Ctrl-C; `partial` is the ensemble with the runs that had ended.

    Example:
        >>> import cosim
        >>> gravity = {"g": [1.62, 9.81]}  # of the Moon, of the Earth
        >>> many = simulate_many(cosim.load("bicycle"), gravity, outputs=["phi"], stop_time=1)
        >>> many["phi"].shape
        (2, 101)
    """
    began = perf_counter()
    if not isinstance(on_invalid, str) or on_invalid not in ON_INVALID:
        what = "answer to an invalid state"
        raise UnknownName.among("simulate_many", what, on_invalid, ON_INVALID)
    values = assign_many(dae, start_values)
    dae, names = recording(dae, outputs)
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
    fits = _fits(dae, inputs, step_size, grid)
    if solver is None and fits:
        solver = Dop853.name
    chosen = chosen_solver(dae, solver, relative_tolerance, absolute_tolerance, step_size)
    if isinstance(chosen, Dop853) and fits:
        tolerance, most = chosen.tolerance, threads or processors()
        ensemble, interrupted = in_lanes(
            dae, values, names, grid, tolerance, on_invalid, most, lanes
        )
    else:
        if lanes is not None:
            raise UsageError(
                f"{dae.full_name}: lanes are for explicit forms and dop853, compiled, without "
                "input series; leave lanes out"
            )
        settings = {"solver": chosen, "inputs": inputs, "on_invalid": on_invalid}
        ours = solver is None and watches_rank(dae)
        numbers = {"relative_tolerance": relative_tolerance}
        unnamed = {"solver": None, "absolute_tolerance": absolute_tolerance, **numbers}
        ensemble, interrupted = one_by_one(
            dae, values, names, grid, settings, watch, unnamed if ours else None
        )
    ensemble = _without_first(ensemble, first)
    numbers = {name: value for name, value in vars(chosen).items() if value is not None}
    stats = {"solver": chosen.name, **numbers, **ensemble.stats}
    ensemble = replace(
        ensemble,
        stats=stats | {"wall_time": perf_counter() - began},
        drawing=dae.drawing,
        numbers=numbers_of(dae, assign(dae)),
    )
    if interrupted:
        done = int(ensemble.complete.sum())
        raise Interrupted(
            f"{dae.full_name}: interrupted after {done} of {len(ensemble)} runs", ensemble
        )
    return ensemble


def runs_in_lanes(dae: Dae, settings: Mapping[str, Any], inputs: InputSeries | None = None) -> bool:
    """Tell whether `simulate_many` runs variants in lanes with these of its arguments."""
    points = np.array([0.0, settings.get("stop_time") or 1.0])
    lean = _fits(dae, inputs, settings.get("step_size"), points)
    solver = settings.get("solver")
    return lean and (solver in (None, Dop853.name) or isinstance(solver, Dop853))


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
    explicit = not dae.algebraics and bool(dae.states) and fits_lanes(dae)
    return explicit and inputs is None and step_size is None and len(grid) > 1 and has_compiler()


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
