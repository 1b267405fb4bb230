"""Road one: a DAE through CasADi's integrators, CVODES and IDAS first, to a `Trajectory`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import casadi as ca
import numpy as np
from casadi import MX
from numpy.typing import ArrayLike

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.compiler import has_compiler
from cosim.errors import Interrupted, SolverError, UnknownName, UsageError
from cosim.integrate import engine
from cosim.integrate.call import INTERRUPTED, call
from cosim.integrate.drift_control import controlled
from cosim.integrate.initial_values import algebraic_values, start_values
from cosim.integrate.outputs import all_columns, observe, wanted_names, watching
from cosim.integrate.solvers import SOLVERS, Tolerance, method
from cosim.integrate.validity import ON_INVALID, Breach, breaches, too_coarse
from cosim.model.inputs import InputSeries
from cosim.model.time_grid import checked_grid, time_grid
from cosim.model.values import Values, assign, listed, number
from cosim.trajectory import Trajectory


def simulate(
    dae: Dae,
    *,
    start_time: float = 0.0,
    stop_time: float | None = None,
    output_interval: float | Vector | None = None,
    solver: str | None = None,
    relative_tolerance: float | None = None,
    absolute_tolerance: float | None = None,
    step_size: float | None = None,
    start: Mapping[str, float] | None = None,
    inputs: InputSeries | None = None,
    outputs: Sequence[str] | None = None,
    compiled: bool | None = None,
    on_invalid: str = "warn",
    drift_control: str | None = None,
) -> Trajectory:
    """Integrate a DAE with CVODES, or with IDAS when it has algebraic unknowns.

    Args:
        dae: The model; SI units throughout.
        start_time: Begin of the run, s.
        stop_time: End of the run, s; the model's own span after `start_time` when None.
        output_interval: Distance of the output times, s; the model's own when None. The last
            output is at `stop_time` in any case. An array holds the times themselves, (n,).
        solver: A name of `SOLVERS`; CVODES, or IDAS for a DAE, when None.
        relative_tolerance: Error per step relative to each state's size (1); 1e-8 when None.
        absolute_tolerance: Error per step in SI units; a hundredth of the relative when None.
        step_size: Largest step of `rk4` and `ode8`, s; the output interval when None.
        start: Values by name that replace starts of states, parameters, or inputs.
        inputs: Time series of some inputs, piecewise linear; the others keep their start value.
        outputs: Names to record, monitors among them; everything but those when None.
        compiled: Whether to compile the equations; if a compiler is there when None.
        on_invalid: What happens where a run leaves the model's limits, or a fixed step is too long
            for the motion: "warn" says so in `stats["invalid"]`, "stop" ends the run there,
            "ignore" looks at neither.
        drift_control: "none", "baumgarte" (the model's closing rate) or "projection" after every
            step, which makes `dop853` the default solver; what the model has when None.

    Returns:
        Every state, algebraic unknown and output of `dae`, each of shape (n,), with its unit.

    Raises:
        UnknownName: `start`, `outputs`, `solver`, `on_invalid` or `drift_control` holds a name that
            does not exist.
        ParameterError: A value is not finite or out of its bounds, or asks for what cannot be.
        UsageError: The solver cannot integrate the model.
        InitialConditionError: The start values contradict the constraints.
        SolverError: The solver gave up, or the run stopped at a limit; `partial` holds the run up
            to there.
        Interrupted: Ctrl-C, a `KeyboardInterrupt` whose `partial` holds the run up to there.
        MissingTool: `compiled` is True and no compiler works.

    References:
        Hindmarsh et al., SUNDIALS, ACM TOMS 2005, doi:10.1145/1089014.1089020.
    """
    began = perf_counter()
    if not isinstance(on_invalid, str) or on_invalid not in ON_INVALID:
        raise UnknownName.among("simulate", "answer to an invalid state", on_invalid, ON_INVALID)
    dae, project = controlled(dae, drift_control)
    values = assign(dae, start)
    wanted = None if outputs is None else listed(f"{dae.full_name}: outputs", outputs)
    dae = watching(dae, wanted or ())
    names = wanted_names(dae, wanted)
    grid = output_times(dae, start_time, stop_time, output_interval)
    if not isinstance(compiled, bool | None):
        raise UsageError.of_type(f"{dae.full_name}: compiled", compiled, "True, False or None")
    if compiled is None:
        compiled = has_compiler()
    relative = Tolerance().relative if relative_tolerance is None else relative_tolerance
    task = _Task(
        dae,
        method(dae, "dop853" if project and solver is None else solver)[0],
        Tolerance(relative, absolute_tolerance),
        step_size,
        compiled,
        values,
        inputs,
        on_invalid,
        project,
    )
    solution = first = task.solve(grid)
    # A run that failed is repeated up to its last good time: what is kept then equals, bit for bit,
    # a run that was to stop there (solvers look ahead to the stop time).
    while solution.reason not in ("", INTERRUPTED) and 0 < len(solution.table) < len(solution.grid):
        solution = task.solve(grid[: len(solution.table)])
    time = grid[: len(solution.table)]
    status = "complete"
    if first.reason:
        last = f"{time[-1]:g} s" if len(time) else "the start"
        status = f"stopped after {last}: {first.reason}"
    stats = {"solver": task.solver, "relative_tolerance": relative, **solution.stats}
    stats |= {"compiled": task.compiled, "wall_time": perf_counter() - began}
    if first.invalid:
        stats["invalid"] = [breach.text for breach in first.invalid]
    every = Trajectory(dae.full_name, time, all_columns(dae), solution.table, stats, status)
    run = every.select(names)
    if first.reason == INTERRUPTED:
        raise Interrupted(f"{dae.full_name}: {status}", run)
    if first.reason:
        raise SolverError(task.explain(every), run)
    return run


def output_times(
    dae: Dae, start_time: float, stop_time: float | None, output_interval: float | Vector | None
) -> Vector:
    """Return the output times of a run, s, (n,); see `simulate`.

    An array in place of the interval holds these times themselves.

    Raises:
        ParameterError: A time is not finite, or they are not increasing.
    """
    if isinstance(output_interval, np.ndarray):
        return checked_grid(output_interval)
    start_time = number("run", "start_time", start_time)
    return time_grid(
        start_time,
        start_time + dae.experiment.stop_time if stop_time is None else stop_time,
        dae.experiment.output_interval if output_interval is None else output_interval,
        numbers=len(all_columns(dae)),
    )


def integrator(
    dae: Dae,
    grid: ArrayLike,
    *,
    solver: str | None = None,
    relative_tolerance: float = 1e-8,
    absolute_tolerance: float | None = None,
    step_size: float | None = None,
    compiled: bool | None = None,
) -> ca.Function:
    """Return the bare function of CasADi's integrator API, to embed, map or differentiate.

    Args:
        dae: The model.
        grid: Increasing output times, s, the start first, (n,).
        solver, relative_tolerance, absolute_tolerance, step_size, compiled: See `simulate`.

    Returns:
        `(x0, z0, p, u, ...) -> (xf, zf, ...)` with one column per time of the grid, in the order
        of `dae.x`, `dae.z`, `dae.p`, `dae.u`. What is not given is 0: see `start_vectors`.
        Compiled `erk`, `rosenbrock`, `rk4` and `ode8` have no derivatives; pass `compiled=False`
        where an optimizer needs them.

    Raises:
        ParameterError: The grid is not increasing or not finite.
        UnknownName, UsageError, MissingTool: See `simulate`.
    """
    times = checked_grid(grid)
    built = engine.build(
        dae,
        times,
        solver,
        Tolerance(relative_tolerance, absolute_tolerance),
        step_size=step_size,
        compiled=has_compiler() if compiled is None else compiled,
    )
    if built.parameters is None:
        return built.function
    x0, z0, p, u = (
        MX.sym(n, v.numel()) for n, v in (("x0", dae.x), ("z0", dae.z), ("p", dae.p), ("u", dae.u))
    )
    result = built.function(x0=x0, z0=z0, p=built.parameters(p), u=u)
    names = ["x0", "z0", "p", "u"]
    return ca.Function(
        "integrator", [x0, z0, p, u], [result["xf"], result["zf"]], names, ["xf", "zf"]
    )


def start_vectors(dae: Dae, start: Mapping[str, float] | None = None) -> dict[str, Vector]:
    """Return consistent `x0`, `z0`, `p`, `u` to call an `integrator` with.

    Raises:
        UnknownName, ParameterError, InitialConditionError: See `simulate`.
    """
    values = assign(dae, start)
    x0 = start_values(dae, values)
    return {"x0": x0, "z0": algebraic_values(dae, 0.0, x0, values), "p": values.p, "u": values.u}


@dataclass(frozen=True)
class _Solution:
    """Rows of everything observable up to the last good time of a grid, and why it ended."""

    grid: Vector
    table: Vector
    stats: dict[str, Any]
    reason: str
    invalid: list[Breach]


@dataclass(frozen=True)
class _Task:
    """What a run needs besides its output times."""

    dae: Dae
    solver: str
    tolerance: Tolerance
    step_size: float | None
    compiled: bool
    values: Values
    inputs: InputSeries | None
    on_invalid: str
    project: bool

    def solve(self, grid: Vector) -> _Solution:
        dae, values = self.dae, self.values
        x0 = start_values(dae, values)
        u = _input_values(dae, grid, values, self.inputs)
        z0 = algebraic_values(dae, grid[0], x0, replace(values, u=u[:, 0]))
        states, guesses = (np.tile(start[:, None], len(grid)) for start in (x0, z0))
        stats: dict[str, Any] = {}
        reason, found = "", list[Breach]()
        if len(grid) > 1 and dae.states:
            engine = self.engine(grid, self.step_size)
            ready = perf_counter()
            reached = call(engine, x0, z0, values.p, values.u)
            started = reached.states.shape[1] > 0 or reached.reason in ("", INTERRUPTED)
            if self.solver == "idas" and not started:
                # IDACalcIC gave up on a start that is consistent already
                slopes = self.slopes(grid[0], x0, z0, u[:, 0])
                reached = call(self.engine(grid, None, slopes), x0, z0, values.p, values.u)
            stats = {"solve_time": perf_counter() - ready, **reached.stats}
            states, guesses, reason = reached.states, reached.algebraics, reached.reason
            if not SOLVERS[self.solver].adaptive and not reason and self.on_invalid != "ignore":
                found, reason = self.step_check(grid, states, z0)
        n = states.shape[1]
        table, margins = observe(dae, grid[:n], states, guesses, u[:, :n], values.p, self.compiled)
        bad = np.flatnonzero(~np.isfinite(table).all(axis=1))
        if bad.size:
            n = int(bad[0])
            name = all_columns(dae)[int(np.argmin(np.isfinite(table[n])))].name
            reason = reason or f"{name} is not finite at {grid[n]:g} s"
        if self.on_invalid != "ignore":
            found = sorted([*found, *breaches(dae, grid[:n], margins[:n])])
            if found and self.on_invalid == "stop":
                n, reason = found[0]
        return _Solution(grid, table[:n], stats, reason, found)

    def slopes(self, t: float, x: Vector, z: Vector, u: Vector) -> Vector:
        """Return dx/dt at a consistent state, (nx,)."""
        ode, _ = engine.equations(self.dae)(t, x, z, u, self.values.p)
        return np.array(ode).ravel()

    def engine(
        self, grid: Vector, step_size: float | None, slopes: Vector | None = None
    ) -> engine.Engine:
        return engine.build(
            self.dae,
            grid,
            self.solver,
            self.tolerance,
            step_size=step_size,
            inputs=self.inputs,
            compiled=self.compiled,
            sensitivities=False,
            project=self.project,
            slopes=slopes,
        )

    def step_check(self, grid: Vector, states: Vector, z0: Vector) -> tuple[list[Breach], str]:
        """Repeat a run of fixed steps with half of them; say where the states part.

        Returns:
            What is found, and whether that was interrupted (then nothing is).
        """
        step = float(np.diff(grid).max()) if self.step_size is None else self.step_size
        engine = self.engine(grid, step / 2)
        finer = call(engine, states[:, 0], z0, self.values.p, self.values.u)
        if finer.reason == INTERRUPTED:
            return [], INTERRUPTED
        return too_coarse(self.dae, grid, states, finer.states, step), ""

    def explain(self, run: Trajectory) -> str:
        settings = "rtol {:g}, atol {:g}".format(*self.tolerance.pair)
        if not SOLVERS[self.solver].adaptive:
            step = "output interval" if self.step_size is None else f"{self.step_size:g} s"
            settings = f"step: {step}"
        return (
            f"{self.dae.full_name}: {self.solver} {run.status} ({settings}); look for a "
            "singularity near that state, or use another tolerance or step, formulation or solver"
        )


def _input_values(dae: Dae, grid: Vector, values: Values, inputs: InputSeries | None) -> Vector:
    """Return every input at the output times, (nu, n)."""
    table = np.tile(values.u[:, None], len(grid))
    if not isinstance(inputs, InputSeries | None):
        raise UsageError.of_type(f"{dae.full_name}: inputs", inputs, "what read_inputs returns")
    if inputs is not None:
        known = [variable.name for variable in dae.inputs]
        for name, row in zip(inputs.names, inputs.at(grid), strict=True):
            if name not in known:
                raise UnknownName.among(dae.full_name, "input", name, known)
            table[known.index(name)] = row
    return table
