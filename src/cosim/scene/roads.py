"""A scene on any road: the one place that knows both of them."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from casadi_models.dae import Dae
from cosim.errors import UnknownName, UsageError
from cosim.fmi.export.package import export_fmu
from cosim.fmi.run.simulate import simulate_fmu
from cosim.integrate.simulate import simulate
from cosim.integrate.solvers import SOLVERS, solver_class, solver_name
from cosim.model.catalogue import formulations, load, no_such_output, observable
from cosim.model.inputs import InputSeries
from cosim.model.reduction.reduce import reduce
from cosim.scene.scene import Scene
from cosim.temporary import temporary_folder
from cosim.trajectory import Trajectory

FMU_ROADS = {"fmu": None, "fmu-me": "ModelExchange", "fmu-cs": "CoSimulation"}


def scene_dae(scene: Scene) -> Dae:
    """Return the DAE that a scene requires: with its values, and reduced to its outputs.

    Raises:
        UnknownName: The model does not compute an output.
    """
    full = scene.configured()
    return reduce(full, scene.outputs) if scene.outputs else full


def run_scene(
    scene: Scene,
    road: str | None = None,
    *,
    compiled: bool | None = None,
    on_invalid: str = "warn",
    drift_control: str | None = None,
) -> Trajectory:
    """Run a scene through CasADi's integrators, or through fmpy as an FMU made from it.

    Args:
        scene: What to run.
        road: "fmu-me", "fmu-cs", or "fmu" for what fmpy prefers; CasADi's integrators when None.
        compiled, on_invalid, drift_control: Of CasADi's integrators, see `simulate`.

    Raises:
        CosimError: The run failed; see `simulate`, `export_fmu`, `simulate_fmu`.
    """
    if not isinstance(scene, Scene):
        raise UsageError.of_type("run_scene", scene, "what cosim.read_scene returns")
    dae = scene_dae(scene)
    if road is None:
        return simulate(
            dae,
            compiled=compiled,
            on_invalid=on_invalid,
            drift_control=drift_control,
            **native_settings(scene, dae),
        )
    if road not in FMU_ROADS:
        raise UnknownName.among("cosim", "road", road, FMU_ROADS)
    with temporary_folder() as folder:
        path = export_fmu(dae, Path(folder) / "scene.fmu")
        return run_fmu(scene, dae, path, FMU_ROADS[road])


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


def run_fmu(scene: Scene, dae: Dae, path: Path, interface: str | None) -> Trajectory:
    """Run the FMU that was made from the DAE of a scene.

    Raises:
        CosimError: See `simulate_fmu`.
    """
    settings = scene.settings
    span = dae.experiment.stop_time
    return simulate_fmu(
        path,
        interface=interface,
        start_time=settings.start_time,
        stop_time=settings.start_time + span if settings.stop_time is None else settings.stop_time,
        output_interval=dae.experiment.output_interval,
        relative_tolerance=settings.relative_tolerance,
        inputs=_felt(scene, dae),
        outputs=scene.outputs or None,
    )


def variant(scene: Scene, name: str) -> tuple[Scene, str | None]:
    """Return a scene and a road that compute the same in another way, to compare with.

    Args:
        scene: What is compared.
        name: A road ("fmu", "fmu-me", "fmu-cs"), a solver, or a formulation of the model.

    Raises:
        UnknownName: It is none of them, or that formulation lacks an output.
    """
    if name in FMU_ROADS:
        return without_goal(scene), name
    if name in SOLVERS:
        return with_solver(scene, name), None
    others = other_formulations(scene)
    if name in others:
        return in_formulation(scene, others[name]), None
    raise UnknownName.among(
        f"{scene.name}: --compare", "road", name, (*FMU_ROADS, *SOLVERS, *others)
    )


def with_solver(scene: Scene, name: str) -> Scene:
    """Return a scene with another solver, which takes over no accuracy or budget.

    An adaptive one takes over no step size either, one with fixed steps no tolerance.

    Raises:
        UnknownName: There is no such solver.
    """
    name = solver_name(scene.dae, name)
    if name not in SOLVERS:
        raise UnknownName.among("cosim", "solver", name, SOLVERS)
    scene = without_goal(scene)
    settings = replace(scene.settings, solver=name)
    if SOLVERS[name].adaptive:
        settings = replace(settings, step_size=None)
    else:
        settings = replace(settings, relative_tolerance=None, absolute_tolerance=None)
    return replace(scene, settings=settings)


def without_goal(scene: Scene) -> Scene:
    """Return a scene without an accuracy or a budget."""
    settings = replace(scene.settings, accuracy=None, budget=None)
    return scene if settings == scene.settings else replace(scene, settings=settings)


def in_formulation(scene: Scene, model: str) -> Scene:
    """Return a scene with another formulation of its model.

    A solver that cannot integrate that formulation gives way to the default.

    Raises:
        UnknownName: The formulation lacks an output of the scene, or what the scene sets.
    """
    dae, settings = load(model), scene.settings
    for name in scene.outputs:
        if name not in observable(dae):
            raise no_such_output(dae, name)
    exact = {v.name for v in (*dae.states, *dae.parameters, *dae.inputs) if v.start is not None}
    for name in scene.values:
        if name not in exact:
            raise UnknownName(f"{model} cannot be given '{name}', which {scene.name} sets")
    if dae.algebraics and settings.solver and not SOLVERS[settings.solver].solves_dae:
        settings = replace(settings, solver=None, step_size=None)
    return replace(scene, dae=dae, settings=settings)


def fitting_formulations(scene: Scene) -> Iterator[Scene]:
    """Yield a scene in its own formulation, then in every other one that fits it.

    What does not fit lacks an output of the scene, or cannot be given what the scene sets.
    """
    yield scene
    for name in other_formulations(scene).values():
        with suppress(UnknownName):
            yield in_formulation(scene, name)


def other_formulations(scene: Scene) -> dict[str, str]:
    """Return `MODEL/FORMULATION` of a scene's other formulations, by formulation."""
    try:
        every = formulations(scene.dae.name)
    except UnknownName:  # a user's own model
        return {}
    return {e.partition("/")[2]: e for e in every if e != scene.dae.full_name}


def _felt(scene: Scene, dae: Dae) -> InputSeries | None:
    """Return the series of those inputs that a reduced model still has."""
    return scene.inputs and scene.inputs.only({variable.name for variable in dae.inputs})
