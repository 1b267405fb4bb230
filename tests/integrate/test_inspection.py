"""What `cosim info` says of a model at its start."""

import json

import casadi as ca
import pytest

import cosim
from casadi_models.dae import Model
from cosim.cli.main import main
from cosim.integrate.validity import inspect_start


def test_start_of_the_bicycle_is_regular_and_both_wheels_carry():
    dae = cosim.load("bicycle")
    start = inspect_start(dae)
    monitors = dict(zip((v.name for v, _ in dae.monitors), start.monitors, strict=True))
    assert monitors["singularity_distance"] == pytest.approx(1.0)
    assert monitors["position_drift"] < 1e-15
    assert start.margins[:2] == pytest.approx([600.0, 302.0], abs=1.0)  # N; docs/bicycle.md


def test_model_without_a_start_is_shown_without_numbers():
    model = Model("nowhere")
    x = model.state("x", "1", 1.0, "a number")
    model.derivative(x, 0)
    model.start_equation(x, x**2 + 1, "a square is negative")
    model.limit(x, "x is positive")
    assert inspect_start(model.freeze()).margins == (None,)


def test_info_of_a_scene_is_that_of_its_start_time():
    model = Model("aged", stop_time=1.0)
    x = model.state("x", "1", 1.0, "a number")
    model.derivative(x, 0)
    model.limit(3 - model.t, "it is young")
    model.start(x, 2 * model.t, "it has grown")
    info = cosim.info(cosim.Scene("late", cosim.requested(model.freeze(), start_time=5.0)))
    assert info.facts["span"] == "5 ... 6 s"
    assert info.limits == ((-2.0, "it is young"),)
    assert info.tables["states"][0]["start"] == 10.0
    assert not [line for line in str(info).splitlines() if line.strip() in ("title", "source")]


def test_info_shows_conditions_and_margins(capsys):
    assert main(["info", "bicycle/multipliers"]) == 0
    shown = capsys.readouterr().out
    assert "\nconditions" in shown
    assert "\nvalidity conditions: a run is valid while" in shown
    assert main(["info", "bicycle/multipliers", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    rows = {row["name"]: row["at the start"] for row in facts["conditions"]}
    assert rows["constraint_condition"] == pytest.approx(1.0)  # upright: no two slips are coupled
    assert len(facts["margins"]) == len(facts["limits"])


def test_monitor_is_refused_like_any_other_declaration():
    model = Model("point")
    x = model.state("x", "m", 0.0, "place")
    model.derivative(x, 1)
    with pytest.raises(ValueError, match="'x' is declared twice"):
        model.monitor("x", x, "the place again")
    model.monitor("wild", ca.SX.sym("stranger"), "of nobody")
    with pytest.raises(ValueError, match="monitor 'wild' uses 'stranger'"):
        model.freeze()


def test_monitors_that_are_not_named_stay_monitors():
    dae = cosim.load("bicycle")
    assert dae.watching(()) is dae
    asked = dae.watching(["mass_condition"])
    assert "mass_condition" in [v.name for v in asked.output_variables]
    assert "mass_condition" not in [v.name for v, _ in asked.monitors]
    assert len(asked.monitors) == len(dae.monitors) - 1
