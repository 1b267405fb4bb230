"""Functions of `import cosim` that combine packages: run requests, goals and scenes."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Unpack

from casadi_models.dae import Dae
from cosim.backend import Backend
from cosim.errors import UsageError
from cosim.integrate.keywords import Keywords, RareKeywords, requested
from cosim.integrate.run import run
from cosim.model.request import RunRequest, choice
from cosim.model.solver import Goal, Solver
from cosim.scene.scene import Scene
from cosim.study.accuracy.choice import accurate_run
from cosim.trajectory import Trajectory


def simulate(
    dae: Dae | str | RunRequest,
    *,
    start_time: float | None = None,
    stop_time: float | None = None,
    output_interval: float | None = None,
    solver: str | Solver | None = None,
    accuracy: float | str | None = None,
    budget: float | None = None,
    start_values: Mapping[str, float | str] | None = None,
    inputs: Any = None,
    outputs: Sequence[str] | None = None,
    **options: Unpack[RareKeywords],
) -> Trajectory:
    """Integrate a DAE with CVODES, or with IDAS when it has algebraic unknowns.

    Args:
        dae: The model, the name of one, or a request whose fields are the defaults of all other
            arguments; SI units throughout.
        start_time: Start of the run, s; 0 when None.
        stop_time: End of the run, s; the model's own span after `start_time` when None.
        output_interval: Distance of the output times, s; the model's own when None. The last
            output is at `stop_time` in any case.
        solver: A solver with its numbers, as `cosim.solvers.Dop853(relative_tolerance=1e-10)`, or
            the name of one; CVODES, or IDAS for a DAE, when None.
        accuracy: Target instead of solver and tolerance: largest global error of the outputs, in
            nominal values, or a text with a unit that fits every output, as "1mm". The cheapest
            configuration whose measured error is small enough is used, and its error on this run is
            estimated by a second method.
        budget: Target instead of solver, tolerance and accuracy: largest time of the solver, s.
        start_values: Numbers in SI units, or texts with a unit, by name, that replace initial
            values of states, parameters, or constant inputs.
        inputs: An `InputSeries`, piecewise linear; or by name a number, a text with a unit, a
            formula of time, states and parameters, also with constants of its own that become
            parameters, `("k*phi", {"k": 2.0})`, a function of time, samples at the output times
            (n,), or an `InputSeries`. A formula, and a function that CasADi can evaluate
            symbolically (`lambda t: np.sin(t)`), become part of the equations; any other function
            is sampled at the output times. Other inputs are constant.
        outputs: Names to record, monitors among them; everything but monitors when None.
        options: Rarely needed keywords.
            `relative_tolerance`: error per step relative to the size of each state (1), 1e-8 when
            None. For the default solver, a tolerance below 1e-8 is read as the desired accuracy of
            the result.
            `absolute_tolerance`: error per step in the nominal value of each unknown (1), which is
            1 SI unit if neither the model nor the initial values set it; a hundredth of the
            relative tolerance when None.
            `step_size`: largest step of `rk4` and `ode8`, s; the output interval when None.
            `max_step`: largest step of the other solvers, s. When None, the error control chooses
            the steps; but if the equations contain time or an `InputSeries` drives them, no step
            spans more than 10 output intervals or a fiftieth of the run.
            `compiled`: whether the equations are compiled; small models are when None.
            `on_invalid`: what happens if a run violates a validity condition of the model, or a
            fixed step is too long for the motion: "warn" (the default) reports it in
            `stats["invalid"]`, "stop" ends the run at that time, "ignore" checks neither. It also
            ignores singular configurations, at which a run is rejected otherwise.
            `drift_control`: "none", "baumgarte" (the model's stabilization rate) or "projection"
            after every step, which makes `dop853` the default solver and passes singular
            configurations; as the model is built when None.
            `output_times`: output times, s, (n,), in place of `stop_time` and `output_interval`.
            `stop_when`: a condition, e.g. "abs(phi) > 45deg", that ends the run where it becomes
            true, which is an event; `stats.stop` reports it.
            `record_events`: whether rows just before and after each event are added to the result,
            both at its time.

    Returns:
        Every state, algebraic unknown and output of `dae`, each of shape (n,), with its unit. Its
        `at` computes the run at other times.

    Raises:
        UnknownName: A name does not exist: of a value, an output, a solver or an option.
        ParameterError: A value is not finite or out of its bounds.
        UsageError: The solver cannot integrate the model, or two arguments contradict each other.
        InitialConditionError: The start values contradict the constraints.
        SolverError: The run failed, violated a validity condition with `on_invalid="stop"`, reached
            a singular configuration, or missed the `accuracy`; `partial` is the run up to there.
        Interrupted: Ctrl-C, a `KeyboardInterrupt` whose `partial` holds the run up to there.
        MissingTool: `compiled` is True and no compiler works.

    References:
        Hindmarsh et al., SUNDIALS, ACM TOMS 2005, doi:10.1145/1089014.1089020.

    Example:
        >>> run = simulate("crank_shaft", start_values={"omega": "60rpm"}, stop_when="phi > 2*pi")
        >>> round(run.stats.stop_time, 6)  # of 2 pi t + 5 t^2 = 2 pi
        0.656758
    """
    return execute(
        requested(
            dae,
            start_time=start_time,
            stop_time=stop_time,
            output_interval=output_interval,
            solver=solver,
            accuracy=accuracy,
            budget=budget,
            start_values=start_values,
            inputs=inputs,
            outputs=outputs,
            **options,
        )
    )


def execute(request: RunRequest, backend: Backend = Backend.NATIVE) -> Trajectory:
    """Execute a request on a backend; a goal is first resolved to a solver and a tolerance."""
    if backend.interface is not None:
        from cosim.fmi.run.exported import run as run_as_fmu

        return run_as_fmu(request, backend.interface)
    if backend is Backend.INTERPRETED:
        request = replace(request, policy=replace(request.policy, compiled=False))
    return accurate_run(request) if isinstance(request.solver, Goal) else run(request)


def run_scene(
    scene: Scene, backend: Backend | str = Backend.NATIVE, **keywords: Unpack[Keywords]
) -> Trajectory:
    """Run a scene, reduced to what its outputs require.

    Args:
        scene: What to run.
        backend: "native", "native-interpreted", "fmu-me" or "fmu-cs".
        keywords: Keywords of `simulate` that replace settings of the scene.

    Raises:
        UsageError: An FMU cannot run with a stop condition, a goal or explicit output times.
        CosimError: The run failed; see `simulate`, `export_fmu`, `simulate_fmu`.

    Example:
        >>> import cosim
        >>> run_scene(cosim.read_scene("crank_torque.toml")).names
        ('T',)
    """
    UsageError.reject("run_scene", scene, Scene, "what cosim.read_scene returns")
    request = requested(scene.request, **keywords) if keywords else scene.request
    return execute(request.reduced(), choice(Backend, "backend", backend))
