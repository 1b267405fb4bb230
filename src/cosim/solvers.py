"""Solvers as values: `cosim.simulate(dae, solver=cosim.solvers.Ode8(step_size=1e-3))`."""

from cosim.integrate.families.casadi_rk import Erk, Rosenbrock
from cosim.integrate.families.explicit import Dop853
from cosim.integrate.families.fixed_step import Ode8, Rk4
from cosim.integrate.families.sundials import Cvodes, CvodesAdams, Idas
from cosim.integrate.solvers import SOLVERS
from cosim.model.solver import Goal, Solver, Tolerance

__all__ = [
    "SOLVERS", "Cvodes", "CvodesAdams", "Dop853", "Erk", "Goal", "Idas", "Ode8", "Rk4",
    "Rosenbrock", "Solver", "Tolerance",
]  # fmt: skip
