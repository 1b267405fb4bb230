"""Many runs at once: each agrees with a single run, and none depends on its neighbors."""

import os
import signal
import threading
import time

import casadi as ca
import numpy as np
import pytest
from helpers import event_models
from helpers.oscillators import bad_output, blow_up, emptying, oscillator

import cosim
from casadi_models.dae import Model
from cosim.codegen.runge_kutta.lane_library import processor_lanes
from cosim.errors import (
    InitialConditionError,
    Interrupted,
    ParameterError,
    SolverError,
    UnknownName,
    UsageError,
)
from cosim.integrate.ensemble.ensemble import RunState
from cosim.integrate.ensemble.lanes import run_lanes
from cosim.integrate.ensemble.simulate_many import simulate_many
from cosim.integrate.outputs import _lane_library

ROLLS = np.linspace(0.3, 0.5, 37)


@pytest.fixture(scope="module")
def bicycle():
    return cosim.load("bicycle")


@pytest.fixture(scope="module")
def reference(bicycle):
    return simulate_many(
        bicycle, {"phi_dot": ROLLS}, output_times=[5.0, 20.0], relative_tolerance=1e-6
    )


def growth():
    """Declare x' = rate x^2, x(0) = 1: 1 / (1 - rate t), which ends at t = 1 / rate."""
    model = Model("growth", stop_time=1.0)
    x = model.state("x", "1", 1.0, "x")
    rate = model.parameter("rate", "1/s", 0.5, "rate")
    model.derivative(x, rate * x**2)
    model.output("inverse", "1", 1 / x, "1 / x")
    model.limit(5 - x, "x is less than 5")
    return model.freeze()


@pytest.mark.quick_rows("bar_on_frame")
@pytest.mark.parametrize(
    "name",
    ["bicycle", "bicycle/book", "disk_two_bars", "double_pendulum", "bar_on_frame", "crank_shaft"],
)
def test_lanes_agree_with_single_runs_to_the_tolerance(name):
    dae = cosim.load(name)
    many = simulate_many(dae, stop_time=2.0, relative_tolerance=1e-9)
    single = cosim.simulate(dae, stop_time=2.0, relative_tolerance=1e-9, solver="dop853")
    assert many.stats["solver"] == "dop853"
    assert many.names == single.names
    sizes = np.array([column.nominal for column in many.columns])
    scale = np.maximum(sizes, np.abs(single.values).max(axis=0))
    worst = (np.abs(many.values[0] - single.values) / scale).max()
    assert worst < 1e-9  # measured up to 4e-11
    assert abs(many.steps[0] - single.stats["steps"]) <= 1


def test_lanes_follow_a_closed_form_with_parameters_of_their_own():
    rates = np.linspace(0.1, 0.9, 23)
    many = simulate_many(growth(), {"rate": rates}, relative_tolerance=1e-10, on_invalid="ignore")
    exact = 1 / (1 - rates[:, None] * many.time)
    np.testing.assert_allclose(many["x"], exact, rtol=1e-8)  # measured 2e-10
    np.testing.assert_allclose(many["inverse"] * many["x"], 1, rtol=1e-15)
    assert many.complete.all()


@pytest.mark.slow
def test_a_run_has_the_same_bits_whatever_runs_beside_it(bicycle, reference):
    settings = {"output_times": [5.0, 20.0], "relative_tolerance": 1e-6}
    shuffled = np.random.default_rng(3).permutation(len(ROLLS))
    other = simulate_many(bicycle, {"phi_dot": ROLLS[shuffled]}, threads=1, **settings)
    np.testing.assert_array_equal(other.values, reference.values[shuffled])
    np.testing.assert_array_equal(other.steps, reference.steps[shuffled])
    np.testing.assert_array_equal(other.error, reference.error[shuffled])
    for i in (0, 17, 36):
        alone = simulate_many(bicycle, {"phi_dot": ROLLS[i]}, **settings)
        np.testing.assert_array_equal(alone.values[0], reference.values[i])
    pieces = [
        simulate_many(bicycle, {"phi_dot": part}, threads=2, **settings).values
        for part in np.array_split(ROLLS, 5)
    ]
    np.testing.assert_array_equal(np.concatenate(pieces), reference.values)


@pytest.mark.slow
def test_numbers_of_lanes_agree_to_rounding(bicycle, reference):
    for lanes in (1, 4):
        other = simulate_many(
            bicycle,
            {"phi_dot": ROLLS},
            output_times=[5.0, 20.0],
            relative_tolerance=1e-6,
            lanes=lanes,
        )
        assert other.stats["lanes"] == lanes
        np.testing.assert_allclose(other.values, reference.values, rtol=1e-7, atol=1e-9)


