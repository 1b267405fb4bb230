"""CasADi's own Runge-Kutta methods; if compiled, an integration is one C function."""

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np
from casadi import MX

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.casadi_library import add_integrator, cache_key, sources_beside
from cosim.codegen.casadi_patches import patched, run_time_grid, watched
from cosim.codegen.compiler import cached_library
from cosim.codegen.functions import CALL, inputs_at, prepared, symbols_of
from cosim.codegen.runge_kutta.explicit_library import explicit_function
from cosim.integrate.engine import Engine, EngineFunctions, Problem, reported
from cosim.integrate.families.plugin import COMMON, plugin_engine, tolerances
from cosim.memo import cached_per_thread
from cosim.model.inputs import InputSeries
from cosim.model.solver import AdaptiveSolver

_CASADI_COUNTERS = ("n_steps", "n_rhs", "n_jac")
_SETTINGS = 2  # of fmu/solvers/casadi_driver.h


@dataclass(frozen=True, kw_only=True)
class _CasadiSolver(AdaptiveSolver):
    order = 5
    own_patches: ClassVar[tuple[str, ...]] = ()  # of its generated code; see `patched`

    def engine(self, problem: Problem) -> Engine:
        """Build the engine for a problem."""
        if problem.compiled:
            return self._generated(problem)
        options = COMMON | tolerances(self)
        if not problem.piecewise:  # steps may pass output times
            options["control_group_size"] = [len(problem.grid)]
        return plugin_engine(problem, self.name, options, _CASADI_COUNTERS)

    def _generated(self, problem: Problem) -> Engine:
        """Return the engine of CasADi's generated C code on the unit interval."""
        dae, grid, inputs = problem.dae, problem.grid, problem.inputs
        points = len(grid)
        start, length = grid[0], grid[-1] - grid[0]
        path, constants = _library(type(self), dae, inputs)
        run, library = explicit_function(path, points, 0, points if problem.piecewise else 1)
        p, clock = MX.sym("p", dae.p.numel()), MX.sym("clock", 2 if problem.in_own_time else 0)
        settings = (points, 1 if problem.piecewise else points)
        largest = (problem.longest(self.max_step) or np.inf) / length
        span = (clock,) if problem.in_own_time else (start, length)
        numbers = (*span, *self.tolerance.pair, largest, problem.most_steps, *settings)
        extended = ca.vertcat(constants(p), *numbers, ca.DM(_unit_grid(grid)))
        known = ca.vertcat(p, clock)
        functions = EngineFunctions(run, ca.Function("parameters", [known], [extended]))
        counts = reported(library, start, length)
        return Engine(lambda: functions, points, problem.piecewise, counts, library)


@cached_per_thread(32)
def _library(
    method: type[_CasadiSolver], dae: Dae, inputs: InputSeries | None
) -> tuple[str, ca.Function]:
    """Return the path of the compiled method for a model, and its constants by parameters."""
    function, constants = prepared(dae)
    s, x, z, u, c = symbols_of(function)
    span = MX.sym("span", 6)  # start, length, tolerances, largest step, most steps
    t = span[0] + span[1] * s
    ode, alg = function(t, x, z, inputs_at(dae, inputs, t, u), c)
    known = ca.vertcat(c, span)
    symbols = [s, x, z, u, known]
    system = dict(zip(CALL, symbols, strict=True)) | {"ode": span[1] * ode, "alg": alg}
    original = ca.Function("driven", symbols, [system["ode"], alg])
    sizes = {"NX": x, "NZ": z, "NU": u, "NC": known}
    head = "".join(f"#define {name} {symbol.numel()}\n" for name, symbol in sizes.items())

    def generate() -> str:
        run = ca.integrator("stepper", method.name, system, 0.0, [0.0, 1.0], COMMON)
        generator = ca.CodeGenerator("code", {"with_header": False})
        add_integrator(generator, run)
        first = c.numel() + 2
        relative, absolute, largest, most = (f"arg[2][{first + i}]" for i in range(4))
        code = patched(str(generator.dump()), "smallest_step")
        code = patched(code, "run_time_tolerances", relative=relative, absolute=absolute)
        code = patched(code, "largest_step", largest=largest)
        code = patched(code, "most_steps", most=most)
        code = run_time_grid(watched(code), known.numel())
        for patch in method.own_patches:
            code = patched(code, patch)
        return f"{head}#define SETTINGS {_SETTINGS}\n{code}"

    key = cache_key(f"generated-13 {method.name}", original, repr(sorted(COMMON.items())).encode())
    return str(cached_library(key, generate, sources_beside(original))), constants


@dataclass(frozen=True, kw_only=True)
class Erk(_CasadiSolver):
    """Dormand and Prince's explicit pair of order 5(4), the method of MATLAB's ode45."""

    name = "erk"
    own_patches = ("in_one_piece",)


@dataclass(frozen=True, kw_only=True)
class Rosenbrock(_CasadiSolver):
    """An L-stable linearly implicit method, for stiff problems and DAEs."""

    name = "rosenbrock"
    own_patches = ("underflow",)
    solves_dae = True
    uses_jacobian = True


def _unit_grid(grid: Vector) -> Vector:
    unit = (grid - grid[0]) / (grid[-1] - grid[0])
    even: Vector = np.arange(len(grid)) / (len(grid) - 1)
    return even if np.allclose(unit, even, rtol=0, atol=1e-12) else unit
