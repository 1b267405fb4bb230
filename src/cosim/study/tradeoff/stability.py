"""The largest stable step of the fixed-step methods: predicted from eigenvalues, and measured.

A step h turns a mode exp(lambda t) of the linearised system into a factor R(h lambda), R being the
stability function of the method: the polynomial 1 + sum of b A^(k-1) 1 z^k. The mode grows, though
the system damps it, as soon as |R| > 1 (Hairer & Wanner, Solving Ordinary Differential Equations
II, section IV.2).
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.polynomial import Polynomial

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.runge_kutta.tableau import Tableau, step_function
from cosim.integrate.families.fixed_step import tableau_of
from cosim.integrate.solvers import SOLVERS
from cosim.model.values import assign
from cosim.scene.scene import Scene
from cosim.verify.reference import Reference

_STEPS = 120  # over which a perturbation must not grow
_PERTURBATION = 1e-6  # of it, in nominal values
_CHANGE = 0.01  # of the eigenvalue over the last tenth of the run, in a steady motion


@dataclass(frozen=True)
class StabilityLimit:
    """The step at which a fixed-step method becomes unstable at the end of a run.

    Attributes:
        model: `MODEL/FORMULATION`.
        solver: The method.
        mode: Eigenvalue of the linearised system that sets the limit, 1/s.
        predicted: Step at which |R(h mode)| = 1, s.
        measured: Step at which a small perturbation of that mode stops to decay, s.
    """

    model: str
    solver: str
    mode: complex
    predicted: float
    measured: float

    def row(self) -> dict[str, Any]:
        """Return plain values, for tables."""
        return {
            "model": self.model,
            "solver": self.solver,
            "mode": f"{self.mode:.4g} 1/s",
            "predicted": self.predicted,
            "measured": self.measured,
            "deviation": f"{100 * (self.measured / self.predicted - 1):+.2f} %",
        }


def stability_limit(scene: Scene, truth: Reference, solver: str) -> StabilityLimit | None:
    """Predict and measure the largest stable step at the end of a run.

    Args:
        scene: A model without algebraic unknowns.
        truth: Its reference.
        solver: Name of one with fixed steps.

    Returns:
        None where no mode decays, or the motion has not become steady: there is no limit then.
    """
    dae = scene.configured()
    rhs = _right_hand_side(scene, dae)
    tableau = tableau_of(SOLVERS[solver])
    polynomial = stability_function(tableau)
    modes = []
    for row in np.linspace(0.9 * len(truth.run), len(truth.run) - 1, 5).astype(int):
        t = truth.run.time[row]
        x = np.array([truth.run[variable.name][row] for variable in dae.states])
        mode, vectors = _limiting_mode(rhs, t, x, polynomial)
        modes.append(mode)
    if not mode or max(abs(other - mode) for other in modes) > _CHANGE * abs(mode):
        return None
    predicted = largest_stable_step(polynomial, mode)
    step = step_function(rhs, tableau)
    nominal = np.array([variable.nominal for variable in dae.states])
    measured = _growth_step(step, t, x, vectors, nominal, predicted)
    return StabilityLimit(dae.full_name, solver, mode, predicted, measured)


def stability_function(tableau: Tableau) -> Polynomial:
    """Return R(z) of an explicit Runge-Kutta method."""
    n = len(tableau.b)
    a = np.zeros((n, n))
    for i, row in enumerate(tableau.a):
        a[i, : len(row)] = [float(weight) for weight in row]
    b, ones = np.array([float(weight) for weight in tableau.b]), np.ones(n)
    powers = [np.linalg.matrix_power(a, k) @ ones for k in range(n)]
    return Polynomial([1.0, *(b @ power for power in powers)])


def largest_stable_step(polynomial: Polynomial, mode: complex) -> float:
    """Return the smallest h > 0 at which |R(h mode)| = 1, for a mode that decays."""
    scale = np.linspace(0.01, 20.0, 2000) / abs(mode)
    grows = np.flatnonzero(np.abs(polynomial(scale * mode)) > 1)
    low, high = (scale[grows[0] - 1] if grows[0] else 0.0), scale[grows[0]]
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if abs(polynomial(middle * mode)) > 1 else (middle, high)
    return float(high)


def _right_hand_side(scene: Scene, dae: Dae) -> ca.Function:
    """Return `rhs(t, x, u, p) -> dx/dt` with the scene's numbers in it."""
    values = assign(dae)
    expression = ca.substitute(dae.ode, ca.vertcat(dae.u, dae.p), ca.DM([*values.u, *values.p]))
    none = ca.SX(0, 1)
    return ca.Function("rhs", [dae.t, dae.x, none, none], [expression], {"cse": True})


def _limiting_mode(
    rhs: ca.Function, t: float, x: Vector, polynomial: Polynomial
) -> tuple[complex, tuple[Vector, Vector]]:
    """Return the decaying eigenvalue that limits the step first, with its two eigenvectors."""
    symbol = ca.SX.sym("x", len(x))
    slope = ca.Function("slope", [symbol], [ca.jacobian(rhs(t, symbol, [], []), symbol)])
    matrix = np.array(slope(x))
    values, right = np.linalg.eig(matrix)
    left = np.linalg.pinv(right).conj().T
    decaying = [i for i, v in enumerate(values) if v.real < -1e-3 * abs(v) < 0]
    if not decaying:
        return 0j, (np.zeros(len(x)), np.zeros(len(x)))
    first = min(decaying, key=lambda i: largest_stable_step(polynomial, complex(values[i])))
    return complex(values[first]), (right[:, first], left[:, first])


def _growth_step(
    step: ca.Function,
    t: float,
    x: Vector,
    vectors: tuple[Vector, Vector],
    nominal: Vector,
    guess: float,
) -> float:
    """Return the step at which a perturbation of the mode grows, by bisection."""
    low, high = guess / 3, 5 * guess
    for _ in range(20):
        middle = (low * high) ** 0.5
        low, high = (
            (low, middle) if _grows(step, t, x, vectors, nominal, middle) else (middle, high)
        )
    return high


def _grows(
    step: ca.Function,
    t: float,
    x: Vector,
    vectors: tuple[Vector, Vector],
    nominal: Vector,
    h: float,
) -> bool:
    right, left = vectors
    shift = np.real(right)
    shift = shift * _PERTURBATION / np.max(np.abs(shift) / nominal)
    apart = []
    states = [x, x + shift]
    for i in range(_STEPS):
        states = [np.array(step(state, t + i * h, h, [], [])).ravel() for state in states]
        apart.append(abs(np.vdot(left, states[1] - states[0])))
    begin, end = max(apart[: _STEPS // 4]), max(apart[-_STEPS // 4 :])
    return not end < begin
