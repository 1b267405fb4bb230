"""CasADi's own integrators; compiled, the whole integration is one C function."""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from casadi import MX

from cosim.arrays import Vector
from cosim.codegen.casadi_library import cache_key
from cosim.codegen.casadi_patches import (
    in_one_piece,
    run_time_grid,
    run_time_tolerances,
    smallest_step,
    watched,
)
from cosim.codegen.compiler import cached_library
from cosim.codegen.externals import add_integrator, sources_beside
from cosim.codegen.functions import CALL, inputs_at, prepared, symbols_of
from cosim.codegen.runge_kutta.explicit_library import explicit_function
from cosim.integrate.engine import Engine, EngineFunctions, Problem, reported
from cosim.integrate.families.plugin import COMMON, plugin_engine, tolerances
from cosim.integrate.solver import AdaptiveSolver

_CASADI_COUNTERS = ("n_steps", "n_rhs", "n_jac")
_SETTINGS = 2  # of fmu/solvers/casadi_driver.h


@dataclass(frozen=True, kw_only=True)
class _OwnOfCasadi(AdaptiveSolver):
    order = 5

    def engine(self, problem: Problem) -> Engine:
        """Build the engine for a problem."""
        if problem.compiled:
            return self._generated(problem)
        options = COMMON | tolerances(self)
        if not problem.piecewise:  # steps may pass output times
            options["control_group_size"] = [len(problem.grid)]
        return plugin_engine(problem, self.name, options, _CASADI_COUNTERS)

    def _generated(self, problem: Problem) -> Engine:
        """CasADi's generated integrator on the unit interval; all numbers come with `p`."""
        dae, grid, inputs = problem.dae, problem.grid, problem.inputs
        start, length = grid[0], grid[-1] - grid[0]
        function, constants = prepared(dae)
        s, x, z, u, c = symbols_of(function)
        span = MX.sym("span", 4)  # start, length, relative and absolute tolerance
        t = span[0] + span[1] * s
        ode, alg = function(t, x, z, inputs_at(dae, inputs, t, u), c)
        known = ca.vertcat(c, span)
        symbols = [s, x, z, u, known]
        system = dict(zip(CALL, symbols, strict=True)) | {"ode": span[1] * ode, "alg": alg}
        options: dict[str, Any] = dict(COMMON)
        if inputs is not None:
            options["max_step_size"] = float(np.diff(inputs.time).min() / length)
        original = ca.Function("driven", symbols, [system["ode"], alg])
        sizes = {"NX": x, "NZ": z, "NU": u, "NC": known}
        head = "".join(f"#define {name} {symbol.numel()}\n" for name, symbol in sizes.items())

        def generate() -> str:
            run = ca.integrator("stepper", self.name, system, 0.0, [0.0, 1.0], options)
            generator = ca.CodeGenerator("code", {"with_header": False})
            add_integrator(generator, run)
            first = c.numel() + 2
            code = run_time_tolerances(
                str(generator.dump()), f"arg[2][{first}]", f"arg[2][{first + 1}]"
            )
            code = run_time_grid(watched(smallest_step(code)), known.numel())
            return f"{head}#define SETTINGS {_SETTINGS}\n{self.finished(code)}"

        key = cache_key(
            f"generated-10 {self.name}", original, repr(sorted(options.items())).encode()
        )
        path = str(cached_library(key, generate, sources_beside(original)))
        points = len(grid)
        run, library = explicit_function(path, points, 0, points if problem.piecewise else 1)
        p = MX.sym("p", dae.p.numel())
        settings = (points, 1 if problem.piecewise else points)
        numbers = (start, length, *self.tolerance.pair, *settings)
        extended = ca.vertcat(constants(p), *numbers, ca.DM(_unit_grid(grid)))
        made = EngineFunctions(run, ca.Function("parameters", [p], [extended]))
        counts = reported(library, start, length)
        return Engine(lambda: made, points, problem.piecewise, counts, True, library)

    @staticmethod
    def finished(code: str) -> str:
        """Return the generated code as it is compiled."""
        return code


@dataclass(frozen=True, kw_only=True)
class Erk(_OwnOfCasadi):
    """Dormand and Prince's explicit pair 5(4), the class of the book's ode45."""

    name = "erk"

    @staticmethod
    def finished(code: str) -> str:
        """Return the generated code as it is compiled."""
        return in_one_piece(code)


@dataclass(frozen=True, kw_only=True)
class Rosenbrock(_OwnOfCasadi):
    """A linearly implicit method, L-stable: for what is stiff, and for DAEs."""

    name = "rosenbrock"
    solves_dae = True
    uses_jacobian = True


def _unit_grid(grid: Vector) -> Vector:
    unit = (grid - grid[0]) / (grid[-1] - grid[0])
    even: Vector = np.arange(len(grid)) / (len(grid) - 1)
    return even if np.allclose(unit, even, rtol=0, atol=1e-12) else unit
