"""`promised_run`: solver and tolerance follow from an accuracy, or from a time.

The measured front of the model says which solver at which tolerance will do. It was measured at the
model's own values, so what it promises is checked on the very run that is wanted: by a second run
of a different solver, promised to be more accurate. How far the two are apart is the estimate of
the first one's error. Where it is too large, a third run checks the second, and so on. A tolerance
that has no effect any more cannot pass for convergence, nor one chaotic run for the truth: two
methods agree to that many digits only where both have them.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

from casadi_models.dae import Dae
from cosim.errors import ParameterError, SolverError
from cosim.study.accuracy.checks import Done, ErrorCheck, Pair, SolveAt, label, with_check
from cosim.study.accuracy.front import Front, measured_front
from cosim.study.tradeoff.measurement import Measurement
from cosim.trajectory import Trajectory

SAFETY = 3.0  # by which the front's error is to be below what is asked for
CHECK = 100.0  # by which the run that checks another is to be more accurate


def promised_run(
    dae: Dae,
    solve: SolveAt,
    names: Sequence[str],
    length: float,
    compiled: bool,
    accuracy: float | None,
    budget: float | None,
) -> Trajectory:
    """Return a run whose estimated error is not above what is asked for, or the best within a time.

    Args:
        dae: The model, with the values at which its front is measured.
        solve: Runs it by a solver at a tolerance, with the values and times that are wanted.
        names: Outputs whose error counts.
        length: From the first to the last time of the run, s.
        compiled: Whether the equations are compiled.
        accuracy: Largest global error of these outputs, in nominal values; or None.
        budget: Time that the solver may take, s; what checks the run has its own; or None.

    Returns:
        With an `accuracy`, the most accurate run that it took, since it is there. `stats` tell the
        cheapest `configuration` that will do, its `promised_error`, what it was `checked_by`, the
        `error_estimate`, and the variable that has it. With a `budget`, the run of that
        configuration itself.

    Raises:
        ParameterError: Double precision does not carry that accuracy; or the front promises no
            configuration that is so fast.
        SolverError: The solvers fail, or no two of them agree so well (`partial` is the better run
            of the best two); or none was so fast on this run (`partial` is the cheapest one).
    """
    if not dae.states:
        run = solve()
        return with_check(run, {"accuracy": accuracy, "budget": budget}, ErrorCheck.exact(run))
    front = measured_front(dae, compiled=compiled)
    if accuracy is not None:
        return _accurate_run(dae, front, solve, names, accuracy)
    assert budget is not None
    return _affordable_run(dae, front, solve, names, budget, length / dae.experiment.stop_time)


def promise_kept(run: Trajectory) -> str:
    """Say in a line what was promised of a run, and what its check found."""
    facts, check = run.stats, ErrorCheck.of(run)
    if facts.get("budget") is not None:
        asked = f"budget {1e3 * facts['budget']:g} ms: {check.configuration}"
        asked += f" took {1e3 * facts.get('solve_time', 0.0):.2g} ms"
    else:
        asked = f"accuracy {facts['accuracy']:g}: {check.configuration}"
    return (
        f"{asked}; error promised {check.promised_error:.1e}, on this run "
        f"{check.error_estimate:.1e} ({check.error_estimate_of}), checked by {check.checked_by}"
    )


def _accurate_run(
    dae: Dae, front: Front, solve: SolveAt, names: Sequence[str], accuracy: float
) -> Trajectory:
    """Return the most accurate run that it took to confirm an accuracy.

    Raises:
        ParameterError: Double precision does not carry it.
        SolverError: Two solvers fail, or no two runs agree so well.
    """
    _refuse_too_much(dae, front, accuracy, names)
    runs: list[Done] = []
    failures: dict[str, SolverError] = {}
    target = accuracy / SAFETY
    while True:
        before = [run.solver for run in runs[-1:]]
        every = front.cheapest_first(names, without=(*before, *failures))
        measured = _promising([m for m in every if _tighter(m, runs)], target)
        if measured is None:
            break
        try:
            runs.append(Done.of(measured, solve))
        except SolverError as error:
            failures[measured.configuration.solver] = error
            if len(failures) == 2:  # it is the run, not the solver
                raise next(iter(failures.values())) from error
            continue
        if len(runs) == 1:
            target = min(accuracy / CHECK, runs[0].promised)
            continue
        pair = Pair(*runs[-2:])
        if pair.worst.scaled <= accuracy:
            return with_check(pair.better.run, {"accuracy": accuracy}, pair.check)
        target = min(target, runs[-1].promised) * min(0.1, accuracy / pair.worst.scaled)
    if len(runs) < 2:
        raise SolverError(
            f"{dae.full_name}: {runs[0] if runs else 'accuracy'} cannot be checked: "
            f"{', '.join(map(str, failures.values())) or 'there is no other solver'}",
            runs[0].run if runs else None,
        )
    raise _unconfirmed(dae, accuracy, _closest_pair(runs))


def _tighter(measured: Measurement, runs: Sequence[Done]) -> bool:
    """Tell whether a configuration promises more than its solver's runs so far."""
    own = [run.promised for run in runs if run.solver == measured.configuration.solver]
    return not own or measured.known_error < min(own)


