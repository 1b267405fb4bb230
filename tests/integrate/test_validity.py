"""Limits of validity: declared by a model, watched in a run, kept or dropped by a reduction."""

import casadi as ca
import numpy as np
import pytest

import cosim
from casadi_models.dae import Model
from cosim.errors import SolverError, UnknownName


def falling_ball(limit=True):
    """A ball that falls from 1 m; the ground is at height 0, where the model ends."""
    model = Model("ball", stop_time=1.0)
    height = model.state("height", "m", 1.0, "height above the ground")
    speed = model.state("speed", "m/s", 0.0, "speed upward")
    way = model.state("way", "m", 0.0, "way along the ground")
    model.derivative(height, speed)
    model.derivative(speed, -9.81)
    model.derivative(way, 1.0)
    if limit:
        model.limit(height, "the ball is above the ground")
    return model.freeze()


FALL = np.sqrt(2 / 9.81)  # s, from 1 m; 0.4515


def test_run_beyond_a_limit_says_when_and_why():
    run = cosim.simulate(falling_ball())
    assert run.complete
    assert run.stats["invalid"] == [
        "invalid from 0.451524 s: not fulfilled: the ball is above the ground"
    ]


def test_run_within_its_limits_says_nothing():
    run = cosim.simulate(falling_ball(), stop_time=0.45)
    assert "invalid" not in run.stats


def test_run_stops_at_a_limit_when_asked_and_keeps_what_is_valid():
    reason = r"the ball is above.*; on_invalid='warn' goes on"
    with pytest.raises(SolverError, match=reason) as caught:
        cosim.simulate(falling_ball(), on_invalid="stop")
    partial = caught.value.partial
    assert partial.time[-1] == pytest.approx(0.45)
    assert partial.time[-1] < FALL < partial.time[-1] + 0.01
    exact = 1 - 9.81 * partial.time**2 / 2
    np.testing.assert_allclose(partial["height"], exact, rtol=0, atol=1e-8)  # measured 2e-10


@pytest.mark.slow_rows("stop")
@pytest.mark.parametrize("on_invalid", ["stop", "ignore"])
def test_run_that_stops_at_a_limit_has_no_event_after_it(on_invalid):
    model = Model("clock", stop_time=1.0)
    x = model.state("x", "s", 0.0, "time that has passed")
    ticks = model.discrete("ticks", "1", 0, "number of ticks")
    model.derivative(x, 1.0)
    model.every(0.1, {ticks: ticks + 1}, offset=0.05, name="tick")
    model.stop(model.t > 0.8, "it is late")
    model.limit(0.32 - x, "it is early")
    if on_invalid == "stop":
        with pytest.raises(SolverError, match="not fulfilled: it is early") as caught:
            cosim.simulate(model.freeze(), on_invalid=on_invalid, record_events=True)
        run, ticks = caught.value.partial, 3
        assert run.time[-1] == pytest.approx(0.32)
    else:
        run, ticks = cosim.simulate(model.freeze(), on_invalid=on_invalid), 8
    assert [event.name for event in run.events if event.name == "tick"] == ticks * ["tick"]
    assert ("stop" in run.stats) == (on_invalid == "ignore")


def test_limit_is_dropped_with_the_states_that_it_needs():
    small = cosim.reduce(falling_ball(), ["way"])
    assert small.limits == ()
    assert any("the ball is above the ground" in line for line in small.report)
    assert len(cosim.reduce(falling_ball(), ["height"]).limits) == 1


def test_unknown_answer_is_refused():
    with pytest.raises(UnknownName, match="did you mean stop"):
        cosim.simulate(falling_ball(), on_invalid="stopp")


def test_limit_without_meaning_or_declared_twice_is_refused():
    model = Model("m")
    x = model.state("x", "m", 1.0, "x")
    with pytest.raises(ValueError, match="meaning"):
        model.limit(x, " ")
    model.limit(x, "x is positive")
    with pytest.raises(ValueError, match="twice"):
        model.limit(x, "x is positive")