@pytest.mark.slow
def test_output_times_do_not_change_the_steps(bicycle, reference):
    often = simulate_many(
        bicycle, {"phi_dot": ROLLS[:3]}, stop_time=20.0, relative_tolerance=1e-6, outputs=["phi"]
    )
    np.testing.assert_array_equal(often.steps, reference.steps[:3])
    np.testing.assert_array_equal(often["phi"][:, -1], reference["phi"][:3, -1])
    single = cosim.simulate(
        bicycle, start_values={"phi_dot": ROLLS[1]}, stop_time=20.0, relative_tolerance=1e-6,
        solver="dop853", outputs=["phi"],
    )  # fmt: skip
    np.testing.assert_allclose(often["phi"][1], single["phi"], rtol=0, atol=1e-9)


def test_a_failing_run_is_a_row_and_its_neighbors_keep_their_bits():
    rates = np.tile([0.5, 0.7, 0.9], 5)
    well = simulate_many(growth(), {"rate": rates}, on_invalid="ignore")
    rates[4] = 3.0  # ends at 1/3 s
    mixed = simulate_many(growth(), {"rate": rates}, on_invalid="ignore")
    assert mixed.states[4] is RunState.FAILED
    assert "step size too small at t = 0.33333" in mixed.reasons[4]
    last = mixed.time[mixed.reached[4] - 1]
    assert last == pytest.approx(0.33)
    assert np.isnan(mixed["x"][4, mixed.reached[4] :]).all()
    assert np.isfinite(mixed["x"][4, : mixed.reached[4]]).all()
    others = np.arange(len(rates)) != 4
    np.testing.assert_array_equal(mixed.values[others], well.values[others])
    assert mixed.complete[others].all()


def test_a_limit_is_reported_or_ends_its_run():
    rates = [0.5, 0.9, 0.5]
    warned = simulate_many(growth(), {"rate": rates})
    text = "invalid from 0.888889 s: not fulfilled: x is less than 5"
    assert warned.invalid == {1: text}
    assert warned.invalid[1].time == pytest.approx(8 / 9, abs=1e-9)
    assert warned.complete.all()
    stopped = simulate_many(growth(), {"rate": rates}, on_invalid="stop")
    assert [str(state) for state in stopped.states] == ["complete", "stopped", "complete"]
    assert text in stopped.reasons[1]
    assert stopped.run(1).time[-1] == pytest.approx(0.88)
    assert not simulate_many(growth(), {"rate": rates}, on_invalid="ignore").invalid


def test_reason_begins_with_the_violation_that_comes_before_a_failure():
    many = simulate_many(growth(), {"rate": [0.5, 3.0]})  # ends at 1/3 s
    first, _, then = many.reason(1).partition("; ")
    assert first.startswith("invalid from 0.267 s: not fulfilled: x is less than 5")
    assert then.startswith("stopped after 0.33 s: step size too small")
    assert many.to_xarray()["reason"].values.tolist() == ["", many.reason(1)]


@pytest.mark.slow
def test_an_impossible_value_refuses_its_row_alone(bicycle):
    many = simulate_many(
        bicycle, {"rF": [0.35, -1.0, np.nan], "IBxx": [9.2, 9.2, 9.2]}, output_times=[1.0]
    )
    assert [str(state) for state in many.states] == ["complete", "refused", "refused"]
    assert "rF = -1 m is out of its range" in many.reasons[1]
    assert "not finite" in many.reasons[2]
    inertia = simulate_many(bicycle, {"IDyy": [0.28, 10.0]}, output_times=[1.0])
    assert "which no body has" in inertia.reasons[1]
    assert inertia.complete[0]


def test_a_start_without_solution_refuses_its_row_alone(bicycle):
    many = simulate_many(bicycle, {"phi": [0, 1.5], "delta": [0, 1.5]}, output_times=[1.0])
    assert many.complete[0]
    assert many.states[1] is RunState.REFUSED
    assert "no start value of theta" in many.reasons[1]


def test_calculated_starts_are_those_of_single_runs(bicycle):
    radii = np.linspace(0.3, 0.36, 5)
    many = simulate_many(
        bicycle, {"rF": radii}, stop_time=0.0, outputs=["theta"], output_times=None
    )
    for radius, theta in zip(radii, many["theta"][:, 0], strict=True):
        single = cosim.start_vectors(bicycle, {"rF": radius})["x0"]
        row = [v.name for v in bicycle.states].index("theta")
        assert theta == pytest.approx(single[row], abs=1e-14)


