"""How far solvers that know no events integrate before a run looks for events."""

import casadi as ca
import numpy as np
import pytest

import cosim
from cosim.errors import SolverError

SOLVERS = ["cvodes", "idas", "erk", "rosenbrock"]


def built(name, stop_time, rows, states, equations):
    """Return a model with states by initial values, and rates and events from a function."""
    model = cosim.Model(name, stop_time=stop_time, output_interval=stop_time / rows)
    symbols = [model.state(f"x{i}", "1", start, "state") for i, start in enumerate(states)]
    rates = equations(model, *symbols)
    model.derivative(ca.vertcat(*symbols), ca.vertcat(*rates))
    return model.freeze()


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(("stop_time", "rows"), [(1e3, 100), (1e4, 100), (10.0, 1)])
def test_fast_motion_beyond_an_event_is_not_followed(solver, stop_time, rows):
    speed, length = 1e6, 1e3

    def gate(_, s, w):
        inside = ca.logic_and(s > 0, s < length)
        return speed, ca.if_else(inside, ca.sin(np.pi * s / length), 0)

    run = cosim.simulate(built("gate", stop_time, rows, [0, 0], gate), solver=solver)
    exact = 2 * length / np.pi / speed
    assert abs(run.final["x1"] / exact - 1) < 1e-5  # measured 5e-6
    assert run.stats["steps"] < 10_000  # 2,400,000, or a failure, with rows alone


LAWS = {
    "log": (lambda _, x, y: (-1, ca.if_else(x > 0.1, ca.log(x), 0)), [1.03, 0], 1, -0.66929592),
    "pole": (lambda _, x, y: (-1, ca.if_else(x > 0.01, 1 / x, 0)), [1.03, 0], 1, np.log(103)),
    "square": (lambda _, x: (ca.if_else(x < 50, x * x, 0),), [1], 0, 50),
    "growth": (lambda _, x: (ca.if_else(x < 10, 1e4 * x, 0),), [1], 0, 10),
}


def again(model, x):
    model.when(x > 5, {x: 1}, name="again")
    return (x * x,)


LAWS["again"] = again, [1], 0, 1 / 0.6


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("rows", [1, 20, 200])
@pytest.mark.parametrize("law", LAWS)
def test_law_that_ends_soon_after_an_event_is_left_at_the_event(law, rows, solver):
    equations, states, i, exact = LAWS[law]
    run = cosim.simulate(built(law, 2.0, rows, states, equations), solver=solver)
    assert abs(run.final[f"x{i}"] - exact) < 1e-5  # measured 5e-6


@pytest.mark.parametrize("solver", ["cvodes", "erk", "rosenbrock"])
def test_true_singularity_is_told_as_before(solver):
    def pole(model, x):
        model.when(x < -1, {x: 0}, name="never")
        return (x * x,)

    cause = "error test failed|step size too small"
    with pytest.raises(SolverError, match=cause) as caught:
        cosim.simulate(built("pole", 2.0, 20, [1], pole), solver=solver)
    assert caught.value.partial.time[-1] >= 0.9


@pytest.mark.parametrize("solver", SOLVERS)
def test_steps_from_one_output_time_to_the_next_are_limited(solver):
    def fast(model, y, v):
        model.when(y > 2, {y: 0}, name="never")
        return 1e7 * v, -1e7 * y

    with pytest.raises(SolverError, match="too many steps"):
        cosim.simulate(built("fast", 2.0, 20, [1, 0], fast), solver=solver)


@pytest.mark.parametrize("solver", ["cvodes", "rosenbrock"])
def test_state_at_an_event_in_a_fast_change_is_that_of_a_run_up_to_it(solver):
    def relaxation(model, y, v):
        count = model.discrete("count", "1", 0, "zeros")
        model.when(y < 0, {count: count + 1}, name="down")
        model.when(y > 0, {count: count + 1}, name="up")
        return v, 1e4 * (1 - y * y) * v - y

    run = cosim.simulate(built("relaxation", 3e4, 50, [2, 0], relaxation), solver=solver)
    first, second, third = (event.time for event in run.events)
    assert abs((third - second) - (second - first)) < 0.1  # of 8069 s; measured 2e-3, before 81
    speeds = [abs(event.before["x1"]) for event in run.events]
    np.testing.assert_allclose(speeds, 6666.775, rtol=1e-5)  # before 4 % off
