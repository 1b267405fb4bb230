"""Compiled solvers end steps at given times, between output times and next to each other."""

import numpy as np
import pytest
from casadi import SX

import cosim
from cosim.integrate.engine import Problem
from cosim.integrate.nominal import InitialState, scaled_call
from cosim.model.values import Values
from cosim.solvers import Dop853, Ode8, Rk4

EPS = np.finfo(float).eps


@pytest.mark.parametrize(
    "solver", [Dop853(relative_tolerance=1e-10), Rk4(step_size=0.01), Ode8(step_size=0.01)]
)
@pytest.mark.parametrize("grid", [[0, 1, 2, 4], [0, 1e-17, 4], [1, 1 + 4 * EPS, 4]])
def test_steps_end_at_times_that_only_rounding_separates(solver, grid):
    x = SX.sym("x", 2)
    dae = cosim.from_casadi({"x": x, "ode": SX(np.array([[0, 1], [-1, 0]])) @ x})
    ends = np.array([1.0, 1 + 4 * EPS, 1 + 20 * EPS, 2.5, 3 - 2 * EPS, 3.0])
    times = np.array(grid, dtype=float)
    start = np.array([np.sin(times[0]), np.cos(times[0])])
    values = Values(start, np.empty(0), np.empty(0))
    problem = Problem(dae, times.tobytes(), compiled=True, ends=ends.tobytes())
    reached = scaled_call(problem, solver, InitialState(start, np.empty(0), values))
    assert not reached.reason
    assert reached.states[0] == pytest.approx(np.sin(times), abs=1e-9)


def test_an_end_of_a_step_makes_a_kink_of_the_equations_known():
    """With it, the error control rejects no step."""
    t, x = SX.sym("t"), SX.sym("x")
    dae = cosim.from_casadi({"t": t, "x": x, "ode": 1e3 * (abs(t - np.pi) - t)})
    start = Values(np.zeros(1), np.empty(0), np.empty(0))
    calls = list[int]()
    for ends in ([], [np.pi]):
        times = np.array([0.0, 4.0]).tobytes()
        problem = Problem(dae, times, compiled=True, ends=np.array(ends).tobytes())
        begin = InitialState(start.x, np.empty(0), start)
        calls.append(scaled_call(problem, Dop853(), begin).counts.rhs_calls)
    assert calls[1] < calls[0]
