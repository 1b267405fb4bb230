"""Small models with closed forms, for tests of integrators."""

from collections.abc import Callable
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_models.dae import Dae, Model
from cosim.integrate.solvers import SOLVERS

Vector = NDArray[np.float64]
K, X0, V0 = 4.0, 1.0, 0.5

ADAPTIVE = tuple(name for name, method in SOLVERS.items() if method.adaptive)
INTERPRETED = tuple(name for name, method in SOLVERS.items() if not method.compiled_only)
WAYS = tuple((name, False) for name in INTERPRETED) + tuple((name, True) for name in SOLVERS)


class Known(NamedTuple):
    """A model and its solution: time, push -> x, v."""

    dae: Dae
    solution: Callable[[Vector, float], tuple[Vector, Vector]]


def _solution(time: Vector, push: float = 0.0) -> tuple[Vector, Vector]:
    """Return the motion of x'' = -K x + sin(t) + push from X0, V0 at t = 0."""
    w, rest, drive = np.sqrt(K), push / K, 1 / (K - 1)
    a, b = X0 - rest, (V0 - drive) / w
    x = rest + drive * np.sin(time) + a * np.cos(w * time) + b * np.sin(w * time)
    v = drive * np.cos(time) + w * (b * np.cos(w * time) - a * np.sin(w * time))
    return x, v


def resting_spring() -> Dae:
    """Declare a damped spring at rest, over 500 output intervals; input: `force` over mass."""
    model = Model("resting_spring", stop_time=100.0)
    x, v = model.state("x", "m", 0.0, "place"), model.state("v", "m/s", 0.0, "speed")
    force = model.input("force", "m/s2", 0.0, "force over mass")
    model.derivative(x, v)
    model.derivative(v, force - x - 0.5 * v)
    return model.freeze()


def oscillator(*, algebraic: bool = False) -> Known:
    """Declare a driven oscillator, its acceleration an algebraic unknown where `algebraic`."""
    model = Model("oscillator", "algebraic" if algebraic else "explicit", stop_time=5.0)
    x = model.state("x", "m", X0, "place")
    v = model.state("v", "m/s", V0, "speed")
    k = model.parameter("k", "1", K, "stiffness over mass")
    push = model.input("push", "m/s2", 0.0, "push over mass")
    acceleration = ca.sin(model.t) + push - k * x
    if algebraic:
        a = model.algebraic("a", "m/s2", 0.0, "acceleration")
        model.equation(2 * a - 2 * acceleration)
        acceleration = a
    model.derivative(ca.vertcat(x, v), ca.vertcat(v, acceleration))
    model.output("energy", "J", (v**2 + k * x**2) / 2, "energy over mass")
    return Known(model.freeze(), _solution)


def blow_up() -> Dae:
    """Declare x' = x^2, x(0) = 1: the solution 1 / (1 - t) ends at t = 1."""
    model = Model("blow_up", stop_time=2.0)
    x = model.state("x", "1", 1.0, "x")
    calm = model.state("calm", "1", 1.0, "a state that stays")
    model.derivative(ca.vertcat(x, calm), ca.vertcat(x**2, 0))
    return model.freeze()


def emptying() -> Dae:
    """Declare h' = -sqrt(h) - 0.1, h(0) = 1: at h = 0 the right-hand side ends.

    With s = sqrt(h), dt = -2 s ds / (s + 0.1), so the end is at 2 (1 - 0.1 ln(1.1 / 0.1)) s.
    """
    model = Model("emptying", stop_time=2.0)
    h = model.state("h", "m", 1.0, "level")
    model.derivative(h, -ca.sqrt(h) - 0.1)
    return model.freeze()


def bad_output() -> Dae:
    """Declare x = 1 - t and the output sqrt(x), which ends at t = 1 while x goes on."""
    model = Model("bad_output", stop_time=2.0)
    x = model.state("x", "1", 1.0, "x")
    model.derivative(x, -1)
    model.output("root", "1", ca.sqrt(x), "its square root")
    return model.freeze()


def singular() -> Dae:
    """Declare x = 1 - t and the unknown z of x z = 1, singular at t = 1."""
    model = Model("singular", stop_time=2.0)
    x = model.state("x", "1", 1.0, "x")
    z = model.algebraic("z", "1", 1.0, "its inverse")
    model.derivative(x, -1)
    model.equation(x * z - 1)
    return model.freeze()


# Largest error over 5 s as a multiple of the tolerance per step; measured at 1e-4 to 1e-10:
# 9 to 66, 11 to 31, 1.5 to 31, 0.6 to 0.7, 0.9 to 1.4
MULTIPLE = {
    "cvodes": 150,
    "cvodes_adams": 100,
    "idas": 100,
    "erk": 2,
    "rosenbrock": 4,
    "dop853": 50,
}


def machine_code(solver):
    """Return the option to run without a compiler, where the solver can."""
    return {"compiled": solver not in INTERPRETED}


def error(run, solution, push=0.0):
    x, v = solution(run.time, push)
    return max(np.abs(run["x"] - x).max(), np.abs(run["v"] - v).max())
