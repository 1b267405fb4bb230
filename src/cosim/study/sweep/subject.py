"""Subjects of a sweep: a model, a scene or an FMU. Only this module calls a simulation."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from threading import Lock
from time import perf_counter
from typing import Any

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.runge_kutta.lane_library import lane_library, processor_lanes
from cosim.errors import FmuError, UsageError
from cosim.fmi.run.description import by_name, unit_of
from cosim.fmi.run.isolated import run_apart
from cosim.fmi.run.opened import OpenedFmu
from cosim.fmi.trust import is_made_here
from cosim.integrate.ensemble.ensemble import Ensemble
from cosim.integrate.ensemble.simulate_many import (
    explicit_solver,
    one_by_one,
    runs_in_lanes,
    simulate_many,
)
from cosim.integrate.keywords import TimeKeywords, requested
from cosim.integrate.modes import hybrid
from cosim.integrate.outputs import recorded_columns, watching
from cosim.integrate.solvers import chosen_solver
from cosim.memo import digest_of
from cosim.model.catalogue import loaded
from cosim.model.request import RunRequest
from cosim.model.solver import Goal, Solver
from cosim.model.start_outputs import overriding
from cosim.model.times import Times
from cosim.model.values import assign, numbers_of, settable_variable
from cosim.scene.scene_file import read_scene
from cosim.trajectory import Column, Trajectory


class RunKeywords(TimeKeywords, total=False):
    """Keywords of `sweep` that concern each run; see `simulate_many`."""

    outputs: Sequence[str] | None
    solver: str | Solver | None
    relative_tolerance: float | None
    absolute_tolerance: float | None
    step_size: float | None
    max_step: float | None
    on_invalid: str | None


def run_settings(keywords: RunKeywords) -> dict[str, Any]:
    """Return the keywords of a run that are not None, in the types of JSON."""
    settings = {name: value for name, value in keywords.items() if value is not None}
    solver = settings.get("solver")
    if isinstance(solver, Solver):
        if twice := next((name for name in solver.numbers if name in settings), None):
            raise UsageError(f"sweep: {twice} is given with {solver}; give it once")
        settings |= {"solver": solver.name, **solver.numbers}
    if (times := keywords.get("output_times")) is not None:
        settings["output_times"] = Times.at(times).requested.tolist()
    return settings


class ModelSubject:
    """A model with the values, inputs and solver of a request, ready to run.

    Other processes receive it by pickle.
    """

    takes_units = True  # in texts of its values

    def __init__(self, request: RunRequest) -> None:
        dae, self._request = request.dae, request
        self.name = dae.full_name
        inputs = request.inputs and request.inputs.digest
        settings = (request.times, request.solver, request.policy)
        facts = repr((dae.digest, sorted(request.values.items()), inputs, settings))
        self.digest = digest_of((facts.encode(),))

    def columns(self, outputs: Sequence[str] | None) -> tuple[Column, ...]:
        """Return the recorded outputs."""
        names = self._with({"outputs": outputs}).outputs or self._request.dae.observed
        return recorded_columns(self._watching(names), names)[0]

    def times(self, settings: Mapping[str, Any]) -> Vector:
        """Return the output times of every run, s."""
        times = self._with(settings).times
        return times.requested if times.own else times.grid(self._request.dae)

    def unit(self, name: str) -> str:
        """Return the unit of the numbers of a quantity."""
        return settable_variable(self._request.dae, name).unit

    def prepare(self, names: Sequence[str], settings: Mapping[str, Any]) -> str:
        """Check the varied names and compile; return the method of the runs as text."""
        dae = self._request.dae
        own = assign(dae)
        starts = dict(zip((v.name for v in dae.states), own.x, strict=True)) | numbers_of(dae, own)
        replaced = {rule.variable.name for rule in dae.start_outputs} & set(names)
        assign(dae, {name: starts.get(name, 0.0) for name in names if name not in replaced})
        request = self._with(settings)
        if runs_in_lanes(request):
            outputs = tuple(column.name for column in self.columns(settings.get("outputs")))
            lane_library(self._watching(outputs), outputs, processor_lanes())
            return f"dop853 in {processor_lanes()} lanes"
        solver = explicit_solver(request)
        if solver is not None and hybrid(dae) is not None:
            return f"{solver.name} in blocks"
        return str(settings.get("solver") or "one by one")

    def run(
        self, columns: Mapping[str, Vector], settings: Mapping[str, Any], threads: int
    ) -> Ensemble:
        """Run every row, in SIMD lanes or one by one."""
        request = self._with(settings)
        values = overriding(request.dae, request.values, dict.fromkeys(columns, 0.0))
        return simulate_many(replace(request, values={}), {**values, **columns}, threads=threads)

    def knows_motion(self, settings: Mapping[str, Any]) -> bool:
        """Return whether runs can be computed again at further times."""
        request = self._with(settings)
        return chosen_solver(request.dae, request.solver)[0].adaptive

    def close(self) -> None:
        """Do nothing: compiled code is shared by all subjects of a process."""

    def _with(self, settings: Mapping[str, Any]) -> RunRequest:
        return requested(self._request, **settings)

    def _watching(self, names: tuple[str, ...]) -> Dae:
        dae = self._request.dae
        return dae if names == dae.observed else watching(dae, names)


_TAKEN = ("start_time", "stop_time", "output_interval", "relative_tolerance")


def _taken(settings: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in settings.items() if name in _TAKEN}


class FmuSubject:
    """An FMU file that is unpacked once in each process.

    Args:
        path: The file.
        apart: Whether each run has a process of its own where this object makes them, and not its
            copy in a worker.
    """

    takes_units = False  # numbers are in the FMU's own

    def __init__(self, path: str, *, apart: bool = False) -> None:
        self._path, self._fmu, self._apart = path, OpenedFmu(path), apart
        self._one_at_a_time = Lock()  # a worker of a cluster may have several threads
        self.name = str(self._fmu.description.modelName)
        self.digest = digest_of([Path(path).read_bytes()])

    def __reduce__(self) -> tuple[type["FmuSubject"], tuple[str]]:
        return FmuSubject, (self._path,)

    def close(self) -> None:
        """Free the instance of the FMU."""
        self._fmu.close()

    def columns(self, outputs: Sequence[str] | None) -> tuple[Column, ...]:
        """Return the recorded outputs."""
        return self._fmu.request(outputs=outputs).columns

    def times(self, settings: Mapping[str, Any]) -> Vector:
        """Return the output times of every run, s."""
        return self._fmu.request(**_taken(settings)).grid

    def unit(self, name: str) -> str:
        """Return the unit of the numbers of a quantity; "1" if the FMU has none."""
        return unit_of(by_name(self._fmu.description)[name]) or "1"

    def prepare(self, names: Sequence[str], settings: Mapping[str, Any]) -> str:
        """Check the varied names and the settings; return the method of the runs as text."""
        variables = by_name(self._fmu.description)
        for name in names:
            if name in variables and variables[name].causality == "structuralParameter":
                raise UsageError(
                    f"{self._fmu.path}: {name} changes the sizes of arrays, which all runs of a "
                    "sweep share; leave it out"
                )
        items = {n: v.declaredType.items for n, v in variables.items() if v.type == "Enumeration"}
        values = {n: float(items[n][0].value) if items.get(n) else 0.0 for n in names}
        self._fmu.request(start_values=values)
        for name in settings:
            if name not in (*_TAKEN, "outputs"):
                raise UsageError(
                    f"{self._fmu.path}: a sweep of an FMU has no setting {name}; "
                    f"give {', '.join(_TAKEN)} or outputs"
                )
        return f"fmpy {self._fmu.interface}"

    def knows_motion(self, settings: Mapping[str, Any]) -> bool:
        """Return False: an FMU tells its values at output times only."""
        return False

    def run(
        self, columns: Mapping[str, Vector], settings: Mapping[str, Any], threads: int
    ) -> Ensemble:
        """Run every row, one by one."""
        began, taken, outputs = perf_counter(), _taken(settings), settings["outputs"]
        time = self._fmu.request(**taken).grid

        def simulate(row: dict[str, float]) -> Trajectory:
            options = {"start_values": row, "outputs": outputs, **taken}
            with self._one_at_a_time:
                run: Trajectory
                if self._apart:
                    run = run_apart(self._path, **options)
                else:
                    run = self._fmu.run(self._fmu.request(**options))
            if len(run) != len(time) and "stop" not in run.stats:
                raise FmuError(f"it recorded {len(run)} of {len(time)} output times")
            note = {"invalid": (run.stats["note"],)} if "note" in run.stats else {}
            return replace(run, stats={**note, **run.stats})

        runs, own = len(next(iter(columns.values()))), self.columns(outputs)
        found = one_by_one(self.name, time, own, columns, runs, simulate, {}, stops=False)
        stats = {"solver": f"fmpy {self._fmu.interface}", "wall_time": perf_counter() - began}
        return replace(found, stats=stats)


Subject = ModelSubject | FmuSubject


def open_subject(subject: Any, *, apart: bool = False) -> Subject:
    """Return the model, scene or FMU that a user names, ready to run.

    Args:
        subject: What the user names.
        apart: Whether an FMU that was not exported here stays out of this process.

    Raises:
        UsageError: It is none of these.
        CosimError: The model, the scene or the file is wrong.
    """
    if isinstance(subject, ModelSubject | FmuSubject):
        return subject
    if isinstance(subject, Dae):
        return ModelSubject(RunRequest(subject))
    if isinstance(subject, str | os.PathLike):
        name = os.fspath(subject)
        if Path(name).suffix.lower() == ".fmu":
            return FmuSubject(str(Path(name).resolve()), apart=apart and not is_made_here(name))
        if Path(name).suffix.lower() == ".toml":
            scene = read_scene(name)
            if isinstance(scene.request.solver, Goal):
                raise UsageError(
                    f"{scene.name}: a sweep has no accuracy and no budget; give a solver and a "
                    "tolerance"
                )
            return ModelSubject(scene.request.reduced())
        return ModelSubject(RunRequest(loaded(name)))
    expected = "a model's name, a Dae, SCENE.toml or FILE.fmu"
    raise UsageError.of_type("sweep", subject, expected)
