"""Calls of `import cosim` that need more than one room: runs of an accuracy, or within a time."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Unpack

from numpy.typing import ArrayLike

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.errors import UsageError
from cosim.integrate import simulate as native
from cosim.integrate.run.asked_times import AskedTimes, again
from cosim.integrate.run.outputs import recording
from cosim.integrate.run.stopping import run_until
from cosim.integrate.solver import Solver
from cosim.integrate.solvers import SOLVERS
from cosim.memo import kept_per_thread
from cosim.model.catalogue import load
from cosim.model.driving import driven
from cosim.model.quantities import quantity
from cosim.model.values import A_DAE, assign, plain_values
from cosim.scene import roads
from cosim.scene.goals import GOALS, OVERRULED, refuse_contradiction
from cosim.scene.roads import Road
from cosim.scene.scene import Scene
from cosim.study.accuracy.front import pays_compiling
from cosim.study.accuracy.solver_selection import promised_run
from cosim.trajectory import Trajectory


class Options(native.Shorthand, total=False):
    """What few runs need; see `simulate`."""

    compiled: bool | None
    on_invalid: str
    drift_control: str | None
    output_times: ArrayLike | None
    stop_when: str | None


def simulate(
    dae: Dae | str,
    *,
    start_time: float = 0.0,
    stop_time: float | None = None,
    output_interval: float | None = None,
    solver: str | Solver | None = None,
    accuracy: float | None = None,
    budget: float | None = None,
    start_values: Mapping[str, float | str] | None = None,
    inputs: Any = None,
    outputs: Sequence[str] | None = None,
    **options: Unpack[Options],
) -> Trajectory:
    """Integrate a DAE with CVODES, or with IDAS when it has algebraic unknowns.

    Args:
        dae: The model, or the name of one; SI units throughout.
        start_time: Begin of the run, s.
        stop_time: End of the run, s; the model's own span after `start_time` when None.
        output_interval: Distance of the output times, s; the model's own when None. The last
            output is at `stop_time` in any case.
        solver: A solver with its numbers, as `cosim.solvers.Dop853(relative_tolerance=1e-10)`, or
            the name of one; CVODES, or IDAS for a DAE, when None: and where constraints lose rank,
            `dop853` with projection if the run itself tells that it keeps to its branch.
        accuracy: Instead of solver and tolerance: largest global error of the outputs, in nominal
            values. The cheapest configuration that was measured to do is taken, and checked.
        budget: Instead of these, too: time that the solver may take, s.
        start_values: Numbers in SI units, or texts with a unit, by name, that replace starts of
            states, parameters, or inputs.
        inputs: An `InputSeries`, piecewise linear; or by name a number, a text with a unit, a
            formula of time, states and parameters, a function of time, samples at the output
            times (n,), or an `InputSeries`. A formula, and a function that CasADi can take
            (`lambda t: np.sin(t)`), are followed exactly; any other function is sampled at the
            output times. Other inputs keep their start value.
        outputs: Names to record, monitors among them; everything but those when None.
        options: What few runs need.
            `compiled`: whether to compile the equations; where that pays when None.
            `on_invalid`: what happens where a run leaves the model's limits, or a fixed step is
            too long for the motion: "warn" (the default) says so in `stats["invalid"]`, "stop"
            ends the run there, "ignore" looks at neither.
            `drift_control`: "none", "baumgarte" (the model's closing rate) or "projection" after
            every step, which makes `dop853` the default solver; what the model has when None.
            `relative_tolerance`, `absolute_tolerance`, `step_size`: numbers of a solver that is
            named or left out: error per step relative to each state's size (1), 1e-8 when None;
            error per step in the nominal value of each unknown (1), a hundredth of the relative
            one when None; largest step of `rk4` and `ode8`, s, the output interval when None.
            `output_times`: times of one's own, s, (n,), in place of `stop_time` and
            `output_interval`.
            `stop_when`: a condition, e.g. "abs(phi) > 45deg", that ends the run where it becomes
            true; `stats.stop` says so. It is looked at on the output times, then located as
            accurately as the solver integrates by repeating the run with closer output times.
            `start`: another name of `start_values`.

    Returns:
        Every state, algebraic unknown and output of `dae`, each of shape (n,), with its unit. Its
        `at` computes the run at other times.

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

    Example:
        >>> run = simulate("crank_shaft", start_values={"omega": "60rpm"}, stop_when="phi > 2*pi")
        >>> round(run.stats.stop_time, 6)  # of 2 pi t + 5 t^2 = 2 pi
        0.656758
    """
    native.refuse_unknown(options, Options.__optional_keys__)
    dae = named(dae) if isinstance(dae, str) else dae
    if not isinstance(dae, Dae):
        raise UsageError.of_type("a run", dae, A_DAE)
    fixed = {name: options.get(name) for name in (*OVERRULED, "drift_control")}
    refuse_contradiction(accuracy, budget, **fixed | {"solver": solver})
    given = _numbers_of_texts(dae, native.one_of(dae, start_values, options.pop("start", None)))
    own_times, condition = options.pop("output_times", None), options.pop("stop_when", None)
    times = AskedTimes(dae, start_time, stop_time, output_interval, own_times)
    settled = driven(dae, inputs, times.grid)
    dae = settled.dae
    run: dict[str, Any] = {"inputs": settled.series}
    run["start_values"] = _together(dae, given, settled.constants)
    if condition is not None:
        if accuracy is not None or budget is not None:
            raise UsageError(
                f"{dae.full_name}: stop_when needs a solver; leave accuracy or budget out"
            )
        found = _until(dae, condition, times, outputs, run | {"solver": solver, **options})
    elif accuracy is None and budget is None:
        run |= {"solver": solver, "outputs": outputs, **options}
        found = native.simulate(dae, **times.given, **run)
    else:
        found = _promised(dae, accuracy, budget, times, outputs, run, options)
    if accuracy is None and budget is None and SOLVERS[found.stats["solver"]].adaptive:
        settings = run | {"solver": solver, **options}
        span = float(found.time[0]), float(found.time[-1])
        found = found.computed_by(partial(again, dae, settings, *span))
    return times.asked(found)


def _promised(
    dae: Dae,
    accuracy: float | None,
    budget: float | None,
    times: AskedTimes,
    outputs: Sequence[str] | None,
    run: dict[str, Any],
    options: Options,
) -> Trajectory:
    """Run with what an accuracy or a budget chooses."""
    assign(dae, run["start_values"])
    dae, names = recording(dae, outputs)
    grid = times.grid()
    compiled = options.get("compiled")
    compiled = pays_compiling(dae, grid) if compiled is None else compiled
    run = run | times.given | {"on_invalid": options.get("on_invalid", "warn")}
    solve = partial(native.simulate, dae, outputs=names, compiled=compiled, **run)
    length = float(grid[-1] - grid[0])
    return promised_run(dae, solve, names, length, compiled, accuracy, budget)


def _until(
    dae: Dae,
    condition: str,
    times: AskedTimes,
    outputs: Sequence[str] | None,
    run: dict[str, Any],
) -> Trajectory:
    """Run until a condition becomes true."""
    dae, names = recording(dae, outputs)

    def solve(watched: Dae, grid: Vector, names: Sequence[str]) -> Trajectory:
        return native.simulate(watched, output_interval=grid, outputs=names, **run)

    return run_until(dae, condition, solve, times.grid(), names)


def _together(dae: Dae, given: Any, constants: Mapping[str, float]) -> Any:
    """Return start values with those of constant inputs."""
    if not constants or not isinstance(given, Mapping | None):
        return given
    if twice := constants.keys() & (given or {}).keys():
        raise UsageError(f"{dae.full_name}: {min(twice)} is given twice; give it once")
    return {**(given or {}), **constants}


def _numbers_of_texts(dae: Dae, given: Any) -> Any:
    """Return what is given for starts, texts as numbers in the variables' units."""
    if not isinstance(given, Mapping) or not isinstance(dae, Dae):
        return given  # and refused with the rest
    units = {v.name: v.unit for v in dae.variables}
    return {
        name: quantity(name, value, units[name])
        if isinstance(value, str) and name in units
        else value
        for name, value in given.items()
    }


@kept_per_thread(16)
def _catalogued(name: str) -> Dae:
    return load(name)


def named(name: str) -> Dae:
    """Return the model of a name, the same one for the same name of the catalogue.

    Raises:
        CosimError: See `load`.
    """
    return load(name) if ".py:" in name else _catalogued(name)


def run_scene(
    scene: Scene,
    road: Road | str | None = None,
    *,
    stop_when: str | None = None,
    output_times: ArrayLike | None = None,
    **options: Any,
) -> Trajectory:
    """Run a scene on a road: through the integrators here, or through fmpy as an FMU made from it.

    With an accuracy or a budget, the front of the model with its author's values is what chooses,
    so that it need not be measured anew for each of the scene's values.

    Args:
        scene: What to run.
        road: "native", "native-interpreted", "fmu-me" or "fmu-cs"; the first one when None.
        stop_when: A condition that ends the run; see `simulate`.
        output_times: Times of one's own, s; see `simulate`.
        options: `compiled`, `on_invalid`, `drift_control` of the native road.

    Raises:
        UsageError: An FMU shall run with an accuracy, a budget or a condition.
        CosimError: The run failed; see `simulate`, `export_fmu`, `simulate_fmu`.

    Example:
        >>> import cosim
        >>> run_scene(cosim.read_scene("crank_torque.toml")).names
        ('T',)
    """
    if not isinstance(scene, Scene):
        return roads.run_on_road(scene, road, **options)  # which refuses it
    goals = {name: getattr(scene.settings, name) for name in GOALS}
    goal = any(value is not None for value in goals.values())
    asked: dict[str, Any] = {"stop_when": stop_when, "output_times": output_times}
    if not goal and all(value is None for value in asked.values()):
        return roads.run_on_road(scene, road, **options)
    way = Road.NATIVE if road is None else Road.named(road)
    if not way.native:
        words = "accuracy and budget are" if goal else "stop_when and output_times are"
        raise UsageError(
            f"{scene.name}: {words} for CasADi's integrators; an FMU gets its accuracy when it is "
            "exported: cosim export --accuracy"
        )
    if way is Road.INTERPRETED:
        options["compiled"] = False
    dae = roads.scene_dae(replace(scene, values={}) if goal else scene)
    settings = roads.native_settings(scene, dae)
    if output_times is not None:
        settings["stop_time"] = None
    if not goal:
        return simulate(dae, **asked, **settings, **options)
    known = {v.name for v in (*dae.states, *dae.parameters, *dae.inputs)}
    values = plain_values(scene.dae, scene.values)
    start = {name: value for name, value in values.items() if name in known}
    return simulate(dae, start_values=start, **asked, **goals, **settings, **options)
