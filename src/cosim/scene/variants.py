"""From a scene to one that computes the same in another way: a solver, a formulation, a road."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

from cosim.errors import UnknownName
from cosim.integrate.solvers import SOLVERS, solver_name
from cosim.model.catalogue import formulations, load, no_such_output, observable
from cosim.scene.roads import Road
from cosim.scene.scene import Scene


def variant(scene: Scene, name: str) -> tuple[Scene, Road]:
    """Return a scene and a road that compute the same in another way, to compare with.

    Args:
        scene: What is compared.
        name: A road, a solver, or a formulation of the model.

    Raises:
        UnknownName: It is none of them, or that formulation lacks an output.
    """
    if name in SOLVERS:
        return with_solver(scene, name), Road.NATIVE
    others = other_formulations(scene)
    if name in others:
        return in_formulation(scene, others[name]), Road.NATIVE
    with suppress(UnknownName):
        return without_goal(scene), Road.named(name)
    known = (*Road, *SOLVERS, *others)
    raise UnknownName.among(f"{scene.name}: --compare", "road", name, known)


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
    exact |= {way.variable.name for way in dae.start_outputs}
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
