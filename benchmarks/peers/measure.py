"""Comparable times: medians of interleaved repeats."""

import gc
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count
from math import inf
from random import Random
from statistics import median
from time import perf_counter, process_time

from entries import Evaluation, Run, Solver
from problem import SEED, Problem

TARGETS = (1e-4, 1e-7, 1e-10)
LOOSEST, PER_DECADE = 1e-1, 3  # tolerances
TOO_LONG = 3.0  # s: a longer run ends the search
REPEATS = 31
FEWEST, ENOUGH = 5, 1.0  # repeats and total time in s after which a run is not repeated
CALLS = 2000  # right-hand sides in a turn


@dataclass(frozen=True)
class Chosen:
    """A run that meets a target.

    Attributes:
        tolerance, error: Relative tolerance, and the resulting global error.
        run: Function that returns the states.
    """

    tolerance: float
    error: float
    run: Run


@dataclass(frozen=True)
class Choice:
    """Runs of one solver that meet the targets.

    Attributes:
        runs: By target; a target that is not met is missing.
        preparation: Time until the first result, s: building, compiling, running.
    """

    runs: dict[float, Chosen]
    preparation: float


def choose(solver: Solver, problem: Problem) -> Choice:
    """Try tolerances from the largest; for each target, choose the fastest run that meets it."""
    found: dict[float, Chosen] = {}
    fastest = dict.fromkeys(TARGETS, inf)
    preparation = 0.0
    for k in count():
        tolerance = LOOSEST * 10 ** (-k / PER_DECADE)
        if len(found) == len(TARGETS) or tolerance < solver.tightest:
            break
        began = perf_counter()
        run = solver.prepare(tolerance)
        error = problem.error(run())
        preparation = preparation or perf_counter() - began
        taken = min(_processor_time(run) for _ in range(2))
        for target in TARGETS:
            if error <= target and taken < fastest[target]:
                found[target], fastest[target] = Chosen(tolerance, error, run), taken
        if taken > TOO_LONG:
            break
    if solver.final is not None:
        for target, chosen in found.items():
            began = perf_counter()
            run = solver.final(chosen.tolerance)
            error = problem.error(run())
            preparation = max(preparation, perf_counter() - began)
            found[target] = Chosen(chosen.tolerance, error, run)
    return Choice(found, preparation)


def interleaved(runs: Sequence[Callable[[], object]]) -> list[float]:
    """Return the median CPU time of each run, s.

    The CPU time leaves out the work of other processes. The order is shuffled in every round. Each
    run is executed twice and the second time counts, so that threads and caches of the previous
    run have no effect.
    """
    times: list[list[float]] = [[] for _ in runs]
    pairs = list(zip(runs, times, strict=True))
    order = Random(SEED)
    gc.disable()
    for _ in range(REPEATS):
        order.shuffle(pairs)
        for run, taken in pairs:
            if len(taken) < FEWEST or sum(taken) < ENOUGH:
                run()
                taken.append(_processor_time(run))
    gc.enable()
    return [median(taken) for taken in times]


def per_call(evaluations: Sequence[Evaluation]) -> list[float]:
    """Return the median time of one evaluation, s; a round has CALLS of them."""

    def turn(evaluation: Evaluation) -> None:
        for _ in range(CALLS // evaluation.count):
            evaluation.run()

    turns = [partial(turn, evaluation) for evaluation in evaluations]
    return [time / CALLS for time in interleaved(turns)]


def _processor_time(run: Callable[[], object]) -> float:
    began = process_time()
    run()
    return process_time() - began
