"""The most accurate run for the time that a user has."""

from collections.abc import Sequence
from dataclasses import replace

from casadi_models.dae import Dae
from cosim.errors import ParameterError, SolverError
from cosim.study.accuracy.checked_runs import (
    CHECK,
    Done,
    Pair,
    Solve,
    label,
    labelled,
    promising,
    run_of,
)
from cosim.study.accuracy.front import Front
from cosim.study.tradeoff.measurement import Measurement
from cosim.trajectory import Trajectory


def affordable_run(
    dae: Dae, front: Front, solve: Solve, names: Sequence[str], budget: float, share: float
) -> Trajectory:
    """Return the most accurate run whose solver takes no longer than a time.

    Args:
        dae, front, solve, names: See `promised_run`.
        budget: s.
        share: Length of the run over that of the front's.

    Raises:
        ParameterError: The front has no configuration that is so fast.
        SolverError: None was so fast on this run, or all failed.
    """
    every = front.cheapest_first(names)
    affordable = [m for m in every if share * (m.cost("solver_time") or 0.0) <= budget]
    if not affordable:
        least = share * (every[0].cost("solver_time") or 0.0)
        raise ParameterError(
            f"{dae.full_name}: budget = {1e3 * budget:g} ms; the cheapest configuration, "
            f"{label(every[0])}, takes {1e3 * least:.2g} ms; give more time or a shorter run"
        )
    done, took, failures = None, 0.0, list[SolverError]()
    for measured in reversed(affordable):  # the most accurate one first
        try:
            done, took = _timed(measured, solve, budget)
        except SolverError as error:
            failures.append(error)
            continue
        if took <= budget:
            return labelled(done.run, {"budget": budget} | _check(front, solve, done, names))
    if done is None:
        raise failures[0]
    raise SolverError(
        f"{dae.full_name}: {done}, the cheapest configuration, took {1e3 * took:.2g} ms on this "
        f"run, more than budget = {1e3 * budget:g} ms; give more time or a shorter run",
        replace(done.run, status=f"took {1e3 * took:.2g} ms, more than its budget"),
    )


def _timed(measured: Measurement, solve: Solve, budget: float) -> tuple[Done, float]:
    """Return a run and what its solver took, s: once more if that was long, to be sure."""
    done = run_of(measured, solve)
    took: float = done.run.stats.get("solve_time", 0.0)
    if took > budget:
        done = run_of(measured, solve)
        took = min(took, done.run.stats.get("solve_time", 0.0))
    return done, took


def _check(front: Front, solve: Solve, done: Done, names: Sequence[str]) -> dict[str, object]:
    """Check a run by a solver that does not fail."""
    target = done.promised / CHECK
    failed: list[str] = []
    while True:
        check = promising(front.cheapest_first(names, without=(done.solver, *failed)), target)
        if check is None:
            raise SolverError(f"{done.run.model}: no other solver can check {done}", done.run)
        try:
            return Pair(done, run_of(check, solve)).facts
        except SolverError:
            failed.append(check.configuration.solver)
