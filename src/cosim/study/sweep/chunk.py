"""One chunk of a sweep: run, reduced and written by whatever process it came to."""

import pickle
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from time import perf_counter
from typing import Any

import numpy as np

from cosim.arrays import Vector
from cosim.integrate.ensemble.ensemble import Ensemble, RunState
from cosim.study.sweep.keep import Keep
from cosim.study.sweep.statistics import node_of, sketch_of
from cosim.study.sweep.store import STATES, ChunkRecord, Store, Watch
from cosim.study.sweep.subjects.opening import opened_subject
from cosim.study.sweep.subjects.subject import Rows, Subject
from cosim.trajectory import Trajectory


@dataclass(frozen=True)
class Job:
    """What every chunk of a sweep has in common; it goes with each task.

    Attributes:
        subject: What is swept.
        outputs: What is recorded.
        settings: Of the runs, by the names of `simulate_many`.
        keep: What is kept.
        function: A user's function of a `Trajectory`, pickled.
        store: The folder, as every process sees it.
        threads: Of each process.
    """

    subject: Subject
    outputs: tuple[str, ...]
    settings: Mapping[str, Any]
    keep: Keep
    function: bytes | None
    store: str
    threads: int = 1


@dataclass(frozen=True)
class Summary:
    """What returns of a chunk: where it is, how its runs ended, how long it took."""

    first: int
    count: int
    states: Mapping[str, int]
    numbers: int
    seconds: float


def compute_chunk(job: Job, first: int, columns: Mapping[str, Vector]) -> Summary:
    """Run consecutive samples and write what is kept of them.

    Raises:
        CosimError: Not of single runs, which are rows, but of all of them.
    """
    began = perf_counter()
    store = Store(job.store)
    count = len(next(iter(columns.values())))
    if store.has(first, count):  # a scheduler may ask again where an answer was lost
        return summary_of(store.read(first, count))
    with store.watching(first, count) as watch:
        subject = opened_subject(job.subject)
        ensemble = subject.run(Rows(columns, job.outputs, job.settings, job.threads), watch)
        if RunState.INTERRUPTED in ensemble.states:
            raise KeyboardInterrupt
        record = _record(job, first, ensemble, watch)
    store.write(record)
    return summary_of(record, ensemble.values.size, perf_counter() - began)


def summary_of(record: ChunkRecord, numbers: int = 0, seconds: float = 0.0) -> Summary:
    """Return what is told of a chunk."""
    states = Counter(str(STATES[i]) for i in record.states)
    return Summary(record.first, len(record), states, numbers, seconds)


def lost(job: Job, run: int, reason: str) -> Summary:
    """Write a run that ends every process that computes it as a row."""
    record = ChunkRecord(
        run,
        np.empty(0),
        np.array([STATES.index(RunState.LOST)], dtype=np.int8),
        np.zeros(1, dtype=np.int64),
        np.zeros(1, dtype=np.int64),
        {run: reason},
        {},
    )
    Store(job.store).write(record)
    return summary_of(record)


def _record(job: Job, first: int, ensemble: Ensemble, watch: Watch) -> ChunkRecord:
    states = list(ensemble.states)
    reasons = dict(ensemble.invalid) | dict(ensemble.reasons)
    numbers: dict[str, Vector] = {}
    good = ensemble.complete
    for reduction in job.keep.reductions:
        column = reduction.of(ensemble.time, ensemble[reduction.variable])
        numbers[reduction.name] = np.where(good, column, np.nan)
    if job.function is not None:
        for i in np.flatnonzero(good).tolist():
            watch(i)
            try:
                found = dict(_unpickled(job.function)(ensemble.run(i)))
                for name, value in found.items():
                    column = numbers.setdefault(str(name), np.full(len(states), np.nan))
                    column[i] = float(value)
            except Exception as error:
                states[i] = RunState.FAILED
                reasons[i] = f"the function failed with {type(error).__name__}: {error}"
    good = np.array([state is RunState.COMPLETE for state in states], dtype=bool)
    statistics = job.keep.statistics
    return ChunkRecord(
        first,
        ensemble.time,
        np.array([STATES.index(state) for state in states], dtype=np.int8),
        ensemble.steps,
        ensemble.reached,
        {first + i: reason for i, reason in sorted(reasons.items())},
        numbers,
        ensemble.values if job.keep.trajectories else None,
        node_of(first, ensemble.values, good) if statistics else None,
        sketch_of(ensemble.values, good) if statistics else None,
    )


@lru_cache(2)
def _unpickled(content: bytes) -> Callable[[Trajectory], Mapping[str, float]]:
    function: Callable[[Trajectory], Mapping[str, float]] = pickle.loads(content)
    return function
