"""A step passes over no localized term: bumps of a road, tables, pulses of time."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from casadi import SX

import cosim
from casadi_models.dae.relations import called
from cosim.errors import Interrupted
from cosim.integrate.call import INTERRUPTED
from cosim.integrate.passed_over import attentive

PLACE, SPEED, HEIGHT = 50.3, 10.0, 0.05  # m, m/s, m
SHAPES = {  # of a variable of width 1, with its area
    "gauss": (lambda s: ca.exp(-(s**2)), np.sqrt(np.pi)),
    "lorentz": (lambda s: 1 / (1 + s**2) ** 4, 5 * np.pi / 16),
    "tanh": (lambda s: (ca.tanh(s + 1.5) - ca.tanh(s - 1.5)) / 2, 3.0),
}


def on_road(road, kind=SX, **more):
    """Return a mass on a spring and a damper over a road, at constant speed."""
    t, x = kind.sym("t"), kind.sym("x", 3)
    ode = ca.vertcat(SPEED, x[2], -25 * (x[1] - road(x[0])) - x[2])
    return cosim.from_casadi({"t": t, "x": x, "ode": ode}, name="road", stop_time=7, **more)


def after_an_impulse(area, place=PLACE):
    """Return the height at 7 s after a narrow bump, from the response to an impulse."""
    t, w = 7 - place / SPEED, np.sqrt(25 - 0.25)
    return 25 * area / SPEED * np.exp(-t / 2) * np.sin(w * t) / w


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("solver", ["dop853", "cvodes"])
@pytest.mark.parametrize("shape", SHAPES)
def test_a_bump_between_two_steps_is_not_passed_over(shape, solver):
    form, area = SHAPES[shape]
    width = 1e-3
    dae = on_road(lambda s: HEIGHT * form((s - PLACE) / width), output_interval=0.5)
    run = cosim.simulate(dae, solver=solver)
    right = after_an_impulse(HEIGHT * width * area)
    assert abs(run["x_2"][-1] / right - 1) < 1e-3  # measured 1e-6 to 1.5e-4; before: 1


@pytest.mark.parametrize("kind", ["linear", "bspline"])
def test_a_bump_of_a_table_is_not_passed_over(kind):
    knots = np.linspace(0, 200, 2001)
    heights = np.where((knots > 50.25) & (knots < 50.35), HEIGHT, 0.0)  # one knot: a hat
    table = ca.interpolant("road", kind, [knots], heights)
    run = cosim.simulate(on_road(table, ca.MX, output_interval=0.5), solver="dop853")
    right = after_an_impulse(HEIGHT * 0.1)
    assert abs(run["x_2"][-1] / right - 1) < 1e-2  # its width of 0.1 m; measured below


EXPANDED = {  # forms of -c**2, where c = (s - PLACE) / 1e-3, and its area in widths
    "square": (lambda s: -(s * s - 2 * PLACE * s + PLACE**2) / 1e-6, np.sqrt(np.pi)),
    "nested": (lambda s: -(s * (s - 2 * PLACE) + PLACE**2) / 1e-6, np.sqrt(np.pi)),
    "squared": (lambda s: -(((s * s - 2 * PLACE * s + PLACE**2) / 1e-6) ** 2), 1.8128049541),
}


@pytest.mark.slow_rows("cvodes")
@pytest.mark.parametrize("solver", ["dop853", "cvodes"])
@pytest.mark.parametrize("form", EXPANDED)
def test_a_bump_of_a_polynomial_that_is_multiplied_out_is_not_passed_over(form, solver):
    exponent, area = EXPANDED[form]
    dae = on_road(lambda s: HEIGHT * ca.exp(exponent(s)), output_interval=0.5)
    run = cosim.simulate(dae, solver=solver)
    right = after_an_impulse(HEIGHT * 1e-3 * area)
    assert abs(run["x_2"][-1] / right - 1) < 1e-3  # measured 2e-6; before: 1


def test_far_bumps_of_multiplied_out_polynomials_add():
    s, h = SX.sym("s"), SX.sym("h")
    bumps = (ca.exp(-(s * s - 2 * a * s + a * a) / 900) for a in (1e6, 1.5e6))
    laws = {"x": ca.vertcat(s, h), "ode": ca.vertcat(1e5, 1e3 * sum(bumps))}
    run = cosim.simulate(cosim.from_casadi(laws, stop_time=30, output_interval=3), solver="dop853")
    right = 2 * 30 * np.sqrt(np.pi) / 1e2
    assert run["h"][-1] == pytest.approx(right, rel=1e-5)  # measured 5e-7; before: 0


@pytest.mark.parametrize("shape", ["logistic", "cosh"])
def test_a_bump_whose_bounds_overflow_is_not_passed_over(shape):
    def road(s):
        if shape == "cosh":
            return HEIGHT / ca.cosh((s - PLACE) / 1e-2)
        edges = (1 / (1 + ca.exp((place - s) / 1e-5)) for place in (PLACE - 0.005, PLACE + 0.005))
        return HEIGHT * (next(edges) - next(edges))

    run = cosim.simulate(on_road(road, output_interval=0.5), solver="dop853")
    right = after_an_impulse(HEIGHT * 1e-2 * (np.pi if shape == "cosh" else 1))
    assert abs(run["x_2"][-1] / right - 1) < 1e-2


@pytest.mark.slow_rows("table")
@pytest.mark.parametrize("kind", ["table", "formula"])
def test_spikes_of_a_rest_between_are_not_passed_over(kind):
    places = np.arange(0.35, 70, 0.7)
    if kind == "table":
        knots = np.sort(np.concatenate([[0.0], *(places + d for d in (-0.005, 0, 0.005)), [100]]))
        heights = np.where(np.isin(knots, places), HEIGHT, 0.0)
        road, area = ca.interpolant("road", "linear", [knots], heights), HEIGHT * 0.005
    else:
        width = 3e-3

        def road(s):
            return HEIGHT * ca.exp(-((ca.sin(np.pi * (s - 0.35) / 0.7) / width) ** 2))

        area = HEIGHT * np.sqrt(np.pi) * width * 0.7 / np.pi
    kinds = ca.MX if kind == "table" else SX
    run = cosim.simulate(on_road(road, kinds, output_interval=0.5), solver="dop853")
    right = sum(after_an_impulse(area, place) for place in places)
    assert abs(run["x_2"][-1] / right - 1) < 1e-2


@pytest.mark.parametrize(("width", "bound"), [(1e-5, 1e-5), (1e-8, 2e-4)])  # times round to 1e-13 s
def test_a_pulse_of_time_that_samples_miss_is_integrated(width, bound):
    t, x = SX.sym("t"), SX.sym("x")
    ode = ca.exp(-(((t - 500.3) / width) ** 2)) / width
    dae = cosim.from_casadi({"t": t, "x": x, "ode": ode}, stop_time=1000, output_interval=20)
    run = cosim.simulate(dae, solver="dop853")
    assert abs(run["x"][-1] - np.sqrt(np.pi)) < bound


def test_two_bumps_in_one_step_are_both_seen():
    places = (50.3, 50.5)

    def road(s):
        return sum(HEIGHT * ca.exp(-(((s - place) / 1e-3) ** 2)) for place in places)

    run = cosim.simulate(on_road(road, output_interval=0.5), solver="dop853")
    right = sum(after_an_impulse(HEIGHT * 1e-3 * np.sqrt(np.pi), place) for place in places)
    assert abs(run["x_2"][-1] / right - 1) < 1e-4


@pytest.mark.slow_rows("dop853")
@pytest.mark.parametrize("solver", ["dop853", "cvodes", "erk"])
def test_a_bump_under_a_damper_is_seen_although_its_push_and_pull_cancel(solver):
    width, x = 1e-2, SX.sym("x", 3)
    c = (x[0] - PLACE) / width
    rising = SPEED * HEIGHT * -2 * c / width * ca.exp(-(c**2))  # of the ground, m/s
    laws = {"x": x, "ode": ca.vertcat(SPEED, x[2], -25 * x[1] - (x[2] - rising))}
    dae = cosim.from_casadi(laws, name="damper", stop_time=7, output_interval=0.5)
    run = cosim.simulate(dae, solver=solver)
    t, w = 7 - PLACE / SPEED, np.sqrt(25 - 0.25)
    area = HEIGHT * width * np.sqrt(np.pi) / SPEED
    right = area * np.exp(-t / 2) * (np.cos(w * t) - np.sin(w * t) / (2 * w))
    assert abs(run["x_2"][-1] / right - 1) < 1e-2  # before: 1


@pytest.mark.parametrize(("place", "share"), [(0.0, 0.5), (69.9, 1.0)])
def test_bumps_at_the_start_and_near_the_end_are_seen(place, share):
    dae = on_road(lambda s: HEIGHT * ca.exp(-(((s - place) / 1e-2) ** 2)), output_interval=0.5)
    run = cosim.simulate(dae, solver="dop853")
    right = share * after_an_impulse(HEIGHT * 1e-2 * np.sqrt(np.pi), place)
    assert abs(run["x_2"][-1] / right - 1) < 1e-2


def test_a_bump_on_the_way_there_and_back_is_seen_without_output_times():
    x, v, y = SX.sym("x"), SX.sym("v"), SX.sym("y")
    bump = ca.exp(-(((x - 0.5) / 1e-4) ** 2)) / 1e-4
    ode = ca.vertcat(v, -x, bump)
    states = {"x": ca.vertcat(x, v, y), "ode": ode}
    dae = cosim.from_casadi(states, {"v": 1.0}, stop_time=2 * np.pi)
    run = cosim.simulate(dae, solver="dop853", output_interval=2 * np.pi)
    right = 2 * np.sqrt(np.pi) / np.sqrt(1 - 0.5**2)  # twice, at a speed of cos(asin(1/2))
    assert abs(run["y"][-1] / right - 1) < 1e-5


def test_a_bump_within_a_mode_that_begins_at_an_event_is_seen():
    model = cosim.Model("gate", stop_time=7.0, output_interval=0.5)
    s, v = model.state("s", "m", 0.0, "way"), model.state("v", "1", 0.0, "effect")
    model.derivative(s, SPEED)
    bump = ca.exp(-(((s - PLACE) / 1e-3) ** 2))
    model.derivative(v, ca.if_else(s > 30, 1e3 * bump, 0))
    run = cosim.simulate(model.freeze(), solver="dop853")
    assert abs(run["v"][-1] / (np.sqrt(np.pi) / SPEED) - 1) < 1e-5


@pytest.mark.parametrize("above", [1.2, -0.3])  # its flank is touched, or its top is passed twice
def test_a_bump_where_a_state_turns_is_seen(above):
    x, v, y = SX.sym("x"), SX.sym("v"), SX.sym("y")
    width, top = 1.3e-4, 50.0
    bump = ca.exp(-(((x - top - above * width) / width) ** 2)) / np.sqrt(width)
    laws = {"x": ca.vertcat(x, v, y), "ode": ca.vertcat(v, -9, bump)}
    dae = cosim.from_casadi(laws, {"v": 30.0}, stop_time=6.5, output_interval=0.5)
    run = cosim.simulate(dae, solver="dop853")
    t = np.linspace(-40, 40, 100_001)  # in the time in which it falls by the width
    right = np.trapezoid(np.exp(-((t**2 + above) ** 2)), t) * np.sqrt(2 / 9)
    assert abs(run["y"][-1] / right - 1) < 1e-3  # before: 1


def test_a_term_that_grows_up_to_where_a_state_turns_is_seen():
    x, v, y = SX.sym("x"), SX.sym("v"), SX.sym("y")
    laws = {"x": ca.vertcat(x, v, y), "ode": ca.vertcat(v, -x, 300 * ca.exp(9e4 * (x - 1)))}
    dae = cosim.from_casadi(laws, {"v": 1.0}, stop_time=7, output_interval=0.5)
    run = cosim.simulate(dae, solver="dop853")
    assert run["y"][-1] == pytest.approx(np.sqrt(2 * np.pi), rel=1e-3)  # before: 0


@pytest.mark.slow_rows("dop853")
@pytest.mark.parametrize("solver", ["dop853", "cvodes"])
def test_a_bump_of_a_remainder_is_seen_in_each_period(solver):
    width, place = 1e-4, 0.43

    def road(s):
        return HEIGHT * ca.exp(-(((s - ca.floor(s) - place) / width) ** 2))

    run = cosim.simulate(on_road(road, output_interval=0.5), solver=solver, stop_time=1.5)
    t, w = 1.5 - (np.arange(15) + place) / SPEED, np.sqrt(25 - 0.25)
    area = HEIGHT * width * np.sqrt(np.pi)
    right = np.sum(25 * area / SPEED * np.exp(-t / 2) * np.sin(w * t) / w)
    assert abs(run["x_2"][-1] / right - 1) < 1e-3  # before: 0.1 to 0.2, in six times as long


def test_rows_that_let_a_solver_see_a_bump_are_in_the_motion():
    def road(s):
        return ca.if_else(s > 15, ca.exp(-(((s - place) / width) ** 2)) / width, 0)

    place, width = 58.0185, 5.16e-4
    run = cosim.simulate(on_road(road, output_interval=0.5), solver="cvodes")
    right = after_an_impulse(np.sqrt(np.pi), place)
    assert abs(run["x_2"][-1] / right - 1) < 1e-3  # before: 1


@pytest.mark.slow
def test_a_bump_that_shifts_those_after_it_is_seen_each_time():
    x, v = SX.sym("x"), SX.sym("v")
    width = 1.7e-3
    drag = 1e-2 / width * ca.exp(-(((x + 0.414) / width) ** 2))
    laws = {"x": ca.vertcat(x, v), "ode": ca.vertcat(v, -x - drag * v)}
    dae = cosim.from_casadi(laws, {"x": 1.0}, stop_time=12, output_interval=2)
    run = cosim.simulate(dae, solver="dop853")
    close = cosim.simulate(dae, solver="dop853", max_step=width / 20)
    assert abs(run["x"][-1] - close["x"][-1]) < 1e-5  # before: 0.009


def with_bump_in(role):
    """Return a model in which a bump of width 1 mm decides, and does nothing else."""
    model = cosim.Model("switch", stop_time=7.0, output_interval=0.5)
    s, y = model.state("s", "m", 0.0, "way"), model.state("y", "s", 0.0, "time since the bump")
    hits = model.discrete("hits", "1", 0, "hits")
    bump = ca.exp(-(((s - PLACE) / 1e-3) ** 2))
    model.derivative(s, SPEED)
    model.derivative(y, hits)
    model.output("bump", "1", bump, "bump")
    if role == "when":
        model.when(bump > 0.5, {hits: hits + 1}, name="hit")
    if role == "limit":
        model.limit(0.5 - bump, "the ground is flat")
    return model.freeze()


HIT = (PLACE - 1e-3 * np.sqrt(np.log(2))) / SPEED  # s


@pytest.mark.slow_rows("dop853")
@pytest.mark.parametrize("solver", ["dop853", "cvodes"])
def test_a_bump_in_a_condition_alone_is_seen(solver):
    run = cosim.simulate(with_bump_in("when"), solver=solver)
    assert run["y"][-1] == pytest.approx(7 - HIT, abs=1e-6)  # before: 0
    run = cosim.simulate(with_bump_in("stop"), solver=solver, stop_when="bump > 0.5")
    assert run.time[-1] == pytest.approx(HIT, abs=1e-6)  # before: 7
    run = cosim.simulate(with_bump_in("limit"), solver=solver)
    assert run.stats["invalid_from"] == pytest.approx(HIT, abs=1e-4)  # before: none


def test_a_term_that_every_step_sees_changes_no_bit():
    x, v = SX.sym("x"), SX.sym("v")
    ode = ca.vertcat(v, -9 * x - 0.3 * ca.tanh(v / 0.1))
    dae = cosim.from_casadi({"x": ca.vertcat(x, v), "ode": ode}, stop_time=2, output_interval=0.1)
    start = {"x": 0.4}
    plain = cosim.simulate(dae, solver="dop853", start_values=start)
    closer = cosim.simulate(dae, solver="dop853", start_values=start, output_interval=0.01)
    assert plain.stats["steps"] == closer.stats["steps"]
    assert not plain.stats.get("note")


@pytest.mark.parametrize("solver", ["idas", "rosenbrock"])
def test_a_bump_that_an_algebraic_unknown_follows_is_seen(solver):
    model = cosim.Model("ground", stop_time=7.0, output_interval=0.5)
    s, v = model.state("s", "m", 0.0, "way"), model.state("v", "m/s", 0.0, "speed")
    y = model.state("y", "m", 0.0, "height")
    ground = model.algebraic("ground", "m", 0.0, "height of the ground")
    model.derivative(s, SPEED)
    model.derivative(y, v)
    model.derivative(v, -25 * (y - ground) - v)
    model.equation(ground - HEIGHT * ca.exp(-(((s - PLACE) / 1e-3) ** 2)))
    run = cosim.simulate(model.freeze(), solver=solver)
    right = after_an_impulse(HEIGHT * 1e-3 * np.sqrt(np.pi))
    assert abs(run["y"][-1] / right - 1) < 1e-4  # measured 6e-6; before: 1


def moved_bump(**more):
    place, t, x = SX.sym("place"), SX.sym("t"), SX.sym("x", 3)
    bump = HEIGHT * ca.exp(-(((x[0] - place) / 1e-3) ** 2))
    ode = ca.vertcat(SPEED, x[2], -25 * (x[1] - bump) - x[2])
    laws = {"t": t, "x": x, "ode": ode, "p": place}
    return cosim.from_casadi(laws, {"place": PLACE}, name="moved", stop_time=7, **more)


@pytest.mark.slow
def test_many_runs_see_the_bump_of_each():
    places = np.array([PLACE, 33.3, 60.1])
    many = cosim.simulate_many(moved_bump(output_interval=0.5), {"place": places})
    area = HEIGHT * 1e-3 * np.sqrt(np.pi)
    right = [after_an_impulse(area, place) for place in places]
    np.testing.assert_allclose(many["x_2"][:, -1], right, rtol=1e-3)  # before: 0 in lanes


@pytest.mark.parametrize(("step", "noted"), [(0.1, True), (1e-5, False)])
def test_equal_steps_that_pass_over_a_bump_are_noted(step, noted):
    dae = moved_bump(output_interval=0.5)
    span = {"start_time": 0.0, "stop_time": 0.2}
    start = {"x_1": PLACE - 1}
    run = cosim.simulate(dae, solver="rk4", step_size=step, start_values=start, **span)
    assert ("a term of x_1 near 0.0996" in run.stats.get("note", "")) == noted


def test_an_integrator_warns_of_a_bump():
    with pytest.warns(UserWarning, match="a term of x_1 changes in a small part"):
        cosim.integrator(moved_bump(), [0.0, 7.0])


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("solver", ["dop853", "cvodes"])
@pytest.mark.parametrize("shape", ["gauss", "tanh"])
def test_a_bump_in_two_coordinates_is_seen(shape, solver):
    x, y, h, v = (SX.sym(name) for name in "xyhv")
    width, off = 1e-3, ca.vertcat(x - PLACE, y - 0.3 * PLACE)
    if shape == "gauss":
        ground, area = ca.exp(-ca.sumsqr(off / width)), np.sqrt(np.pi / (1 + 0.3**2))
    else:
        across = ca.sum1(off) / width
        ground = (ca.tanh(across + 1.5) - ca.tanh(across - 1.5)) / 2
        area = 3 / (1 + 0.3)
    ode = ca.vertcat(SPEED, 0.3 * SPEED, v, -25 * (h - HEIGHT * ground) - v)
    laws = {"x": ca.vertcat(x, y, h, v), "ode": ode}
    dae = cosim.from_casadi(laws, name="plane", stop_time=7, output_interval=0.5)
    run = cosim.simulate(dae, solver=solver)
    right = after_an_impulse(HEIGHT * width * area)
    assert abs(run["h"][-1] / right - 1) < 1e-3  # measured 3e-7 to 9e-5; before: 1


def test_a_table_of_two_states_is_named():
    knots, x = np.linspace(0, 100, 11), ca.MX.sym("x", 3)
    table = ca.interpolant("ground", "linear", [knots, knots], np.zeros(121))
    laws = {"x": x, "ode": ca.vertcat(1, 2, table(x[:2]))}
    dae = cosim.from_casadi(laws, name="ground", stop_time=1, output_interval=0.1)
    run = cosim.simulate(dae, solver="dop853")
    assert "may pass over changes of a term of x_1, x_2" in run.stats["note"]
    run = cosim.simulate(dae, solver="ode8")
    assert "a term of x_1, x_2; set a smaller step_size" in run.stats["note"]  # before: none


def test_info_names_the_terms_whose_changes_are_found():
    facts = cosim.info(moved_bump()).facts
    assert facts["changes of terms, found in steps"] == "of x_1"
    assert not any("changes of terms" in name for name in cosim.info("bicycle").facts)


def test_ctrl_c_in_a_further_run_ends_it(monkeypatch):
    dae = on_road(lambda s: HEIGHT * SHAPES["gauss"][0]((s - PLACE) / 1e-3), output_interval=0.5)
    count = last = 0

    def interrupted(attempt, *rest):
        def one(*times):
            nonlocal count
            count += 1
            motion = attempt(*times)
            return replace(motion, reason=INTERRUPTED) if count == last else motion

        return attentive(one, *rest)

    monkeypatch.setattr("cosim.integrate.events.attentive", interrupted)
    cosim.simulate(dae)
    assert count > 3
    for further in range(2, count + 1):
        count, last = 0, further
        with pytest.raises(Interrupted):  # before: a run that passes over the bump
            cosim.simulate(dae)


@pytest.mark.slow_rows("cvodes")
@pytest.mark.parametrize("solver", ["dop853", "cvodes"])
def test_a_bump_of_a_table_whose_argument_is_limited_is_seen(solver):
    knots = np.linspace(-1, 1, 401)
    heights = HEIGHT * np.exp(-((knots / 0.02) ** 2))
    table = ca.interpolant("bump", "linear", [knots], heights)
    dae = on_road(lambda s: table(ca.fmin(ca.fmax(s - PLACE, -1), 1)), ca.MX, output_interval=0.5)
    run = cosim.simulate(dae, solver=solver)
    right = after_an_impulse(np.trapezoid(heights, knots))
    assert abs(run["x_2"][-1] / right - 1) < 1e-2  # before: 1, with a note
    assert "note" not in run.stats


@pytest.mark.parametrize("form", [ca.log, ca.sin, lambda a: 1 / a])
def test_a_bump_in_a_sum_within_another_term_is_seen(form):
    s, y, width = SX.sym("s"), SX.sym("y"), 1e-2
    bump = ca.exp(-(((s - PLACE) / width) ** 2))
    change = (form(30 + s + bump) - form(30 + s)) / width
    laws = {"x": ca.vertcat(s, y), "ode": ca.vertcat(SPEED, change)}
    dae = cosim.from_casadi(laws, name="sum", stop_time=7, output_interval=0.5)
    run = cosim.simulate(dae, solver="dop853")
    at = np.linspace(PLACE - 10 * width, PLACE + 10 * width, 10_001)
    rates = np.array(ca.Function("rate", [s], [change])(at[None])).ravel()
    right = np.trapezoid(rates, at) / SPEED
    assert abs(run["y"][-1] / right - 1) < 1e-3  # before: 1 with the logarithm and the quotient


@pytest.mark.parametrize("mover", ["time", "s"])
def test_a_bump_shorter_than_rounding_is_noted(mover):
    t, s, y, width = SX.sym("t"), SX.sym("s"), SX.sym("y"), 1e-17
    bump = ca.exp(-((((t if mover == "time" else s) - 5.3) / width) ** 2)) / width
    laws = {"t": t, "x": ca.vertcat(s, y), "ode": ca.vertcat(1, bump)}
    dae = cosim.from_casadi(laws, name="short", stop_time=7, output_interval=0.5)
    run = cosim.simulate(dae, solver="dop853")
    assert f"a term of {mover} near 5.3 s, which is shorter than rounding" in run.stats["note"]


def test_a_pulse_is_seen_once_where_the_relative_tolerance_is_0():
    t, x = SX.sym("t"), SX.sym("x")
    system = {"t": t, "x": x, "ode": ca.exp(-(((t - 0.5) / 1e-3) ** 2)) - x}
    dae = cosim.from_casadi(system, stop_time=1.0, output_interval=0.5)
    run = cosim.simulate(dae, relative_tolerance=0.0, absolute_tolerance=1e-8)
    assert run.stats.get("note") is None
    right = 1e-3 * np.sqrt(np.pi) * np.exp(-0.5 + 1e-6 / 4)
    assert run["x"][-1] == pytest.approx(right, abs=1e-6)
    assert run.stats["steps"] < 2000


@pytest.mark.quick_share(0.5)
@pytest.mark.parametrize("solver", ["dop853", "cvodes"])
@pytest.mark.parametrize("several", [False, True])
def test_uneven_output_times_hide_no_bump_where_they_are_far_apart(several, solver):
    model = cosim.Model("swinging", stop_time=10.0)
    x, v = model.state("x", "1", 0.0, "place"), model.state("v", "1", 1.0, "speed")
    total, width = model.state("total", "1", 0.0, "integral over the bumps"), 1e-4
    model.derivative(x, v)
    model.derivative(v, -x)
    place = x + 1e-9 * x * v if several else x
    model.derivative(total, ca.exp(-(((place - 0.5) / width) ** 2)) / width)
    times = [*np.linspace(0, 0.1, 2000), 3 * np.pi]
    run = cosim.simulate(model.freeze(), output_times=times, solver=solver)
    passes = 4 * np.sqrt(np.pi) / np.cos(np.arcsin(0.5))  # at the speed there
    assert run["total"][-1] == pytest.approx(passes, rel=1e-4)  # measured 2e-6; before: 0


def test_a_result_without_entries_has_no_terms():
    x = SX.sym("x")
    function = ca.Function("function", [x], [SX(1, 0), x**2])
    assert [str(term) for term in called(function, [x])] == ["sq(x)"]


def test_a_table_that_relations_switch_is_no_term_that_moves():
    model = cosim.Model("switched", stop_time=2.0)
    x, v = model.state("x", "1", 0, "sum"), model.state("v", "1", -0.5, "what switches")
    table = ca.interpolant("table", "linear", [[0, 1, 2]], [1.0, 2.0, 4.0])
    model.derivative(v, 1)
    model.derivative(x, table(ca.if_else(v > 0, 1, 0)) + table(ca.if_else(v > 1, 1, 0)))
    run = cosim.simulate(model.freeze())
    assert run.final["x"] == pytest.approx(6)
    assert "note" not in run.stats


@pytest.mark.parametrize(("stop", "passes"), [(5.5, 2), (12, 4)])
def test_a_term_is_seen_wherever_a_state_turns_under_a_relation(stop, passes):
    x, w, y, k = SX.sym("x"), SX.sym("w"), SX.sym("y"), 1e6
    top = ca.exp(k * (ca.fabs(x) - 1)) * np.sqrt(k / (2 * np.pi))
    laws = {"x": ca.vertcat(x, w, y), "ode": ca.vertcat(w, -x, top)}
    dae = cosim.from_casadi(laws, {"w": 1.0}, name="turn", stop_time=stop, output_interval=0.5)
    run = cosim.simulate(dae, solver="dop853", relative_tolerance=1e-9)
    assert run.final["y"] == pytest.approx(passes, rel=1e-2)  # before: 1


@pytest.mark.parametrize("law", [lambda s: s != 0, lambda s: ca.logic_not(s == 0)])
def test_a_pulse_of_all_but_one_place_is_not_passed_over(law):
    model = cosim.Model("pulse", stop_time=7.0, output_interval=0.1)
    s, y = model.state("s", "1", 0.0, "place"), model.state("y", "s", 0.0, "integral")
    model.derivative(s, 1)
    model.derivative(y, ca.if_else(law(s), 1e5 * ca.exp(-(((s - 3.3) / 1e-5) ** 2)), 0))
    run = cosim.simulate(model.freeze(), solver="dop853")
    assert run.final["y"] == pytest.approx(np.sqrt(np.pi), rel=1e-4)  # before: 0
