"""What `when`, `every` and discrete variables do, against closed forms."""

import casadi as ca
import numpy as np
import pytest
from helpers import event_models
from helpers.event_models import FIXED, SOLVERS, simulate

import cosim
from casadi_models.dae import Model
from cosim.errors import SolverError


@pytest.mark.quick_rows("rk4")
@pytest.mark.parametrize("solver", ["dop853", "cvodes", "rk4"])
def test_relay_with_hysteresis_has_the_period_of_its_closed_form(solver):
    model = Model("relay", stop_time=10.0)
    x = model.state("x", "1", 0.0, "temperature")
    on = model.discrete("on", "1", 1.0, "heater")
    model.derivative(x, -x + 2 * on)
    model.when(x > 1.2, {on: 0}, name="off")
    model.when(x < 0.8, {on: 1}, name="on")
    run = simulate(model.freeze(), solver)
    first, down, up = np.log(2 / 0.8), np.log(1.2 / 0.8), np.log(1.2 / 0.8)
    exact = first + np.concatenate(([0.0], np.cumsum([down, up] * 20)))
    exact = exact[exact < 10]
    error = 1e-6 if solver == "cvodes" else 1e-8
    np.testing.assert_allclose([event.time for event in run.events], exact, atol=error)
    assert [event.name for event in run.events[:3]] == ["off", "on", "off"]


def test_sampled_controller_is_that_of_its_difference_equation():
    model = Model("sampled", stop_time=1.0, output_interval=0.05)
    x = model.state("x", "1", 1.0, "plant")
    u = model.discrete("u", "1", 0.0, "held control")
    model.derivative(x, u)
    model.every(0.1, {u: -4 * x}, name="sample")
    run = simulate(model.freeze())
    assert [event.time for event in run.events] == pytest.approx(0.1 * np.arange(11), abs=1e-15)
    exact = 0.6 ** np.arange(11)
    np.testing.assert_allclose(run["x"][::2], exact, rtol=1e-10)
    np.testing.assert_allclose(run["u"][::2], -4 * exact, rtol=1e-10)  # after the sample


@pytest.mark.slow
@pytest.mark.parametrize("solver", SOLVERS)
def test_states_faster_than_the_output_interval_meet_all_events(solver):
    """Discrete variables stay exact as well: `floor` of one shows an error of rounding."""
    interval = 1e-3 if solver in FIXED else 0.3
    model = Model("counted", stop_time=3.0, output_interval=interval)
    s, v = model.state("s", "m", 0.0, "place"), model.state("v", "m/s", 200.0, "speed")
    y = model.state("y", "1", 0.0, "integral of the count")
    n, k = model.discrete("n", "1", 0.0, "count"), model.discrete("k", "1", 0.0, "crossings")
    model.derivative(s, v)
    model.derivative(v, -(200.0**2) * s)
    model.derivative(y, ca.floor(n))
    model.every(0.5, {n: n + 1}, offset=0.5)
    model.when(s > 0.5, {k: k + 1})
    run = simulate(model.freeze(), solver, tolerance=1e-8)
    assert (run.final["n"], run.final["k"]) == (6, 96)
    assert run.final["y"] == pytest.approx(7.5, abs=1e-9)


@pytest.mark.parametrize("solver", ["dop853", "cvodes"])
def test_a_sample_that_rounding_puts_behind_the_end_happens_there(solver):
    run = simulate(event_models.late(), solver)
    assert (run.final["n"], run.final["x"]) == (16, 5)
    assert run.events[-1].time == 2.0


@pytest.mark.slow
def test_events_at_one_instant_use_the_values_before_it():
    model = Model("swap", stop_time=2.0)
    a, b = model.discrete("a", "1", 1.0, "a"), model.discrete("b", "1", 2.0, "b")
    x = model.state("x", "1", 0.0, "x")
    model.derivative(x, 1)
    model.when(x > 1, {a: b, b: a}, name="swap")
    model.when(a > 1.5, {x: 10 * x}, name="then")  # what an event makes true happens, too
    run = simulate(model.freeze())
    assert (run.final["a"], run.final["b"]) == (2.0, 1.0)
    assert [event.name for event in run.events] == ["swap", "then"]
    assert run.final["x"] == pytest.approx(11, rel=1e-12)


