"""Explicit Runge-Kutta methods with equal steps within each output interval."""

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np
from casadi import MX

from cosim.codegen.functions import inputs_at, prepared, symbols_of
from cosim.codegen.runge_kutta.explicit_library import fixed_step_method
from cosim.codegen.runge_kutta.tableau import ODE8, RK4, Tableau, step_function
from cosim.errors import ParameterError, UsageError
from cosim.integrate.engine import Counts, Engine, EngineFunctions, Problem
from cosim.integrate.families.explicit import explicit_engine
from cosim.model.solver import Solver
from cosim.model.values import number

MOST_UNROLLED_STEPS = 2_000_000  # CasADi unrolls interpreted steps


@dataclass(frozen=True, kw_only=True)
class FixedStep(Solver):
    """A method without error control.

    Args:
        step_size: Largest step, s; the output interval when None.

    Raises:
        ParameterError: The step size is not positive.
    """

    adaptive = False
    projects = True
    watches = True
    takes_times = True
    tableau: ClassVar[Tableau]
    step_size: float | None = None

    def __post_init__(self) -> None:
        if self.step_size is not None:
            number("solver", "step_size", self.step_size, positive=True)

    @property
    def settings(self) -> str:
        """Step size, for messages."""
        return f"step: {'output interval' if self.step_size is None else f'{self.step_size:g} s'}"

    def step(self, problem: Problem) -> float:
        """Return the largest step for a problem, s."""
        return float(np.diff(problem.grid).max()) if self.step_size is None else self.step_size

    def exceeds(self, problem: Problem) -> bool:
        """Return whether a problem takes more steps than one may have."""
        return float(np.ptp(problem.grid)) / self.step(problem) > MOST_UNROLLED_STEPS

    def engine(self, problem: Problem) -> Engine:
        """Build the engine for a problem."""
        largest = self.step(problem)
        if self.exceeds(problem):
            raise ParameterError(
                f"step_size = {largest:g} s makes more than {MOST_UNROLLED_STEPS:.0e} steps; "
                "give a larger one"
            )
        if not problem.compiled:
            return self._unrolled(problem, largest)
        method = fixed_step_method(self.tableau)
        return explicit_engine(problem, self.name, method, (0.0, 0.0, largest))

    def _unrolled(self, problem: Problem, largest: float) -> Engine:
        dae, grid = problem.dae, problem.grid
        intervals = np.diff(grid)
        parts = np.maximum(1, np.ceil(intervals / largest * (1 - 1e-12))).astype(int)
        full, constants = prepared(dae, sensitivities=problem.sensitivities)
        t, x, z, u, c = symbols_of(full)
        ode, _ = full(t, x, z, inputs_at(dae, problem.inputs, t, u), c)
        rhs = ca.Function("rhs", [t, x, u, c], [ode])
        step = step_function(rhs, self.tableau)
        sizes = np.repeat(intervals / parts, parts)
        within = np.arange(len(sizes)) - np.repeat(np.cumsum(parts) - parts, parts)
        begins = np.repeat(grid[:-1], parts) + within * sizes
        total = len(sizes)
        run = step.mapaccum("steps", total, {"base": 100}) if total > 1 else step
        x0, p = MX.sym("x0", dae.x.numel()), MX.sym("p", dae.p.numel())
        times, lengths = MX(ca.DM(begins).T), MX(ca.DM(sizes).T)
        clock = MX.sym("clock", 2 if problem.in_own_time else 0)
        if problem.in_own_time:
            begin, length = ca.vertsplit(clock)
            times, lengths = begin + length * times, length * lengths
        u0 = MX.sym("u", dae.u.numel(), len(grid) if problem.piecewise else 1)
        columns = np.repeat(np.arange(1, len(grid)) * problem.piecewise, parts)
        repeated = (u0[:, columns.tolist()], ca.repmat(constants(p), 1, total))
        states = run(x0, times, lengths, *repeated)
        at_output_times = (np.cumsum(parts) - 1).tolist()
        function = ca.Function(
            self.name,
            [x0, MX.sym("z0", 0), ca.vertcat(p, clock), u0],
            [ca.horzcat(x0, states[:, at_output_times]), MX(0, len(grid))],
            ["x0", "z0", "p", "u"],
            ["xf", "zf"],
        )
        counts = Counts(total, total * len(self.tableau.b), 0)
        functions = EngineFunctions(function)
        return Engine(lambda: functions, len(grid), problem.piecewise, lambda: counts)


@dataclass(frozen=True, kw_only=True)
class Rk4(FixedStep):
    """The classical method of order 4."""

    name = "rk4"
    order = RK4.order
    tableau = RK4


@dataclass(frozen=True, kw_only=True)
class Ode8(FixedStep):
    """Prince and Dormand's method of order 8 with 13 stages, the method of Simulink's ode8."""

    name = "ode8"
    order = ODE8.order
    tableau = ODE8


def tableau_of(solver: type[Solver]) -> Tableau:
    """Return the tableau of a fixed-step solver.

    Raises:
        UsageError: The solver has no fixed steps.
    """
    if not issubclass(solver, FixedStep):
        raise UsageError(f"{solver.name} chooses its own steps; use a solver with fixed steps")
    return solver.tableau
