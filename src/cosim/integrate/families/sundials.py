"""CVODES and IDAS of SUNDIALS, through CasADi.

Source  Hindmarsh et al., SUNDIALS, ACM TOMS 2005, doi:10.1145/1089014.1089020.
"""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

from cosim.arrays import Vector
from cosim.integrate.engine import Engine, Problem
from cosim.integrate.families.plugin import COMMON, plugin_engine, restarted_engine, tolerances
from cosim.model.solver import AdaptiveSolver

_SUNDIALS_COUNTERS = ("nsteps", "nfevals", "nlinsetups")
# CasADi's default "qr" gives NaN where an element of the Jacobian is as small as 1e-155
_COMMON = COMMON | {"linear_solver": "csparse"}


@dataclass(frozen=True, kw_only=True)
class Cvodes(AdaptiveSolver):
    """CVODES with backward differentiation formulas: the default solver for an ODE."""

    name = "cvodes"
    order = 5
    uses_jacobian = True
    plugin_options: ClassVar[dict[str, Any]] = {}

    def engine(self, problem: Problem) -> Engine:
        """Build the engine for a problem."""
        grid, options = problem.grid, _COMMON | tolerances(self) | self.plugin_options
        restarted = problem.piecewise and bool(problem.dae.inputs)
        # without a limit, steps shrink until h^2 underflows, and the results are wrong
        span = 1.0 if restarted else float(grid[-1] - grid[0])
        options["min_step_size"] = 1e-18 * span
        if restarted:
            return restarted_engine(problem, "cvodes", options)
        return plugin_engine(problem, "cvodes", options, _SUNDIALS_COUNTERS)


@dataclass(frozen=True, kw_only=True)
class CvodesAdams(Cvodes):
    """CVODES with the Adams method and functional iteration, for non-stiff problems."""

    name = "cvodes_adams"
    order = 12
    uses_jacobian = False
    plugin_options: ClassVar[dict[str, Any]] = {
        "linear_multistep_method": "adams",
        "nonlinear_solver_iteration": "functional",
    }


@dataclass(frozen=True, kw_only=True)
class Idas(AdaptiveSolver):
    """IDAS with backward differentiation formulas: the default solver for a DAE.

    Args:
        suppress_algebraic: Whether algebraic unknowns are excluded from the error control, which
            needs a third to a half of the steps and increases the error up to 30 times; see
            `integrate.fallbacks`.
    """

    name = "idas"
    order = 5
    solves_dae = True
    uses_jacobian = True
    suppress_algebraic: bool = False

    def engine(self, problem: Problem) -> Engine:
        """Build the engine for a problem."""
        options = _COMMON | tolerances(self) | {"suppress_algebraic": self.suppress_algebraic}
        if problem.piecewise and problem.dae.inputs:
            return restarted_engine(problem, "idas", options)

        def restart(slopes: Vector) -> Engine:
            # IDACalcIC fails at some initial values that are consistent already
            own = options | {"calc_ic": False, "init_xdot": slopes.tolist()}
            return plugin_engine(problem, "idas", own, _SUNDIALS_COUNTERS)

        first = plugin_engine(problem, "idas", options, _SUNDIALS_COUNTERS)
        return replace(first, restart=restart)
