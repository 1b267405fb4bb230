"""Starts that are given through an output: `speed` of the bicycle instead of its wheel's rate."""

import pickle

import numpy as np
import pytest

import cosim
from casadi_models.dae import Model
from cosim.cli.main import main
from cosim.errors import InitialConditionError, UsageError
from cosim.model.many_values import assign_many

FORMULATIONS = ["bicycle", "bicycle/book", "bicycle/multipliers"]
LEANING = {"phi": 0.3, "delta": 0.2, "delta_dot": 1.0, "phi_dot": 0.4}
RADIUS = 0.3  # m, of the rear wheel


def start(dae, **values):
    return cosim.simulate(dae, start_values=values, stop_time=0, compiled=False).final


@pytest.mark.parametrize("name", FORMULATIONS)
def test_upright_bicycle_rolls_with_the_speed_over_the_radius(name):
    found = start(name, speed=4.6)
    assert found["thetaR_dot"] == pytest.approx(-4.6 / RADIUS, rel=1e-14)


@pytest.mark.parametrize("name", FORMULATIONS)
def test_leaning_bicycle_starts_with_the_speed_although_its_pitch_rate_counts(name):
    found = start(name, speed=4.6, **LEANING)
    rolling = -RADIUS * (found["thetaR_dot"] + found.get("theta_dot"))
    assert abs(found["theta_dot"]) > 0.01  # measured 0.05 rad/s
    assert rolling == pytest.approx(4.6, abs=1e-12)
    assert found["speed"] == pytest.approx(4.6, abs=1e-12)


def test_quantity_with_a_unit_is_taken():
    run = cosim.simulate("bicycle", start_values={"speed": "36 km/h"}, stop_time=0, compiled=False)
    assert run["speed"][0] == pytest.approx(10.0, abs=1e-12)


@pytest.mark.slow
def test_many_runs_take_speeds_row_by_row():
    dae = cosim.load("bicycle")
    speeds = np.array([3.0, 4.6, 7.0])
    many = cosim.simulate_many(
        dae, {"speed": speeds, "phi": 0.1}, stop_time=0.02, outputs=["speed"], solver="erk"
    )
    np.testing.assert_allclose(many["speed"][:, 0], speeds, atol=1e-12)


def test_no_runs_take_no_speeds():
    assert len(assign_many(cosim.load("bicycle"), {"speed": []})) == 0


def test_reduced_and_pickled_models_still_take_it():
    small = pickle.loads(pickle.dumps(cosim.reduce(cosim.load("bicycle"), ["phi"])))
    both = [
        cosim.simulate(small, start_values=values, stop_time=0.5, compiled=False)["phi"]
        for values in ({"speed": 4.6}, {"thetaR_dot": -4.6 / RADIUS})
    ]
    np.testing.assert_allclose(*both, rtol=0, atol=1e-12)


@pytest.mark.parametrize("call", ["run", "runs"])
def test_speed_beside_the_wheel_s_rate_is_refused(call):
    given = {"speed": 4.6, "thetaR_dot": -12.0}
    dae = cosim.load("bicycle")
    with pytest.raises(UsageError, match=r"speed gives the start of thetaR_dot.*give one of them"):
        cosim.simulate(dae, start_values=given) if call == "run" else cosim.simulate_many(
            dae, given
        )


def test_option_overrides_what_a_scene_says_of_the_same_start(tmp_path, capsys):
    scene = tmp_path / "fast.toml"
    scene.write_text('model = "bicycle"\n[start]\nspeed = "20 km/h"\n[run]\nstop_time = 0.0\n')
    line = [
        "simulate",
        str(scene),
        "--backend",
        "native-interpreted",
        "--outputs",
        "speed",
        "--at",
        "0",
    ]
    for more, expected in (([], 20 / 3.6), (["-p", "thetaR_dot=-10"], 3.0)):
        assert main([*line, *more]) == 0
        assert float(capsys.readouterr().out.split()[-1]) == pytest.approx(expected, rel=1e-9)


def test_exported_model_starts_with_the_wheel_s_rate_that_the_speed_gives(tmp_path):
    scene = cosim.Scene("fast", cosim.requested("bicycle", start_values={"speed": 6.0}))
    starts = {v.name: v.start for v in scene.request.configured().states}
    assert starts["thetaR_dot"] == pytest.approx(-6.0 / RADIUS, rel=1e-14)


@pytest.mark.slow
def test_sensitivity_starts_where_the_run_starts():
    dae = cosim.load("bicycle")
    by = {"with_respect_to": ["g"], "check": False, "stop_time": 0.1, "solver": "erk"}
    both = [
        cosim.sensitivity(dae, outputs=["phi"], start_values=values, **by).values
        for values in ({"speed": 3.0}, {"thetaR_dot": -3.0 / RADIUS})
    ]
    np.testing.assert_allclose(*both, rtol=1e-9)


def squared(*, calculated=False):
    """Return a model whose output is the square of its state: negative values have no start."""
    model = Model("squared", description="x falls", source="a test")
    x = model.state("x", "1", 2.0, "a number")
    model.derivative(x, -x)
    model.output("square", "1", x**2, "its square")
    model.start_through(x, "square")
    if calculated:
        model.start(x, 1.0, "it is one")
    return model.freeze()


@pytest.mark.slow
def test_value_that_no_start_gives_is_refused_and_a_row_of_many():
    dae = squared()
    assert start(dae, square=9.0)["x"] == pytest.approx(3.0, rel=1e-14)
    with pytest.raises(InitialConditionError, match="no start of x was found that gives square"):
        start(dae, square=-1.0)
    many = cosim.simulate_many(dae, {"square": [4.0, -1.0]}, solver="erk", stop_time=0.1)
    assert many.complete.tolist() == [True, False]
    assert "no start of x" in many.reasons[1]


def test_model_refuses_an_output_for_a_calculated_start():
    with pytest.raises(ValueError, match="the start of 'x' is calculated"):
        squared(calculated=True)


def test_other_outputs_stay_results():
    with pytest.raises(cosim.errors.UnknownName, match="'fz_P' is a result"):
        start("bicycle", fz_P=1.0)
    assert "alternative start values  speed (for thetaR_dot)" in str(cosim.info("bicycle"))


def test_info_rounds_start_values_of_rounding_errors_and_distant_bounds():
    text = str(cosim.info("bicycle"))
    assert "e-17" not in text
    assert "1e-12 ... 1e+12" in text
