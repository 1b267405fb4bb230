"""`sweep`: many runs over the processes of a machine or a cluster, kept as they finish."""

import os
import pickle
import platform
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cosim.errors import Interrupted, ParameterError, UsageError
from cosim.host.optional_packages import optional_module
from cosim.host.temporary import temporary_folder
from cosim.integrate.ensemble.simulate_many import processors
from cosim.integrate.solver import Solver
from cosim.study.sweep.chunk import Job
from cosim.study.sweep.engines.cluster import connected, run_cluster
from cosim.study.sweep.engines.processes import run_here, run_processes
from cosim.study.sweep.engines.schedule import Schedule, gaps
from cosim.study.sweep.keep import keep_from
from cosim.study.sweep.progress import SweepProgress
from cosim.study.sweep.result import SweepResult, collect
from cosim.study.sweep.samples import Samples, as_samples, digest_of
from cosim.study.sweep.store import Store
from cosim.study.sweep.subjects.opening import as_subject, opened_subject
from cosim.trajectory import Trajectory

_STORE_FORMAT = 1  # of the store
_LANE_CHUNK = 16  # runs; fewer leave lanes empty

Function = Callable[[Trajectory], Mapping[str, float]]


def sweep(
    subject: Any,
    samples: Any = None,
    *,
    outputs: Sequence[str] | None = None,
    keep: Iterable[str] = ("final",),
    function: Function | None = None,
    times: ArrayLike | None = None,
    start_time: float | None = None,
    stop_time: float | None = None,
    output_interval: float | None = None,
    solver: str | Solver | None = None,
    relative_tolerance: float | None = None,
    absolute_tolerance: float | None = None,
    step_size: float | None = None,
    on_invalid: str | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    client: Any = None,
    chunk: int | None = None,
    store: str | os.PathLike[str] | None = None,
    resume: bool = False,
    progress: bool | None = None,
) -> SweepResult:
    """Run many variants of a model, a scene or an FMU.

    What is returned is the same, bit for bit, for any number of workers and size of chunks, and
    with interruptions; a run that fails or is refused is a row like the others.

    Args:
        subject: A model's name, a `Dae`, SCENE.toml or FILE.fmu (its binary runs: trust it).
        samples: What is varied: arrays by name, a CSV file, a pandas table, or what `grid`,
            `design` and `sensitivity_design` of `cosim.study.sweep` return; SI units. The stored
            ones when None, to resume.
        outputs: Names to record; the model's own when None.
        keep: Words: "trajectories", "statistics" (over all runs), and of each run "final", "max",
            "min", "mean", "rms" of all outputs, or "max(phi)" of one, "first(phi, 0.5)" for the
            time when it first crosses a level.
        function: Of a run's `Trajectory`; returns more numbers by name.
        times: Output times, s; see `simulate_many`.
        start_time, stop_time, output_interval, solver, relative_tolerance, absolute_tolerance,
            step_size, on_invalid: See `simulate_many`; the model's or the scene's own when None.
        workers: Processes; one per processor when None; 0: this process itself, with threads.
        scheduler: Instead: "local" for a Dask cluster of this machine, or a scheduler's address.
        client: Instead: a `distributed.Client`. Its workers must see the store's folder.
        chunk: Runs of a task, rounded down to a power of two; about a second when None.
        store: Folder that keeps everything: manifest, samples, chunks, and at the end `runs.csv`
            and `results.zarr`.
        resume: Whether to go on with a store; nothing that is finished is computed again.
        progress: Whether to say on stderr how far it is; where that is a terminal when None.

    Raises:
        UnknownName, ParameterError, UsageError: A name, a number or a word is wrong; or the store
            holds another sweep.
        MissingTool: A package of the extra `sweep` is not there.
        Interrupted: Ctrl-C; `partial` holds what had finished, and the store keeps it.

    Example:
        >>> run = {"stop_time": 1, "workers": 0}
        >>> found = sweep("crank_shaft", {"omega": [40, 50]}, keep=["final"], **run)
        >>> found["omega_final"]
        array([50., 60.])
    """
    thing = opened_subject(as_subject(subject))
    if store is not None:
        optional_module("xarray", "sweep"), optional_module("zarr", "sweep")
    if samples is None and (store is None or not resume):
        raise UsageError("sweep: give samples; they may be left out to resume a store")
    chosen = Store(store).samples() if samples is None and store else as_samples(samples)
    settings = _kept_settings(
        times=times,
        start_time=start_time,
        stop_time=stop_time,
        output_interval=output_interval,
        solver=solver,
        relative_tolerance=relative_tolerance,
        absolute_tolerance=absolute_tolerance,
        step_size=step_size,
        on_invalid=on_invalid,
    )
    columns = thing.columns(outputs)
    names = tuple(column.name for column in columns)
    kept = keep_from(keep, names)
    how = thing.prepare([*chosen.columns], {**settings, "outputs": names})
    lean = "lanes" in how
    crew = _Crew.of(workers, scheduler, client)
    with ExitStack() as stack:
        temporary = store is None
        folder = stack.enter_context(temporary_folder()) if store is None else os.fspath(store)
        kept_here = Store(Path(folder).resolve() / "sweep" if temporary else Path(folder).resolve())
        manifest = {
            "format": _STORE_FORMAT,
            "model": thing.name,
            "model_digest": thing.digest,
            "samples": chosen.origin,
            "samples_digest": chosen.digest,
            "problem": None if chosen.problem is None else dict(chosen.problem),
            "runs": len(chosen),
            "outputs": list(names),
            "keep": kept.words(),
            "function": _function_name(function),
            "settings": settings,
            "computed": how,
            "versions": _versions(),
        }
        if resume and not temporary:
            kept_here.reopen(manifest)
        else:
            kept_here.create(manifest, chosen)
        packed = None if function is None else _packed(function, crew.processes > 0)
        job = Job(
            as_subject(subject),
            names,
            settings,
            kept,
            packed,
            str(kept_here.folder),
            1 if crew.processes or crew.scheduler or crew.client else processors(),
        )
        finished = kept_here.finished()
        schedule = Schedule(
            gaps(len(chosen), finished), max(1, crew.processes), chunk, _LANE_CHUNK if lean else 1
        )
        tell = SweepProgress(len(chosen), sum(count for _, count in finished), progress)
        meanings = {r.name: r.meaning for r in kept.reductions}
        gather = partial(
            collect, kept_here, thing.name, chosen, columns, meanings, temporary=temporary
        )
        try:
            if not schedule.over:
                crew.compute(job, chosen, schedule, tell)
        except KeyboardInterrupt as stopped:
            result = gather()
            done = int(result.computed.sum())
            where = "" if temporary else f" are kept in {store}; go on with resume (--resume)"
            told = f"sweep: interrupted; {done} of {len(chosen)} runs{where or ' had ended'}"
            raise Interrupted(told, result) from stopped
        finally:
            tell.end()
        result = gather()
        if not temporary:
            result.to_csv(kept_here.folder / "runs.csv")
            result.to_zarr(kept_here.folder / "results.zarr")
        return result


