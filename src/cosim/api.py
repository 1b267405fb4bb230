"""Calls of `import cosim` that need more than one room: runs of an accuracy, or within a time."""

from dataclasses import replace
from functools import partial
from typing import Any

from casadi_models.dae import Dae
from cosim.codegen.compiler import has_compiler
from cosim.errors import UsageError
from cosim.integrate import simulate as native
from cosim.integrate.outputs import wanted_names, watching
from cosim.model.values import assign, listed
from cosim.scene import roads
from cosim.scene.goals import GOALS, OVERRULED, refuse_contradiction
from cosim.scene.roads import Road
from cosim.scene.scene import Scene
from cosim.study.accuracy.solver_selection import promised_run
from cosim.trajectory import Trajectory


def simulate(
    dae: Dae, *, accuracy: float | None = None, budget: float | None = None, **run: Any
) -> Trajectory:
    """Integrate a DAE with CVODES, or with IDAS when it has algebraic unknowns.

    Args:
        dae: The model; SI units throughout.
        accuracy: Instead of solver and tolerance: largest global error of the outputs, in nominal
            values. The cheapest configuration that was measured to do is taken, and checked.
        budget: Instead of these, too: time that the solver may take, s.
        run: Start and stop time, solver, values, ...: see `cosim.integrate.simulate.simulate`.

    Returns:
        Every state, algebraic unknown and output of `dae`, each of shape (n,), with its unit.

    Raises:
        UsageError: Something is given beside the `accuracy` or `budget` that decides on it.
        SolverError: The run failed, or it does not have the `accuracy`; `partial` is the best one.
        CosimError: See `cosim.integrate.simulate.simulate`.
    """
    overruled = {name: run.get(name) for name in (*OVERRULED, "drift_control")}
    refuse_contradiction(accuracy, budget, **overruled)
    if accuracy is None and budget is None:
        return native.simulate(dae, **run)
    assign(dae, run.get("start"))
    outputs = run.pop("outputs", None)
    wanted = None if outputs is None else listed(f"{dae.full_name}: outputs", outputs)
    dae = watching(dae, wanted or ())
    names = wanted_names(dae, wanted)
    times = (run.get("start_time", 0.0), run.get("stop_time"), run.get("output_interval"))
    grid = native.output_times(dae, *times)
    compiled = run.pop("compiled", None)
    compiled = has_compiler() if compiled is None else compiled
    run = {name: value for name, value in run.items() if name not in overruled}
    solve = partial(native.simulate, dae, outputs=names, compiled=compiled, **run)
    length = float(grid[-1] - grid[0])
    return promised_run(dae, solve, names, length, compiled, accuracy, budget)


def run_scene(scene: Scene, road: Road | str | None = None, **options: Any) -> Trajectory:
    """Run a scene on a road: through the integrators here, or through fmpy as an FMU made from it.

    With an accuracy or a budget, the front of the model with its author's values is what chooses,
    so that it need not be measured anew for each of the scene's values.

    Args:
        scene: What to run.
        road: "native", "native-interpreted", "fmu-me" or "fmu-cs"; the first one when None.
        options: `compiled`, `on_invalid`, `drift_control` of the native road.

    Raises:
        UsageError: An FMU shall run with an accuracy or a budget.
        CosimError: The run failed; see `simulate`, `export_fmu`, `simulate_fmu`.
    """
    goals = {name: getattr(scene.settings, name) for name in GOALS} if _is(scene) else {}
    if not any(goal is not None for goal in goals.values()):
        return roads.run_scene(scene, road, **options)
    way = Road.NATIVE if road is None else Road.named(road)
    if not way.native:
        raise UsageError(
            f"{scene.name}: accuracy and budget are for CasADi's integrators; an FMU gets its "
            "accuracy when it is exported: cosim export --accuracy"
        )
    if way is Road.INTERPRETED:
        options["compiled"] = False
    dae = roads.scene_dae(replace(scene, values={}))
    known = {v.name for v in (*dae.states, *dae.parameters, *dae.inputs)}
    start = {name: value for name, value in scene.values.items() if name in known}
    settings = roads.native_settings(scene, dae)
    return simulate(dae, start=start, **goals, **settings, **options)


def _is(scene: object) -> bool:
    return isinstance(scene, Scene)
