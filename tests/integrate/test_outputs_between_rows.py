"""Numbers of outputs on which no state depends: they miss no change between two steps."""

import casadi as ca
import numpy as np
import pytest
from casadi import SX

import cosim
from cosim.integrate import passed_over
from cosim.integrate.passed_over import with_switching

PLACE, SPEED, WIDTH = 3.217, 10.0, 1e-5
BUMP = np.sqrt(np.pi) * WIDTH  # its area
SHAPES = {  # of the distance from a place, in widths; with its mean over 1 s
    "gauss": (lambda c: ca.exp(-(c**2)), BUMP / SPEED),
    "slopes": (lambda c: (ca.tanh(c + 1.5) - ca.tanh(c - 1.5)) / 2, 3 * WIDTH / SPEED),
    "square": (lambda c: ca.if_else(ca.fabs(c) < 1, 1, 0), 2 * WIDTH / SPEED),
    "contact": (lambda c: ca.fmax(0, 1 - ca.fabs(c)), WIDTH / SPEED),
}


def moving(form, **more):
    """Return a model at constant speed with an output that changes near a place."""
    x, place = SX.sym("x"), SX.sym("place")
    laws, start = {"x": x, "ode": SPEED, "p": place}, {"place": PLACE}
    outputs = {"y": form((x - place) / WIDTH)}
    return cosim.from_casadi(
        laws, start, outputs=outputs, name="m", stop_time=1, output_interval=0.1, **more
    )


def numbers(run):
    found = run.select("y").curves
    return found.extremes.high[0], found.mean()[0]


@pytest.mark.quick_share(0.4)
@pytest.mark.parametrize("solver", ["dop853", "cvodes", "erk"])
@pytest.mark.parametrize("shape", SHAPES)
def test_a_change_of_an_output_alone_is_in_its_largest_value_and_mean(shape, solver):
    form, mean = SHAPES[shape]
    run = cosim.simulate(moving(form), solver=solver)
    peak = 1.0 if shape != "slopes" else np.tanh(1.5)
    assert numbers(run) == pytest.approx((peak, mean), rel=1e-4)  # 6e-8; before: 0, 0
    found = run.select("y").curves
    if shape != "square":
        half = found.first(0, peak / 2)
        assert abs(half - PLACE / SPEED) < 2 * WIDTH / SPEED  # before: NaN
    row = next(row for row in run.summary() if row["name"] == "y")
    assert row["max"] == pytest.approx(peak, rel=1e-4)
    assert row["max at [s]"] == pytest.approx(PLACE / SPEED, abs=2 * WIDTH / SPEED)


@pytest.mark.parametrize("kind", ["linear", "bspline"])
def test_a_table_as_an_output_has_all_its_rows(kind):
    knots = np.linspace(-10, 10, 20_001)  # of which one has a value
    table = ca.interpolant("table", kind, [knots], np.where(np.abs(knots - PLACE) < 1e-6, 1.0, 0.0))
    x, v = ca.MX.sym("x"), ca.MX.sym("v")
    laws = {"x": ca.vertcat(x, v), "ode": ca.vertcat(v, -x)}
    outputs = {"y": table(x)}
    dae = cosim.from_casadi(laws, {"v": 5.0}, outputs=outputs, stop_time=np.pi, output_interval=0.3)
    at = PLACE + 1e-3 * np.linspace(-20, 20, 80_001)
    seen = np.array(table(at[None])).ravel()
    area = np.trapezoid(seen / np.sqrt(25 - at**2), at)  # on the way there, and back
    found = numbers(cosim.simulate(dae, solver="dop853"))
    assert found == pytest.approx((seen.max(), 2 * area / np.pi), rel=1e-3)  # before: 0


def test_changes_with_time_an_input_or_an_unknown_are_found():
    model = cosim.Model("others", stop_time=1.0, output_interval=0.1)
    x, u = model.state("x", "1", 1.0, "state"), model.input("u", "1", 0.0, "input")
    z = model.algebraic("z", "1", 0.0, "unknown")
    model.derivative(x, -x)

    def form(quantity):
        return ca.exp(-(((quantity - PLACE) / WIDTH) ** 2))

    model.equation(z - form(10 * model.t))
    for name, y in {"of_time": form(10 * model.t), "of_input": form(u), "of_unknown": z}.items():
        model.output(name, "1", y, "bump")
    run = cosim.simulate(model.freeze(), solver="idas", inputs={"u": lambda t: 10 * t})
    found = run.select(["of_time", "of_input", "of_unknown", "z"]).curves
    np.testing.assert_allclose(found.extremes.high, 1, rtol=1e-6)
    np.testing.assert_allclose(found.mean(), BUMP / SPEED, rtol=1e-6)


def test_a_model_without_states_has_the_peaks_of_its_outputs():
    model = cosim.Model("pulse", stop_time=1.0, output_interval=0.1)
    model.output("y", "1", ca.exp(-(((model.t - 1e6 - 0.3217) / 1e-6) ** 2)), "pulse")
    run = cosim.simulate(model.freeze(), start_time=1e6, stop_time=1e6 + 1)
    # a width has 8,600 numbers at that time
    assert numbers(run) == pytest.approx((1, np.sqrt(np.pi) * 1e-6), rel=1e-4)


