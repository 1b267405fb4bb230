"""The integrators of road one by name, and their tolerances."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from casadi_models.dae import Dae
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.model.values import A_DAE, number


@dataclass(frozen=True)
class Method:
    """What is known of a solver.

    Attributes:
        plugin: CasADi's integrator; empty for our own methods.
        solves_dae: Whether it takes algebraic unknowns.
        adaptive: Whether it chooses its steps.
        options: Of the plugin.
    """

    plugin: str
    solves_dae: bool
    adaptive: bool = True
    options: Mapping[str, Any] = field(default_factory=dict)


_COMMON = {"show_eval_warnings": False, "max_num_steps": 100_000}  # steps per output interval
_ADAMS = {"linear_multistep_method": "adams", "nonlinear_solver_iteration": "functional"}
SOLVERS: dict[str, Method] = {
    "cvodes": Method("cvodes", False, options=_COMMON),
    "cvodes_adams": Method("cvodes", False, options=_COMMON | _ADAMS),
    "idas": Method("idas", True, options=_COMMON),
    "erk": Method("erk", False, options=_COMMON),
    "rosenbrock": Method("rosenbrock", True, options=_COMMON),
    "rk4": Method("", False, adaptive=False),
    "ode8": Method("", False, adaptive=False),
    "dop853": Method("", True),
}


@dataclass(frozen=True)
class Tolerance:
    """Error per step that an adaptive solver may make: relative, and absolute in SI units."""

    relative: float = 1e-8
    absolute: float | None = None

    def __post_init__(self) -> None:
        relative = number("solver", "relative_tolerance", self.relative)
        if relative != 0 and not 100 * np.finfo(float).eps <= relative <= 0.1:
            raise ParameterError(
                f"relative_tolerance = {relative:g} is not within 2.2e-14 ... 0.1; "
                "double precision carries no less, and more is no accuracy"
            )
        if self.absolute is not None and number("solver", "absolute_tolerance", self.absolute) < 0:
            raise ParameterError(
                f"absolute_tolerance = {self.absolute:g} is negative; give 0 or more"
            )
        if relative == 0 and not self.absolute:
            raise ParameterError("both tolerances are 0; give one of them a positive value")

    @property
    def pair(self) -> tuple[float, float]:
        """Relative and absolute; the absolute one is a hundredth of the relative by default."""
        return self.relative, 0.01 * self.relative if self.absolute is None else self.absolute


def method(dae: Dae, solver: str | None) -> tuple[str, Method]:
    """Return the solver's name and method: CVODES for an ODE, IDAS for a DAE when None.

    Raises:
        UnknownName: There is no such solver.
        UsageError: It cannot integrate algebraic unknowns, or this is no model.
    """
    if not isinstance(dae, Dae):
        raise UsageError.of_type("a solver", dae, A_DAE)
    default = "idas" if dae.algebraics else "cvodes"
    name = default if solver is None else solver
    if not isinstance(name, str) or name not in SOLVERS:
        raise UnknownName.among("cosim", "solver", name, SOLVERS)
    if dae.algebraics and not SOLVERS[name].solves_dae:
        able = " or ".join(key for key, value in SOLVERS.items() if value.solves_dae)
        raise UsageError(
            f"{dae.full_name} has algebraic unknowns, which {name} cannot integrate; use {able}"
        )
    return name, SOLVERS[name]
