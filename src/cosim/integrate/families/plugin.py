"""Engines that call an integrator plugin of CasADi, for compiled or interpreted equations."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
from casadi import MX

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.casadi_library import cache_key, external
from cosim.codegen.functions import CALL, equations, inputs_at, is_large, symbols_of
from cosim.codegen.initialization import algebraic_function
from cosim.integrate.engine import MOST_STEPS, Counts, Engine, EngineFunctions, Problem
from cosim.memo import cached_per_thread
from cosim.model.solver import AdaptiveSolver

COMMON = {"show_eval_warnings": False, "max_num_steps": MOST_STEPS}  # options of every plugin
_CLOSE = 1e-8  # s; CasADi's SUNDIALS interfaces pass output times within 1e-9 s of the present


def plugin_engine(
    problem: Problem, plugin: str, options: Mapping[str, Any], names: Sequence[str]
) -> Engine:
    """Return the engine of an integrator plugin of CasADi.

    Args:
        problem: The problem to solve; if it is compiled, equations and Jacobian are machine code.
        plugin: Name of the plugin.
        options: Options of the plugin; steps in s.
        names: Keys of steps, right-hand sides and Jacobians in the plugin's statistics.
    """
    grid = problem.grid
    unit = _time_unit(grid)
    system = _system(replace(problem, times=b""), unit)
    options = {**options, "max_num_steps": problem.most_steps}
    longest = problem.longest(options.get("max_step_size"))
    if longest is not None:
        options["max_step_size"] = longest
    options |= {n: options[n] / unit for n in ("min_step_size", "max_step_size") if n in options}
    if "init_xdot" in options:
        options["init_xdot"] = [unit * slope for slope in options["init_xdot"]]
    run = ca.integrator("run", plugin, system, grid[0] / unit, list(grid / unit), options)

    def counts() -> Counts:
        raw = run.stats(1)  # the memory of the engine's buffer; plain calls use 0
        steps, rhs, jacobians = (int(raw[name]) if name in raw else None for name in names)
        return Counts(steps, rhs, jacobians)

    functions, repeat = EngineFunctions(run), "control_group_size" not in options
    return Engine(lambda: functions, len(grid), repeat, counts, time_unit=unit)


@cached_per_thread(16)
def _system(problem: Problem, unit: float) -> Mapping[str, Any]:
    """Return the equations of a problem, whose times do not matter, for CasADi's integrators.

    Args:
        problem: The problem.
        unit: The unit of time, s.
    """
    dae, inputs = problem.dae, problem.inputs
    large = is_large(dae) and not problem.sensitivities
    if not (problem.compiled or inputs is not None or large or unit != 1 or problem.in_own_time):
        return dae.casadi
    function = _equations(dae, problem.compiled, problem.sensitivities)
    t, x, z, u, p = symbols = symbols_of(function)
    clock = MX.sym("clock", 2 if problem.in_own_time else 0)
    begin, length = ca.vertsplit(clock) if problem.in_own_time else (MX(1, 1), unit)
    time = begin + length * t
    ode, alg = function(time, x, z, inputs_at(dae, inputs, time, u), p)
    given = dict(zip(CALL, symbols, strict=True))
    return given | {"p": ca.vertcat(p, clock), "ode": length * ode, "alg": alg}


def _time_unit(grid: Vector) -> float:
    """Return the unit of time for a grid, s: a power of two, and 1 unless times are close."""
    gap = float(np.diff(grid).min())
    return 1.0 if gap > _CLOSE else float(2.0 ** np.floor(np.log2(gap)))


def restarted_engine(problem: Problem, plugin: str, options: Mapping[str, Any]) -> Engine:
    """Return an engine of SUNDIALS that restarts at every output time, where inputs may change.

    Without a restart, CasADi continues with the step history and the algebraic unknowns of the old
    inputs, and error tests fail.

    Args:
        problem: The problem; its inputs have a column per output time.
        plugin, options: See `plugin_engine`; an interval is scaled to times from 0 to 1.
    """
    dae, grid = problem.dae, problem.grid
    function, n = _equations(dae, problem.compiled, problem.sensitivities), len(grid)
    s, x, z, u, p = symbols_of(function)
    begin, length = MX.sym("begin"), MX.sym("length")
    ode, alg = function(begin + length * s, x, z, u, p)
    known = ca.vertcat(u, p, begin, length)
    system = {"t": s, "x": x, "z": z, "p": known, "ode": length * ode, "alg": alg}
    options = dict(options)
    if "max_step_size" in options:
        options["max_step_size"] /= float(np.diff(grid).max())
    run = ca.integrator("run", plugin, system, 0, 1, options)
    found = run(x0=x, z0=z, p=known)
    arguments = [x, z, u, p, begin, length]
    interval = ca.Function("interval", arguments, [found["xf"], found["zf"]])
    steps = interval.mapaccum("intervals", n - 1, 2) if n > 2 else interval
    columns = MX.sym("u", u.numel(), n)
    numbers = (ca.DM(grid[:-1]).T, ca.DM(np.diff(grid)).T)
    rest = steps(x, z, columns[:, 1:], ca.repmat(p, 1, n - 1), *numbers)
    first = algebraic_function(dae)(grid[0], x, z, columns[:, 1], p)
    results = [ca.horzcat(start, part) for start, part in zip((x, first), rest, strict=True)]
    names = ["x0", "z0", "p", "u"]
    whole = ca.Function("run", [x, z, p, columns], results, names, ["xf", "zf"])
    return Engine(lambda: EngineFunctions(whole), n, True, Counts)


@cached_per_thread(32)
def _equations(dae: Dae, compiled: bool, sensitivities: bool) -> ca.Function:
    """Return a model's equations; if compiled, from a library that also has their Jacobian."""
    complete = sensitivities or not (compiled or is_large(dae))
    function = equations(dae, sensitivities=complete)
    if compiled:
        functions = [function, function.jacobian()]
        (function,) = external(functions, cache_key("sundials", function), ["dae"])
    return function


def tolerances(solver: AdaptiveSolver) -> dict[str, Any]:
    """Return the tolerances and the largest step, s, as options of CasADi's integrators."""
    relative, absolute = solver.tolerance.pair
    found = {"reltol": relative, "abstol": absolute}
    return found if solver.max_step is None else found | {"max_step_size": solver.max_step}
