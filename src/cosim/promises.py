"""A run of the accuracy that a user asks for, or the most accurate one within a time.

The measured front of the model says which solver at which tolerance will do. It was measured at the
model's own values, so what it promises is checked on the very run that is wanted: by a second run
of a different solver, promised to be a hundred times as accurate. How far the two are apart is the
estimate of the first one's error. Where it is too large, a third run checks the second, and so on.
A tolerance that has no effect any more cannot pass for convergence, nor one chaotic run for the
truth: two methods agree to that many digits only where both have them.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from casadi_models.dae import Dae
from cosim.comparison import Difference, compare
from cosim.errors import ParameterError, SolverError
from cosim.fronts import Front, measured_front
from cosim.tradeoffs import Measurement
from cosim.trajectory import Trajectory

SAFETY = 3.0  # by which the front's error is to be below what is asked for
CHECK = 100.0  # the same, of the run that checks another
Solve = Callable[..., Trajectory]  # of `solver` and `relative_tolerance`


@dataclass(frozen=True)
class _Done:
    """A run, and what the front says of its configuration."""

    measured: Measurement
    run: Trajectory

    @property
    def solver(self) -> str:
        return self.measured.configuration.solver

    def __str__(self) -> str:
        return _label(self.measured)


@dataclass(frozen=True)
class _Pair:
    """Two runs by different solvers; the second one checks the first."""

    first: _Done
    second: _Done

    @property
    def worst(self) -> Difference:
        """Where they are farthest apart."""
        return compare(self.first.run, self.second.run).worst

    @property
    def better(self) -> _Done:
        """The one that is promised to be more accurate: the second, unless the first is at best."""
        return min(self.second, self.first, key=lambda done: done.measured.error or 0.0)

    @property
    def facts(self) -> dict[str, object]:
        worst = self.worst
        return {
            "configuration": str(self.first),
            "promised_error": self.first.measured.error,
            "checked_by": str(self.second),
            "error_estimate": worst.scaled,
            "error_estimate_of": worst.name,
        }


def promised_run(
    dae: Dae,
    solve: Solve,
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
        return _labelled(run, {"accuracy": accuracy, "budget": budget} | _exact(run))
    front = measured_front(dae, compiled=compiled)
    if accuracy is not None:
        return _accurate(dae, front, solve, names, accuracy)
    assert budget is not None
    return _affordable(dae, front, solve, names, budget, length / dae.experiment.stop_time)


def promise_kept(run: Trajectory) -> str:
    """Say in a line what was promised of a run, and what its check found."""
    facts = run.stats
    if facts.get("budget") is not None:
        asked = f"budget {1e3 * facts['budget']:g} ms: {facts['configuration']}"
        asked += f" took {1e3 * facts.get('solve_time', 0.0):.2g} ms"
    else:
        asked = f"accuracy {facts['accuracy']:g}: {facts['configuration']}"
    return (
        f"{asked}, promised error {facts['promised_error']:.1e}, on this run "
        f"{facts['error_estimate']:.1e} ({facts['error_estimate_of']}) by {facts['checked_by']}"
    )


def _accurate(
    dae: Dae, front: Front, solve: Solve, names: Sequence[str], accuracy: float
) -> Trajectory:
    _refuse_too_much(dae, front, accuracy, names)
    runs: list[_Done] = []
    failures: dict[str, SolverError] = {}
    target = accuracy / SAFETY
    while True:
        before = [run.solver for run in runs[-1:]]
        measured = _promising(front, names, target, without=(*before, *failures))
        if measured is None or measured in [run.measured for run in runs]:
            break
        try:
            runs.append(_done(measured, solve))
        except SolverError as error:
            failures[measured.configuration.solver] = error
            if len(failures) == 2:  # it is the run, not the solver
                raise next(iter(failures.values())) from error
            continue
        if len(runs) == 1:
            target = accuracy / CHECK
            continue
        pair = _Pair(*runs[-2:])
        if pair.worst.scaled <= accuracy:
            return _labelled(pair.better.run, {"accuracy": accuracy} | pair.facts)
        target *= min(0.1, accuracy / pair.worst.scaled)
    if len(runs) < 2:
        raise next(iter(failures.values()))
    raise _unconfirmed(dae, accuracy, _closest(runs))


def _affordable(
    dae: Dae, front: Front, solve: Solve, names: Sequence[str], budget: float, share: float
) -> Trajectory:
    every = front.cheapest_first(names)
    affordable = [m for m in every if share * (m.cost("solver_time") or 0.0) <= budget]
    if not affordable:
        least = share * (every[0].cost("solver_time") or 0.0)
        raise ParameterError(
            f"{dae.full_name}: budget = {1e3 * budget:g} ms; the cheapest configuration, "
            f"{_label(every[0])}, takes {1e3 * least:.2g} ms; give more time or a shorter run"
        )
    done, took, failures = None, 0.0, list[SolverError]()
    for measured in reversed(affordable):  # the most accurate one first
        try:
            done, took = _timed(measured, solve, budget)
        except SolverError as error:
            failures.append(error)
            continue
        if took <= budget:
            return _labelled(done.run, {"budget": budget} | _check(front, solve, done, names))
    if done is None:
        raise failures[0]
    raise SolverError(
        f"{dae.full_name}: {done}, the cheapest configuration, took {1e3 * took:.2g} ms on this "
        f"run, more than budget = {1e3 * budget:g} ms; give more time or a shorter run",
        replace(done.run, status=f"took {1e3 * took:.2g} ms, more than its budget"),
    )


def _label(measured: Measurement) -> str:
    configuration = measured.configuration
    return f"{configuration.solver} at {configuration.tolerance:g}"


def _labelled(run: Trajectory, facts: dict[str, object]) -> Trajectory:
    return replace(run, stats={**run.stats, **facts})


def _done(measured: Measurement, solve: Solve) -> _Done:
    configuration = measured.configuration
    run = solve(solver=configuration.solver, relative_tolerance=configuration.tolerance)
    return _Done(measured, run)


def _timed(measured: Measurement, solve: Solve, budget: float) -> tuple[_Done, float]:
    """Return a run and what its solver took, s: once more if that was long, to be sure."""
    done = _done(measured, solve)
    took: float = done.run.stats.get("solve_time", 0.0)
    if took > budget:
        done = _done(measured, solve)
        took = min(took, done.run.stats.get("solve_time", 0.0))
    return done, took


def _promising(
    front: Front, names: Sequence[str], error: float, *, without: Collection[str]
) -> Measurement | None:
    """Return the cheapest configuration with such an error, else the most accurate one."""
    every = front.cheapest_first(names, without=without)
    good = (m for m in every if m.error is not None and m.error <= error)
    return next(good, every[-1] if every else None)


def _check(front: Front, solve: Solve, done: _Done, names: Sequence[str]) -> dict[str, object]:
    """Check a run by a solver that does not fail."""
    target = (done.measured.error or 0.0) / CHECK
    failed: list[str] = []
    while True:
        check = _promising(front, names, target, without=(done.solver, *failed))
        if check is None:
            raise SolverError(f"{done.run.model}: no other solver can check {done}", done.run)
        try:
            return _Pair(done, _done(check, solve)).facts
        except SolverError:
            failed.append(check.configuration.solver)


def _exact(run: Trajectory) -> dict[str, object]:
    """Return what is known of a run without states, which no solver touches."""
    scaled = np.spacing(np.abs(run.values).max(axis=0)) / [c.nominal for c in run.columns]
    worst = int(np.argmax(scaled))
    return {
        "configuration": "no integration",
        "promised_error": float(scaled[worst]),
        "checked_by": "double precision",
        "error_estimate": float(scaled[worst]),
        "error_estimate_of": run.names[worst],
    }


def _refuse_too_much(dae: Dae, front: Front, accuracy: float, names: Sequence[str]) -> None:
    worst = max(names, key=front.rounding.__getitem__)
    least = front.rounding[worst]
    if accuracy < least:
        raise ParameterError(
            f"{dae.full_name}: accuracy = {accuracy:g} is below {1.1 * least:.1e}, the smallest "
            f"possible: double precision carries {worst} no further; ask for less, or for other "
            "outputs"
        )


def _closest(runs: Sequence[_Done]) -> _Pair:
    """Return the two runs of different solvers that agree best."""
    pairs = [_Pair(a, b) for a, b in combinations(runs, 2) if a.solver != b.solver]
    return min(pairs, key=lambda pair: pair.worst.scaled)


def _unconfirmed(dae: Dae, accuracy: float, best: _Pair) -> SolverError:
    worst = best.worst
    reached = (
        f"accuracy {accuracy:g} is not reached: {best.first} and {best.second} are "
        f"{worst.scaled:.1e} of its nominal value apart in {worst.name}"
    )
    partial = _labelled(best.better.run, {"accuracy": accuracy} | best.facts)
    return SolverError(
        f"{dae.full_name}: {reached}, the best of this run; ask for less, for a shorter run or "
        "for other outputs",
        replace(partial, status=reached),
    )
