"""Candidates: measured once, cached, and valid for other values than the model's own."""

import numpy as np
import pytest
from helpers.known_errors import OTHER, error
from helpers.oscillators import K, oscillator
from helpers.small_models import decay

import cosim
from cosim.api import simulate
from cosim.study.accuracy.candidates import TOLERANCES, measured_candidates
from cosim.study.accuracy.choice import report


@pytest.mark.slow
def test_predicted_errors_hold_for_the_candidates(dae):
    """At the model's own values, measured errors are those from the closed form."""
    own = {"k": K, "x": 1.0, "v": 0.5}
    front = measured_candidates(dae, compiled=True).cheapest_first(["x"])
    floor = cosim.reference(dae).error(["x"])
    errors = [m.error for m in front]
    assert errors == sorted(errors, reverse=True)
    for m in front:
        run = simulate(dae, solver=m.solver, relative_tolerance=m.tolerance)
        assert m.error == pytest.approx(error(run, own), rel=0.01, abs=2 * floor)


@pytest.fixture
def stored(monkeypatch, tmp_path):
    """Return the folder of candidates in a cache that no other test writes to."""
    monkeypatch.setenv("COSIM_CACHE", str(tmp_path))
    return tmp_path / "candidates"


@pytest.mark.slow
def test_other_values_of_a_scene_need_no_new_candidates(stored):
    small = cosim.requested(decay("candidates_of_decay"), accuracy=1e-6)
    for rate in (0.5, 0.7, 3.0):
        run = simulate(small, start_values={"rate": rate})
        assert np.abs(run["x"] - np.exp(-rate * run.time)).max() <= 1e-6
    assert len([*stored.iterdir()]) == 1


@pytest.mark.slow
def test_candidates_are_measured_once_and_again_if_their_file_is_damaged(stored):
    dae = decay("damaged_front")
    first = measured_candidates(dae, compiled=True)
    (place,) = stored.iterdir()
    assert measured_candidates(dae, compiled=True) == first
    whole = place.read_bytes()
    place.write_bytes(whole[:-40])
    with pytest.warns(RuntimeWarning, match="was corrupt and has been rebuilt"):
        again = measured_candidates(dae, compiled=True)
    assert [str(c) for c in again.every] == [str(c) for c in first.every]
    assert measured_candidates(dae, compiled=True) == again  # whole again


@pytest.mark.slow
def test_reference_of_one_output_serves_the_accuracy_of_another():
    """Both need the same states, and so the same reduced model."""
    dae = oscillator().dae
    cosim.reference(cosim.reduce(dae, ["x"]))
    assert "v" in cosim.reference(cosim.reduce(dae, ["v"])).run.names
    assert simulate(cosim.reduce(dae, ["x", "v"]), accuracy=1e-6).stats["error_estimate"] <= 1e-6


@pytest.mark.slow
def test_solver_with_too_many_calls_is_not_run_at_tighter_tolerances(monkeypatch):
    monkeypatch.setattr("cosim.study.accuracy.candidates.MOST_CALLS", 300)
    every = measured_candidates(decay("calls"), compiled=True).every
    calls = [c.rhs_calls for c in every if c.solver == "erk"]
    assert len(calls) < len(TOLERANCES)
    assert calls[-2] <= 300 < calls[-1]


@pytest.mark.slow
def test_candidates_are_measured_without_a_cache(monkeypatch, tmp_path):
    (tmp_path / "candidates").write_text("a file where the folder should be")
    monkeypatch.setenv("COSIM_CACHE", str(tmp_path))
    assert simulate(decay(), accuracy=1e-6).stats["error_estimate"] <= 1e-6


@pytest.mark.slow
def test_interpreted_equations_have_their_own_candidates():
    run = simulate(oscillator().dae, start_values=OTHER, accuracy=1e-6, compiled=False)
    assert not run.stats["compiled"]
    assert "dop853" not in report(run)
    assert error(run) <= 1e-6
