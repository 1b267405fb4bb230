"""A block of a sweep: consecutive runs that are computed and stored together."""

import pickle
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.arrays import Vector
from cosim.errors import UsageError
from cosim.integrate.ensemble.ensemble import Ensemble, RunState
from cosim.study.sweep.reductions import Function, Keep, Moments, moments_of
from cosim.study.sweep.subject import Subject
from cosim.text import short_reason

STATES = tuple(RunState)  # a state is stored as its position here
COMPLETE = STATES.index(RunState.COMPLETE)
NOT_COMPUTED = STATES.index(RunState.INTERRUPTED)


@dataclass(frozen=True, eq=False)
class Block:
    """Results of consecutive runs.

    Attributes:
        first: Position of the first run in the sweep.
        states, steps, reached: Of each run: position in `STATES`, steps, valid output times.
        reasons: By position in the sweep: why a run is not complete, where it left the model's
            validity conditions, or its note.
        numbers: Reductions by name, (runs,).
        values: Trajectories, (runs, times, outputs); None if the sweep does not store them.
        moments: Of the complete runs; None if the sweep does not compute them.
    """

    first: int
    states: NDArray[np.int8]
    steps: NDArray[np.int64]
    reached: NDArray[np.int64]
    reasons: Mapping[int, str]
    numbers: Mapping[str, Vector]
    values: Vector | None
    moments: Moments | None = None

    def __len__(self) -> int:
        return len(self.states)


@dataclass(frozen=True, eq=False)
class Job:
    """Common data of the blocks of a sweep; every worker receives them once.

    Attributes:
        subject: The model or FMU.
        settings: Keywords of every run, the names of the recorded outputs among them.
        times: Number of output times.
        keep: The results to store.
        taken: Names that the number of a user's function cannot have.
        threads: Threads of a process, for runs in SIMD lanes.
    """

    subject: Subject
    settings: Mapping[str, Any]
    times: int
    keep: Keep
    taken: frozenset[str]
    threads: int = 1

    def compute(self, first: int, columns: Mapping[str, Vector]) -> Block:
        """Run consecutive samples, from `first` of the sweep on, with values by name, (runs,).

        Returns:
            The block with all trajectories; see `reduced`.

        Raises:
            CosimError: The settings suit no run. A run that fails is a row of the block.
            KeyboardInterrupt: Ctrl-C.
        """
        ensemble = self.subject.run(columns, self.settings, self.threads)
        if RunState.INTERRUPTED in ensemble.states:
            raise KeyboardInterrupt
        states = np.array([STATES.index(state) for state in ensemble.states], dtype=np.int8)
        reasons = {**ensemble.notes, **ensemble.invalid, **ensemble.reasons}
        numbers = dict[str, Vector]()
        for reduction in self.keep.reductions:
            numbers[reduction.name] = np.full(len(states), np.nan)
        if any(reduction.of_motion for reduction in self.keep.reductions):
            every = ensemble.curves()
        else:
            every = ((i, ensemble.rows(i)) for i in np.flatnonzero(states == COMPLETE).tolist())
        for i, known in every if self.keep.reductions else ():
            for reduction in self.keep.reductions:
                curve = ensemble.names.index(reduction.variable)
                numbers[reduction.name][i] = reduction.of(known, curve)
        for function in self.keep.functions:
            _add_results(function, ensemble, states, reasons, numbers, self.taken | {*numbers})
        return Block(
            first,
            states,
            ensemble.steps,
            ensemble.reached,
            {first + i: short_reason(reason) for i, reason in sorted(reasons.items())},
            numbers,
            ensemble.values,
        )

    def reduced(self, block: Block) -> Block:
        """Return a block with its moments, and with trajectories only if they are stored."""
        values = block.values
        if values is None:
            return block
        statistics = self.keep.statistics
        moments = moments_of(values, block.states == COMPLETE) if statistics else None
        return replace(block, values=values if self.keep.trajectories else None, moments=moments)

    def lost(self, run: int, reason: str) -> Block:
        """Return a run whose results are lost with the process that computed it."""
        return Block(
            run,
            np.array([STATES.index(RunState.LOST)], dtype=np.int8),
            np.zeros(1, dtype=np.int64),
            np.zeros(1, dtype=np.int64),
            {run: reason},
            {},
            np.full((1, self.times, len(self.settings["outputs"])), np.nan),
        )


def joined(blocks: Sequence[Block]) -> Block:
    """Return blocks that follow each other, with their trajectories, as one."""
    names = dict.fromkeys(name for block in blocks for name in block.numbers)
    missing = {len(block): np.full(len(block), np.nan) for block in blocks}

    def column(name: str) -> Vector:
        return np.concatenate([b.numbers.get(name, missing[len(b)]) for b in blocks])

    return Block(
        blocks[0].first,
        np.concatenate([block.states for block in blocks]),
        np.concatenate([block.steps for block in blocks]),
        np.concatenate([block.reached for block in blocks]),
        {run: reason for block in blocks for run, reason in block.reasons.items()},
        {name: column(name) for name in names},
        np.concatenate([block.values for block in blocks if block.values is not None]),
    )


def _add_results(
    function: Function | bytes,
    ensemble: Ensemble,
    states: NDArray[np.int8],
    reasons: dict[int, str],
    numbers: dict[str, Vector],
    taken: Collection[str],
) -> None:
    """Add the numbers of a user's function for each complete run; an exception fails that run.

    Raises:
        UsageError: A number has the name of something else in the sweep.
    """
    for i in np.flatnonzero(states == COMPLETE).tolist():
        try:
            call = _unpickled(function) if isinstance(function, bytes) else function
            found = {str(name): float(v) for name, v in dict(call(ensemble.run(i))).items()}
        except Exception as error:
            states[i] = STATES.index(RunState.FAILED)
            reasons[i] = f"the function failed with {type(error).__name__}: {error}"
            for column in numbers.values():
                column[i] = np.nan
            continue
        for name, value in found.items():
            if name in taken:
                raise UsageError(
                    f"sweep: a function of keep returns '{name}', which the results have already; "
                    "give its number another name"
                )
            numbers.setdefault(name, np.full(len(states), np.nan))[i] = value


@lru_cache(2)
def _unpickled(content: bytes) -> Function:
    function: Function = pickle.loads(content)
    return function