@pytest.mark.parametrize(
    ("model", "cause"),
    [(blow_up, "step size too small"), (emptying, "step size"), (bad_output, "not finite")],
)
def test_what_ends_a_single_run_ends_a_run_in_lanes(model, cause):
    many = simulate_many(model())
    assert many.states[0] is RunState.FAILED
    assert cause in many.reasons[0]
    assert np.isfinite(many.run(0).values).all()


def test_runs_that_are_too_stiff_for_lanes_run_one_by_one_by_default():
    model = Model("damped", stop_time=2.0)
    x, c = model.state("x", "m", 1.0, "x"), model.parameter("c", "1/s", 1.0, "rate")
    model.derivative(x, -c * (x - ca.cos(model.t)))
    dae, rates = model.freeze(), {"c": [1.0, 1e8]}
    options = {"output_times": [1.0, 2.0]}
    many = simulate_many(dae, rates, **options)
    assert many.complete.all()  # 31,000 steps are needed for c = 1e5
    assert many.notes == {1: "computed by cvodes, not dop853"}
    single = cosim.simulate(dae, start_values={"c": 1e8}, **options)
    np.testing.assert_array_equal(many["x"][1], single["x"])
    forced = simulate_many(dae, rates, solver="dop853", **options)
    assert [str(s) for s in forced.states] == ["complete", "failed"]


def test_a_dae_and_other_solvers_run_one_by_one():
    known = oscillator(algebraic=True)
    many = simulate_many(known.dae, {"x": [1.0, 2.0]}, outputs=["x"], stop_time=1.0)
    assert many.stats["solver"] == "idas"
    for i, x in enumerate((1.0, 2.0)):
        single = cosim.simulate(known.dae, start_values={"x": x}, outputs=["x"], stop_time=1.0)
        np.testing.assert_array_equal(many["x"][i], single["x"])
    failing = simulate_many(growth(), {"rate": [0.5, 3.0, np.inf]}, solver="cvodes")
    assert [str(s) for s in failing.states] == ["complete", "failed", "refused"]
    assert failing.reached[1] == 34  # up to 0.33 s


def test_what_contradicts_itself_is_refused_at_once(bicycle):
    with pytest.raises(UnknownName, match="phi_dot"):
        simulate_many(bicycle, {"phi_dott": [0.1]})
    with pytest.raises(InitialConditionError, match="calculated"):
        simulate_many(bicycle, {"theta": [0.1]})
    with pytest.raises(ParameterError, match="others have 3"):
        simulate_many(bicycle, {"phi": [0.1, 0.2], "delta": [0, 0, 0]})
    with pytest.raises(UsageError, match="output_times already sets all"):
        simulate_many(bicycle, output_times=[1.0], stop_time=2.0)
    with pytest.raises(ParameterError, match="output_times: time 2"):
        simulate_many(bicycle, output_times=[2.0, 1.0])
    with pytest.raises(UsageError, match="lanes"):
        simulate_many(bicycle, lanes=3)
    with pytest.raises(UsageError, match="lanes are for models without events"):
        simulate_many(event_models.ball(), lanes=4, solver="dop853")
    uneven = simulate_many(bicycle, output_times=[1.0, 1.5, 1.7], solver="cvodes")
    assert uneven.time.tolist() == [1.0, 1.5, 1.7]


@pytest.mark.slow
def test_ctrl_c_keeps_the_runs_that_have_ended(bicycle, monkeypatch):
    rolls = np.full(40_000, 0.5)
    timer = threading.Timer(0.7, os.kill, (os.getpid(), signal.SIGINT))
    simulate_many(bicycle, {"phi_dot": rolls[:16]}, output_times=[20.0])  # compiled and loaded

    def with_timer(*arguments, **options):
        timer.start()
        return run_lanes(*arguments, **options)

    monkeypatch.setattr("cosim.integrate.ensemble.lanes.run_lanes", with_timer)
    began = time.monotonic()
    with pytest.raises(Interrupted) as caught:
        simulate_many(bicycle, {"phi_dot": rolls}, output_times=[20.0], relative_tolerance=1e-12)
    assert time.monotonic() - began < 5
    partial = caught.value.partial
    done = partial.complete
    assert 0 < done.sum() < len(rolls)
    assert np.isfinite(partial["phi"][done]).all()
    assert np.isnan(partial["phi"][~done]).all()
    assert {partial.states[i] for i in np.flatnonzero(~done)} == {RunState.INTERRUPTED}


