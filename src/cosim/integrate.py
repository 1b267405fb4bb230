"""Road one: a DAE through CasADi's integrators, CVODES and IDAS first, to a `Trajectory`."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any

import casadi as ca
import numpy as np
from casadi import MX
from numpy.typing import ArrayLike, NDArray

from casadi_models.dae import Dae
from cosim import solvers
from cosim.compile import has_compiler
from cosim.consistent import algebraic_function, algebraic_values, start_values
from cosim.errors import ParameterError, SolverError, UnknownName
from cosim.inputs import InputSeries
from cosim.monitors import ON_INVALID, Breach, breaches, too_coarse
from cosim.solvers import SOLVERS, Engine, Tolerance
from cosim.trajectory import Column, Trajectory
from cosim.values import Values, assign, number

__all__ = ["SOLVERS", "integrator", "simulate", "time_grid"]

Vector = NDArray[np.float64]
MOST_POINTS = 50_000_000  # output times; beyond, a run would not fit into memory


def simulate(
    dae: Dae,
    *,
    start_time: float = 0.0,
    stop_time: float | None = None,
    output_interval: float | None = None,
    solver: str | None = None,
    relative_tolerance: float = 1e-8,
    absolute_tolerance: float | None = None,
    step_size: float | None = None,
    start: Mapping[str, float] | None = None,
    inputs: InputSeries | None = None,
    outputs: Sequence[str] | None = None,
    compiled: bool | None = None,
    on_invalid: str = "warn",
) -> Trajectory:
    """Integrate a DAE with CVODES, or with IDAS when it has algebraic unknowns.

    Args:
        dae: The model; SI units throughout.
        start_time: Begin of the run, s.
        stop_time: End of the run, s; the model's own span after `start_time` when None.
        output_interval: Distance of the output times, s; the model's own when None. The last
            output is at `stop_time` in any case.
        solver: A name of `SOLVERS`; CVODES, or IDAS for a DAE, when None.
        relative_tolerance: Error per step relative to each state's size (1).
        absolute_tolerance: Error per step in SI units; a hundredth of the relative when None.
        step_size: Largest step of `rk4` and `ode8`, s; the output interval when None.
        start: Values by name that replace starts of states, parameters, or inputs.
        inputs: Time series of some inputs, piecewise linear; the others keep their start value.
        outputs: Names to record; everything observable when None.
        compiled: Whether to compile the equations; if a compiler is there when None.
        on_invalid: What happens where a run leaves the model's limits, or a fixed step is too long
            for the motion: "warn" says so in `stats["invalid"]`, "stop" ends the run there,
            "ignore" looks at neither.

    Returns:
        Every state, algebraic unknown and output of `dae`, each of shape (n,), with its unit.

    Raises:
        UnknownName: `start`, `outputs`, `solver` or `on_invalid` holds a name that does not exist.
        ParameterError: A value is not finite or out of its bounds.
        InitialConditionError: The start values contradict the constraints.
        SolverError: The solver gave up, or the run stopped at a limit; `partial` holds the run up
            to there.
        MissingTool: `compiled` is True and no compiler works.

    References:
        Hindmarsh et al., SUNDIALS, ACM TOMS 2005, doi:10.1145/1089014.1089020.
    """
    began = perf_counter()
    if on_invalid not in ON_INVALID:
        raise UnknownName.among("simulate", "answer to an invalid state", on_invalid, ON_INVALID)
    values = assign(dae, start)
    if start_time and stop_time is None:
        stop_time = start_time + dae.experiment.stop_time
    grid = time_grid(
        start_time,
        dae.experiment.stop_time if stop_time is None else stop_time,
        dae.experiment.output_interval if output_interval is None else output_interval,
    )
    columns = _columns(dae, outputs)
    tolerance = Tolerance(relative_tolerance, absolute_tolerance)
    name, method = solvers.method(dae, solver)
    compiled = has_compiler() if compiled is None else compiled
    x0 = start_values(dae, values)
    u = _input_values(dae, grid, values, inputs)
    z0 = algebraic_values(dae, grid[0], x0, replace(values, u=u[:, 0]))
    stats: dict[str, Any] = {"solver": name, "relative_tolerance": relative_tolerance}
    coarse: list[Breach] = []
    if len(grid) == 1 or not dae.states:
        states, stopped = np.tile(x0[:, None], len(grid)), ""
    else:
        engine = solvers.build(
            dae,
            grid,
            name,
            tolerance,
            step_size=step_size,
            inputs=inputs,
            compiled=compiled,
            sensitivities=False,
        )
        ready = perf_counter()
        states, stopped = _run(engine, dae, x0, z0, values)
        stats |= {"solve_time": perf_counter() - ready} | ({} if stopped else engine.stats())
        if not method.adaptive and not stopped and on_invalid != "ignore":
            coarse = _step_check(dae, grid, name, step_size, inputs, compiled, states, z0, values)
    reached = grid[: states.shape[1]]
    table = _observe(dae, reached, states, z0, u, values.p, compiled)
    table, margins = np.split(table, [len(_all_columns(dae))], axis=1)
    bad = np.flatnonzero(~np.isfinite(table).all(axis=1))
    if bad.size and not stopped:
        stopped = _not_finite(dae, table[bad[0]], reached[bad[0]])
    end = bad[0] if bad.size else len(reached)
    if on_invalid != "ignore":
        found = sorted([*coarse, *breaches(dae, reached[:end], margins[:end])])
        if found:
            stats["invalid"] = [breach.text for breach in found]
        if found and on_invalid == "stop":
            end, stopped = found[0]
    stats |= {"compiled": compiled, "wall_time": perf_counter() - began}
    status = "complete"
    if stopped:
        last = f"{reached[end - 1]:g} s" if end else "the start"
        status = f"stopped after {last}: {stopped}"
    every = Trajectory(
        dae.full_name, reached[:end].copy(), _all_columns(dae), table[:end].copy(), stats, status
    )
    run = every.select([column.name for column in columns])
    if stopped:
        raise SolverError(_explain(dae, name, tolerance, run), run)
    return run


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
    times = _checked_grid(grid)
    engine = solvers.build(
        dae,
        times,
        solver,
        Tolerance(relative_tolerance, absolute_tolerance),
        step_size=step_size,
        compiled=has_compiler() if compiled is None else compiled,
    )
    if not engine.extra.size:
        return engine.function
    x0, z0, p, u = (
        MX.sym(n, v.numel()) for n, v in (("x0", dae.x), ("z0", dae.z), ("p", dae.p), ("u", dae.u))
    )
    result = engine.function(x0=x0, z0=z0, p=ca.vertcat(p, engine.extra), u=u)
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


def time_grid(start: float, stop: float, interval: float) -> Vector:
    """Return output times from start to stop, both included, (n,).

    Raises:
        ParameterError: A number is not finite, the interval not positive, or stop before start.
    """
    start, stop = number("run", "start_time", start), number("run", "stop_time", stop)
    interval = number("run", "output_interval", interval, positive=True)
    if stop < start:
        raise ParameterError(
            f"stop_time = {stop:g} s lies before start_time = {start:g} s; give a later stop"
        )
    count = (stop - start) / interval
    if count > MOST_POINTS:
        raise ParameterError(
            f"output_interval = {interval:g} s makes {count:.3g} output times; give a larger one"
        )
    whole = round(count)
    if abs(count - whole) < 1e-6 * max(1.0, count):
        grid: Vector = np.linspace(start, stop, whole + 1)
        return grid
    return np.append(start + interval * np.arange(int(np.floor(count)) + 1), stop)


def _checked_grid(grid: ArrayLike) -> Vector:
    times = np.asarray(grid, dtype=float)
    if times.ndim != 1 or len(times) < 2 or not np.isfinite(times).all():
        raise ParameterError("grid: give two or more finite times in one dimension")
    falling = np.flatnonzero(np.diff(times) <= 0)
    if falling.size:
        i = int(falling[0]) + 1
        raise ParameterError(f"grid: time {i} ({times[i]:g} s) is not after the one before it")
    return times


def _run(engine: Engine, dae: Dae, x0: Vector, z0: Vector, values: Values) -> tuple[Vector, str]:
    """Call an engine; return the states at the times it reached, (nx, n), and why it stopped."""
    n = engine.function.size2_out(0)
    states = np.full((n, dae.x.numel()), np.nan)  # CasADi is column-major
    u = np.tile(values.u, n) if engine.repeat_u else values.u
    arguments = [x0, z0, np.concatenate((values.p, engine.extra)), u]
    buffer, call = engine.function.buffer()
    for i, array in enumerate(arguments):
        if array.size:
            buffer.set_arg(i, array.data)  # type: ignore[call-arg]  # stub and binding differ
    buffer.set_res(0, states.data)  # type: ignore[call-arg]
    reason = ""
    try:
        call()
        if buffer.ret():
            reason = engine.stats().get("cause", "it gave up")
    except RuntimeError as error:  # CasADi has no narrower type
        reason = _cause(str(error))
    finite = np.isfinite(states).all(axis=1)
    reached = n if finite.all() else int(np.argmin(finite))
    if reached < n and not reason:
        reason = "a state is not finite"
    return states[:reached].T, reason


def _step_check(
    dae: Dae,
    grid: Vector,
    name: str,
    step_size: float | None,
    inputs: InputSeries | None,
    compiled: bool,
    states: Vector,
    z0: Vector,
    values: Values,
) -> list[Breach]:
    """Repeat a run of fixed steps with half of them; say where the states part."""
    half = (float(np.diff(grid).max()) if step_size is None else step_size) / 2
    engine = solvers.build(
        dae, grid, name, step_size=half, inputs=inputs, compiled=compiled, sensitivities=False
    )
    finer, _ = _run(engine, dae, states[:, 0], z0, values)
    return too_coarse(dae, grid, states, finer, 2 * half)


def _cause(message: str) -> str:
    """Return the SUNDIALS flag, or the last line of CasADi's message."""
    flag = message.partition('returned "')[2].partition('"')[0]
    return flag or message.strip().splitlines()[-1][:200]


