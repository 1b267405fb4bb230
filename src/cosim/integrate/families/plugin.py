"""An integrator of CasADi's called from its virtual machine, whatever evaluates its equations."""

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np
from casadi import MX

from cosim.codegen.casadi_library import cache_key, external
from cosim.codegen.functions import CALL, equations, inputs_at, is_large, symbols_of
from cosim.codegen.initialization import algebraic_function
from cosim.integrate.engine import Counts, Engine, EngineFunctions, Problem
from cosim.integrate.solver import AdaptiveSolver

MOST_STEPS = 100_000  # from one output time to the next
COMMON = {"show_eval_warnings": False, "max_num_steps": MOST_STEPS}  # of every plugin


def plugin_engine(
    problem: Problem, plugin: str, options: Mapping[str, Any], names: Sequence[str]
) -> Engine:
    """Return the engine of an integrator of CasADi's.

    Args:
        problem: What it is for; where compiled, its equations and their Jacobian are.
        plugin: Name of the integrator.
        options: Its options besides the largest step.
        names: Its names for steps, right-hand sides and Jacobians.
    """
    dae, grid, inputs = problem.dae, problem.grid, problem.inputs
    large = is_large(dae) and not problem.sensitivities
    if problem.compiled or inputs is not None or large:
        function = _equations(problem)
        t, x, z, u, p = symbols = symbols_of(function)
        ode, alg = function(t, x, z, inputs_at(dae, inputs, t, u), p)
        system: dict[str, Any] = dict(zip(CALL, symbols, strict=True)) | {"ode": ode, "alg": alg}
    else:
        system = dae.casadi
    options = dict(options)
    if inputs is not None:
        options["max_step_size"] = float(np.diff(inputs.time).min())
    run = ca.integrator("run", plugin, system, grid[0], list(grid), options)

    def counts() -> Counts:
        raw = run.stats(1)  # the memory that `Function.buffer` takes; 0 belongs to plain calls
        steps, rhs, jacobians = (int(raw[name]) if name in raw else None for name in names)
        return Counts(steps, rhs, jacobians)

    made, repeat = EngineFunctions(run), "control_group_size" not in options
    return Engine(lambda: made, len(problem.grid), repeat, counts, problem.compiled)


def restarted_engine(problem: Problem, plugin: str, options: Mapping[str, Any]) -> Engine:
    """Return an engine of SUNDIALS' that begins anew at every output time.

    Within one run, CasADi goes on there with what it knows of the past, though inputs have changed:
    its error tests fail, or it starts from unknowns that belong to other inputs.

    Args:
        problem: With inputs that have a column per output time.
        plugin, options: See `plugin_engine`; times go from 0 to 1.
    """
    dae, grid = problem.dae, problem.grid
    function, n = _equations(problem), len(grid)
    s, x, z, u, p = symbols_of(function)
    begin, length = MX.sym("begin"), MX.sym("length")
    ode, alg = function(begin + length * s, x, z, u, p)
    known = ca.vertcat(u, p, begin, length)
    system = {"t": s, "x": x, "z": z, "p": known, "ode": length * ode, "alg": alg}
    run = ca.integrator("run", plugin, system, 0, 1, dict(options))
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
    made = EngineFunctions(whole)
    return Engine(lambda: made, len(problem.grid), True, Counts, problem.compiled)


def _equations(problem: Problem) -> ca.Function:
    """Return the model's equations, with their Jacobian in a library where compiled."""
    complete = problem.sensitivities or not (problem.compiled or is_large(problem.dae))
    function = equations(problem.dae, sensitivities=complete)
    if problem.compiled:
        functions = [function, function.jacobian()]
        (function,) = external(functions, cache_key("sundials", function), ["dae"])
    return function


def tolerances(solver: AdaptiveSolver) -> dict[str, Any]:
    """Return the tolerances as CasADi's integrators take them."""
    relative, absolute = solver.tolerance.pair
    return {"reltol": relative, "abstol": absolute}
