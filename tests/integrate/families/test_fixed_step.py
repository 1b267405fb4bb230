"""Fixed-step methods as `tradeoff` reports them: observed order, largest stable step."""

from itertools import pairwise
from math import factorial

import numpy as np
import pytest
from helpers.extended import Long, final_state, has_extended_precision, right_hand_side
from helpers.oscillators import oscillator

import cosim
from casadi_models.dae import Model
from cosim.api import simulate
from cosim.codegen.runge_kutta.tableau import ODE8, RK4, Tableau, stability_function
from cosim.errors import SolverError
from cosim.integrate.families.fixed_step import Rk4
from cosim.integrate.integrator import start_vectors
from cosim.study.tradeoff.fixed_steps import (
    largest_stable_step,
    observed_order,
    stability_limit,
)
from cosim.verify.reference import reference

METHODS = {"rk4": RK4, "ode8": ODE8}
POUND_FOOT_SECOND = 1.3558179483314004  # ft.lbf.s/rad in N.m.s/rad


def scene(name, **changes):
    stop = changes.pop("stop_time", None)
    return cosim.requested(name, stop_time=stop, start_values=changes)


def decay(rate=50.0):
    """Return x' = -rate x."""
    model = Model("decay", stop_time=1.0)
    x = model.state("x", "1", 1.0, "what decays")
    model.derivative(x, -rate * x)
    return cosim.requested(model.freeze())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "solver", "order"),
    [
        ("double_pendulum/quaternion", "rk4", 4),  # measured 3.94
        ("double_pendulum/quaternion", "ode8", 8),  # measured 8.07
        ("double_pendulum/euler_313", "rk4", 4),  # measured 3.94
        ("double_pendulum/euler_313", "ode8", 8),  # measured 7.78
        ("disk_two_bars/reduced", "rk4", 4),  # measured 4.00
        ("bicycle/independent", "rk4", 4),  # measured 4.01
        ("bar_on_frame/reduced", "rk4", 4),  # measured 3.93
    ],
)
def test_error_falls_with_the_order_over_four_halvings(name, solver, order):
    found = observed_order(scene(name), reference(scene(name)), solver)
    assert found.expected == order
    assert found.halvings == 4
    assert found.observed == pytest.approx(order, abs=0.04 * order)
    assert found.steps[0] / found.steps[-1] == pytest.approx(16)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bicycle/independent", "disk_two_bars/reduced"])
def test_order_8_ends_at_rounding_after_three_halvings_where_steps_must_be_small(name):
    """From the stability limit to rounding there are no four halvings of order 8 or more."""
    found = observed_order(scene(name), reference(scene(name)), "ode8")
    assert found.halvings == 3
    assert 8 < found.observed < 10  # measured 9.3, 9.5


@pytest.mark.slow_rows("bicycle-5.0-30", "double_pendulum-5.0-64")
@pytest.mark.skipif(not has_extended_precision(), reason="long double has no more bits here")
@pytest.mark.parametrize(
    ("name", "stop", "steps"),
    [
        ("bar_on_frame", 5.0, 32),  # measured 8.13, 8.40, 7.94, 7.89
        ("bicycle", 5.0, 30),  # measured 9.62, 8.83, 8.43, 8.17
        ("disk_two_bars", 2.0, 16),  # measured 8.01, 8.36, 8.39, 8.21
        ("double_pendulum", 5.0, 64),  # measured 9.31, 7.80, 7.63, 7.94
    ],
)
def test_order_8_shows_over_four_halvings_where_rounding_is_small(name, stop, steps, tmp_path):
    """From each halving to the next, not as the slope of a fit."""
    dae = cosim.load(name)
    f, x = right_hand_side(dae, tmp_path), start_vectors(dae)["x0"].astype(Long)
    ends = [final_state(f, x, ODE8, stop, steps * 2**k) for k in range(6)]
    apart = [float(np.abs(b - a).max()) for a, b in pairwise(ends)]
    observed = [np.log2(a / b) for a, b in pairwise(apart)]
    assert len(observed) == 4
    assert min(observed) > 7.5
    assert observed[-1] == pytest.approx(8, abs=0.25)