@pytest.mark.slow_rows("ode8")
@pytest.mark.parametrize("solver", ["rk4", "ode8"])
def test_fixed_step_too_long_for_a_near_singularity_is_flagged(solver):
    dae = cosim.load("double_pendulum/euler_313_axial")
    regular = cosim.simulate(cosim.load("double_pendulum"), relative_tolerance=1e-10)
    run = cosim.simulate(dae, solver=solver)
    gap = np.abs(run["x_tip"] - regular["x_tip"]).max()
    assert gap > 1e-2  # m, wrong: measured 0.5 (rk4) and 0.02 (ode8)
    assert "is too long" in run.stats["invalid"][0]


@pytest.mark.parametrize("solver", ["rk4", "ode8"])
def test_fixed_step_that_resolves_the_motion_is_not_flagged(solver):
    run = cosim.simulate(cosim.load("double_pendulum"), solver=solver)
    assert "invalid" not in run.stats


STEERED = {"phi_dot": 0.0, "delta": np.radians(85), "delta_dot": 1.0, "thetaR_dot": -3.0}


@pytest.mark.slow_rows("book")
@pytest.mark.parametrize("formulation", ["independent", "book"])
def test_bicycle_of_three_speeds_stops_where_the_steer_angle_is_singular(formulation):
    dae = cosim.load(f"bicycle/{formulation}")
    start = {"phi": 1.4, "phi_dot": 3.0, "thetaR_dot": -10.0}
    run = cosim.simulate(dae, start_values=start, stop_time=0.5)
    assert any("the steer angle is singular here" in text for text in run.stats["invalid"])
    with pytest.raises(SolverError, match="the front wheel would lift off"):
        cosim.simulate(dae, start_values=start, stop_time=0.5, on_invalid="stop")


@pytest.mark.slow
def test_singular_steer_angle_is_not_a_limit_of_the_form_with_multipliers():
    dae = cosim.load("bicycle/multipliers")
    run = cosim.simulate(dae, start_values=STEERED, stop_time=0.1)
    assert np.degrees(run["delta"]).max() > 100
    assert not any("steer angle" in text for text in run.stats["invalid"])


@pytest.mark.slow
def test_wheel_that_the_ground_would_have_to_hold_down_is_reported():
    run = cosim.simulate(cosim.load("bicycle/multipliers"), start_values=STEERED, stop_time=0.1)
    lifted = run.time[np.argmax(run["fz_Q"] > 0)]
    text = f"invalid from {lifted:g} s: the front wheel would lift off"
    assert any(line.startswith(text) for line in run.stats["invalid"])


@pytest.mark.parametrize("solver", ["rk4", "ode8"])
def test_few_digits_of_fixed_steps_over_close_knots_are_noted(solver):
    """A road of long waves and roughness, with knots each 2 ms."""
    knots = np.arange(0, 80, 0.02)
    rough = np.random.default_rng(3).normal(0, 5e-4, len(knots))
    road = ca.interpolant("road", "linear", [knots], 1e-2 * np.sin(0.3 * knots) + rough)
    t, x = ca.MX.sym("t"), ca.MX.sym("x", 3)
    ode = ca.vertcat(10, x[2], -2500 * (x[1] - road(x[0])) - x[2])
    dae = cosim.from_casadi({"t": t, "x": x, "ode": ode}, name="rough", stop_time=2)
    exact = cosim.simulate(dae, relative_tolerance=1e-6)
    peak = np.abs(exact["x_2"]).max()
    noted = cosim.simulate(dae, solver=solver, step_size=0.01)
    assert np.abs(noted["x_2"] - exact["x_2"]).max() > 0.02 * peak
    note = str(noted.stats.get("note"))
    assert "of its largest value" in note or "is too long" in str(noted.stats.get("invalid"))
    assert "knots of a table of x_1" in note
    fine = cosim.simulate(dae, solver=solver, step_size=0.001)
    assert np.abs(fine["x_2"] - exact["x_2"]).max() < 0.01 * peak
    assert "note" not in fine.stats or not fine.stats["note"]


