"""Problem for every peer: right-hand side with numbers for all parameters, initial state, grid."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import walk
from entries import Vector

import cosim
from casadi_models.dae import Dae
from cosim.verify.reference import Reference, reference

STATES = 2000  # at which a right-hand side is evaluated
SEED = 20


@dataclass(frozen=True)
class Problem:
    """One model with its own numbers over its own span.

    Attributes:
        dae: The model.
        compared: Names of the states whose error is measured.
    """

    dae: Dae
    compared: tuple[str, ...]

    @cached_property
    def start(self) -> dict[str, Vector]:
        """Consistent start values `x0`, parameters `p`, inputs `u`."""
        return cosim.start_vectors(self.dae)

    @property
    def size(self) -> int:
        return len(self.start["x0"])

    @cached_property
    def grid(self) -> Vector:
        """Output times, s, (n,)."""
        return self.reference.run.time

    @cached_property
    def states(self) -> Vector:
        """States around the initial state, (STATES, nx)."""
        away = np.random.default_rng(SEED).uniform(-0.1, 0.1, (STATES, self.size))
        return self.start["x0"] + away

    @cached_property
    def rhs(self) -> ca.Function:
        """`rhs(t, x) -> dx/dt` of SX, parameters and inputs being numbers."""
        symbols = ca.vertcat(self.dae.p, self.dae.u)
        numbers = ca.SX(ca.DM(np.concatenate((self.start["p"], self.start["u"]))))
        ode = ca.densify(ca.substitute(self.dae.ode, symbols, numbers))
        return ca.Function("rhs", [self.dae.t, self.dae.x], [ode], {"cse": True})

    @cached_property
    def jacobian(self) -> ca.Function:
        """`jacobian(t, x)`: d rhs / dx, all entries row by row, (nx * nx,)."""
        t, x = self.dae.t, self.dae.x
        entries = ca.vec(ca.densify(ca.jacobian(self.rhs(t, x), x)).T)
        return ca.Function("jacobian", [t, x], [entries], {"cse": True})

    def python(self, meaning: Mapping[str, Any], name: str = "rhs") -> Callable[..., Any]:
        """Return the right-hand side, or its "jacobian", with a meaning for sin, cos, ..."""
        return walk.build(getattr(self, name), name, meaning)

    @cached_property
    def reference(self) -> Reference:
        """The reference run for all errors, with an estimate of its own error."""
        return reference(self.dae)

    def error(self, states: Vector) -> float:
        """Return the largest error of the compared states, (n, nx), over the grid."""
        if states.shape != (len(self.grid), self.size):
            return np.inf  # the solver stopped early
        names = [variable.name for variable in self.dae.states]
        return max(
            float(np.abs(states[:, names.index(name)] - self.reference.run[name]).max())
            for name in self.compared
        )


def bicycle() -> Problem:
    """The benchmark bicycle over 20 s; errors of its six angles."""
    angles = ("phi", "thetaR", "delta", "psi", "theta", "thetaF")
    return Problem(cosim.load("bicycle"), angles)


def pendulum() -> Problem:
    """The double pendulum in quaternions over 10 s; errors of the quaternions."""
    names = tuple(f"q{body}_{part}" for body in (1, 2) for part in "wxyz")
    return Problem(cosim.load("double_pendulum"), names)
