"""Calls of `import cosim` that need more than one room: runs of an accuracy, or within a time."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Unpack

from casadi_models.dae import Dae
from cosim.codegen.compiler import has_compiler
from cosim.errors import UsageError
from cosim.integrate import simulate as native
from cosim.integrate.outputs import wanted_names, watching
from cosim.integrate.solver import Solver
from cosim.model.inputs import InputSeries
from cosim.model.values import assign, listed
from cosim.scene import roads
from cosim.scene.goals import GOALS, OVERRULED, refuse_contradiction
from cosim.scene.roads import Road
from cosim.scene.scene import Scene
from cosim.study.accuracy.solver_selection import promised_run
from cosim.trajectory import Trajectory


class Options(native.Shorthand, total=False):
    """What few runs need; see `simulate`."""

    compiled: bool | None
    on_invalid: str
    drift_control: str | None


def simulate(
    dae: Dae,
    *,
    start_time: float = 0.0,
    stop_time: float | None = None,
    output_interval: float | None = None,
    solver: str | Solver | None = None,
    accuracy: float | None = None,
    budget: float | None = None,
    start_values: Mapping[str, float] | None = None,
    inputs: InputSeries | None = None,
    outputs: Sequence[str] | None = None,
    **options: Unpack[Options],
) -> Trajectory:
    """Integrate a DAE with CVODES, or with IDAS when it has algebraic unknowns.

    Args:
        dae: The model; SI units throughout.
        start_time: Begin of the run, s.
        stop_time: End of the run, s; the model's own span after `start_time` when None.
        output_interval: Distance of the output times, s; the model's own when None. The last
            output is at `stop_time` in any case.
        solver: A solver with its numbers, as `cosim.solvers.Dop853(relative_tolerance=1e-10)`, or
            the name of one; CVODES, or IDAS for a DAE, when None.
        accuracy: Instead of solver and tolerance: largest global error of the outputs, in nominal
            values. The cheapest configuration that was measured to do is taken, and checked.
        budget: Instead of these, too: time that the solver may take, s.
        start_values: Values by name that replace starts of states, parameters, or inputs.
        inputs: Time series of some inputs, piecewise linear; the others keep their start value.
        outputs: Names to record, monitors among them; everything but those when None.
        options: What few runs need.
            `compiled`: whether to compile the equations; if a compiler is there when None.
            `on_invalid`: what happens where a run leaves the model's limits, or a fixed step is
            too long for the motion: "warn" (the default) says so in `stats["invalid"]`, "stop"
            ends the run there, "ignore" looks at neither.
            `drift_control`: "none", "baumgarte" (the model's closing rate) or "projection" after
            every step, which makes `dop853` the default solver; what the model has when None.
            `relative_tolerance`, `absolute_tolerance`, `step_size`: numbers of a solver that is
            named or left out: error per step relative to each state's size (1), 1e-8 when None;
            in SI units, a hundredth of the relative one when None; largest step of `rk4` and
            `ode8`, s, the output interval when None.
            `start`: another name of `start_values`.

    Returns:
        Every state, algebraic unknown and output of `dae`, each of shape (n,), with its unit.

    Raises:
        UnknownName: A name does not exist: of a value, an output, a solver or an option.
        ParameterError: A value is not finite or out of its bounds, or asks for what cannot be.
        UsageError: The solver cannot integrate the model, something is said twice, or is given
            beside the `accuracy` or `budget` that decides on it.
        InitialConditionError: The start values contradict the constraints.
        SolverError: The run failed, stopped at a limit, or does not have the `accuracy`; `partial`
            is what there is.
        Interrupted: Ctrl-C, a `KeyboardInterrupt` whose `partial` holds the run up to there.
        MissingTool: `compiled` is True and no compiler works.
    """
    native.refuse_unknown(options, Options.__optional_keys__)
    fixed = {name: options.get(name) for name in (*OVERRULED, "drift_control")}
    refuse_contradiction(accuracy, budget, **fixed | {"solver": solver})
    given = native.one_of(dae, start_values, options.pop("start", None))
    run: dict[str, Any] = {"start_time": start_time, "stop_time": stop_time}
    run |= {"output_interval": output_interval, "start_values": given, "inputs": inputs}
    if accuracy is None and budget is None:
        return native.simulate(dae, solver=solver, outputs=outputs, **run, **options)
    assign(dae, given)
    wanted = None if outputs is None else listed(f"{dae.full_name}: outputs", outputs)
    dae = watching(dae, wanted or ())
    names = wanted_names(dae, wanted)
    grid = native.output_times(dae, start_time, stop_time, output_interval)
    compiled = options.get("compiled")
    compiled = has_compiler() if compiled is None else compiled
    run["on_invalid"] = options.get("on_invalid", "warn")
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
    return simulate(dae, start_values=start, **goals, **settings, **options)


def _is(scene: object) -> bool:
    return isinstance(scene, Scene)
