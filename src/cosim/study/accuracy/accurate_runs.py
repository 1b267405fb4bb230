"""A run of the accuracy that a user asks for.

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
from cosim.study.accuracy.checked_runs import (
    CHECK,
    Done,
    Pair,
    Solve,
    labelled,
    promised_error,
    promising,
    run_of,
)
from cosim.study.accuracy.front import Front
from cosim.study.tradeoff.measurement import Measurement
from cosim.trajectory import Trajectory

SAFETY = 3.0  # by which the front's error is to be below what is asked for


def accurate_run(
    dae: Dae, front: Front, solve: Solve, names: Sequence[str], accuracy: float
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
        measured = promising([m for m in every if _tighter(m, runs)], target)
        if measured is None:
            break
        try:
            runs.append(run_of(measured, solve))
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
            return labelled(pair.better.run, {"accuracy": accuracy} | pair.facts)
        target = min(target, runs[-1].promised) * min(0.1, accuracy / pair.worst.scaled)
    if len(runs) < 2:
        raise SolverError(
            f"{dae.full_name}: {runs[0] if runs else 'accuracy'} cannot be checked: "
            f"{', '.join(map(str, failures.values())) or 'there is no other solver'}",
            runs[0].run if runs else None,
        )
    raise _unconfirmed(dae, accuracy, _closest(runs))


def _tighter(measured: Measurement, runs: Sequence[Done]) -> bool:
    """Tell whether a configuration promises more than its solver's runs so far."""
    own = [run.promised for run in runs if run.solver == measured.configuration.solver]
    return not own or promised_error(measured) < min(own)


def _refuse_too_much(dae: Dae, front: Front, accuracy: float, names: Sequence[str]) -> None:
    worst = max(names, key=front.rounding.__getitem__)
    least = front.rounding[worst]
    if accuracy < least:
        raise ParameterError(
            f"{dae.full_name}: accuracy = {accuracy:g} is below {1.1 * least:.1e}, the smallest "
            f"possible: double precision carries {worst} no further; ask for less, or for other "
            "outputs"
        )


def _closest(runs: Sequence[Done]) -> Pair:
    """Return the two runs of different solvers that agree best."""
    pairs = [Pair(a, b) for a, b in combinations(runs, 2) if a.solver != b.solver]
    return min(pairs, key=lambda pair: pair.worst.scaled)


def _unconfirmed(dae: Dae, accuracy: float, best: Pair) -> SolverError:
    worst = best.worst
    reached = (
        f"accuracy {accuracy:g} is not reached: {best.first} and {best.second} are "
        f"{worst.scaled:.1e} nominal values apart in {worst.name}"
    )
    partial = labelled(best.better.run, {"accuracy": accuracy} | best.facts)
    return SolverError(
        f"{dae.full_name}: {reached}, the best of this run; ask for less, for a shorter run or "
        "for other outputs",
        replace(partial, status=reached),
    )