@dataclass(frozen=True)
class _Crew:
    """Who computes: some processes, or a cluster."""

    processes: int
    scheduler: str | None
    client: Any

    @classmethod
    def of(cls, workers: int | None, scheduler: str | None, client: Any) -> "_Crew":
        if scheduler is not None and client is not None:
            raise UsageError("sweep: give a scheduler or a client, not both")
        if workers is not None and (not isinstance(workers, int) or workers < 0):
            raise ParameterError(f"sweep: workers = {workers!r}; give 0 or more")
        if scheduler not in (None, "local") and workers is not None:
            raise UsageError("sweep: a scheduler has workers of its own; leave workers out")
        return cls(processors() if workers is None else workers, scheduler, client)

    def compute(self, job: Job, samples: Samples, schedule: Schedule, tell: SweepProgress) -> None:
        if self.client is not None:
            run_cluster(job, samples, schedule, tell, self.client)
        elif self.scheduler is not None:
            with connected(self.scheduler, max(1, self.processes)) as client:
                run_cluster(job, samples, schedule, tell, client)
        elif self.processes:
            run_processes(job, samples, schedule, tell, self.processes)
        else:
            run_here(job, samples, schedule, tell)


def _kept_settings(*, times: ArrayLike | None, **given: Any) -> dict[str, Any]:
    """Return what is not None, in forms that JSON keeps."""
    solver = given.get("solver")
    if isinstance(solver, Solver):
        numbers = {name: value for name, value in vars(solver).items() if value is not None}
        twice = next((name for name in numbers if given.get(name) is not None), None)
        if twice is not None:
            raise UsageError(f"sweep: {twice} is given beside {solver}; give it once")
        given |= {"solver": solver.name, **numbers}
    settings = {name: value for name, value in given.items() if value is not None}
    if times is not None:
        if "stop_time" in settings or "output_interval" in settings:
            raise UsageError("give times, or stop_time and output_interval, not both")
        try:
            settings["times"] = np.atleast_1d(np.array(times, dtype=float)).tolist()
        except (TypeError, ValueError) as error:
            raise ParameterError(f"times: {error}; give times in s") from error
    return settings


def _function_name(function: Function | None) -> str | None:
    """Return by what a user's function is told from another."""
    if function is None:
        return None
    name = getattr(function, "__qualname__", type(function).__qualname__)
    code = getattr(function, "__code__", None)
    digest = "" if code is None else digest_of([code.co_code, repr(code.co_consts).encode()])[:16]
    return f"{name} {digest}".strip()


def _packed(function: Function, elsewhere: bool) -> bytes:
    """Return a function as bytes; other processes know nothing of a script's own ones."""
    if elsewhere:
        found: bytes = optional_module("cloudpickle", "sweep").dumps(function)
        return found
    try:
        return pickle.dumps(function)
    except (pickle.PicklingError, AttributeError, TypeError):
        packed: bytes = optional_module("cloudpickle", "sweep").dumps(function)
        return packed


def _versions() -> dict[str, str]:
    packages = {name: version(name) for name in ("cosim-rigid", "casadi", "numpy")}
    return {**packages, "machine": platform.machine()}