def test_fixed_steps_over_close_rows_of_an_input_are_noted():
    model = Model("driven", stop_time=2.0, output_interval=0.1)
    x, u = model.state("x", "1", 0.0, "x"), model.input("u", "1", 0.0, "u")
    model.derivative(x, (u - x) * 5)
    t = np.arange(0, 2.001, 0.002)
    rows = 1e-2 * np.random.default_rng(0).normal(0, 1, len(t))
    series = cosim.InputSeries(["u"], t, rows[:, None])
    run = cosim.simulate(model.freeze(), solver="rk4", step_size=0.01, inputs=series)
    assert "steps pass over rows of u" in run.stats["note"]


@pytest.mark.parametrize("events", [False, True])
def test_fixed_steps_beyond_the_limit_of_stability_end_the_run(events):
    model = Model("stiff", stop_time=10.0, output_interval=0.1)
    x = model.state("x", "1", 1.0, "x")
    model.derivative(x, -100 * x)
    if events:
        n = model.discrete("n", "1", 0.0, "n")
        model.every(1.0, {n: n + 1})
    with pytest.raises(SolverError, match=r"the step of 0\.1 s is too long") as caught:
        cosim.simulate(model.freeze(), solver="rk4", step_size=0.1)  # before: 1e246, complete
    assert caught.value.partial.time.tolist() == [0.0]
    assert cosim.simulate(model.freeze(), solver="rk4", step_size=0.01)["x"][-1] < 1e-9


def test_fixed_steps_whose_half_fails_end_the_run():
    """A pole at 0.075 m, between the stages of a step but at one of half the step."""
    model = Model("pole", stop_time=0.6, output_interval=0.3)
    s, x = model.state("s", "m", 0.0, "way"), model.state("x", "m", 0.0, "x")
    model.derivative(s, 1.0)
    model.derivative(x, 1e-3 / (s - 0.075))
    with pytest.raises(SolverError, match="too long: half of it fails"):  # before: complete
        cosim.simulate(model.freeze(), solver="rk4", step_size=0.3)


def test_fixed_steps_follow_what_grows():
    model = Model("growth", stop_time=30.0, output_interval=0.1)
    x = model.state("x", "1", 1.0, "x")
    model.derivative(x, x)
    run = cosim.simulate(model.freeze(), solver="ode8", step_size=0.01)
    assert run["x"][-1] == pytest.approx(np.exp(30), rel=1e-9)


@pytest.mark.parametrize("on_invalid", ["warn", "stop"])
def test_long_steps_after_the_end_of_a_run_are_no_result(on_invalid):
    """x, which grows, has few digits from 4 s on; y ends at 1.2 s."""
    model = Model("late", stop_time=4.0, output_interval=0.5)
    s, x = model.state("s", "1", 0.0, "s"), model.state("x", "1", 1.0, "x")
    model.derivative(s, 1.0)
    model.derivative(x, 3 * x)
    model.output("y", "1", ca.sqrt(1.2 - s), "y")
    options = {"solver": "rk4", "step_size": 0.01, "on_invalid": on_invalid}
    with pytest.raises(SolverError, match=r"y is not finite at 1\.5 s") as caught:
        cosim.simulate(model.freeze(), **options)
    assert caught.value.partial.time.tolist() == [0.0, 0.5, 1.0]  # before: up to 3.5 by "stop"
    assert not caught.value.partial.stats.invalid


def test_fixed_steps_of_which_half_would_be_too_many_are_run_without_a_check(monkeypatch):
    monkeypatch.setattr("cosim.integrate.families.fixed_step.MOST_UNROLLED_STEPS", 100)
    run = cosim.simulate("crank_shaft", solver="rk4", stop_time=0.9, step_size=0.01)
    assert run["phi"][-1] == pytest.approx(50 * 0.9 + 0.5 * 10 * 0.9**2)
    assert run.stats["note"].startswith("the error of its steps is not checked")