@pytest.mark.parametrize(("stop", "interval"), [(1.0, 0.3), (10.0, 0.3), (10.0, 20.0)])
def test_order_shows_where_the_last_output_interval_is_shorter(stop, interval):
    spring = cosim.requested(oscillator().dae, stop_time=stop, output_interval=interval)
    found = observed_order(spring, reference(spring), "rk4")
    assert found.observed == pytest.approx(4, abs=0.1)  # measured 3.94, 4.02, 4.01


def test_wrong_coefficient_shows_as_a_lower_order(monkeypatch):
    wrong = Tableau(4, RK4.a, (*RK4.b[:2], RK4.b[2] + RK4.b[3], 0))
    monkeypatch.setattr(Rk4, "tableau", wrong)
    spring = cosim.requested(oscillator().dae)
    found = observed_order(spring, reference(spring), "rk4")
    assert found.observed == pytest.approx(1, abs=0.2)  # measured 1.0


def test_stability_functions_are_taylor_polynomials_up_to_the_order():
    for name, order in (("rk4", 4), ("ode8", 8)):
        coefficients = stability_function(METHODS[name]).coef[: order + 1]
        expected = [1 / factorial(k) for k in range(order + 1)]
        np.testing.assert_allclose(coefficients, expected, rtol=1e-11)  # measured 3e-13


@pytest.mark.parametrize(("mode", "limit"), [(-1, 2.78529), (-1e-9 + 1j, 8**0.5)])
def test_rk4_has_its_published_limits_on_the_real_and_the_imaginary_axis(mode, limit):
    polynomial = stability_function(RK4)
    assert largest_stable_step(polynomial, mode) == pytest.approx(limit, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("solver", METHODS)
def test_limit_of_a_decay_is_that_of_the_real_axis(solver):
    found = stability_limit(decay(), reference(decay()), solver)
    expected = largest_stable_step(stability_function(METHODS[solver]), -50.0)
    assert found.mode == -50
    assert found.predicted == pytest.approx(expected)
    assert found.measured == pytest.approx(expected, rel=1e-4)


@pytest.mark.slow
def test_limit_follows_the_time_series_of_an_input():
    """x' = -u x with u = 50, and 20 as its start value."""
    model = Model("driven", stop_time=1.0)
    x, u = model.state("x", "1", 1.0, "what decays"), model.input("u", "1/s", 20.0, "rate")
    model.derivative(x, -u * x)
    series = cosim.InputSeries(("u",), np.array([0.0, 1.0]), np.array([[50.0], [50.0]]))
    request = cosim.requested(model.freeze(), inputs=series)
    found = stability_limit(request, reference(request), "rk4")
    assert found.mode == -50
    expected = largest_stable_step(stability_function(RK4), -50.0)
    assert found.measured == pytest.approx(expected, rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("solver", METHODS)
@pytest.mark.parametrize(
    "model",
    [
        scene("bar_on_frame/reduced", b=2000 * POUND_FOOT_SECOND, stop_time=0.02),
        scene("bicycle/independent"),
        scene("disk_two_bars/reduced"),
    ],
    ids=lambda request: request.dae.name,
)
def test_runs_are_lost_beyond_the_predicted_step_and_not_before(model, solver):
    """Whole runs, not single modes: within 10 % on either side of what the eigenvalues say."""
    truth = reference(model)
    found = stability_limit(model, truth, solver)
    assert found.measured == pytest.approx(found.predicted, rel=1e-3)  # measured 2e-6

    def moves(step):
        """Return how much the states move in the last tenth of a long run."""
        dae, stop = model.configured(), 400 * step
        names = [v.name for v in dae.states if v.name.endswith("_dot")]
        try:
            run = simulate(dae, solver=solver, output_interval=step, stop_time=stop)
        except SolverError:
            return np.inf
        return max(np.ptp(run[name][-40:]) / run.column(name).nominal for name in names)

    assert moves(0.9 * found.predicted) < 1e-2
    assert moves(1.1 * found.predicted) > 1e-1


def test_motion_that_is_not_steady_has_no_limit():
    name = "double_pendulum/quaternion"
    assert stability_limit(scene(name), reference(scene(name)), "rk4") is None


def test_model_without_a_mode_that_decays_has_no_limit():
    name = "crank_shaft/driven"
    assert stability_limit(scene(name), reference(scene(name)), "rk4") is None
