"""Runs of every solver, interpreted and compiled, against solutions it did not compute."""

import math

import casadi as ca
import numpy as np
import pytest
from helpers.oscillators import (
    ADAPTIVE,
    INTERPRETED,
    MULTIPLE,
    V0,
    WAYS,
    X0,
    K,
    error,
    machine_code,
    oscillator,
)
from scipy.integrate import solve_ivp

import cosim
from casadi_models.dae import Model
from cosim.api import simulate
from cosim.codegen.compiler import MissingTool
from cosim.errors import CosimError, ParameterError, UnknownName, UsageError
from cosim.integrate.integrator import start_vectors
from cosim.integrate.solvers import SOLVERS
from cosim.model.inputs import InputSeries

EVERY_WAY = pytest.mark.parametrize(("solver", "compiled"), WAYS)


# -- spans and grids ------------------------------------------------------------------------------


@EVERY_WAY
def test_run_that_begins_later_keeps_its_time(solver, compiled):
    known = oscillator()
    x, v = known.solution(np.array([1.3]))
    run = simulate(
        known.dae,
        solver=solver,
        start_time=1.3,
        stop_time=2.35,
        output_interval=0.1,
        step_size=0.01 if not SOLVERS[solver].adaptive else None,
        start_values={"x": x[0], "v": v[0]},
        compiled=compiled,
    )
    assert run.time.tolist() == pytest.approx([*np.arange(1.3, 2.31, 0.1), 2.35])
    assert error(run, known.solution) < 5e-6


def test_span_of_the_model_follows_a_later_start():
    run = simulate(oscillator().dae, start_time=2, compiled=False)
    assert (run.time[0], run.time[-1]) == (2, 7)


@pytest.mark.parametrize("name", ["bicycle", "bicycle/multipliers"])
def test_run_of_no_length_has_one_row_with_the_start(name):
    dae = cosim.load(name)
    run = simulate(dae, stop_time=0)
    assert run.time.tolist() == [0]
    assert run.complete
    np.testing.assert_array_equal(run.values[0, : len(dae.states)], start_vectors(dae)["x0"])
    assert abs(run["loop_closure"][0]) < 1e-15  # m, measured 0
    assert run["energy"][0] == pytest.approx(run["kinetic_energy"][0] + run["potential_energy"][0])


@pytest.mark.parametrize("solver", ADAPTIVE)
def test_output_times_do_not_touch_the_accuracy(solver):
    known = oscillator()
    for interval in (5.0, 0.001):
        run = simulate(known.dae, solver=solver, output_interval=interval, **machine_code(solver))
        assert len(run) == round(5 / interval) + 1
        assert error(run, known.solution) < MULTIPLE[solver] * 1e-8


def test_step_longer_than_the_output_interval_is_cut_to_it():
    known = oscillator()
    run = simulate(known.dae, solver="rk4", output_interval=0.1, step_size=10.0, compiled=False)
    assert run.stats["steps"] == 50


def test_system_without_states_is_evaluated_at_every_time():
    model = Model("signal", stop_time=1.0)
    model.output("wave", "1", ca.sin(model.t), "a wave")
    run = simulate(model.freeze(), output_interval=0.25)
    np.testing.assert_allclose(run["wave"], np.sin(run.time), rtol=1e-15)


# -- inputs, parameters, outputs ------------------------------------------------------------------


@EVERY_WAY
def test_constant_input_and_parameter_act_in_every_solver(solver, compiled):
    known = oscillator()
    run = simulate(known.dae, solver=solver, start_values={"push": 2.0}, compiled=compiled)
    assert error(run, known.solution, push=2.0) < 1e-5
    free = simulate(
        known.dae, solver=solver, start_values={"k": 0.0, "x": 0.0, "v": 0.0}, compiled=compiled
    )
    np.testing.assert_allclose(free["x"], free.time - np.sin(free.time), rtol=0, atol=1e-5)


@pytest.mark.slow_rows("erk-True")
@pytest.mark.parametrize(
    ("solver", "compiled"),
    [
        *((solver, False) for solver in INTERPRETED),
        *((s, True) for s in ("cvodes", "erk", "rk4", "dop853")),
    ],
)
def test_ramp_of_an_input_acts_in_every_solver(solver, compiled):
    known = oscillator()
    ramp = InputSeries(("push",), np.array([0.0, 1.0, 5.0]), np.array([[0.0], [1.0], [1.0]]))
    run = simulate(known.dae, solver=solver, inputs=ramp, compiled=compiled)

    def rates(t, y):
        return [y[1], math.sin(t) + min(t, 1.0) - K * y[0]]

    expected = solve_ivp(
        rates, (0, 5), [X0, V0], "DOP853", run.time, rtol=1e-12, atol=1e-12, max_step=0.05
    )
    assert np.abs(run["x"] - expected.y[0]).max() < 2e-5  # measured 3e-7 at most


def test_unknown_column_of_an_input_series_is_refused():
    series = InputSeries(("pushh",), np.array([0.0, 1.0]), np.zeros((2, 1)))
    with pytest.raises(UnknownName, match="no input 'pushh'; did you mean push"):
        simulate(oscillator().dae, inputs=series, compiled=False)


