"""Fronts: measured once, kept, for other values as good as for the model's own."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.oscillators import K, oscillator
from helpers.promises import OTHER, error
from helpers.small_models import decay

import cosim
from cosim.api import run_scene, simulate
from cosim.codegen.c_sources import cache_folder
from cosim.scene.scene import Scene, Settings
from cosim.study.accuracy.front import FRONT_TOLERANCES, measured_front
from cosim.study.accuracy.solver_selection import promise_kept


def test_front_promises_what_its_configurations_keep(dae):
    """At the model's own values, measured errors are those from the closed form."""
    own = {"k": K, "x": 1.0, "v": 0.5}
    front = measured_front(dae, compiled=True).cheapest_first(["x"])
    floor = cosim.reference(dae).error(["x"])
    errors = [m.error for m in front]
    assert errors == sorted(errors, reverse=True)
    for m in front:
        configuration = m.configuration
        run = simulate(dae, solver=configuration.solver, relative_tolerance=configuration.tolerance)
        assert m.error == pytest.approx(error(run, own), rel=0.01, abs=2 * floor)


def test_other_values_of_a_scene_need_no_other_front():
    small = Scene("small", decay("front_of_decay"), settings=Settings(accuracy=1e-6))
    before = set((cache_folder() / "fronts").glob("*"))
    for rate in (0.5, 0.7, 3.0):
        run = run_scene(replace(small, values={"rate": rate}))
        assert np.abs(run["x"] - np.exp(-rate * run.time)).max() <= 1e-6
    assert len(set((cache_folder() / "fronts").glob("*")) - before) == 1


def test_front_is_measured_once_and_again_where_its_file_is_damaged(monkeypatch):
    dae = decay("damaged_front")
    before = set((cache_folder() / "fronts").glob("*"))
    first = measured_front(dae, compiled=True)
    (place,) = set((cache_folder() / "fronts").glob("*")) - before
    assert measured_front(dae, compiled=True) == first
    whole = place.read_bytes()
    place.write_bytes(whole[:-40])
    with pytest.warns(RuntimeWarning, match="was damaged; it is made again"):
        again = measured_front(dae, compiled=True)
    assert {e.configuration for e in again.events} == {e.configuration for e in first.events}
    assert measured_front(dae, compiled=True) == again  # whole again


def test_reference_of_one_output_serves_the_accuracy_of_another():
    """Both need the same states, and so the same reduced model."""
    dae = oscillator().dae
    cosim.reference(cosim.reduce(dae, ["x"]))
    assert "v" in cosim.reference(cosim.reduce(dae, ["v"])).run.names
    assert simulate(cosim.reduce(dae, ["x", "v"]), accuracy=1e-6).stats["error_estimate"] <= 1e-6


def test_solver_that_needs_too_many_calls_is_not_tried_any_tighter(monkeypatch):
    monkeypatch.setattr("cosim.study.accuracy.front.MOST_CALLS", 300)
    events = measured_front(decay("calls"), compiled=True).events
    calls = [e.rhs_calls for e in events if e.configuration.solver == "erk"]
    assert len(calls) < len(FRONT_TOLERANCES)
    assert calls[-2] <= 300 < calls[-1]


def test_without_a_cache_the_front_is_measured_all_the_same(monkeypatch, tmp_path):
    (tmp_path / "fronts").write_text("a file where the folder should be")
    monkeypatch.setenv("COSIM_CACHE", str(tmp_path))
    assert simulate(decay(), accuracy=1e-6).stats["error_estimate"] <= 1e-6


def test_interpreted_equations_have_a_front_of_their_own():
    run = simulate(oscillator().dae, start=OTHER, accuracy=1e-6, compiled=False)
    assert not run.stats["compiled"]
    assert "dop853" not in promise_kept(run)
    assert error(run) <= 1e-6