def _input_values(dae: Dae, grid: Vector, values: Values, inputs: InputSeries | None) -> Vector:
    """Return every input at the output times, (nu, n)."""
    table = np.tile(values.u[:, None], len(grid))
    if inputs is not None:
        known = [variable.name for variable in dae.inputs]
        for name, row in zip(inputs.names, inputs.at(grid), strict=True):
            if name not in known:
                raise UnknownName.among(dae.full_name, "input", name, known)
            table[known.index(name)] = row
    return table


def _observe(
    dae: Dae, time: Vector, states: Vector, z0: Vector, u: Vector, p: Vector, compiled: bool
) -> Vector:
    """Evaluate algebraic unknowns, outputs and limits from the states; one row per time."""
    if not len(time):
        return np.empty((0, len(_all_columns(dae)) + len(dae.limits)))
    observe = _observer(dae)
    if compiled and len(time) > 1:
        (observe,) = solvers.external([observe], solvers.cache_key("observe", observe), ["observe"])
    n = len(time)
    every = observe.map("every", "serial", n, [2, 4], []) if n > 1 else observe
    rows = np.array(every(time[None, :], states, z0, u[:, :n], p))
    return np.vstack((states, rows)).T


def _observer(dae: Dae) -> ca.Function:
    names = ["t", "x", "z", "u", "p"]
    symbols = [dae.t, dae.x, dae.z, dae.u, dae.p]
    margins = (margin for margin, _ in dae.limits)
    outputs = ca.Function("outputs", symbols, [ca.vertcat(dae.outputs, *margins)], {"cse": True})
    t, x, z, u, p = (MX.sym(n, s.numel()) for n, s in zip(names, symbols, strict=True))
    solved = algebraic_function(dae)(t, x, z, u, p)
    rows = ca.vertcat(solved, outputs(t, x, solved, u, p))
    return ca.Function("observe", [t, x, z, u, p], [rows], names, ["rows"])


