"""A model as the subject of a sweep, by itself or with what a scene says of its runs."""

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from casadi_models.dae import Dae
from cosim.codegen.initialization import law_of_knowns
from cosim.codegen.runge_kutta.lane_library import lane_library, processor_lanes
from cosim.errors import UnknownName, UsageError
from cosim.integrate.ensemble.ensemble import Ensemble
from cosim.integrate.ensemble.simulate_many import runs_in_lanes, simulate_many
from cosim.integrate.run.outputs import all_columns, recording, watching
from cosim.model.inputs import InputSeries
from cosim.model.start_outputs import overriding
from cosim.model.values import assign, settable
from cosim.scene.roads import native_settings, scene_dae
from cosim.scene.scene import Scene
from cosim.study.sweep.samples import digest_of
from cosim.study.sweep.store import Watch
from cosim.study.sweep.subjects.subject import Rows
from cosim.trajectory import Column


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
        function = ca.Function("model", dae.arguments, [dae.ode, dae.alg, dae.outputs])
        starts = law_of_knowns(dae, "starts", *rules)
        numbers = [v.start for v in dae.variables]
        said = repr((dae.full_name, numbers, dae.x_start, sorted(values.items()), inputs))
        self.digest = digest_of(
            part.encode() for part in (function.serialize(), starts.serialize(), said)
        )

    def columns(self, outputs: Sequence[str] | None) -> tuple[Column, ...]:
        """Return what is recorded."""
        dae, names = recording(self._dae, outputs)
        known = {column.name: column for column in all_columns(dae)}
        return tuple(known[name] for name in names)

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

    def run(self, rows: Rows, watch: Watch) -> Ensemble:
        """Run every row; `watch` is told which one begins, where they go one by one."""
        every = overriding(self._dae, self._values, dict.fromkeys(rows.given, 0.0))
        base = {name: np.full(len(rows), value) for name, value in every.items()}
        merged = {**self._settings, **rows.settings, "outputs": rows.outputs}
        if "times" in merged:
            merged = {k: v for k, v in merged.items() if k not in ("stop_time", "output_interval")}
        return simulate_many(
            self._dae,
            {**base, **rows.given},
            inputs=self._inputs,
            threads=rows.threads,
            watch=watch,
            **merged,
        )


def scene_subject(scene: Scene) -> ModelSubject:
    """Return the model of a scene, with what the scene says of its runs.

    Raises:
        UsageError: It asks for an accuracy or a budget.
    """
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
