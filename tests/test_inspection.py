"""What `cosim info` says of a model at its start."""

import json

import pytest

import cosim
from casadi_models.dae import Model
from cosim.cli import main
from cosim.inspection import inspect_start


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


def test_info_shows_conditions_and_margins(capsys):
    assert main(["info", "bicycle/multipliers"]) == 0
    shown = capsys.readouterr().out
    assert "\nconditions" in shown
    assert "\nlimits: a run is valid while" in shown
    assert main(["info", "bicycle/multipliers", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    rows = {row["name"]: row["at the start"] for row in facts["conditions"]}
    assert rows["constraint_condition"] == pytest.approx(1.0)  # upright: no two slips are coupled
    assert len(facts["margins"]) == len(facts["limits"])
