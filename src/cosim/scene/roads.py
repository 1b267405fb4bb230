"""A scene on any road: the one place that knows both of them."""

from enum import StrEnum
from pathlib import Path
from typing import Any

from casadi_models.dae import Dae
from cosim.errors import UnknownName, UsageError
from cosim.fmi.export.package import export_fmu
from cosim.fmi.run.simulate import simulate_fmu
from cosim.host.temporary import temporary_folder
from cosim.integrate.simulate import simulate
from cosim.integrate.solvers import solver_class
from cosim.model.inputs import InputSeries
from cosim.model.reduction.reduce import reduce
from cosim.scene.scene import Scene
from cosim.trajectory import Trajectory


class Road(StrEnum):
    """How a model is run: by the integrators here, compiled or not, or as an FMU through fmpy."""

    NATIVE = "native"
    INTERPRETED = "native-interpreted"
    MODEL_EXCHANGE = "fmu-me"
    CO_SIMULATION = "fmu-cs"

    @classmethod
    def named(cls, name: str, who: str = "cosim") -> "Road":
        """Return a road by its name, or by one that it had.

        Raises:
            UnknownName: There is none of that name.
        """
        try:
            return cls(_FORMER.get(name, name))
        except (ValueError, TypeError):
            raise UnknownName.among(who, "road", name, tuple(cls)) from None

    @property
    def interface(self) -> str | None:
        """What the FMI calls it; None without an FMU."""
        return _INTERFACES.get(self)

    @property
    def native(self) -> bool:
        """Whether it needs no FMU."""
        return self.interface is None


_INTERFACES = {Road.MODEL_EXCHANGE: "ModelExchange", Road.CO_SIMULATION: "CoSimulation"}
FMU_ROADS = tuple(_INTERFACES)
_FORMER = {
    "casadi": "native",
    "compiled": "native",
    "interpreted": "native-interpreted",
    "fmpy-me": "fmu-me",
    "fmpy-cs": "fmu-cs",
    "fmu": "fmu-cs",  # what fmpy prefers
}


def scene_dae(scene: Scene) -> Dae:
    """Return the DAE that a scene requires: with its values, and reduced to its outputs.

    Raises:
        UnknownName: The model does not compute an output.
    """
    full = scene.configured()
    return reduce(full, scene.outputs) if scene.outputs else full


def run_on_road(
    scene: Scene,
    road: Road | str | None = None,
    *,
    compiled: bool | None = None,
    on_invalid: str = "warn",
    drift_control: str | None = None,
) -> Trajectory:
    """Run a scene on a road: through the integrators here, or through fmpy as an FMU made from it.

    Args:
        scene: What to run.
        road: A `Road`, or its name; the native one when None.
        compiled, on_invalid, drift_control: Of the native road, see `simulate`.

    Raises:
        CosimError: The run failed; see `simulate`, `export_fmu`, `simulate_fmu`.
    """
    if not isinstance(scene, Scene):
        raise UsageError.of_type("run_scene", scene, "what cosim.read_scene returns")
    way = Road.NATIVE if road is None else Road.named(road)
    dae = scene_dae(scene)
    if way.native:
        return simulate(
            dae,
            compiled=False if way is Road.INTERPRETED else compiled,
            on_invalid=on_invalid,
            drift_control=drift_control,
            **native_settings(scene, dae),
        )
    with temporary_folder() as folder:
        path = export_fmu(dae, Path(folder) / "scene.fmu")
        return run_fmu(scene, dae, path, way)


def native_settings(scene: Scene, dae: Dae) -> dict[str, Any]:
    """Return what `simulate` is given for a scene.

    Args:
        scene: What to run.
        dae: What it requires.

    Raises:
        UsageError: A tolerance is given for a solver without error control.
    """
    settings = scene.settings
    solver = solver_class(dae, settings.solver)
    if settings.relative_tolerance is not None and not solver.adaptive:
        raise UsageError(f"{settings.solver} has no error control; leave relative_tolerance out")
    return {
        "start_time": settings.start_time,
        "stop_time": settings.stop_time,
        "solver": settings.solver,
        "relative_tolerance": settings.relative_tolerance,
        "absolute_tolerance": settings.absolute_tolerance,
        "step_size": settings.step_size,
        "inputs": _felt(scene, dae),
        "outputs": scene.outputs or None,
    }


def run_fmu(scene: Scene, dae: Dae, path: Path, road: Road) -> Trajectory:
    """Run the FMU that was made from the DAE of a scene.

    Raises:
        CosimError: See `simulate_fmu`.
    """
    settings = scene.settings
    span = dae.experiment.stop_time
    return simulate_fmu(
        path,
        interface=road.interface,
        start_time=settings.start_time,
        stop_time=settings.start_time + span if settings.stop_time is None else settings.stop_time,
        output_interval=dae.experiment.output_interval,
        relative_tolerance=settings.relative_tolerance,
        inputs=_felt(scene, dae),
        outputs=scene.outputs or None,
    )


def _felt(scene: Scene, dae: Dae) -> InputSeries | None:
    """Return the series of those inputs that a reduced model still has."""
    return scene.inputs and scene.inputs.only({variable.name for variable in dae.inputs})
