"""Tables of curved functions of a state: their knots are found where the functions reach them."""

import casadi as ca
import numpy as np
import pytest

import cosim


def of_table(knots, values, argument, speed):
    """Return the integral y over a table of what moves at a speed."""
    table = ca.interpolant("table", "linear", [np.array(knots)], np.array(values))
    model = cosim.Model("curved", stop_time=7.0, output_interval=0.1)
    s, y = model.state("s", "1", 0.0, "place"), model.state("y", "s", 0.0, "integral")
    w, q = model.state("w", "1/s", speed, "speed"), model.state("q", "1", 1.0, "swings")
    r = model.state("r", "1/s", 0.0, "its rate")
    model.derivative(s, w)
    model.derivative(w, 0 if speed else -w)
    model.derivative(q, r)
    model.derivative(r, -400 * q)
    model.derivative(y, table(argument(s)))
    return model.freeze()


def test_a_narrow_table_of_a_bump_is_not_passed_over():
    knots, values = [0, 0.44, 0.4401, 0.4402, 0.6], [0, 0, 100, 0, 0]
    dae = of_table(knots, values, lambda s: ca.exp(-s * s), 10.0)
    s = np.sqrt(-np.log(np.linspace(0.44, 0.4402, 200_001)))[::-1]
    right = np.trapezoid(np.interp(np.exp(-s * s), knots, values), s) / 10
    run = cosim.simulate(dae, solver="dop853")
    assert run.final["y"] == pytest.approx(right, rel=1e-3)  # before: 0


@pytest.mark.parametrize("solver", ["rk4", "ode8"])
def test_a_curved_table_of_a_state_at_rest_has_a_result(solver):
    dae = of_table([-1, 0, 1, 2], [0, 1, 0, 1], lambda s: s * s / 50, 0.0)
    assert cosim.simulate(dae, solver=solver, step_size=0.1).final["y"] == pytest.approx(7)
