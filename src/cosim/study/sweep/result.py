"""`SweepResult`: how the runs of a sweep ended, their numbers, statistics and trajectories."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cosim.arrays import Truths, Vector
from cosim.errors import UnknownName, UsageError
from cosim.files import write_atomically
from cosim.integrate.ensemble.ensemble import RunState
from cosim.study.sweep.block import COMPLETE, NOT_COMPUTED, STATES
from cosim.study.sweep.reductions import Statistics
from cosim.study.sweep.samples import Samples
from cosim.study.sweep.store import Store
from cosim.text import csv_text
from cosim.trajectory import Column, Trajectory

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True, eq=False)
class SweepResult:
    """Results of the runs of a sweep, in the order of its samples.

    Attributes:
        model: `MODEL/FORMULATION`, or the name in an FMU.
        samples: What was varied.
        columns: The outputs.
        time: Output times, s.
        codes: How each run ended, as positions in `STATES`, (runs,).
        reasons: By run: why it is not complete, where it left the model's validity conditions, or
            where an FMU took a solver more steps than usual.
        steps, reached: Steps and valid output times of each run, (runs,).
        numbers: Reductions by name, (runs,); not a number where a run is not complete.
        statistics: Over all complete runs; None if the sweep did not compute them.
        data: The store.

    Example:
        >>> import cosim
        >>> found = cosim.sweep("crank_shaft", {"omega": [40, 50]}, stop_time=1, workers=0)
        >>> len(found)
        2
    """

    model: str
    samples: Samples
    columns: tuple[Column, ...]
    time: Vector
    codes: NDArray[np.int8]
    reasons: Mapping[int, str]
    steps: NDArray[np.int64]
    reached: NDArray[np.int64]
    numbers: Mapping[str, Vector]
    statistics: Statistics | None
    data: Store

    @classmethod
    def of(cls, data: Store) -> SweepResult:
        """Return what a store holds."""
        layout = data.layout
        return cls(
            layout.manifest["model"],
            layout.samples,
            layout.columns,
            layout.time,
            data["status"],
            {run: str(reason) for run, reason in enumerate(data["reason"].tolist()) if reason},
            data["steps"],
            data["reached"],
            {name: data[name] for name in data.numbers},
            data.statistics(),
            data,
        )

    @property
    def store(self) -> Path | None:
        """The zarr folder; None for a sweep in memory."""
        return self.data.folder

    def __len__(self) -> int:
        return len(self.codes)

    @property
    def states(self) -> tuple[RunState, ...]:
        """How each run ended."""
        return tuple(STATES[code] for code in self.codes)

    @property
    def complete(self) -> Truths:
        """Which runs reached their stop time, (runs,)."""
        return np.asarray(self.codes == COMPLETE, dtype=bool)

    @property
    def status(self) -> str:
        """Number of runs by how they ended, e.g. "9 complete, 1 failed"."""
        counts = np.bincount(self.codes, minlength=len(STATES))
        return ", ".join(f"{n} {state}" for state, n in zip(STATES, counts, strict=True) if n)

    @property
    def stats(self) -> Mapping[str, Any]:
        """Cost of all runs together."""
        return {"runs": len(self), "steps": int(self.steps.sum())}

    @property
    def computed(self) -> Truths:
        """Which runs have been computed at all, (runs,)."""
        return np.asarray(self.codes != NOT_COMPUTED, dtype=bool)

    def __getitem__(self, name: str) -> Vector:
        """Return a number of each run, or a varied quantity, (runs,).

        Raises:
            UnknownName: There is neither of that name.
        """
        known = {**self.samples.columns, **self.numbers}
        if name not in known:
            raise UnknownName.among("sweep", "number", name, known)
        return known[name]

    @cached_property
    def values(self) -> Vector:
        """Trajectories, (runs, times, outputs); not a number where a run has no value.

        Raises:
            UsageError: The sweep does not store them.
        """
        self._need_trajectories()
        return np.stack([self.data[column.name] for column in self.columns], axis=2)

    def run(self, i: int) -> Trajectory:
        """Return the trajectory of one run up to its last valid time.

        Raises:
            UsageError: The sweep does not store trajectories.
        """
        self._need_trajectories()
        n = int(self.reached[i])
        complete = self.states[i] is RunState.COMPLETE
        status = "complete" if complete else self.reasons.get(i, str(self.states[i]))
        values = np.column_stack([self.data.row(column.name, i)[:n] for column in self.columns])
        return Trajectory(self.model, self.time[:n], self.columns, values, {}, status)

    def _need_trajectories(self) -> None:
        if not self.data.layout.keep.trajectories:
            raise UsageError("the sweep stores no trajectories; add keep=['trajectories']")

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the table of runs; the file is whole or not there."""
        write_atomically(path, self.csv_text().encode())

    def csv_text(self) -> str:
        """Return the table of runs: samples, status, reason, steps, numbers; one row per run."""
        rows = [
            {
                "run": i,
                **{name: float(column[i]) for name, column in self.samples.columns.items()},
                "status": str(STATES[self.codes[i]]),
                "reason": self.reasons.get(i, ""),
                "steps": int(self.steps[i]),
                **{name: float(column[i]) for name, column in self.numbers.items()},
            }
            for i in range(len(self))
        ]
        return csv_text(rows)

    def to_xarray(self) -> xr.Dataset:
        """Return an `xarray.Dataset`: dimension `run`, what was varied as its coordinates.

        Arrays of a stored sweep are read from its folder when they are used.

        Raises:
            MissingTool: xarray is not installed.
        """
        return self.data.to_xarray()
