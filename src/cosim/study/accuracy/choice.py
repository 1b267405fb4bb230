"""`accurate_run`: the solver for an accuracy or a time budget, with an independent check."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import sqrt

import casadi as ca
import numpy as np

from casadi_models.dae import Dae
from cosim.codegen.functions import equations
from cosim.errors import ParameterError, SolverError
from cosim.integrate.call import RunStats
from cosim.integrate.initial_values import consistent_values, input_values
from cosim.integrate.outputs import watching
from cosim.integrate.preparation import compilation_of
from cosim.integrate.run import run
from cosim.integrate.solvers import contains_time, default_solver, is_driven, requested_solver
from cosim.model.request import RunRequest
from cosim.model.solver import Goal, Tolerance
from cosim.series.samples import below
from cosim.study.accuracy.candidates import Candidate, Candidates, candidates_of
from cosim.text import EndKind, one_note
from cosim.trajectory import Trajectory
from cosim.verify.comparison import Difference, compare
from cosim.verify.reference import rounding_errors

SAFETY = 3.0  # factor by which the predicted error is to be below the requested accuracy
CHECK = 100.0  # factor by which the run that checks another is to be more accurate
_NOISE = 1e-12  # change of an output, in nominal values, that is none


@dataclass(frozen=True)
class ErrorCheck:
    """Predicted and estimated error of a run; see `RunStats`."""

    configuration: str
    predicted_error: float
    checked_by: str
    error_estimate: float
    error_estimate_of: str

    @classmethod
    def exact(cls, run: Trajectory) -> "ErrorCheck":
        """Return the rounding error of a run without states, which needs no solver."""
        errors = rounding_errors(run)
        worst = max(errors, key=errors.__getitem__)
        return cls("no integration", errors[worst], "double precision", errors[worst], worst)


@dataclass(frozen=True)
class CandidateRun:
    """A run of a candidate."""

    candidate: Candidate
    run: Trajectory


@dataclass(frozen=True)
class Pair:
    """Two runs by different solvers; the second one checks the first."""

    first: CandidateRun
    second: CandidateRun

    @property
    def worst(self) -> Difference:
        """The largest difference of the two runs."""
        return compare(self.first.run, self.second.run, by_nominal=True).worst

    @property
    def better(self) -> CandidateRun:
        """The run with the smaller predicted error."""
        return min(self.second, self.first, key=lambda done: done.candidate.error)

    @property
    def error(self) -> float:
        """The error of the first run: the difference, and what the second one is wrong by.

        With other values than those of the prediction, it is better by half of the decades only.
        """
        first, second, apart = self.first.candidate, self.second.candidate, self.worst.scaled
        ratio = second.error / first.error if first.error else 0.0
        return apart * max(1 + ratio, 1 / (1 - min(sqrt(ratio), 0.5)))

    @property
    def check(self) -> ErrorCheck:
        """The error of the first run, estimated by the second."""
        first, second = self.first.candidate, self.second.candidate
        return ErrorCheck(str(first), first.error, str(second), self.error, self.worst.name)


@dataclass(frozen=True)
class _Chooser:
    """A request whose goal is resolved, and the candidates of its model.

    Attributes:
        stiff: Whether the candidates have two implicit solvers for sure.
    """

    request: RunRequest
    candidates: Candidates
    names: tuple[str, ...]
    stiff: bool = False

    @property
    def dae(self) -> Dae:
        return self.request.dae

    def run(self, candidate: Candidate, *, checks: bool = False) -> CandidateRun:
        """Run a candidate; one that checks another evaluates driven equations in every interval."""
        request = self.request
        step = request.times.mean_interval(self.dae) if checks and is_driven(request) else None
        solver = requested_solver(
            self.dae, candidate.solver, candidate.tolerance, max_step=step or None
        )
        return CandidateRun(candidate, run(replace(request, solver=solver)))

    def check(self, pair: Pair) -> ErrorCheck:
        """Return the error of the first run of a pair.

        Raises:
            SolverError: An output rests in a run although the equations contain time.
        """
        found = pair.check
        moves = np.array([np.ptp(one.run.values, axis=0) for one in (pair.first, pair.second)])
        sizes, rests = [c.nominal for c in pair.first.run.columns], moves == 0
        missed = rests.any(axis=0) & (moves.max(axis=0) > _NOISE * np.array(sizes))
        missed |= rests.all(axis=0) & (found.error_estimate == 0)
        if not missed.any() or not is_driven(self.request):
            return found
        changed = first_change(self.request)
        if changed is None and not contains_time(self.dae):
            return found
        since = "" if changed is None else f" from {changed:g} s on"
        raise SolverError(
            f"{self.dae.full_name}: {found.configuration} and {found.checked_by} agree exactly, "
            f"but may have missed what changes the equations{since}; shorten output_interval",
            pair.second.run,
        )

    def after(self, failure: SolverError) -> "_Chooser":
        """Return what chooses next, with two implicit solvers after too many steps.

        Explicit ones that do for the model's own span, for which candidates are measured, may need
        too many for a longer one.
        """
        if self.stiff or failure.ending.kind is not EndKind.TOO_MANY_STEPS:
            return self
        compiled = self.request.policy.compiled or False
        found = candidates_of(self.request, compiled=compiled, stiff=True)
        return replace(self, candidates=found, stiff=True)

    def cheapest_first(self, without: Sequence[str] = ()) -> tuple[Candidate, ...]:
        """Return the Pareto front of the candidates for the outputs of the request."""
        return self.candidates.cheapest_first(self.names, without=without)

    def with_smaller_tolerance(
        self, runs: Sequence[CandidateRun], share: float, without: Sequence[str]
    ) -> Candidate | None:
        """Return a candidate of a solver that has run, whose tolerance is a share of that or less.

        Where rounding covers the predicted errors, only the tolerance tells which one is better.
        """
        least = dict[str, float]()
        for done in runs:
            solver, tolerance = done.candidate.solver, done.candidate.tolerance
            least[solver] = min(tolerance, least.get(solver, tolerance))
        tighter = [
            one
            for one in self.candidates.every
            if one.solver not in without and one.tolerance < least.get(one.solver, 0.0)
        ]
        small = [one for one in tighter if one.tolerance <= share * least[one.solver]]
        return max(small or tighter[-1:], key=lambda one: one.tolerance, default=None)


def accurate_run(request: RunRequest) -> Trajectory:
    """Return a run whose estimated error is within an accuracy, or the best within a time.

    Args:
        request: Its solver is a `Goal`. The candidates are those of the model's own values.

    Returns:
        With an accuracy, the most accurate of the runs that were needed to confirm it. `stats` has
        the cheapest `configuration` that is good enough, its `predicted_error`, what it was
        `checked_by`, the `error_estimate`, and the variable that has it. With a budget, the run of
        that configuration itself; the check costs additional time.

    Raises:
        ParameterError: The accuracy is below rounding; or no candidate is so fast.
        SolverError: The solvers fail, or no two of them agree so well (`partial` is the better run
            of the best two); or none was so fast on this run (`partial` is the cheapest one).
    """
    goal, dae = request.solver, request.dae
    assert isinstance(goal, Goal)
    names = request.outputs or dae.observed
    dae = watching(dae, names)
    chosen = compilation_of(dae, default_solver(dae, Tolerance()), request.policy.compiled)
    policy = replace(request.policy, compiled=chosen.compiled)
    request = replace(request, dae=dae, outputs=names, solver=None, policy=policy)
    if not dae.states:
        found = run(request)
        return _with_check(found, goal, ErrorCheck.exact(found))
    chooser = _Chooser(request, candidates_of(request, compiled=chosen.compiled), names)
    if goal.accuracy is not None:
        return _accurate_run(chooser, goal, goal.accuracy)
    assert goal.budget is not None
    return _affordable_run(chooser, goal, goal.budget)


def report(run: Trajectory) -> str:
    """Return one line on the predicted error of a run and its estimate on this run."""
    facts = run.stats
    if facts.get("budget") is not None:
        goal = f"budget {1e3 * facts['budget']:g} ms: {facts['configuration']}"
        goal += f" took {1e3 * facts.get('solve_time', 0.0):.2g} ms"
    else:
        goal = f"accuracy {facts['accuracy']:g}: {facts['configuration']}"
    return (
        f"{goal}; predicted error {facts['predicted_error']:.1e}; estimated for this run: "
        f"{facts['error_estimate']:.1e} ({facts['error_estimate_of']}, compared with "
        f"{facts['checked_by']})"
    )


def first_change(request: RunRequest) -> float | None:
    """Return the first time at which equations at the initial state differ from those at the start.

    They are evaluated at 16 times per output interval. None: they never differ.
    """
    dae, numbers = request.dae, request.numbers
    grid = request.times.grid(dae)
    times = np.interp(np.arange(16 * len(grid) - 15) / 16, np.arange(len(grid)), grid)
    u = input_values(dae, times, numbers, request.inputs)
    first = replace(numbers, u=u[:, 0])
    x, z = consistent_values(dae, times[0], first)
    rates = np.array(ca.vertcat(*equations(dae).map(len(times))(times[None], x, z, u, numbers.p)))
    changed = np.flatnonzero((rates != rates[:, :1]).any(axis=0))
    return float(times[changed[0]]) if changed.size else None


def _with_check(found: Trajectory, goal: Goal, check: ErrorCheck) -> Trajectory:
    """Return a run whose `stats` report the goal and the error."""
    assert isinstance(found.stats, RunStats)
    small = below(found.columns, found.values, goal.accuracy) if goal.accuracy else ""
    note = one_note(found.stats.note, small) or None
    return replace(found, stats=replace(found.stats, **vars(goal), **vars(check), note=note))


def _accurate_run(chooser: _Chooser, goal: Goal, accuracy: float) -> Trajectory:
    """Return the most accurate of the runs that confirm an accuracy."""
    _reject_below_rounding(chooser, accuracy)
    runs: list[CandidateRun] = []
    failures: dict[str, SolverError] = {}
    target, share = accuracy / SAFETY, 0.1
    while True:
        without = (*(done.candidate.solver for done in runs[-1:]), *failures)
        every = chooser.cheapest_first(without)
        candidate = _good_enough([c for c in every if _tighter(c, runs)], target)
        candidate = candidate or chooser.with_smaller_tolerance(runs, share, without)
        if candidate is None:
            break
        try:
            runs.append(chooser.run(candidate, checks=bool(runs)))
        except SolverError as error:
            failures[candidate.solver] = error
            chooser = chooser.after(error)
            if len(failures) == 2 + chooser.stiff:  # the run fails, whatever the solver
                raise _failed(chooser, goal, failures) from error
            continue
        if len(runs) == 1:
            target = min(accuracy / CHECK, candidate.error)
            continue
        pair = Pair(*runs[-2:])
        if pair.error <= accuracy:
            return _with_check(pair.better.run, goal, chooser.check(pair))
        share = min(0.1, accuracy / pair.error)
        target = min(target, candidate.error) * share
    if failures and not runs:
        raise _failed(chooser, goal, failures)
    if len(runs) < 2:
        what = runs[0].candidate if runs else "accuracy"
        raise SolverError(
            f"{chooser.dae.full_name}: {what} cannot be checked: "
            f"{', '.join(map(str, failures.values())) or 'there is no other solver'}",
            runs[0].run if runs else None,
        )
    raise _unconfirmed(chooser, goal, accuracy, runs)


def _failed(chooser: _Chooser, goal: Goal, failures: Mapping[str, SolverError]) -> SolverError:
    """Return the error of a run that fails, whatever the solver; the first failure tells why."""
    first = next(iter(failures.values()))
    wanted = "" if goal.accuracy is None else f"accuracy {goal.accuracy:g} is not reached: "
    fail, remedy = "fails" if len(failures) == 1 else "fail", "request a shorter run"
    if first.ending.kind is EndKind.TOO_MANY_STEPS:
        remedy += ", or a shorter output_interval"
    why = first.ending if first.ending.remedy else f"{first.ending}; {remedy}"
    return SolverError(
        f"{chooser.dae.full_name}: {wanted}{' and '.join(failures)} {fail}: {why}", first.partial
    )


def _tighter(candidate: Candidate, runs: Sequence[CandidateRun]) -> bool:
    """Return whether a candidate's predicted error is below that of its solver's runs so far."""
    own = [done.candidate.error for done in runs if done.candidate.solver == candidate.solver]
    return not own or candidate.error < min(own)


def _reject_below_rounding(chooser: _Chooser, accuracy: float) -> None:
    rounding = chooser.candidates.rounding
    worst = max(chooser.names, key=rounding.__getitem__)
    least = rounding[worst]
    if accuracy < least:
        raise ParameterError(
            f"{chooser.dae.full_name}: accuracy = {accuracy:g} is below {1.1 * least:.1e}, the "
            f"smallest possible: double precision carries {worst} no further; request less, or "
            "other outputs"
        )


def _unconfirmed(
    chooser: _Chooser, goal: Goal, accuracy: float, runs: Sequence[CandidateRun]
) -> SolverError:
    """Return the error that names the two runs of different solvers that agree best."""
    different = (
        Pair(a, b) for a, b in combinations(runs, 2) if a.candidate.solver != b.candidate.solver
    )
    best = min(different, key=lambda pair: pair.worst.scaled)
    worst = best.worst
    reached = (
        f"accuracy {accuracy:g} is not reached: {best.first.candidate} and "
        f"{best.second.candidate} are {worst.scaled:.1e} nominal values apart in {worst.name}"
    )
    partial = _with_check(best.better.run, goal, best.check)
    return SolverError(
        f"{chooser.dae.full_name}: {reached}, the best of this run; request less, a shorter run or "
        "other outputs",
        replace(partial, status=reached),
    )


def _affordable_run(chooser: _Chooser, goal: Goal, budget: float) -> Trajectory:
    """Return the most accurate run whose solver stays within a budget of time."""
    dae = chooser.dae
    begin, end = chooser.request.times.span(dae)
    share = (end - begin) / dae.experiment.stop_time
    every = chooser.cheapest_first()
    affordable = [c for c in every if share * c.solve_time <= budget]
    if not affordable:
        raise ParameterError(
            f"{dae.full_name}: budget = {1e3 * budget:g} ms; the cheapest configuration, "
            f"{every[0]}, takes {1e3 * share * every[0].solve_time:.2g} ms; increase the budget or "
            "shorten the run"
        )
    done, took, failures = None, 0.0, dict[str, SolverError]()
    for candidate in reversed(affordable):  # the most accurate one first
        try:
            done, took = _timed(chooser, candidate, budget)
        except SolverError as error:
            failures.setdefault(candidate.solver, error)
            continue
        if took <= budget:
            return _with_check(done.run, goal, _check(chooser, done))
    if done is None:
        raise _failed(chooser, goal, failures)
    raise SolverError(
        f"{dae.full_name}: {done.candidate}, the cheapest configuration, took {1e3 * took:.2g} ms "
        f"on this run, more than budget = {1e3 * budget:g} ms; increase the budget or "
        "shorten the run",
        replace(done.run, status=f"took {1e3 * took:.2g} ms, more than its budget"),
    )


def _timed(chooser: _Chooser, candidate: Candidate, budget: float) -> tuple[CandidateRun, float]:
    """Return a run and the time of its solver, s; a run above the budget is repeated once."""
    done = chooser.run(candidate)
    took: float = done.run.stats.get("solve_time", 0.0)
    if took > budget:
        done = chooser.run(candidate)
        took = min(took, done.run.stats.get("solve_time", 0.0))
    return done, took


def _check(chooser: _Chooser, done: CandidateRun) -> ErrorCheck:
    """Check a run by a solver that does not fail."""
    target = done.candidate.error / CHECK
    failed: list[str] = []
    while True:
        check = _good_enough(chooser.cheapest_first((done.candidate.solver, *failed)), target)
        if check is None:
            what = f"no other solver can check {done.candidate}"
            raise SolverError(f"{done.run.model}: {what}", done.run)
        try:
            second = chooser.run(check, checks=True)
        except SolverError as error:
            failed.append(check.solver)
            chooser = chooser.after(error)
            continue
        return chooser.check(Pair(done, second))


def _good_enough(cheapest_first: Sequence[Candidate], error: float) -> Candidate | None:
    """Return the cheapest candidate with at most this error, else the most accurate one."""
    good = (c for c in cheapest_first if c.error <= error)
    return next(good, cheapest_first[-1] if cheapest_first else None)
