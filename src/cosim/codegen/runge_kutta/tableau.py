"""Fixed-step Runge-Kutta methods as CasADi functions: `rk4` and the 8th-order `ode8`."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import casadi as ca
import numpy as np
from casadi import MX
from numpy.polynomial import Polynomial

F = Fraction
_ROUNDED = 1e-15  # published fractions are rounded to double precision


@dataclass(frozen=True)
class Tableau:
    """Butcher tableau of an explicit method.

    Attributes:
        order: Order of consistency.
        a: Weights of the earlier stages, a row for each stage.
        b: Weights of the stages in the step.
        nodes: Published nodes of the stages, as fractions of the step; empty if none are given.

    Raises:
        ValueError: A stage uses itself or a later one, or its weights do not add up to its node;
            or the weights of the step do not add up to 1.
    """

    order: int
    a: tuple[tuple[Fraction | int, ...], ...]
    b: tuple[Fraction | int, ...]
    nodes: tuple[Fraction | int, ...] = ()

    def __post_init__(self) -> None:
        if len(self.a) != len(self.b) or any(len(row) > i for i, row in enumerate(self.a)):
            raise ValueError(
                f"tableau of {len(self.a)} rows and {len(self.b)} weights: give a row for each "
                "stage, with weights of earlier stages only"
            )
        for i, (row, node) in enumerate(zip(self.a, self.nodes, strict=True) if self.nodes else ()):
            if abs(float(sum(row) - node)) > _ROUNDED:
                raise ValueError(
                    f"tableau: weights of stage {i + 1} add up to {float(sum(row))}, its node is "
                    f"{float(node)}; a weight is wrong"
                )
        if abs(float(sum(self.b) - 1)) > _ROUNDED:
            raise ValueError(
                f"tableau: weights of the step add up to {float(sum(self.b))}, not to 1; one is "
                "wrong"
            )

    @property
    def c(self) -> tuple[float, ...]:
        """Nodes: position of each stage in the step, (stages,)."""
        return tuple(float(sum(row)) for row in self.a)

    def change(self, slope: Callable[[MX, MX], MX], t: MX, x: MX, h: MX) -> MX:
        """Return the change of x over a step of length h that begins at t.

        Args:
            slope: Returns dx/dt at a time and a state.
        """
        slopes: list[MX] = []
        for node, row in zip(self.c, self.a, strict=True):
            slopes.append(slope(t + node * h, x + h * _weighted(row, slopes)))
        return h * _weighted(self.b, slopes)


DIVERGED = 1e3  # times that long steps make a state too large: none of its digits is right


def stability_function(tableau: Tableau) -> Polynomial:
    """Return R(z) of an explicit Runge-Kutta method."""
    n = len(tableau.b)
    a = np.zeros((n, n))
    for i, row in enumerate(tableau.a):
        a[i, : len(row)] = [float(weight) for weight in row]
    b, ones = np.array([float(weight) for weight in tableau.b]), np.ones(n)
    powers = [np.linalg.matrix_power(a, k) @ ones for k in range(n)]
    return Polynomial([1.0, *(b @ power for power in powers)])


RK4 = Tableau(
    4,
    ((), (F(1, 2),), (0, F(1, 2)), (0, 0, 1)),
    (F(1, 6), F(1, 3), F(1, 3), F(1, 6)),
    (0, F(1, 2), F(1, 2), 1),
)

_TABLE = json.loads(Path(__file__).with_name("ode8.json").read_text())


def _fractions(text: str) -> tuple[Fraction, ...]:
    return tuple(map(Fraction, text.split()))


# Prince & Dormand, High order embedded Runge-Kutta formulae, J. Comp. Appl. Math. 7 (1981):
# RK8(7)13M, the solution of order 8; MATLAB's and Simulink's ode8.
ODE8 = Tableau(
    8, tuple(map(_fractions, _TABLE["a"])), _fractions(_TABLE["b"]), _fractions(_TABLE["nodes"])
)


def step_function(rhs: ca.Function, tableau: Tableau) -> ca.Function:
    """Return `step(x, t, h, u, p) -> x_end`, one step of an explicit method.

    Args:
        rhs: The right-hand side `(t, x, u, p) -> dx/dt`.
    """
    t, h = MX.sym("t"), MX.sym("h")
    x, u, p = (MX.sym(name, rhs.numel_in(i)) for i, name in ((1, "x"), (2, "u"), (3, "p")))
    end = x + tableau.change(lambda time, state: rhs(time, state, u, p), t, x, h)
    return ca.Function("step", [x, t, h, u, p], [end], ["x", "t", "h", "u", "p"], ["x_end"])


def _weighted(weights: tuple[Fraction | int, ...], slopes: list[MX]) -> MX:
    total = MX(0)
    for weight, slope in zip(weights, slopes, strict=True):
        if weight:
            total = total + float(weight) * slope
    return total
