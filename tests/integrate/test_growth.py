"""A deviation from an unstable equilibrium grows, however far it is below the tolerance."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from casadi import SX
from helpers.wrapped import wrapped
from scipy.integrate import solve_ivp

import cosim
from cosim.errors import Interrupted
from cosim.integrate.call import INTERRUPTED
from cosim.integrate.ensemble.ensemble import RunState
from cosim.integrate.ensemble.lanes import in_lanes
from cosim.integrate.growth import followed_growth
from cosim.model.inputs import InputSeries
from cosim.text import Ending

PUSH, FALLEN = 1e-13, 3.96360057983538  # rad/s2; rad after 30 s, by steps of 1 ms
LONG = {"stop_time": 3000, "output_interval": 30}
RATE = 9.81  # 1/s2; of an upright pendulum


def pendulum(push=PUSH, place=0.0, stiffness=RATE, **options):
    x, v = SX.sym("x"), SX.sym("v")
    ode = ca.vertcat(v, stiffness * ca.sin(x - place) - 0.05 * v + push)
    options = {"stop_time": 30, "output_interval": 0.01} | options
    return cosim.from_casadi({"x": ca.vertcat(x, v), "ode": ode}, {}, name="pendulum", **options)


@pytest.mark.parametrize("solver", [None, "cvodes_adams", "dop853", "idas"])
def test_an_upright_pendulum_with_a_tiny_push_falls(solver):
    run = cosim.simulate(pendulum(), solver=solver)
    assert abs(run["x"][-1] - FALLEN) < 1e-4  # measured 1e-8 to 6e-6; before: 0 or 3.85
    assert "absolute_tolerance" in run.stats["note"]


def test_growth_that_no_relative_tolerance_follows_is_said():
    run = cosim.simulate(pendulum(), relative_tolerance=0, absolute_tolerance=1e-8)
    assert "it may be suppressed: it needs absolute_tolerance" in run.stats["note"]


@pytest.mark.parametrize("interval", [0.01, 5.0])
def test_growth_is_followed_with_an_absolute_tolerance_above_the_start(interval):
    x, y = SX.sym("x"), SX.sym("y")
    dae = cosim.from_casadi({"x": ca.vertcat(x, y), "ode": ca.vertcat(x, 1)}, {"x": 1e-12})
    options = {"stop_time": 30, "output_interval": interval, "absolute_tolerance": 1e-10}
    run = cosim.simulate(dae, **options)
    # measured 2e-5; before: 3e-15 and -5e-11, the latter without a note
    assert run["x"][-1] == pytest.approx(1e-12 * np.exp(30), rel=1e-3)
    assert "so that it is followed" in run.stats["note"]


@pytest.mark.slow  # their compilation
@pytest.mark.parametrize("solver", ["erk", "rosenbrock"])
def test_an_upright_pendulum_falls_with_compiled_solvers(solver):
    assert abs(cosim.simulate(pendulum(), solver=solver)["x"][-1] - FALLEN) < 1e-4


@pytest.mark.parametrize("solver", [None, "dop853"])
@pytest.mark.parametrize("times", [{"output_interval": 30}, LONG], ids=["two rows", "long"])
def test_growth_is_seen_without_close_output_times(solver, times):
    run = cosim.simulate(pendulum(**times), solver=solver)
    assert abs(np.interp(30, run.time, run["x"]) - FALLEN) < 1e-4  # before: 0 or 3.85


@pytest.mark.parametrize("times", [{}, {"output_interval": 30}, LONG], ids=["", "two rows", "long"])
def test_growth_is_seen_in_lanes(times):
    dae, others = pendulum(**times), {"x": [0.1, 0.0, 0.0, -0.2], "v": [0.0, 0.0, 0.3, 0.0]}
    many = cosim.simulate_many(dae, others)
    place = many.time.searchsorted(30)
    assert abs(many["x"][1, place] - FALLEN) < 1e-4  # before: 3.85
    moving = {name: np.delete(rows, 1) for name, rows in others.items()}
    np.testing.assert_array_equal(
        np.delete(many["x"], 1, axis=0), cosim.simulate_many(dae, moving)["x"]
    )


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize(
    ("master", "times"),
    [("fmpy", {}), ("fmpy", {"output_interval": 30}), ("fmpy", LONG), ("c", {})],
    ids=["rows", "two rows", "long", "c"],
)
def test_growth_is_seen_in_model_exchange(tmp_path, master, times):
    path = cosim.export_fmu(pendulum(**times), tmp_path / "pendulum.fmu")
    run = cosim.simulate_fmu(path, interface="ModelExchange", master=master)
    assert abs(np.interp(30, run.time, run["x"]) - FALLEN) < 1e-4  # before: 0, 2.86, 3.52
    assert "so that it is followed" in run.stats["note"]
    assert (f"up to {30:g} s" in run.stats["note"]) is (master == "c")  # throughout


def test_growth_that_cannot_be_followed_is_noted(tmp_path):
    path = cosim.export_fmu(pendulum(**LONG), tmp_path / "pendulum.fmu")
    run = cosim.simulate_fmu(path, interface="ModelExchange", master="c")
    assert "it may be suppressed: it needs absolute_tolerance" in run.stats["note"]


def test_ctrl_c_in_the_second_run_ends_it(monkeypatch):
    def interrupted(run, *rest):
        def again(closer):
            motion = run(closer)
            return replace(motion, reason=INTERRUPTED) if closer else motion

        return followed_growth(again, *rest)

    monkeypatch.setattr("cosim.integrate.events.followed_growth", interrupted)
    with pytest.raises(Interrupted):  # before: the first run
        cosim.simulate(pendulum())


def test_ctrl_c_in_lanes_begins_no_run_alone(monkeypatch):
    def interrupted(*values):
        found, growing, stuck = in_lanes(*values)
        assert len(growing)
        return replace(found, states=(RunState.INTERRUPTED,) * len(found)), growing, stuck

    monkeypatch.setattr("cosim.integrate.ensemble.simulate_many.in_lanes", interrupted)
    with pytest.raises(Interrupted, match="after 0 of 2 runs"):  # before: 1
        cosim.simulate_many(pendulum(), {"x": [0.1, 0.0]})


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("master", ["fmpy", "c"])
def test_a_line_that_leaves_the_range_of_a_function_ends_no_run(tmp_path, master, fmi):
    model = cosim.Model("tank", stop_time=1500.0, output_interval=1500.0)
    level = model.state("level", "m", 1.0, "level")
    model.derivative(level, -1e-3 * ca.sqrt(level))  # on a line, it is negative at the end
    path = cosim.export_fmu(model.freeze(), tmp_path / "tank.fmu", fmi=fmi)
    run = cosim.simulate_fmu(path, interface="ModelExchange", master=master)  # before: an error
    assert run["level"][-1] == pytest.approx(0.0625, rel=1e-3)


@pytest.mark.parametrize("master", ["fmpy", "c"])
def test_a_file_whose_time_does_not_go_back_runs(tmp_path, master):
    body = """static double last = -1; if (time < last - 2) return fmi2Error;
    last = time; return CALL;"""
    path = wrapped(tmp_path, {"fmi": 2}, pendulum(**LONG), fmi2SetTime=body)
    run = cosim.simulate_fmu(path, interface="ModelExchange", master=master, stop_time=30)
    assert run.complete


@pytest.mark.parametrize("trace", [1e-13, 1e-10, 1e-8])  # the absolute tolerance is 1e-10
@pytest.mark.parametrize("solver", [None, "dop853", "lanes"])
def test_logistic_growth_begins_from_a_trace(solver, trace):
    x = SX.sym("x")
    options = {"stop_time": 35, "output_interval": 1}
    dae = cosim.from_casadi({"x": x, "ode": x * (1 - x) + trace}, **options)
    if solver == "lanes":
        run = cosim.simulate_many(dae, {"x": [0.0, 0.0]}).run(0)
    else:
        run = cosim.simulate(dae, solver=solver)
    right = 1 / (1 + 1 / (trace * np.expm1(run.time[1:])))
    assert np.abs(run["x"][1:] - right).max() < 1e-6  # before: 0; 2e-4 to 0.1 from 1e-10 on


@pytest.mark.slow_rows("fmpy", "c", "cvodes")
@pytest.mark.parametrize("runner", ["cvodes", "dop853", "lanes", "fmpy", "c"])
def test_growth_that_the_relative_tolerance_hides_is_not_said_to_be_followed(runner, tmp_path):
    model = cosim.Model("far", stop_time=30.0, output_interval=0.3)
    x, v = model.state("x", "m", 1.0, "place"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(x, v)
    model.derivative(v, RATE * (x - 1) - 0.05 * v + PUSH)  # at the end, x is 1.6e26
    dae = model.freeze()
    if runner in ("fmpy", "c"):
        path = cosim.export_fmu(dae, tmp_path / "far.fmu")
        run = cosim.simulate_fmu(path, interface="ModelExchange", master=runner)
    elif runner == "lanes":
        many = cosim.simulate_many(dae, {"x": [1.0, 2.0]})
        run = many.run(0)  # before: without a note
        assert list(many.notes) == [0]
        assert "1 with a note, the first one: run 0: from 0 s on" in repr(many)
    else:
        run = cosim.simulate(dae, solver=runner)
    assert "it may be suppressed" in run.stats["note"]  # before: it is followed; 1, 1.8e18


@pytest.mark.parametrize("interval", [0.1, 30.0])
@pytest.mark.parametrize("solver", [None, "dop853"])
def test_growth_begins_where_an_input_begins_to_push(solver, interval):
    model = cosim.Model("pendulum", stop_time=30.0, output_interval=interval)
    x, v = model.state("x", "rad", 0.0, "angle"), model.state("v", "rad/s", 0.0, "speed")
    push = model.input("push", "rad/s2", 0.0, "push")
    model.derivative(x, v)
    model.derivative(v, RATE * ca.sin(x) - 0.05 * v + push)
    late = InputSeries(("push",), [0.0, 10.0, 10.0, 30.0], [[0.0], [0.0], [PUSH], [PUSH]])
    run = cosim.simulate(model.freeze(), solver=solver, inputs=late)
    right = cosim.simulate(pendulum(stop_time=20))["x"][-1]
    assert abs(run["x"][-1] - right) < 1e-4  # before: 0


def test_growth_of_what_an_algebraic_unknown_pushes_is_seen():
    model = cosim.Model("pendulum", stop_time=30.0, output_interval=0.1)
    x, v = model.state("x", "rad", 0.0, "angle"), model.state("v", "rad/s", 0.0, "speed")
    torque = model.algebraic("torque", "rad/s2", 0.0, "torque of gravity")
    model.equation(torque - RATE * ca.sin(x))
    model.derivative(x, v)
    model.derivative(v, torque - 0.05 * v + PUSH)
    assert abs(cosim.simulate(model.freeze())["x"][-1] - FALLEN) < 1e-3


def late_pendulum(interval, stiffness):
    x, v, t = SX.sym("x"), SX.sym("v"), SX.sym("t")
    ode = ca.vertcat(v, stiffness(t) * ca.sin(x) - 0.5 * v + PUSH)
    options = {"stop_time": 30, "output_interval": interval}
    return cosim.from_casadi(
        {"t": t, "x": ca.vertcat(x, v), "ode": ode}, {}, name="late", **options
    )


@pytest.mark.slow_rows("fmpy-30.0-on", "c-0.1-on", "fmpy-0.1-while", "c-30.0-while")
@pytest.mark.parametrize(
    ("stiffness", "right"),  # by SciPy's DOP853 at rtol 1e-12, steps of 0.075 s at most
    [(lambda t: t - 10, 2.7895859), (lambda t: 14 - 15 * ca.cos(np.pi * t / 15), 3.0170088)],
    ids=["on", "while"],
)
@pytest.mark.parametrize("interval", [0.1, 30.0])
@pytest.mark.parametrize("runner", ["cvodes", "dop853", "idas", "lanes", "fmpy", "c"])
def test_growth_that_begins_within_a_run_is_followed(interval, stiffness, right, runner, tmp_path):
    dae = late_pendulum(interval, stiffness)
    if runner in ("fmpy", "c"):
        path = cosim.export_fmu(dae, tmp_path / "late.fmu")
        run = cosim.simulate_fmu(path, interface="ModelExchange", master=runner)
    elif runner == "lanes":
        run = cosim.simulate_many(dae, {"x": [0.0, 1.0]}).run(0)
    else:
        run = cosim.simulate(dae, solver=runner)
    assert run["x"][-1] == pytest.approx(right, abs=1e-4)  # before: 3.25, 0.7


def test_growth_is_followed_where_a_long_step_finds_another_solution():
    x, rate, trace = SX.sym("x"), 1.1968390886918674, 2.3102238896052128e-11
    dae = cosim.from_casadi({"x": x, "ode": rate * x * (1 - x) + trace}, stop_time=40)
    run = cosim.simulate(dae, solver="cvodes", output_interval=20)  # before: x < 0, and an error
    right = 1 / (1 + 1 / (trace / rate * np.expm1(20 * rate)))
    np.testing.assert_allclose(run["x"], [0, right, 1], atol=1e-5)


def sampled_pendulum(period, **options):
    model = cosim.Model("pendulum", **options)
    x, v = model.state("x", "rad", 0.0, "angle"), model.state("v", "rad/s", 0.0, "speed")
    count = model.discrete("count", "1", 0, "samples")
    model.derivative(x, v)
    model.derivative(v, RATE * ca.sin(x) - 0.05 * v + PUSH)
    model.every(period, {count: count + 1})
    return model.freeze()


@pytest.mark.parametrize("period", [0.1, 1.0])
@pytest.mark.parametrize("runner", ["cvodes", "fmpy"])
def test_growth_over_samples_is_followed(runner, period, tmp_path):
    dae = sampled_pendulum(period, stop_time=30.0, output_interval=0.1)
    if runner == "cvodes":
        run = cosim.simulate(dae, solver=runner)
    else:
        path = cosim.export_fmu(dae, tmp_path / "pendulum.fmu")
        run = cosim.simulate_fmu(path, interface="ModelExchange")
    assert abs(run["x"][-1] - FALLEN) < 1e-4  # before: with fmpy 3.57, -1e-14
    assert "so that it is followed" in run.stats["note"]


@pytest.mark.parametrize("outputs", [["x"], ["count"]], ids=["angle", "count"])
@pytest.mark.parametrize("period", [2.9, 0.3], ids=["rare", "many"])
def test_growth_over_samples_is_seen_by_the_compiled_master(period, outputs, tmp_path):
    dae = sampled_pendulum(period, stop_time=600.0, output_interval=1.0)
    path = cosim.export_fmu(dae, tmp_path / "pendulum.fmu")
    run = cosim.simulate_fmu(path, interface="ModelExchange", master="c", outputs=outputs)
    if outputs == ["x"]:
        assert abs(run["x"][30] - FALLEN) < 1e-4  # rare samples, before: 5.0e-2
    assert "so that it is followed" in run.stats["note"]


@pytest.mark.parametrize(
    "dae",
    [lambda: late_pendulum(0.1, lambda t: 4 * ca.exp(-t) - 1), "disk_two_bars/multipliers"],
    ids=["growth ends", "hinges"],
)
def test_growth_that_ends_before_it_is_seen_is_no_note(dae):
    run = cosim.simulate(dae() if callable(dae) else dae)
    assert "grows by e" not in run.stats.get("note", "")


@pytest.mark.parametrize(
    "model",
    [
        {"push": 0.0},  # an equilibrium
        {"push": 0.0, "place": -np.pi},  # but for rounding
        {"stiffness": -RATE},  # a stable one
        {"stop_time": 1.0},  # too short to become visible
        {"push": 0.3},  # a push that every step sees
    ],
)
def test_where_nothing_grows_unseen_a_run_is_as_before(model, monkeypatch):
    dae = pendulum(**model)
    run = cosim.simulate(dae)
    monkeypatch.setattr("cosim.integrate.events.followed_growth", lambda run, *_: run(None))
    before = cosim.simulate(dae)
    assert run.stats["steps"] == before.stats["steps"]
    assert run.stats.get("note") == before.stats.get("note")
    np.testing.assert_array_equal(run["x"], before["x"])


@pytest.mark.parametrize("push", [0.0, 1e-10])
@pytest.mark.parametrize("solver", ["cvodes", "dop853", "idas"])
def test_growth_is_seen_while_other_states_move(solver, push):
    """The bar stands across a frame that turns ever faster; its angle grows by e in 0.16 s."""
    values = {"theta": np.pi / 2, "theta_dot": 0.0, "b": 0.0, "T2": push}
    run = cosim.simulate("bar_on_frame/reduced", solver=solver, start_values=values, stop_time=3.0)
    if push:
        assert run.final["theta"] == pytest.approx(2.1660655, abs=1e-4)  # before: pi / 2
    note = "so that it is followed" if push else "at an unstable equilibrium but for rounding"
    assert note in run.stats["note"]


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["idas", "rosenbrock"])
def test_rounding_that_leaves_an_unstable_equilibrium_is_said(solver):
    """With `rosenbrock`, the angle leaves it by 0.017; the exact one by 4e-7."""
    values = {"theta": np.pi / 2, "theta_dot": 0.0, "b": 0.0}
    run = cosim.simulate("bar_on_frame/two_body", solver=solver, start_values=values, stop_time=3)
    assert "at an unstable equilibrium but for rounding" in run.stats["note"]


@pytest.mark.parametrize(("begin", "end", "right"), [(1, 2.2, 1.9737e-3), (8, 9.5, 4.8923)])
def test_growth_in_a_window_of_the_way_is_followed(begin, end, right):
    s, x, v = (SX.sym(name) for name in "sxv")
    stiffness = 200 * (ca.tanh((s - begin) / 0.2) - ca.tanh((s - end) / 0.2)) - 1
    laws = {"x": ca.vertcat(s, x, v), "ode": ca.vertcat(1, v, stiffness * x - 0.5 * v + 1e-14)}
    run = cosim.simulate(cosim.from_casadi(laws, stop_time=10, output_interval=0.1))
    assert run.final["x"] == pytest.approx(right, rel=1e-4)  # by scipy with steps of 20 ms


def after_event(kind):
    """Logistic growth, or an upright pendulum, from what an event does after 5 s."""
    times = {"stop_time": 60.0, "output_interval": 60.0 if kind == "ignition" else 0.5}
    model = cosim.Model(kind, **times)
    x = model.state("x", "1", 0.0, "amount")
    if kind == "kick":
        v, count = model.state("v", "1/s", 0.0, "rate"), model.discrete("count", "1", 0, "samples")
        model.derivative(x, v)
        model.derivative(v, ca.sin(x) - 0.1 * v)
        model.every(0.25, {count: count + 1})
        model.when(model.t > 5.1, {v: v + 1e-13}, name="kick")
        return model.freeze()
    trace = {"seed": 0.0, "again": 1e-12, "ignition": ca.if_else(model.t > 5, 1e-12, 0)}[kind]
    model.derivative(x, x * (1 - x) + trace)
    if kind == "seed":
        model.when(model.t > 5, {x: 1e-12}, name="seed")
    elif kind == "again":
        model.when(model.t > 35, {x: 1e-14}, name="washed out")
    return model.freeze()


def grown_after_event(kind, t):
    if kind == "kick":
        fall = solve_ivp(
            lambda _, x: [x[1], np.sin(x[0]) - 0.1 * x[1]],
            (5.1, 60.0),
            [0.0, 1e-13],
            method="DOP853",
            t_eval=t[t > 5.1],
            rtol=1e-12,
            atol=1e-30,
        )
        return np.append(0 * t[t <= 5.1], fall.y[0])
    start, trace, begin = {
        "seed": (1e-12, 0, 5),
        "again": (1e-14, 1e-12, 35),
        "ignition": (0, 1e-12, 5),
    }[kind]
    amount = (start + trace) * np.exp(np.fmax(t - begin, 0)) - trace
    first = trace * np.expm1(t) if kind == "again" else 0 * t
    amount = np.where(t < begin, first, amount)
    return amount / (1 + amount)


@pytest.mark.parametrize("kind", ["seed", "again", "kick", "ignition"])
@pytest.mark.parametrize("runner", ["cvodes", "dop853", "idas", "fmpy", "c"])
def test_growth_that_begins_at_an_event_is_followed(kind, runner, tmp_path):
    dae = after_event(kind)
    if runner in ("fmpy", "c"):
        path = cosim.export_fmu(dae, tmp_path / f"{kind}.fmu")
        run = cosim.simulate_fmu(path, interface="ModelExchange", master=runner)
    else:
        run = cosim.simulate(dae, solver=runner)
    np.testing.assert_allclose(run["x"], grown_after_event(kind, run.time), rtol=0, atol=1e-4)


def test_what_moves_at_once_is_no_deviation():
    """Its modes of contact push the wheels, which sink at once; the bicycle does not lean."""
    run = cosim.simulate("examples/bicycle_jump.py:build", solver="dop853", stop_time=0.4)
    assert "grows by e" not in run.stats.get("note", "")  # before: contactA, 0.021


def test_growth_that_is_followed_to_the_end_is_said_without_a_time():
    model = cosim.Model("washed_out", stop_time=65.0, output_interval=1.0)
    x = model.state("x", "1", 0.0, "amount")
    model.derivative(x, x * (1 - x) + 1e-12)
    model.when(model.t > 40, {x: 1e-14}, name="washed out")
    run = cosim.simulate(model.freeze(), solver="cvodes")
    amount = 1.01e-12 * np.exp(25) - 1e-12
    assert run.final["x"] == pytest.approx(amount / (1 + amount), rel=1e-5)
    assert "so that it is followed" in run.stats["note"]
    assert "inf" not in run.stats["note"]


def test_chance_after_growth_that_is_followed_is_said():
    model = cosim.Model("upright_again", stop_time=120.0, output_interval=0.5)
    x, v = model.state("x", "rad", 0.0, "angle"), model.state("v", "rad/s", 0.0, "rate")
    model.derivative(x, v)
    model.derivative(v, ca.sin(x) - 0.1 * v + ca.if_else(model.t < 40, 1e-13, 0))
    model.when(model.t > 60, {x: 2 * np.pi, v: 0}, name="upright again")
    note = cosim.simulate(model.freeze(), solver="cvodes").stats["note"]
    assert "so that it is followed" in note
    assert "s on, x is at an unstable equilibrium but for rounding" in note


def test_a_run_that_followed_growth_stays_where_the_next_one_fails(monkeypatch):
    def failing(run, *rest):
        def again(closer):
            motion = run(closer)
            last = closer is not None and closer.until == np.inf
            return replace(motion, reason=Ending("failed")) if last else motion

        return followed_growth(again, *rest)

    monkeypatch.setattr("cosim.integrate.events.followed_growth", failing)
    model = cosim.Model("washed_out", stop_time=65.0, output_interval=1.0)
    x = model.state("x", "1", 0.0, "amount")
    model.derivative(x, x * (1 - x) + 1e-12)
    model.when(model.t > 40, {x: 1e-14}, name="washed out")
    run = cosim.simulate(model.freeze(), solver="cvodes")
    amount = 1e-12 * np.expm1(39)
    assert run["x"][39] == pytest.approx(amount / (1 + amount), rel=1e-4)  # before: -1e-12
    assert "it may be suppressed: it needs absolute_tolerance" in run.stats["note"]


def test_run_without_a_row_is_a_failure_and_no_crash():
    with pytest.raises(cosim.errors.SolverError, match="stopped after the start"):
        cosim.simulate("double_pendulum/multipliers", solver="rosenbrock", relative_tolerance=3e-14)


def test_growth_beside_a_state_that_is_a_billion_times_faster_is_followed():
    """It begins at 10 s; the slopes that tell of it are 1e-9 of the largest one."""
    model = cosim.Model("beside", stop_time=40.0, output_interval=0.4)
    c, i = model.state("c", "1", 0.0, "clock"), model.state("i", "1", 0.0, "current")
    x, v = model.state("x", "1", 0.0, "angle"), model.state("v", "1", 0.0, "rate")
    model.derivative(c, 1)
    model.derivative(i, -1e9 * i)
    model.derivative(x, v)
    model.derivative(v, (c - 10) / 10 * ca.sin(x) - 0.1 * v + 1e-18)
    run = cosim.simulate(model.freeze(), solver="cvodes")
    alone = cosim.simulate(
        model.freeze(), solver="cvodes", relative_tolerance=1e-10, absolute_tolerance=1e-25
    )
    assert run.final["x"] == pytest.approx(alone.final["x"], rel=1e-4)  # before: -3e-19
