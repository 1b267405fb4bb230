"""`SweepResult`: what is kept of many runs, read from the folder of a sweep."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cosim.arrays import Truths, Vector
from cosim.errors import UnknownName, UsageError
from cosim.files import write_atomically
from cosim.host.optional_packages import optional_module
from cosim.host.temporary import temporary_folder
from cosim.integrate.ensemble.ensemble import RunState
from cosim.study.sweep.samples import Samples
from cosim.study.sweep.statistics import Node, Sketch, added, merged, merged_branches, quantile
from cosim.study.sweep.store import STATES, Store
from cosim.trajectory import Column, Trajectory, repr_17

if TYPE_CHECKING:
    import xarray as xr

_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)  # of the datasets
_OPEN = STATES.index(RunState.INTERRUPTED)  # not computed yet


@dataclass(frozen=True, eq=False)
class Statistics:
    """Mean, spread, extremes and quantiles over the complete runs.

    Attributes:
        names: The outputs.
        node, sketch: Everything, per time and output.
    """

    names: tuple[str, ...]
    node: Node
    sketch: Sketch

    def count(self, name: str) -> NDArray[np.int64]:
        """Return how many runs count, (times,)."""
        return self.node.count[:, self._at(name)]

    def mean(self, name: str) -> Vector:
        """Return the mean over the runs, (times,)."""
        return self._known(name, self.node.mean)

    def variance(self, name: str) -> Vector:
        """Return the variance of the runs, its divisor one less than their number, (times,)."""
        return self._known(name, self.node.squares / np.maximum(self.node.count - 1, 1))

    def minimum(self, name: str) -> Vector:
        """Return the least value, (times,)."""
        return self._known(name, self.node.low)

    def maximum(self, name: str) -> Vector:
        """Return the largest value, (times,)."""
        return self._known(name, self.node.high)

    def quantile(self, name: str, q: float) -> Vector:
        """Return a quantile over the runs within 0.4 % of its value, (times,)."""
        if not 0 <= q <= 1:
            raise UsageError(f"quantile {q}: give a number from 0 to 1")
        return quantile(self.sketch, self.node, q)[:, self._at(name)]

    def _known(self, name: str, table: Vector) -> Vector:
        at = self._at(name)
        return np.where(self.node.count[:, at] > 0, table[:, at], np.nan)

    def _at(self, name: str) -> int:
        if name not in self.names:
            raise UnknownName.among("statistics", "output", name, self.names)
        return self.names.index(name)


@dataclass(frozen=True, eq=False)
class SweepResult:
    """What is kept of the runs of a sweep, in the order of its samples.

    Attributes:
        model: `MODEL/FORMULATION`, or the name in an FMU.
        samples: What was varied.
        columns: The outputs.
        time: Output times, s.
        codes: How each run ended, as positions in `STATES`, (runs,).
        reasons: By run: why it is not complete, where it left the model's limits, or where an FMU
            took a solver more steps than usual.
        steps, reached: Steps and good output times of each run, (runs,).
        numbers: What was kept by name, (runs,); not a number where a run is not complete.
        statistics: Over all complete runs, where they were asked for.
        meanings: Of the numbers.
        store: The folder; None where there is none.
        tables: The trajectories by chunk: first run and (runs, times, columns).

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
    meanings: Mapping[str, str]
    store: Path | None
    tables: Sequence[tuple[int, Vector]]

    def __len__(self) -> int:
        return len(self.codes)

    @property
    def states(self) -> tuple[RunState, ...]:
        """How each run ended."""
        return tuple(STATES[code] for code in self.codes)

    @property
    def complete(self) -> Truths:
        """Which runs reached their stop time, (runs,)."""
        return np.asarray(self.codes == STATES.index(RunState.COMPLETE), dtype=bool)

    @property
    def status(self) -> str:
        """How many runs ended how, in words."""
        counts = np.bincount(self.codes, minlength=len(STATES))
        return ", ".join(f"{n} {state}" for state, n in zip(STATES, counts, strict=True) if n)

    @property
    def stats(self) -> Mapping[str, Any]:
        """What all runs took together."""
        return {"runs": len(self), "steps": int(self.steps.sum())}

    @property
    def computed(self) -> Truths:
        """Which runs have been computed at all, (runs,)."""
        return np.asarray(self.codes != _OPEN, dtype=bool)

    def __getitem__(self, name: str) -> Vector:
        """Return a number of each run, or what was varied, (runs,).

        Raises:
            UnknownName: There is no such thing.
        """
        known = {**self.samples.columns, **self.numbers}
        if name not in known:
            raise UnknownName.among("sweep", "number", name, known)
        return known[name]

    @cached_property
    def values(self) -> Vector:
        """Trajectories, (runs, times, columns); not a number where a run did not come.

        Raises:
            UsageError: They were not kept.
        """
        if not self.tables:
            raise UsageError("the sweep kept no trajectories; ask with keep=['trajectories']")
        values = np.full((len(self), len(self.time), len(self.columns)), np.nan)
        for first, table in self.tables:
            values[first : first + len(table)] = table
        return values

    def run(self, i: int) -> Trajectory:
        """Return the trajectory of one run up to its last good time."""
        n = int(self.reached[i])
        complete = self.states[i] is RunState.COMPLETE
        status = "complete" if complete else self.reasons.get(i, str(self.states[i]))
        values = self.values[i, :n]
        return Trajectory(self.model, self.time[:n], self.columns, values, {}, status)

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the table of runs; the file is whole or not there."""
        write_atomically(path, self.csv_text().encode())

    def csv_text(self) -> str:
        """Return the table of runs: samples, status, reason, steps, numbers; one row per run."""
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        varied = self.samples.columns
        writer.writerow(("run", *varied, "status", "reason", "steps", *self.numbers))
        columns = (*varied.values(), *self.numbers.values())
        for i in range(len(self)):
            row = [repr_17(float(column[i])) for column in columns]
            told = (str(STATES[self.codes[i]]), self.reasons.get(i, ""), str(self.steps[i]))
            writer.writerow((str(i), *row[: len(varied)], *told, *row[len(varied) :]))
        return text.getvalue()

    def to_xarray(self) -> xr.Dataset:
        """Return an `xarray.Dataset`: dimension `run`, what was varied as its coordinates.

        Raises:
            MissingTool: xarray is not there.
        """
        xarray = optional_module("xarray", "sweep")
        flags = {"flag_values": list(range(len(STATES))), "flag_meanings": " ".join(STATES)}
        variables: dict[str, Any] = {
            "status": ("run", self.codes, flags),
            "steps": ("run", self.steps),
            "reached": ("run", self.reached, {"long_name": "good output times"}),
        }
        for name, column in self.numbers.items():
            told = {"long_name": self.meanings[name]} if name in self.meanings else {}
            variables[name] = ("run", column, told)
        about = {column.name: column.facts for column in self.columns}
        if self.statistics is not None:
            for name, facts in about.items():
                for kind in ("mean", "variance", "minimum", "maximum"):
                    table = getattr(self.statistics, kind)(name)
                    variables[f"{name}_over_runs_{kind}"] = ("time", table, facts)
                bands = np.array([self.statistics.quantile(name, q) for q in _QUANTILES])
                variables[f"{name}_over_runs_quantile"] = (("quantile", "time"), bands, facts)
        if self.tables:
            for i, output in enumerate(self.columns):
                values = self.values[:, :, i]
                variables[output.name] = (("run", "time"), values, about[output.name])
        coordinates: dict[str, Any] = {"time": ("time", self.time, {"units": "s"})}
        if self.statistics is not None:
            coordinates["quantile"] = ("quantile", np.array(_QUANTILES))
        for name, column in self.samples.columns.items():
            free = name if name not in variables else f"{name}_start"
            coordinates[free] = ("run", column)
        dataset: xr.Dataset = xarray.Dataset(variables, coordinates, {"model": self.model})
        return dataset

    def to_netcdf(self, path: str | os.PathLike[str]) -> None:
        """Write everything as one netCDF file; it is whole or not there."""
        with temporary_folder() as folder:
            made = folder / "sweep.nc"
            self.to_xarray().to_netcdf(made)
            write_atomically(path, made.read_bytes())

    def to_zarr(self, path: str | os.PathLike[str]) -> None:
        """Write everything as a zarr folder, which replaces what is there when it is whole."""
        optional_module("zarr", "sweep")
        target = Path(path)
        with temporary_folder(target.parent) as folder:
            made, old = folder / "made", folder / "old"
            self.to_xarray().to_zarr(made, consolidated=False, zarr_format=2)
            try:
                if target.exists():
                    target.rename(old)
                made.rename(target)
            except BaseException:  # Ctrl-C, too, leaves one of them
                if old.exists() and not target.exists():
                    old.rename(target)
                raise

    def indices(self, number: str, *, method: str = "sobol") -> dict[str, Vector]:
        """Return sensitivity indices of a number by name; see `cosim.study.sweep.indices`."""
        from cosim.study.sweep.indices import indices

        return indices(self.samples, self[number], method)


class _Tables(Sequence[tuple[int, Vector]]):
    """Trajectories by chunk, read from their files one at a time."""

    def __init__(self, store: Store, chunks: Sequence[tuple[int, int]]) -> None:
        self._store, self._places = store, chunks

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, i: Any) -> Any:
        record = self._store.read(*self._places[i])
        return record.first, record.values


def collect(
    store: Store,
    model: str,
    samples: Samples,
    columns: tuple[Column, ...],
    meanings: Mapping[str, str],
    *,
    temporary: bool,
) -> SweepResult:
    """Read what there is of a sweep.

    Args:
        store: Its folder.
        model, samples, columns, meanings: Of the sweep.
        temporary: Whether the folder will go away.
    """
    runs = len(samples)
    codes = np.full(runs, _OPEN, dtype=np.int8)
    steps, reached = (np.zeros(runs, dtype=np.int64) for _ in range(2))
    numbers: dict[str, Vector] = {}
    reasons: dict[int, str] = {}
    time = np.empty(0)
    tables: list[tuple[int, Vector]] = []
    places: list[tuple[int, int]] = []
    nodes: list[Node] = []
    sketch = Sketch(np.empty(0, np.int64), np.empty(0, np.int64))
    for record in store.records():
        part = slice(record.first, record.first + len(record))
        codes[part], steps[part], reached[part] = record.states, record.steps, record.reached
        reasons |= record.reasons
        for name, column in record.numbers.items():
            numbers.setdefault(name, np.full(runs, np.nan))[part] = column
        time = record.time if len(record.time) else time
        if record.values is not None:
            places.append((record.first, len(record)))
            if temporary:
                tables.append((record.first, record.values))
        if record.node is not None and record.sketch is not None:
            nodes = merged_branches([*nodes, record.node])
            sketch = added(sketch, record.sketch)
    statistics = None
    if nodes:
        statistics = Statistics(tuple(c.name for c in columns), merged(nodes), sketch)
    return SweepResult(
        model,
        samples,
        columns,
        time,
        codes,
        reasons,
        steps,
        reached,
        numbers,
        statistics,
        meanings,
        None if temporary else store.folder,
        tables if temporary else _Tables(store, places),
    )