def test_a_short_push_and_pull_is_in_the_largest_speed():
    x, v = SX.sym("x"), SX.sym("v")
    c = (x - PLACE) / 1e-3
    laws = {"x": ca.vertcat(x, v), "ode": ca.vertcat(SPEED, -2e4 * c * ca.exp(-(c**2)))}
    dae = cosim.from_casadi(laws, stop_time=1, output_interval=0.1)
    found = cosim.simulate(dae, solver="dop853").select("v").curves
    assert found.extremes.high[0] == pytest.approx(1, rel=1e-5)  # before: 0


def test_many_runs_and_sweeps_find_the_peak_of_each(tmp_path):
    places = np.array([1.1, PLACE, 7.03, 20.0])  # the last one is not reached
    dae = moving(SHAPES["gauss"][0])
    many = cosim.simulate_many(dae, {"place": places}, outputs=["y"])
    found = dict(many.curves())
    high = [found[i].extremes.high[0] for i in range(4)]
    mean = [found[i].mean()[0] for i in range(4)]
    np.testing.assert_allclose(high, [1, 1, 1, 0], atol=1e-6)  # before: 0
    np.testing.assert_allclose(mean, np.array([1, 1, 1, 0]) * BUMP / SPEED, rtol=1e-6, atol=1e-300)


def test_outputs_change_no_step_and_smooth_ones_no_number():
    x, v = SX.sym("x"), SX.sym("v")
    laws = {"x": ca.vertcat(x, v), "ode": ca.vertcat(v, -9 * x)}
    start = {"x": 0.4}
    outputs = {"y": ca.exp(-(((x - 0.1) / 1e-4) ** 2)), "force": ca.fmax(0, x), "sum": x + v}
    plain = cosim.from_casadi(laws, start, outputs={"sum": x + v}, stop_time=2)
    more = cosim.from_casadi(laws, start, outputs=outputs, stop_time=2)
    runs = [cosim.simulate(dae, solver="dop853") for dae in (plain, more)]
    assert np.array_equal(runs[0]["x"], runs[1]["x"])
    assert runs[0].stats["steps"] == runs[1].stats["steps"]
    assert runs[0].changes is not None
    assert not len(runs[0].changes())


def test_a_model_whose_equations_have_the_conditions_of_its_outputs_stays_as_it_is():
    x = SX.sym("x")
    force = 1e3 * ca.fmax(0, -x)
    dae = cosim.from_casadi({"x": x, "ode": force - x}, outputs={"force": force})
    assert with_switching(dae, ("force",)) is dae


def test_outputs_that_call_several_functions_of_equal_sizes_have_events():
    x = ca.MX.sym("x")
    tables = [ca.interpolant(name, "linear", [[0.0, 10.0]], [0.0, 1.0]) for name in "ab"]
    outputs = {"y": ca.fmax(0, x - 0.505), "a": tables[0](x), "b": tables[1](x)}
    dae = cosim.from_casadi({"x": x, "ode": 1}, outputs=outputs, stop_time=1)
    assert with_switching(dae, ("y", "a", "b")).driving == ("y",)
    run = cosim.simulate(dae)
    assert run.changes is not None
    np.testing.assert_allclose(run.changes(), [0.505], rtol=1e-9)
    assert run.curves.extremes.high[3] == pytest.approx(0.1)


@pytest.mark.slow_rows("cvodes")
@pytest.mark.parametrize("solver", ["dop853", "cvodes"])
def test_conditions_that_switch_very_often_hide_no_bump(solver):
    model = cosim.Model("often", stop_time=10.0, output_interval=1.0)
    x = model.state("x", "1", 0.0, "state")
    model.derivative(x, 1)
    model.output("steps", "1", ca.floor(1000 * x), "counter")
    model.output("y", "1", ca.exp(-(((x - PLACE) / WIDTH) ** 2)), "bump")
    found = cosim.simulate(model.freeze(), solver=solver).curves
    np.testing.assert_allclose(found.extremes.high[1:], [1e4, 1], rtol=2e-4)
    np.testing.assert_allclose(found.mean()[1:], [4999.5, BUMP / 10], rtol=1e-3)


@pytest.mark.parametrize("most", [7, 8])
def test_so_many_changes_that_to_look_at_each_would_last_are_not_sought(most, monkeypatch):
    monkeypatch.setattr(passed_over, "_MOST_PLACES", most)
    model = cosim.Model("oscillator", stop_time=4 * np.pi, output_interval=0.5)
    x, v = model.state("x", "1", 1.0, "place"), model.state("v", "1/s", 0.0, "speed")
    model.derivative(x, v)
    model.derivative(v, -x)
    model.output("y", "1", ca.exp(-(((x - 0.3) / 1e-4) ** 2)), "bump, passed 4 times")
    model.output("z", "1", ca.exp(-(((x + 0.3) / 1e-4) ** 2)), "bump, passed 4 times")
    model.output("sign", "1", ca.sign(x), "which switches 4 times")
    run = cosim.simulate(model.freeze(), solver="dop853")
    assert run.changes is not None
    found = run.changes()
    if most == 8:
        assert len(found) > 4
        assert run.select(["y", "z"]).curves.extremes.high == pytest.approx(1)
    else:
        np.testing.assert_allclose(found, np.pi * (np.arange(4) + 0.5), rtol=1e-7)
