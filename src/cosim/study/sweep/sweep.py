"""`sweep`: many runs of a model, a scene or an FMU, in this process or over a dask cluster."""

import os
import platform
import sys
from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray
from tqdm import tqdm

from cosim.arrays import Truths, Vector
from cosim.errors import Interrupted, UnknownName, UsageError, naming_arguments_of
from cosim.files import write_atomically
from cosim.host.optional_packages import optional_module
from cosim.host.signals import ended_by_signals
from cosim.integrate.ensemble.ensemble import RunState, first_of, range_row, varied_rows
from cosim.integrate.ensemble.lanes import processors
from cosim.model.values import position, whole
from cosim.study.sweep.block import COMPLETE, NOT_COMPUTED, STATES, Block, Job
from cosim.study.sweep.functions import function_name
from cosim.study.sweep.reductions import Function, Statistics, keep_from
from cosim.study.sweep.samples import Samples, chosen_samples
from cosim.study.sweep.store import Layout, Store, stored_samples
from cosim.study.sweep.subject import RunKeywords, open_subject, run_settings
from cosim.text import MOST_LINES, counted, csv_text, text_table
from cosim.trajectory import Column, Trajectory

if TYPE_CHECKING:
    import xarray as xr


@naming_arguments_of
@dataclass(frozen=True, eq=False, repr=False)
class SweepResult:
    """Results of the runs of a sweep, in the order of its samples.

    Attributes:
        model: `MODEL/FORMULATION`, or the name in an FMU.
        samples: What was varied.
        columns: The outputs.
        time: Output times, s.
        codes: How each run ended, as positions in `STATES`, (runs,).
        reasons: By run: why it is not complete, where it left the model's validity conditions, or
            its note, such as on a short change that it may have missed.
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
    def of(cls, data: Store) -> "SweepResult":
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

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the varied quantities and of the numbers."""
        return (*self.samples.columns, *self.numbers)

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __getitem__(self, name: str) -> Vector:
        """Return a number of each run, or a varied quantity, (runs,).

        Raises:
            UnknownName: There is neither of that name.
        """
        UnknownName.reject("sweep", "number", self.names, name)
        return self.numbers[name] if name in self.numbers else self.samples.columns[name]

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
        i = position("sweep", "run", i, len(self))
        n = int(self.reached[i])
        complete = self.states[i] is RunState.COMPLETE
        status = "complete" if complete else self.reasons.get(i, str(self.states[i]))
        values = np.column_stack([self.data.read(column.name, i)[:n] for column in self.columns])
        return Trajectory(self.model, self.time[:n], self.columns, values, {}, status)

    def _need_trajectories(self) -> None:
        if not self.data.layout.keep.trajectories:
            raise UsageError("the sweep stores no trajectories; add keep=['trajectories']")

    def __repr__(self) -> str:
        layout = self.data.layout
        rows = varied_rows(self.samples.columns, layout.units)
        units = layout.number_units
        rows += [range_row(name, units.get(name, ""), v) for name, v in self.numbers.items()]
        head = f"{self.model}: {counted(len(self), 'run')}, {self.status}"
        kinds = dict.fromkeys(r.kind for r in layout.keep.reductions if r.of_motion)
        if layout.of_rows and kinds:
            head += f"; {', '.join(kinds)} of the rows"
        return "\n".join(
            [head, text_table(rows, most=MOST_LINES - 2), *first_of("reason", self.reasons)]
        )

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the table of runs; the file is whole or not there."""
        write_atomically(path, self.csv_text().encode())

    def csv_text(self) -> str:
        """Return the table of runs as CSV."""
        return csv_text(self.rows())

    def rows(self) -> list[dict[str, Any]]:
        """Return the table of runs: samples, status, reason, steps, numbers; one row per run."""
        varied = self.samples.distinct_names({"run", "status", "reason", "steps", *self.numbers})
        return [
            {
                "run": i,
                **{varied[name]: float(v[i]) for name, v in self.samples.columns.items()},
                "status": str(STATES[self.codes[i]]),
                "reason": self.reasons.get(i, ""),
                "steps": int(self.steps[i]),
                **{name: float(column[i]) for name, column in self.numbers.items()},
            }
            for i in range(len(self))
        ]

    def to_xarray(self) -> "xr.Dataset":
        """Return an `xarray.Dataset`: dimension `run`, what was varied as its coordinates.

        Arrays of a stored sweep are read from its folder when they are used.

        Raises:
            MissingTool: xarray is not installed.
        """
        return self.data.to_xarray()


_MOST_WORKERS = 1024
_STORE_FORMAT = 5
_LANE_BLOCK = 16, 1024  # fewest and most runs of a block in SIMD lanes
_BLOCK = 1, 16  # fewest and most runs of a block, run one by one
_BLOCKS = 24  # blocks of a sweep, if these bounds allow it
_BLOCK_NUMBERS = 1 << 21  # of all trajectories in a block, in memory


def sweep(
    subject: Any,
    start_values: Mapping[str, ArrayLike] | None = None,
    *,
    samples: Any = None,
    design: str | None = None,
    keep: Iterable[str | Function] = ("final",),
    store: str | os.PathLike[str] | None = None,
    resume: bool = False,
    scheduler: Any = None,
    workers: int | None = None,
    progress: bool | None = None,
    **run: Unpack[RunKeywords],
) -> SweepResult:
    """Run many variants of a model, a scene or an FMU.

    The results are the same, bit for bit, for any number of workers and with interruptions; a run
    that fails or has impossible values is a row like the others.

    Args:
        subject: A model's name, a `Dae`, SCENE.toml or FILE.fmu (its binary runs: trust it).
        start_values: Values by name, SI: arrays with one number per run, or one number for all.
            With a design: the range (low, high) of each, a distribution of `scipy.stats`, or one
            number; with "grid": the values of each.
        samples: Samples instead of arrays: a CSV file, a pandas table, or a result of `grid`,
            `design`. None with `resume`: the stored samples.
        design: "grid" for every combination, or KIND:N for N runs: sobol, lhs, halton, random.
        keep: Results: "trajectories", "statistics" (over all runs), and of each run "final", "max",
            "min", "mean", "rms" of all outputs, or "max(phi)" of one, "first(phi, 0.5)" for the
            time when it first crosses a level. Functions of a run's `Trajectory` return more
            numbers by name.
        store: A zarr folder for the results, written block by block.
        resume: Whether to continue the sweep in `store`; finished blocks are not repeated.
        scheduler: "local" for processes of this machine, the address of a dask scheduler, or a
            `distributed.Client`. None: this process for runs in SIMD lanes, which use all its
            threads, and without the extra `sweep`; otherwise "local".
        workers: Number of local processes; 0: this process. None: one per processor.
        progress: Whether to show progress on stderr; None: if that is a terminal.
        run: `outputs`, `output_times`, `start_time`, `stop_time`, `output_interval`, `solver`,
            `relative_tolerance`, `absolute_tolerance`, `step_size`, `max_step`, `on_invalid` as
            of `simulate_many`; otherwise those of the model or the scene.

    Raises:
        UnknownName, ParameterError, UsageError: A name, a number or a word is wrong; or the store
            holds another sweep.
        MissingTool: A package of the extra `sweep` is not installed.
        Interrupted: Ctrl-C; `partial` and the store hold the finished runs.

    Example:
        >>> run = {"stop_time": 1, "workers": 0}
        >>> found = sweep("crank_shaft", {"omega": [40, 50]}, keep=["final"], **run)
        >>> found["omega_final"]
        array([50., 60.])
    """
    settings = run_settings(run)
    opened = open_subject(subject)
    folder = None if store is None else Path(store).resolve()
    if folder is not None:
        optional_module("xarray", "sweep"), optional_module("zarr", "sweep")
    elif resume:
        raise UsageError("sweep: there is no store to resume; name it with store (--store)")
    if resume and folder is not None and samples is None and start_values is None:
        chosen = stored_samples(folder)
    else:
        chosen = chosen_samples(start_values, samples, design)
    columns = opened.columns(settings.pop("outputs", None))
    names = tuple(column.name for column in columns)
    stored = keep_from(keep, names)
    recorded = {**settings, "outputs": names}
    computed = opened.prepare([*chosen.columns], recorded)
    in_lanes = "lanes" in computed
    scheduler = _chosen_scheduler(scheduler, workers, alone=in_lanes and not stored.functions)
    time = opened.times(settings)
    manifest = {
        "format": _STORE_FORMAT,
        "model": opened.name,
        "model_digest": opened.digest,
        "samples": chosen.origin,
        "samples_digest": chosen.digest,
        "outputs": list(names),
        "keep": [*stored.words(), *map(function_name, stored.functions)],
        "settings": settings,
        "computed": computed,
        "versions": {name: version(name) for name in ("cosim-rigid", "casadi", "numpy")}
        | {"machine": platform.machine()},
    }
    block = _block_size(len(chosen), len(time) * len(names), in_lanes=in_lanes)
    layout = Layout(
        manifest, chosen, columns, time, stored, block, not opened.knows_motion(recorded),
        {name: opened.unit(name) for name in chosen.columns},
    )  # fmt: skip
    with ExitStack() as held:
        if scheduler is not None:  # this process waits for workers, which end with it
            held.enter_context(ended_by_signals())
        if folder is None:
            results = Store(layout)
        else:
            results = held.enter_context(Store.opened(layout, folder, resume=resume))
        job = Job(opened, recorded, len(time), stored, results.taken, processors())
        _fill(results, job, scheduler, workers, progress)
    return SweepResult.of(results)


def _fill(
    results: Store, job: Job, scheduler: Any, workers: int | None, progress: bool | None
) -> None:
    """Compute the blocks that a store does not hold yet.

    Raises:
        Interrupted: Ctrl-C; the store holds the finished blocks.
    """
    layout, total = results.layout, len(results.layout.samples)
    finished = {*results.finished()}
    left = [part for part in layout.blocks() if part not in finished]
    bar = tqdm(
        total=total,
        initial=total - sum(count for _, count in left),
        unit=" runs",
        # where stderr is no terminal; programs with windows have none
        disable=sys.stderr is None or (None if progress is None else not progress),
    )
    computing = _computed(job, layout.samples, left, scheduler, workers or processors())
    try:
        with bar, closing(computing) as blocks:
            for part in blocks:
                results.write(part)
                bar.update(len(part))
        results.finish()
    except KeyboardInterrupt as stopped:
        result = SweepResult.of(results)
        ended = sum(count for _, count in results.finished())
        done = f"sweep: interrupted; {ended} of {total} runs"
        where = " had ended"
        if results.folder is not None:
            where = f" are stored in {results.folder}; continue with resume=True (--resume)"
        raise Interrupted(done + where, result) from stopped


def _chosen_scheduler(scheduler: Any, workers: int | None, *, alone: bool) -> Any:
    """Return the requested scheduler; by default this process (None) if `alone`, else "local"."""
    if workers is not None:
        whole("sweep", "workers", workers, 0, _MOST_WORKERS)
    is_local = scheduler is None or (isinstance(scheduler, str) and scheduler == "local")
    if not is_local and workers is not None:
        raise UsageError("sweep: a scheduler has workers of its own; leave workers out")
    if scheduler is None and workers != 0:
        here = workers is None and (alone or find_spec("distributed") is None)
        return None if here else "local"
    return scheduler


def _computed(
    job: Job, samples: Samples, blocks: list[tuple[int, int]], scheduler: Any, workers: int
) -> Generator[Block, None, None]:
    """Yield every block as it is finished by this process, local processes or a cluster."""
    if scheduler is None:
        for first, count in blocks:
            yield job.reduced(job.compute(first, samples.part(first, count)))
    elif blocks:
        from cosim.study.sweep.cluster import connected, over_cluster

        # As bytes: other processes may not find a script's own functions
        packed = map(optional_module("cloudpickle", "sweep").dumps, job.keep.functions)
        there = replace(job, keep=replace(job.keep, functions=tuple(packed)), threads=1)
        with ExitStack() as stack:
            if isinstance(scheduler, str):
                scheduler = stack.enter_context(connected(scheduler, workers))
            yield from over_cluster(there, samples, blocks, scheduler)


def _block_size(runs: int, numbers: int, *, in_lanes: bool) -> int:
    """Return the number of runs in a block, a power of two, for a size of each trajectory."""
    least, most = _LANE_BLOCK if in_lanes else _BLOCK
    size = min(max(runs // _BLOCKS, least), most, max(_BLOCK_NUMBERS // max(numbers, 1), 1))
    return int(1 << size.bit_length() - 1)