def test_an_ensemble_shows_its_runs(reference):
    assert len(reference) == len(ROLLS)
    assert reference["phi"].shape == (len(ROLLS), 2)
    run = reference.run(3)
    assert run.complete
    np.testing.assert_array_equal(run["phi"], reference["phi"][3])
    with pytest.raises(UnknownName, match="phi"):
        reference["phii"]
    assert processor_lanes() in (1, 4, 8)


def test_an_ensemble_becomes_a_dataset(reference):
    pytest.importorskip("xarray")
    data = reference.to_xarray()
    assert data["phi"].dims == ("run", "time")
    np.testing.assert_array_equal(data["phi"], reference["phi"])
    assert data["phi"].attrs["units"] == "rad"
    np.testing.assert_array_equal(data.coords["phi_dot_start"], ROLLS)


def test_an_output_that_lanes_cannot_compute_takes_the_scalar_backend():
    model = Model("inverse", stop_time=1.0)
    x = model.state("x", "1", 0.1, "x")
    model.derivative(x, 0.5)
    model.output("y", "1", ca.erfinv(x), "inverse error function")
    dae = model.freeze()
    assert _lane_library(dae, limits_only=False) is None
    assert _lane_library(growth(), limits_only=False) is not None
    run = cosim.simulate(dae, compiled=False)  # C has no such function
    assert run["y"][-1] == pytest.approx(0.5951160814, abs=1e-7)  # erf(0.5951160814) = 0.6


def test_variants_with_events_run_one_by_one():
    dae, options = event_models.ball(), {"solver": "dop853", "stop_time": 1.0}
    many = simulate_many(dae, {"h": [1.0, 2.0]}, **options)
    for start, row in zip((1.0, 2.0), many["h"], strict=True):
        run = cosim.simulate(dae, start_values={"h": start}, **options)
        np.testing.assert_array_equal(row, run["h"])
    assert [event.name for event in many.run(1).events] == ["impact"]


def test_a_variant_that_a_stop_ends_has_its_last_row_at_the_time_of_the_stop():
    many = simulate_many(event_models.stopping(), {"x": [0.0, 0.1]}, solver="dop853")
    assert many.status == "2 complete"
    for start, row, reached in zip((0.0, 0.1), many["x"], many.reached, strict=True):
        np.testing.assert_allclose(row[:reached], start + many.time[:reached], rtol=0, atol=1e-12)
        assert np.isnan(row[reached:]).all()
    ends = [many.run(i) for i in range(2)]
    np.testing.assert_allclose([run.time[-1] for run in ends], [0.777, 0.677], atol=1e-12)
    np.testing.assert_allclose([run["x"][-1] for run in ends], 0.777, atol=1e-12)


def test_many_runs_print_as_a_summary_with_the_first_reason():
    speeds = {"thetaR_dot": [-5.0, -12.0, -15.0]}
    many = cosim.simulate_many(cosim.load("bicycle"), speeds, outputs=["phi"], stop_time=2)
    lines = repr(many).splitlines()
    assert lines[0] == "bicycle/independent: 3 runs, 201 times from 0 to 2 s, 3 complete"
    assert lines[2].split() == ["thetaR_dot", "(varied)", "rad/s", "-15", "-5"]
    assert lines[3].startswith("phi")
    assert lines[4].startswith("1 with a reason, the first one: run 0: invalid from 0.771 s: the")
    assert len(lines) == 5
    assert many.reason(1) == ""


def test_print_of_many_runs_of_many_variables_stays_short():
    many = cosim.simulate_many(cosim.load("bicycle"), {"g": [1.62, 9.81]}, stop_time=0.1)
    assert len(repr(many).splitlines()) < 40


def test_dataset_holds_the_reason_of_each_run():
    pytest.importorskip("xarray")
    speeds = {"thetaR_dot": [-5.0, -15.0]}
    many = cosim.simulate_many(cosim.load("bicycle"), speeds, outputs=["phi"], stop_time=2)
    assert [str(text)[:22] for text in many.to_xarray().reason.values] == [
        "invalid from 0.771 s: ",
        "",
    ]