def _all_columns(dae: Dae) -> tuple[Column, ...]:
    return tuple(
        Column(v.name, v.unit, v.display_unit, v.nominal, v.meaning)
        for v in (*dae.states, *dae.algebraics, *dae.output_variables)
    )


def _columns(dae: Dae, outputs: Sequence[str] | None) -> list[Column]:
    available = {column.name: column for column in _all_columns(dae)}
    wanted = dae.observed if outputs is None else outputs
    for name in wanted:
        if name not in available:
            raise UnknownName.among(dae.full_name, "output", name, available)
    return [available[name] for name in wanted]


def _not_finite(dae: Dae, row: Vector, time: float) -> str:
    name = _all_columns(dae)[int(np.argmin(np.isfinite(row)))].name
    return f"{name} is not finite at {time:g} s"


def _explain(dae: Dae, solver: str, tolerance: Tolerance, run: Trajectory) -> str:
    relative, absolute = tolerance.pair
    if any(run.status.endswith(text) for text in run.stats.get("invalid", ())):
        return f"{dae.full_name}: {solver} {run.status}"
    return (
        f"{dae.full_name}: {solver} {run.status} (rtol {relative:g}, atol {absolute:g}); look for "
        "a singularity near that state, loosen the tolerance, or use another formulation or solver"
    )
