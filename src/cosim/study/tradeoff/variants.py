"""Models and FMUs made once, and run in any configuration."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from casadi_models.dae import Dae
from cosim.errors import UsageError
from cosim.fmi.export.package import export_fmu
from cosim.fmi.run.simulate import simulate_fmu
from cosim.integrate.simulate import simulate
from cosim.model.catalogue import no_such_output, observable
from cosim.model.reduction.reduce import reduce
from cosim.model.reduction.size import size
from cosim.scene.roads import Road
from cosim.scene.scene import Scene
from cosim.scene.variants import fitting_formulations
from cosim.study.tradeoff.configuration import Configuration
from cosim.trajectory import Trajectory


def members(scene: Scene, *, every_formulation: bool = True) -> tuple[Scene, ...]:
    """Return a scene for each formulation that computes the same, the scene's own first.

    Args:
        scene: What is measured.
        every_formulation: Whether others count that have its outputs and take its values.

    Raises:
        UnknownName: The model does not compute an output of the scene.
    """
    for name in scene.outputs:
        if name not in observable(scene.dae):
            raise no_such_output(scene.dae, name)
    return tuple(fitting_formulations(scene)) if every_formulation else (scene,)


def kept_outputs(scenes: Sequence[Scene]) -> tuple[str, ...]:
    """Return the names whose errors are measured: the wanted ones, or all that scenes share.

    Raises:
        UsageError: They share none.
    """
    if scenes[0].outputs:
        return scenes[0].outputs
    own = scenes[0].dae.own_meanings if len(scenes) > 1 else {}
    shared = [name for name in scenes[0].dae.observed if name not in own]
    for scene in scenes[1:]:
        known = set(observable(scene.dae)) - scene.dae.own_meanings.keys()
        shared = [name for name in shared if name in known]
    if not shared:
        raise UsageError(f"{scenes[0].name}: the formulations have no output in common")
    return tuple(shared)


@dataclass(frozen=True)
class Workshop:
    """The formulations of a scene, full and reduced, and a folder for their FMUs.

    Attributes:
        scenes: One per formulation, by `MODEL/FORMULATION`.
        kept: Names whose errors are measured.
        folder: Where FMUs are made.
    """

    scenes: dict[str, Scene]
    kept: tuple[str, ...]
    folder: Path
    _daes: dict[tuple[str, bool], Dae | None] = field(default_factory=dict)

    def dae(self, model: str, *, reduced: bool = False) -> Dae | None:
        """Return a formulation; None where reduction takes nothing away from it."""
        key = (model, reduced)
        if key not in self._daes:
            full = self.scenes[model].configured()
            if reduced:
                small = reduce(full, self.kept)
                self._daes[key] = small if size(small) != size(full) else None
            else:
                self._daes[key] = full
        return self._daes[key]

    def pairs(self) -> Iterator[tuple[Scene, Dae, Dae | None]]:
        """Yield each scene with its full model, and the reduced one where outputs are named."""
        for name, scene in self.scenes.items():
            full = self.dae(name)
            assert full is not None
            yield scene, full, self.dae(name, reduced=True) if scene.outputs else None

    def run(self, configuration: Configuration) -> Trajectory:
        """Run one configuration.

        Raises:
            CosimError: The run failed.
        """
        scene = self.scenes[configuration.model]
        dae = self.dae(configuration.model, reduced=configuration.reduced)
        if dae is None:
            raise UsageError(f"{configuration.model} cannot be reduced to {', '.join(self.kept)}")
        start, stop = span(scene)
        interval = dae.experiment.output_interval
        inputs = scene.inputs and scene.inputs.only({v.name for v in dae.inputs})
        if configuration.road.native:
            step = configuration.step
            return simulate(
                dae,
                start_time=start,
                stop_time=stop,
                output_interval=max(step, interval) if step else interval,
                solver=configuration.solver,
                relative_tolerance=configuration.tolerance,
                step_size=step,
                inputs=inputs,
                outputs=self.kept if configuration.reduced else None,
                compiled=configuration.road is Road.NATIVE,
                drift_control=configuration.drift_control,
            )
        return simulate_fmu(
            self._fmu(dae, configuration.reduced),
            interface=configuration.road.interface,
            start_time=start,
            stop_time=stop,
            output_interval=configuration.step or interval,
            relative_tolerance=configuration.tolerance,
            inputs=inputs,
        )

    def _fmu(self, dae: Dae, reduced: bool) -> Path:
        size = "_reduced" if reduced else ""
        path = self.folder / f"{dae.full_name.replace('/', '_')}{size}.fmu"
        return path if path.exists() else export_fmu(dae, path)


def span(scene: Scene) -> tuple[float, float]:
    """Return begin and end of a scene's run, s."""
    settings = scene.settings
    if settings.stop_time is not None:
        return settings.start_time, settings.stop_time
    return settings.start_time, settings.start_time + scene.configured().experiment.stop_time
