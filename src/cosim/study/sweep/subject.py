"""What is swept: a model, a scene or an FMU, named so that every process can open it itself."""

import os
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import casadi as ca
import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.runge_kutta.lane_library import lane_library, processor_lanes
from cosim.errors import UnknownName, UsageError
from cosim.integrate.ensemble.ensemble import Ensemble
from cosim.integrate.ensemble.simulate_many import runs_in_lanes, simulate_many
from cosim.integrate.run.outputs import all_columns, wanted_names, watching
from cosim.model.catalogue import load
from cosim.model.inputs import InputSeries
from cosim.model.start_outputs import overriding
from cosim.model.values import assign, listed, settable
from cosim.scene.roads import native_settings, scene_dae
from cosim.scene.scene import Scene
from cosim.scene.scene_file import read_scene
from cosim.study.sweep.engines.watch import Watch
from cosim.study.sweep.samples import digest_of
from cosim.trajectory import Column


@dataclass(frozen=True)
class Subject:
    """What is swept, small enough to go with every task.

    Attributes:
        kind: "model", "dae", "scene" or "fmu".
        source: The model's name, the file's absolute path, or a `Dae` as bytes.
    """

    kind: str
    source: str | bytes


class Opened(Protocol):
    """A subject that is ready to run."""

    name: str
    digest: str

    def columns(self, outputs: Sequence[str] | None) -> tuple[Column, ...]:
        """Return what is recorded."""

    def unit(self, name: str) -> str | None:
        """Return the unit of what can be varied; None where numbers have none to be read."""

    def prepare(self, names: Sequence[str], settings: Mapping[str, Any]) -> str:
        """Refuse names that cannot be set, compile; say how the runs are computed."""

    def run(
        self,
        given: Mapping[str, Vector],
        outputs: Sequence[str],
        settings: Mapping[str, Any],
        threads: int,
        watch: Watch,
    ) -> Ensemble:
        """Run every row; `watch` is told which one begins, where they go one by one."""


def as_subject(given: Any) -> Subject:
    """Return what names a model, a scene or an FMU.

    Raises:
        UsageError: It is none of these.
    """
    if isinstance(given, Subject):
        return given
    if isinstance(given, Dae):
        return Subject("dae", pickle.dumps(given))
    if isinstance(given, str | os.PathLike):
        name = os.fspath(given)
        if Path(name).suffix in (".fmu", ".toml"):
            return Subject({".fmu": "fmu", ".toml": "scene"}[Path(name).suffix], str(_there(name)))
        path, colon, function = name.rpartition(".py:")
        return Subject("model", f"{Path(path + '.py').resolve()}:{function}" if colon else name)
    wanted = "a model's name, a Dae, SCENE.toml or FILE.fmu"
    raise UsageError.of_type("sweep", given, wanted)


def _there(name: str) -> Path:
    """Return the whole path of a file; a shipped scene keeps its name."""
    path = Path(name)
    return path.resolve() if path.exists() else path


@lru_cache(2)
def opened(subject: Subject) -> Opened:
    """Open a subject; each process keeps the last two.

    Raises:
        CosimError: The model, the scene or the file is wrong.
    """
    if subject.kind == "fmu":
        from cosim.study.sweep.fmu_subject import FmuSubject

        return FmuSubject(str(subject.source))
    if subject.kind == "scene":
        return _of_scene(read_scene(str(subject.source)))
    if isinstance(subject.source, bytes):
        return ModelSubject(pickle.loads(subject.source), {}, {}, None)
    return ModelSubject(load(subject.source), {}, {}, None)


def _of_scene(scene: Scene) -> "ModelSubject":
    if scene.settings.accuracy is not None or scene.settings.budget is not None:
        raise UsageError(
            f"{scene.name}: a sweep takes no accuracy and no budget; give a solver and a tolerance"
        )
    dae = scene_dae(scene)
    settings = native_settings(scene, dae)
    names = ("start_time", "stop_time", "output_interval", "solver", "relative_tolerance",
             "absolute_tolerance", "step_size")  # fmt: skip
    chosen = {name: settings[name] for name in names if settings.get(name) is not None}
    return ModelSubject(dae, scene.values, chosen, scene.inputs)


class ModelSubject:
    """A `Dae` with what a scene says of its runs."""

    def __init__(
        self,
        dae: Dae,
        values: Mapping[str, float],
        settings: Mapping[str, Any],
        inputs: InputSeries | None,
    ) -> None:
        self._dae, self._values, self._settings, self._inputs = dae, values, settings, inputs
        self.name = dae.full_name
        rules = [rule.expression for rule in dae.start_rules]
        function = ca.Function(
            "model", [dae.t, dae.x, dae.z, dae.u, dae.p], [dae.ode, dae.alg, dae.outputs]
        )
        starts = ca.Function("starts", [dae.x, dae.p], rules)
        numbers = [v.start for v in dae.variables]
        said = repr((dae.full_name, numbers, dae.x_start, sorted(values.items()), inputs))
        self.digest = digest_of(
            part.encode() for part in (function.serialize(), starts.serialize(), said)
        )

    def columns(self, outputs: Sequence[str] | None) -> tuple[Column, ...]:
        """Return what is recorded."""
        wanted = None if outputs is None else listed(f"{self.name}: outputs", outputs)
        dae = watching(self._dae, wanted or ())
        known = {column.name: column for column in all_columns(dae)}
        return tuple(known[name] for name in wanted_names(dae, wanted))

    def unit(self, name: str) -> str | None:
        """Return the unit of what can be varied."""
        known = settable(self._dae)
        if name not in known:
            kind = "state, parameter or input"
            raise UnknownName.of_model(self.name, kind, name, known)
        return known[name].unit

    def prepare(self, names: Sequence[str], settings: Mapping[str, Any]) -> str:
        """Refuse names that cannot be set, compile; say how the runs are computed."""
        known = assign(self._dae)
        starts = dict(zip((v.name for v in self._dae.states), known.x, strict=True))
        starts |= dict(zip((v.name for v in self._dae.parameters), known.p, strict=True))
        starts |= dict(zip((v.name for v in self._dae.inputs), known.u, strict=True))
        given = {way.variable.name for way in self._dae.start_outputs} & set(names)
        assign(self._dae, {name: starts.get(name, 0.0) for name in names if name not in given})
        merged = {**self._settings, **settings}
        if runs_in_lanes(self._dae, merged, self._inputs):
            outputs = tuple(column.name for column in self.columns(settings.get("outputs")))
            lane_library(watching(self._dae, outputs), outputs, processor_lanes())
            return f"dop853 in {processor_lanes()} lanes"
        return str(merged.get("solver") or "one by one")

    def run(
        self,
        given: Mapping[str, Vector],
        outputs: Sequence[str],
        settings: Mapping[str, Any],
        threads: int,
        watch: Watch,
    ) -> Ensemble:
        """Run every row; `watch` is told which one begins, where they go one by one."""
        runs = len(next(iter(given.values())))
        every = overriding(self._dae, self._values, dict.fromkeys(given, 0.0))
        base = {name: np.full(runs, value) for name, value in every.items()}
        merged = {**self._settings, **settings, "outputs": outputs}
        if "times" in merged:
            merged = {k: v for k, v in merged.items() if k not in ("stop_time", "output_interval")}
        return simulate_many(
            self._dae,
            {**base, **given},
            inputs=self._inputs,
            threads=threads,
            watch=watch,
            **merged,
        )
