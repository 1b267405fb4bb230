"""How to integrate, as values: `cosim.simulate(dae, solver=cosim.solvers.Ode8(step_size=1e-3))`."""

from cosim.integrate.casadi_rk import Erk, Rosenbrock
from cosim.integrate.explicit import Dop853
from cosim.integrate.fixed_step import Ode8, Rk4
from cosim.integrate.solver import Solver
from cosim.integrate.solvers import SOLVERS
from cosim.integrate.sundials import Cvodes, CvodesAdams, Idas

__all__ = [
    "SOLVERS",
    "Cvodes",
    "CvodesAdams",
    "Dop853",
    "Erk",
    "Idas",
    "Ode8",
    "Rk4",
    "Rosenbrock",
    "Solver",
]
