"""Runs as people ask for them: names, units, inputs of every kind, times of one's own, a stop."""

import math
import pickle

import numpy as np
import pytest
from helpers.oscillators import blow_up
from helpers.small_models import decay

import cosim
from casadi_models.dae import Model
from cosim.errors import SolverError, UnknownName


def pushed():
    """Return a unit mass under a force: x'' = f."""
    model = Model("pushed", stop_time=2.0, output_interval=0.05)
    force = model.input("force", "N", 0.0, "force on the mass")
    gain = model.parameter("gain", "1", 1.0, "of the force")
    x = model.state("x", "m", 0.0, "place", display_unit="ft")
    v = model.state("v", "m/s", 0.0, "speed")
    model.derivative(x, v)
    model.derivative(v, gain * force)
    model.output("twice", "m", 2 * x, "twice the place")
    return model.freeze()


DAE = pushed()
FINE = np.linspace(0, 2, 4001)


def test_name_stands_for_its_model_and_keeps_what_was_built():
    first, second = (cosim.simulate("crank_shaft", stop_time=0.1) for _ in range(2))
    assert first.model == "crank_shaft/driven"
    np.testing.assert_array_equal(first.values, second.values)
    with pytest.raises(UnknownName, match="did you mean crank_shaft"):
        cosim.simulate("crank_shift")


def test_texts_with_units_are_start_values():
    run = cosim.simulate("crank_shaft", stop_time=0.1, start_values={"omega": "60 rpm", "phi": 1})
    assert run["omega"][0] == pytest.approx(2 * math.pi, rel=1e-15)
    assert run["phi"][0] == 1


@pytest.mark.parametrize(
    "law",
    [
        "sin(3*t)",
        lambda t: np.sin(3 * t),
        lambda t: math.sin(3 * t),  # numbers only: sampled
        np.sin(3 * np.linspace(0, 2, 41)),
        cosim.InputSeries(
            ("f",), np.linspace(0, 2, 4001), np.sin(np.linspace(0, 6, 4001))[:, None]
        ),
    ],
    ids=["formula", "symbolic", "numbers", "samples", "series"],
)
def test_input_may_be_a_law_samples_or_a_series(law):
    run = cosim.simulate(DAE, inputs={"force": law}, compiled=False, relative_tolerance=1e-10)
    exact = run.time / 3 - np.sin(3 * run.time) / 9  # v = (1 - cos 3t) / 3
    exactly = isinstance(law, str) or (callable(law) and not isinstance(law(1.0), float))
    fine = isinstance(law, cosim.InputSeries)
    # straight lines between samples lag by h^2/8 times the curvature
    bound = 1e-8 if exactly else 1e-6 if fine else 9 * 0.05**2 / 8 * 2
    np.testing.assert_allclose(run["x"], exact, rtol=0, atol=bound)  # measured 5e-10, 2e-7, 1e-3


@pytest.mark.parametrize("value", [2, 2.0, "2", "2 N", "2000 mN", "0.4496178902 lbf"])
def test_input_may_be_a_constant_with_a_unit(value):
    run = cosim.simulate(DAE, inputs={"force": value}, compiled=False)
    np.testing.assert_allclose(run["x"], run.time**2, rtol=1e-7, atol=1e-9)


def test_formula_may_use_states_and_parameters():
    law = "where(t < 1, gain, -x)"  # pushed for a second, then on a spring
    run = cosim.simulate(DAE, inputs={"force": law}, compiled=False, relative_tolerance=1e-9)
    after = run.time[run.time >= 1] - 1
    exact = 0.5 * np.cos(after) + np.sin(after)
    np.testing.assert_allclose(run["x"][run.time >= 1], exact, rtol=0, atol=1e-6)  # 4e-8


def test_times_of_one_s_own_need_not_hold_the_start():
    run = cosim.simulate(DAE, output_times=[0.1, 0.7, 1.9], inputs={"force": 2}, compiled=False)
    np.testing.assert_array_equal(run.time, [0.1, 0.7, 1.9])
    np.testing.assert_allclose(run["x"], run.time**2, rtol=1e-7)
    assert cosim.simulate(DAE, output_times=[0, 1], compiled=False).time.tolist() == [0, 1]


