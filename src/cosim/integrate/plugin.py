"""An integrator of CasADi's called from its virtual machine, whatever evaluates its equations."""

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from cosim.codegen.casadi_library import cache_key, external
from cosim.codegen.functions import CALL, driven, equations, symbols_of
from cosim.integrate.engine import Counts, Engine, Problem

# of every plugin; the number of steps is per output interval
COMMON = {"show_eval_warnings": False, "max_num_steps": 100_000}


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
    if problem.compiled or inputs is not None:
        function = equations(dae, sensitivities=problem.sensitivities)
        if problem.compiled:
            functions = [function, function.jacobian()]
            (function,) = external(functions, cache_key("sundials", function), ["dae"])
        t, x, z, u, p = symbols = symbols_of(function)
        ode, alg = function(t, x, z, driven(dae, inputs, t, u), p)
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

    return Engine(run, None, "control_group_size" not in options, counts, problem.compiled)