def test_names_are_found_and_numbers_of_runs_are_words():
    dae = cosim.load("crank_shaft")
    one = cosim.simulate_many(dae, {"omega": [40.0]}, output_times=[1.0], outputs=["phi"])
    assert "phi" in one
    assert "omega" not in one
    assert [*one] == ["phi"]
    assert (
        repr(one).splitlines()[0] == "crank_shaft/driven: 1 run, 1 time from 1 to 1 s, 1 complete"
    )
    for name in ("omega", "density"):  # on which inertias depend
        none = cosim.simulate_many(dae, {name: []}, output_times=[1.0], outputs=["phi"])
        assert repr(none).splitlines()[0] == "crank_shaft/driven: no runs, 1 time from 1 to 1 s"


@pytest.mark.parametrize(("start", "stop"), [(10.0, 11.0), (0.0, 100.0)])
def test_a_start_that_rounding_leaves_beside_0_says_nothing_of_steps(start, stop):
    """x' = 1 + cos x from about 0: tan(x / 2) = t."""
    model = Model("tiny", stop_time=1.0)
    x = model.state("x", "1", 1e-18, "a state")
    model.derivative(x, model.parameter("rate", "1/s", 1.0, "rate") * (1 + ca.cos(x)))
    many = simulate_many(
        model.freeze(), {"rate": [1.0, 2.0]}, start_time=start, stop_time=stop,
        relative_tolerance=1e-9,
    )  # fmt: skip
    assert not many.reasons
    exact = 2 * np.arctan((stop - start) * np.array([1.0, 2.0]))
    assert many["x"][:, -1] == pytest.approx(exact, abs=1e-7)


@pytest.mark.parametrize(("relative", "absolute"), [(0.0, 1e-6), (1e-8, 1e-6)])
def test_errors_are_those_of_the_same_steps_whichever_tolerance_measures_them(relative, absolute):
    usual, other = (
        simulate_many(
            oscillator().dae,
            {"x": [1.0, 2.0]},
            solver="dop853",
            relative_tolerance=own[0],
            absolute_tolerance=own[1],
            max_step=0.1,
        )
        for own in ((1e-6, 0.0), (relative, absolute))
    )
    np.testing.assert_array_equal(other.steps, usual.steps)
    ratio = other.error / usual.error  # sizes are 1 or up to 2, and less for relative errors
    assert ((ratio > 0.1) & (ratio < 10)).all()


def test_runs_count_from_the_end_too():
    many = simulate_many(blow_up(), {"x": [0.1, 2.0]}, stop_time=1.0)  # until 10 s, and 0.5 s
    assert many.reason(-2) == "" != many.reason(-1) == many.reason(1)
    assert many.run(-2).status == "complete" != many.run(-1).status == many.run(1).status
    assert many.run(-1).time[-1] <= 0.5


@pytest.mark.parametrize(
    ("on_invalid", "state", "rows"), [("warn", "failed", 1), ("stop", "stopped", 0)]
)
def test_a_start_without_derivative_is_told_as_in_a_single_run(on_invalid, state, rows):
    """The limit, beyond which the equations have no value, is left at the start already."""
    model = Model("log", stop_time=1.0)
    end = model.parameter("end", "m", 2.0, "where the range ends")
    x, v = model.state("x", "m", 0.0, "way"), model.state("v", "m/s", 1.0, "speed")
    model.derivative(x, v)
    model.derivative(v, ca.log(end - x))
    model.limit(end - x, "x is before the end")
    dae, ends = model.freeze(), [2.0, 0.0, -1.0]
    many = simulate_many(dae, {"end": ends}, on_invalid=on_invalid, solver="dop853")
    assert [str(found) for found in many.states] == ["complete", state, state]
    assert np.isfinite(many["x"]).sum(axis=1).tolist() == [many["x"].shape[1], rows, rows]
    for i in (1, 2):
        with pytest.raises(SolverError) as raised:
            cosim.simulate(dae, start_values={"end": ends[i]}, on_invalid=on_invalid)
        assert len(raised.value.partial["x"]) == rows
        assert many.invalid[i] == "invalid from 0 s: not fulfilled: x is before the end"


def test_lanes_step_over_no_pulses_that_are_many():
    t, y = ca.SX.sym("t"), ca.SX.sym("y")
    pulses = ca.exp(-((ca.sin(40 * t) / 1e-3) ** 2))
    dae = cosim.from_casadi({"t": t, "x": y, "ode": pulses}, stop_time=1, output_interval=0.1)
    many = cosim.simulate_many(dae, {"y": [0.0, 0.0]}, solver="dop853")
    right = 12.5 * np.sqrt(np.pi) * 1e-3 / 40
    np.testing.assert_allclose(many["y"][:, -1], right, rtol=1e-3)