def test_outputs_are_recorded_in_the_order_asked_for():
    run = simulate(oscillator().dae, outputs=["energy", "x"], compiled=False)
    assert run.names == ("energy", "x")
    assert run.units == {"time": "s", "energy": "J", "x": "m"}


@pytest.mark.parametrize(
    ("outputs", "kind", "reason"),
    [
        (["enrgy"], UnknownName, "no output 'enrgy'; did you mean energy"),
        (["x", "x"], UsageError, "output 'x' is named twice"),
        ("x", UsageError, "give a list of names"),
        ([""], UnknownName, "no output ''"),
    ],
)
def test_wrong_outputs_are_refused(outputs, kind, reason):
    with pytest.raises(kind, match=reason):
        simulate(oscillator().dae, outputs=outputs, compiled=False)


def test_output_of_another_formulation_is_refused_with_its_name():
    hint = "crank_shaft/driven does not compute 'shaft_shift_1'; crank_shaft/multipliers does"
    with pytest.raises(UnknownName, match=hint):
        simulate(cosim.load("crank_shaft"), outputs=["shaft_shift_1"])


# -- what a run tells -----------------------------------------------------------------------------


def test_statistics_tell_what_a_run_took():
    run = simulate(oscillator().dae, solver="rk4", step_size=0.005, compiled=False)
    assert run.stats["solver"] == "rk4"
    assert run.stats["steps"] == 1000
    assert run.stats["rhs_calls"] == 4000
    assert run.stats["jacobian_calls"] == 0
    assert 0 < run.stats["solve_time"] < run.stats["wall_time"]


@pytest.mark.parametrize("solver", ADAPTIVE)
def test_statistics_of_adaptive_solvers_grow_with_the_accuracy(solver):
    few, many = (
        simulate(
            oscillator().dae, solver=solver, relative_tolerance=r, **machine_code(solver)
        ).stats
        for r in (1e-4, 1e-10)
    )
    assert few["relative_tolerance"] == 1e-4
    for key in ("steps", "rhs_calls"):
        assert 0 < few[key] < many[key]
    assert few["rhs_calls"] >= few["steps"]
    assert (few["jacobian_calls"] > 0) is (solver in ("cvodes", "idas", "rosenbrock"))


def test_two_runs_are_bit_equal():
    dae = cosim.load("bicycle")
    one, two = (simulate(dae, stop_time=1) for _ in "12")
    assert one.values.tobytes() == two.values.tobytes()


@pytest.mark.parametrize(
    ("options", "kind"),
    [
        ({"stop_time": -1}, ParameterError),
        ({"stop_time": math.nan}, ParameterError),
        ({"stop_time": math.inf}, ParameterError),
        ({"start_time": "0"}, ParameterError),
        ({"start_time": math.nan}, ParameterError),
        ({"start_time": 9, "stop_time": 8}, ParameterError),
        ({"output_interval": 0}, ParameterError),
        ({"output_interval": -0.01}, ParameterError),
        ({"output_interval": math.nan}, ParameterError),
        ({"output_interval": 1e-9}, ParameterError),
        ({"relative_tolerance": 0}, ParameterError),
        ({"relative_tolerance": 1e-20}, ParameterError),
        ({"absolute_tolerance": -1}, ParameterError),
        ({"solver": "rk4", "step_size": 0}, ParameterError),
        ({"solver": "rk4", "step_size": math.nan}, ParameterError),
        ({"solver": "rk4", "absolute_tolerance": 1e-9}, UsageError),
        ({"solver": "euler"}, UnknownName),
        ({"start_values": {"x": math.nan}}, ParameterError),
        ({"start_values": {"y": 1.0}}, UnknownName),
        ({"on_invalid": "crash"}, UnknownName),
    ],
    ids=str,
)
def test_wrong_option_is_refused_in_one_sentence_before_anything_runs(options, kind, monkeypatch):
    monkeypatch.setattr("cosim.integrate.nominal.call", lambda *_: pytest.fail("it ran"))
    with pytest.raises(kind) as caught:
        simulate(oscillator().dae, compiled=False, **options)
    assert issubclass(kind, CosimError)
    assert "\n" not in str(caught.value)


# -- with and without a compiler ------------------------------------------------------------------


@pytest.fixture
def no_compiler(monkeypatch, tmp_path):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr("cosim.codegen.compiler.find_spec", lambda name: None)


def test_without_a_compiler_a_run_is_interpreted(no_compiler):
    run = simulate(oscillator().dae)
    assert run.stats["compiled"] is False
    assert run.complete


def test_without_a_compiler_compiled_equations_are_refused(no_compiler):
    with pytest.raises(MissingTool, match="no C compiler found"):
        simulate(oscillator().dae, compiled=True)


def test_wrong_compiler_is_an_error_and_not_ignored(monkeypatch):
    monkeypatch.setenv("CC", "no_such_compiler")
    with pytest.raises(MissingTool, match="CC names 'no_such_compiler'"):
        simulate(oscillator().dae)