def test_messages_of_events_name_their_own_remedy():
    model = Model("conflict", stop_time=2.0)
    n = model.discrete("n", "1", 0.0, "n")
    model.when(model.t > 1, {n: 1}, name="a")
    model.when(model.t > 1, {n: 2}, name="b")
    with pytest.raises(SolverError, match=r"conditions that exclude each other$"):
        simulate(model.freeze())


def test_events_that_cause_each_other_without_end_are_reported():
    model = Model("flutter", stop_time=2.0)
    a = model.discrete("a", "1", 0.0, "a")
    model.when(ca.logic_and(model.t > 1, a < 0.5), {a: 1}, name="up")
    model.when(ca.logic_and(model.t > 1, a > 0.5), {a: 0}, name="down")
    with pytest.raises(SolverError, match=r"happens again and again at 1 s"):
        simulate(model.freeze())


def test_events_of_one_instant_all_happen_however_many_they_are():
    model, many = Model("crowd", stop_time=2.0), 300
    n = model.discrete("n", "1", 0.0, "n")
    for k in range(many):
        model.when(model.t > 1, {n: n + 1}, name=f"event {k}")
    run = simulate(model.freeze())
    assert run["n"][-1] == many == len(run.events)


def counter(order, name="counter"):
    """Return a count that begins with 7, with events of no and of one value in some order."""
    model = Model(name, stop_time=2.0, output_interval=0.5)
    x, n = model.state("x", "1", 0.0, "x"), model.discrete("n", "1", 7.0, "number")
    model.derivative(x, 1.0)
    declare = {
        "stop": lambda: model.stop(x > 9, "never"),
        "when": lambda: model.when(x > 0.5, {n: n + 1}, name="up"),
    }
    for event in order:
        declare[event]()
    model.output("place", "1", x, "x")
    return model.freeze()


@pytest.mark.quick_rows("order1")
@pytest.mark.parametrize("order", [("stop", "when"), ("when", "stop"), ("stop", "when", "stop")])
def test_order_of_declarations_changes_no_assignment(order):
    for solver in ("dop853", "cvodes"):
        assert simulate(counter(order), solver).final["n"] == 8
    parts = {"a": counter(order, "a"), "b": counter(("when",), "b"), "c": counter(order, "c")}
    run = simulate(cosim.couple(parts, {}).dae, "dop853")
    assert [run.final[f"{part}.n"] for part in parts] == [8, 8, 8]


@pytest.mark.parametrize("angle", np.linspace(0.1, 6, 25))
def test_rounding_of_large_terms_violates_no_constraint(angle):
    """A satellite at rest, 7000 km from the center, is given a speed along its circle."""
    length = 7e6
    model = Model("satellite", stop_time=0.5)
    x = model.state("x", "m", length * np.cos(angle), "position along x")
    y = model.state("y", "m", length * np.sin(angle), "position along y")
    u, v = model.state("u", "m/s", 0.0, "speed along x"), model.state("v", "m/s", 0.0, "along y")
    center = (u**2 + v**2) / length**2
    for state, rate in ((x, u), (y, v), (u, -center * x), (v, -center * y)):
        model.derivative(state, rate)
    model.invariant("length", ca.vertcat(x, y), x**2 + y**2 - length**2, "the distance")
    model.invariant("turning", ca.vertcat(u, v), x * u + y * v, "the direction")
    model.when(model.t >= 0.3, {u: -7000 * y / length, v: 7000 * x / length}, name="thrust")
    run = simulate(model.freeze())
    assert np.hypot(run.final["u"], run.final["v"]) == pytest.approx(7000, rel=1e-8)
