"""`simulate_many`: many variants of one model, in SIMD lanes or one by one."""

import os
from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter
from typing import Unpack

from numpy.typing import ArrayLike

from casadi_models.dae import Dae
from cosim.codegen.compiler import has_compiler
from cosim.codegen.pulses import pulse_within_a_step
from cosim.codegen.runge_kutta.lanes import fits_lanes
from cosim.errors import Interrupted, UsageError
from cosim.integrate.ensemble.ensemble import Ensemble
from cosim.integrate.ensemble.variants import in_lanes, one_by_one
from cosim.integrate.families.explicit import Dop853
from cosim.integrate.keywords import SharedKeywords, requested
from cosim.integrate.modes import hybrid
from cosim.integrate.solvers import chosen_solver, with_largest_step
from cosim.model.many_values import assign_many
from cosim.model.request import RunRequest
from cosim.model.solver import Solver, Tolerance
from cosim.model.values import assign, numbers_of


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