def _refuse_too_much(dae: Dae, front: Front, accuracy: float, names: Sequence[str]) -> None:
    worst = max(names, key=front.rounding.__getitem__)
    least = front.rounding[worst]
    if accuracy < least:
        raise ParameterError(
            f"{dae.full_name}: accuracy = {accuracy:g} is below {1.1 * least:.1e}, the smallest "
            f"possible: double precision carries {worst} no further; ask for less, or for other "
            "outputs"
        )


def _closest_pair(runs: Sequence[Done]) -> Pair:
    """Return the two runs of different solvers that agree best."""
    pairs = [Pair(a, b) for a, b in combinations(runs, 2) if a.solver != b.solver]
    return min(pairs, key=lambda pair: pair.worst.scaled)


def _unconfirmed(dae: Dae, accuracy: float, best: Pair) -> SolverError:
    worst = best.worst
    reached = (
        f"accuracy {accuracy:g} is not reached: {best.first} and {best.second} are "
        f"{worst.scaled:.1e} nominal values apart in {worst.name}"
    )
    partial = with_check(best.better.run, {"accuracy": accuracy}, best.check)
    return SolverError(
        f"{dae.full_name}: {reached}, the best of this run; ask for less, for a shorter run or "
        "for other outputs",
        replace(partial, status=reached),
    )


def _affordable_run(
    dae: Dae, front: Front, solve: SolveAt, names: Sequence[str], budget: float, share: float
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
            return with_check(done.run, {"budget": budget}, _check(front, solve, done, names))
    if done is None:
        raise failures[0]
    raise SolverError(
        f"{dae.full_name}: {done}, the cheapest configuration, took {1e3 * took:.2g} ms on this "
        f"run, more than budget = {1e3 * budget:g} ms; give more time or a shorter run",
        replace(done.run, status=f"took {1e3 * took:.2g} ms, more than its budget"),
    )


def _timed(measured: Measurement, solve: SolveAt, budget: float) -> tuple[Done, float]:
    """Return a run and what its solver took, s: once more if that was long, to be sure."""
    done = Done.of(measured, solve)
    took: float = done.run.stats.get("solve_time", 0.0)
    if took > budget:
        done = Done.of(measured, solve)
        took = min(took, done.run.stats.get("solve_time", 0.0))
    return done, took


def _check(front: Front, solve: SolveAt, done: Done, names: Sequence[str]) -> ErrorCheck:
    """Check a run by a solver that does not fail."""
    target = done.promised / CHECK
    failed: list[str] = []
    while True:
        check = _promising(front.cheapest_first(names, without=(done.solver, *failed)), target)
        if check is None:
            raise SolverError(f"{done.run.model}: no other solver can check {done}", done.run)
        try:
            return Pair(done, Done.of(check, solve)).check
        except SolverError:
            failed.append(check.configuration.solver)


def _promising(cheapest_first: Sequence[Measurement], error: float) -> Measurement | None:
    """Return the cheapest configuration with such an error, else the most accurate one."""
    good = (m for m in cheapest_first if m.known_error <= error)
    return next(good, cheapest_first[-1] if cheapest_first else None)
