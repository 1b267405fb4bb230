"""Fixed-step methods: measured orders of convergence, and largest stable steps."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.polynomial import Polynomial

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.runge_kutta.tableau import stability_function, step_function
from cosim.errors import CosimError
from cosim.integrate.families.fixed_step import tableau_of
from cosim.integrate.initial_values import input_values
from cosim.integrate.run import run
from cosim.integrate.solvers import SOLVERS, requested_solver
from cosim.model.inputs import InputSeries
from cosim.model.request import RunRequest
from cosim.model.times import Times
from cosim.model.values import assign
from cosim.study.tradeoff.measurement import at_common_times
from cosim.verify.comparison import compare
from cosim.verify.reference import Reference

FITTED_HALVINGS = 4  # the order is fitted to the smallest steps that rounding does not affect
_MOST_HALVINGS = 14  # largest number of halvings
_MOST_STEPS = 200_000  # of a run; a step that needs more is not measured
_LARGEST = 0.05  # error in nominal values; larger ones are not in the asymptotic range
_OUTPUTS = 10


@dataclass(frozen=True)
class Order:
    """Observed order of a fixed-step method.

    Attributes:
        model: `MODEL/FORMULATION`.
        solver: The method.
        expected: Its order of consistency.
        observed: Slope of log error over log step; None with fewer than two halvings.
        halvings: Number of halvings in the fit; below 4 if fewer lie between the stability limit
            and rounding.
        steps: Steps of the fit, s, the largest first.
        errors: Largest global error of the states with each step, in nominal values.
    """

    model: str
    solver: str
    expected: int
    observed: float | None
    halvings: int
    steps: tuple[float, ...]
    errors: tuple[float, ...]

    def row(self) -> dict[str, Any]:
        """Return plain values, for tables."""
        ends = (0, -1) if self.steps else ()
        return {
            "model": self.model,
            "solver": self.solver,
            "order": self.expected,
            "observed": self.observed,
            "halvings": self.halvings,
            "steps": " ... ".join(f"{self.steps[i]:.3g}" for i in ends),
            "errors": " ... ".join(f"{self.errors[i]:.1e}" for i in ends),
        }


def observed_order(request: RunRequest, truth: Reference, solver: str) -> Order:
    """Halve the step of a fixed-step method until rounding dominates, and fit the order.

    The request is that of the reference, for a model without algebraic unknowns.
    """
    dae, (begin, end) = request.configured(), request.times.span(request.dae)
    names = [variable.name for variable in dae.states]
    interval = min(dae.experiment.output_interval, end - begin)
    intervals = int((end - begin) / interval * (1 + 1e-9))  # without a shorter last one
    end = min(end, begin + intervals * interval)
    outputs = next(n for n in range(_OUTPUTS, 0, -1) if intervals % n == 0)
    length = (end - begin) / outputs
    times = Times(begin, end, length)
    plain = RunRequest(dae, times=times, outputs=tuple(names), inputs=request.inputs)
    steps: list[float] = []
    errors: list[float] = []
    expected = SOLVERS[solver].order
    for halvings in range(_MOST_HALVINGS):
        step = length / 2**halvings
        if (end - begin) / step > _MOST_STEPS:
            break
        try:
            found = run(replace(plain, solver=requested_solver(dae, solver, step_size=step)))
        except CosimError:  # beyond the limit of stability
            continue
        exact, found = at_common_times(truth.run, found)
        error = compare(exact.select(names), found, by_nominal=True).worst.scaled
        if error > _LARGEST:
            steps, errors = [], []
            continue
        steps.append(step)
        errors.append(error)
        if error < 5 * truth.error(names) or _rounding(errors, expected):
            break
    fitted = slice(-FITTED_HALVINGS - 2, -1)
    lengths, apart = tuple(steps[fitted]), tuple(errors[fitted])
    halvings = max(0, len(lengths) - 1)
    slope = float(np.polyfit(np.log(lengths), np.log(apart), 1)[0]) if halvings > 1 else None
    return Order(dae.full_name, solver, expected, slope, halvings, lengths, apart)


def _rounding(errors: Sequence[float], order: int) -> bool:
    """Return whether the last halving gained far less than the order predicts."""
    return len(errors) > 1 and errors[-2] < errors[-1] * 2 ** (0.75 * order) and errors[-1] < 1e-8


_STEPS = 120  # number of steps over which a perturbation must not grow
_PERTURBATION = 1e-6  # in nominal values
_CHANGE = 0.01  # largest relative change of the eigenvalue in the last tenth of a steady run


@dataclass(frozen=True)
class StabilityLimit:
    """The step at which a fixed-step method becomes unstable at the end of a run.

    Attributes:
        model: `MODEL/FORMULATION`.
        solver: The method.
        mode: Eigenvalue of the linearized system that sets the limit, 1/s.
        predicted: Step at which |R(h mode)| = 1, s.
        measured: Step at which a small perturbation of that mode no longer decays, s.
    """

    model: str
    solver: str
    mode: complex
    predicted: float
    measured: float

    def row(self) -> dict[str, Any]:
        """Return plain values, for tables."""
        deviation = f"{100 * (self.measured / self.predicted - 1):+.2f} %"
        return vars(self) | {"mode": f"{self.mode:.4g} 1/s", "deviation": deviation}


def stability_limit(request: RunRequest, truth: Reference, solver: str) -> StabilityLimit | None:
    """Predict and measure the largest stable step at the end of a run; see `observed_order`.

    None if no mode decays or the motion does not become steady.
    """
    dae = request.configured()
    tableau = tableau_of(SOLVERS[solver])
    polynomial = stability_function(tableau)
    modes = []
    for row in np.linspace(0.9 * len(truth.run), len(truth.run) - 1, 5).astype(int):
        t = truth.run.time[row]
        x = np.array([truth.run[variable.name][row] for variable in dae.states])
        rhs = _right_hand_side(dae, t, request.inputs)
        mode, vectors = _limiting_mode(rhs, t, x, polynomial)
        modes.append(mode)
    if not mode or max(abs(other - mode) for other in modes) > _CHANGE * abs(mode):
        return None
    predicted = largest_stable_step(polynomial, mode)
    step = step_function(rhs, tableau)
    nominal = np.array([variable.nominal for variable in dae.states])
    measured = _growth_step(step, t, x, vectors, nominal, predicted)
    return StabilityLimit(dae.full_name, solver, mode, predicted, measured)


def largest_stable_step(polynomial: Polynomial, mode: complex) -> float:
    """Return the smallest h > 0 at which |R(h mode)| = 1, for a mode that decays."""
    scale = np.linspace(0.01, 20.0, 2000) / abs(mode)
    grows = np.flatnonzero(np.abs(polynomial(scale * mode)) > 1)
    low, high = (scale[grows[0] - 1] if grows[0] else 0.0), scale[grows[0]]
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if abs(polynomial(middle * mode)) > 1 else (middle, high)
    return float(high)


def _right_hand_side(dae: Dae, t: float, inputs: InputSeries | None) -> ca.Function:
    """Return `rhs(t, x, u, p) -> dx/dt` with the numbers of parameters and inputs inserted.

    Inputs keep their values at time t, s.
    """
    values = assign(dae)
    u = input_values(dae, np.array([t]), values, inputs)[:, 0]
    expression = ca.substitute(dae.ode, ca.vertcat(dae.u, dae.p), ca.DM([*u, *values.p]))
    none = ca.SX(0, 1)
    return ca.Function("rhs", [dae.t, dae.x, none, none], [expression], {"cse": True})


def _limiting_mode(
    rhs: ca.Function, t: float, x: Vector, polynomial: Polynomial
) -> tuple[complex, tuple[Vector, Vector]]:
    """Return the decaying eigenvalue that limits the step most, with its two eigenvectors."""
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
    predicted: float,
) -> float:
    """Return the step at which a perturbation of the mode grows, by bisection."""
    right, left = vectors
    shift = np.real(right)
    shift = shift * _PERTURBATION / np.max(np.abs(shift) / nominal)

    def grows(h: float) -> bool:
        apart = []
        states = [x, x + shift]
        for i in range(_STEPS):
            states = [np.array(step(state, t + i * h, h, [], [])).ravel() for state in states]
            apart.append(abs(np.vdot(left, states[1] - states[0])))
        begin, end = max(apart[: _STEPS // 4]), max(apart[-_STEPS // 4 :])
        return not end < begin

    low, high = predicted / 3, 5 * predicted
    for _ in range(20):
        middle = (low * high) ** 0.5
        low, high = (low, middle) if grows(middle) else (middle, high)
    return high