@pytest.mark.slow_rows("erk")
@pytest.mark.parametrize("solver", ["cvodes", "erk", "dop853"])
def test_run_at_other_times_has_the_accuracy_of_the_solver(solver):
    run = cosim.simulate(
        "crank_shaft", stop_time=1, output_interval=0.5, solver=solver, outputs=["phi", "omega"]
    )
    times = np.array([0.0, 0.123, 0.5, 0.777, 1.0])
    there = run.at(times)
    np.testing.assert_allclose(there["phi"], 50 * times + 5 * times**2, rtol=1e-7)  # measured 2e-9
    assert there["phi"][-1] == pytest.approx(run.final["phi"], rel=1e-8)
    assert run.at(0.123)["omega"] == pytest.approx(51.23, rel=1e-7)
    assert pickle.loads(pickle.dumps(run)).again is None


# -- until a condition is true --------------------------------------------------------------------


@pytest.mark.slow_rows("erk")
@pytest.mark.parametrize("solver", ["cvodes", "dop853", "erk", "rk4", "idas"])
def test_stop_is_located_as_accurately_as_the_run(solver):
    run = cosim.simulate("crank_shaft", stop_when="phi > 1000deg", solver=solver)
    angle = math.radians(1000)
    exact = (-50 + math.sqrt(2500 + 20 * angle)) / 10
    assert run.stats.stop_time == pytest.approx(exact, rel=1e-7)  # measured 1e-9
    assert run.time[-1] == run.stats.stop_time
    assert run.complete
    assert run.final["phi"] >= angle
    # SUNDIALS' interpolants differ between steps by an error per step
    slack = 1e-7 if solver in ("cvodes", "idas") else 1e-12  # measured 1e-8, 1e-15
    assert run.final["phi"] == pytest.approx(angle, rel=slack)
    assert "stopped where phi > 1000deg from" in repr(run)
    np.testing.assert_array_equal(np.diff(run.time[:-1]).round(12), 0.01)


def test_condition_may_join_outputs_inputs_and_parameters():
    condition = "twice > 100*gain and v > 0 or force * t >= 2"
    run = cosim.simulate(DAE, stop_when=condition, inputs={"force": "2"}, compiled=False)
    assert run.stats.stop_time == pytest.approx(1, rel=1e-12)
    assert run.names == ("x", "v", "twice")
    run = cosim.simulate(DAE, stop_when="x > 1ft", outputs=["x"], inputs={"force": 2})
    assert run.stats.stop_time == pytest.approx(math.sqrt(0.3048), rel=1e-7)


def test_condition_that_never_holds_changes_nothing():
    plain, watched = (
        cosim.simulate(DAE, stop_when=condition, compiled=False) for condition in (None, "x > 1e9")
    )
    np.testing.assert_array_equal(plain.values, watched.values)
    assert watched.stats.stop is None


def test_run_that_fails_only_after_the_stop_is_no_failure():
    dae = blow_up()
    with pytest.raises(SolverError):
        cosim.simulate(dae, compiled=False)
    run = cosim.simulate(dae, stop_when="x > 4", compiled=False)
    assert run.stats.stop_time == pytest.approx(0.75, rel=5e-6)  # x = 1 / (1 - t); measured 5e-7


def test_scene_stops_too():
    scene = cosim.read_scene("crank_torque.toml")
    run = cosim.run_scene(scene, stop_when="t > 1.2345")
    assert run.time[-1] == pytest.approx(1.2345, rel=1e-14)
    assert run.names == ("T",)


def test_model_without_inputs_refuses_one():
    with pytest.raises(UnknownName, match="has no input 'force'"):
        cosim.simulate("crank_shaft", inputs={"force": 1})
    assert len(cosim.simulate(decay(), inputs={}, stop_time=0.1, compiled=False)) == 11
