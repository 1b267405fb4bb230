"""Runs that cross positions where constraints lose rank: told, and none where they do not."""

from pathlib import Path

import numpy as np
import pytest

import cosim
from cosim.errors import SolverError, UsageError
from cosim.integrate.diagnosis.crossing import times_between, watching_rank
from cosim.integrate.simulate import simulate

FOUR_BARS = f"{Path(__file__).parents[3] / 'examples' / 'four_bars_a02.py'}:build"
FIRST = 0.7144  # s, when all bars lie in a line


@pytest.fixture(scope="module")
def bars():
    return cosim.load(FOUR_BARS)


def other_branch(dae, **options):
    """Return a run that leaves the motion of the cranks without an error of its solver."""
    lenient = cosim.solvers.Idas(suppress_algebraic=True)
    return simulate(dae, solver=lenient, stop_time=2.0, compiled=False, **options)


@pytest.mark.parametrize("interval", [0.01, 0.05, 0.1])
def test_crossing_is_told_whatever_the_output_interval(bars, interval):
    run = other_branch(bars, output_interval=interval)
    assert run.complete
    (told,) = run.stats["invalid"]
    assert "the motion may be another one: the constraints lose rank at 0.71" in told
    assert 0 < run.stats["invalid_from"] - FIRST < interval


def test_crossing_stops_a_run_that_is_to_stop(bars):
    with pytest.raises(SolverError, match=r"lose rank at 0\.71") as caught:
        other_branch(bars, on_invalid="stop")
    assert caught.value.partial.time[-1] == pytest.approx(0.71)
    assert "invalid" not in other_branch(bars, on_invalid="ignore").stats


def test_status_names_the_last_good_time_though_the_outputs_are_far_apart(bars):
    with pytest.raises(SolverError) as caught:
        other_branch(bars, on_invalid="stop", output_interval=0.1)
    partial = caught.value.partial
    np.testing.assert_allclose(partial.time, np.linspace(0, 0.7, 8))
    assert partial.status.startswith("stopped after 0.71 s: ")


def test_projected_steps_keep_to_their_motion_and_nothing_is_told(bars):
    """The cranks stay parallel; along the other branch one of them stops."""
    for solver in ("dop853", "ode8", "rk4"):
        run = simulate(bars, solver=solver, drift_control="projection", stop_time=2.0)
        assert "invalid" not in run.stats
        np.testing.assert_allclose(run["y1"], run["y0"], rtol=0, atol=1e-9)
        assert np.abs(other_branch(bars)["y1"] - run["y1"]).max() > 0.1


@pytest.mark.parametrize(
    "name", ["bicycle/multipliers", "disk_two_bars/multipliers", "bicycle/independent"]
)
def test_no_alarm_where_rank_is_kept(name):
    dae = cosim.load(name)
    assert watching_rank(dae) is not dae
    run = simulate(dae, compiled=False, outputs=["energy"], stop_time=5.0)
    assert not [text for text in run.stats.get("invalid", ()) if "rank" in text]


def test_failure_names_the_way_across(bars):
    with pytest.raises(SolverError, match="dop853 with projection steps across"):
        simulate(bars, compiled=False, stop_time=2.0)


def test_fixed_steps_take_multipliers_with_projection_only(bars):
    with pytest.raises(UsageError, match="or drift control by projection"):
        simulate(bars, solver="ode8")
    dae = cosim.load("bicycle/multipliers")
    settings = {"stop_time": 2.0, "outputs": ["phi", "delta", "fz_P"]}
    run = simulate(dae, solver="ode8", drift_control="projection", **settings)
    other = simulate(dae, solver="rosenbrock", relative_tolerance=1e-10, **settings)
    assert cosim.compare(run, other).worst.scaled < 1e-8  # measured 3e-11


def test_times_between_outputs_keep_them_and_are_close_enough():
    dae = cosim.load("bicycle/multipliers")
    given = np.array([0.0, 0.005, 1.0])
    found = times_between(dae, given)
    assert {*given.tolist()} <= {*found.tolist()}
    assert np.diff(found).max() <= dae.experiment.output_interval * (1 + 1e-12)
    assert times_between(dae, found) is None
    assert len(times_between(dae, np.array([0.0, 1e6]))) == 20_001
    assert times_between(cosim.load("bicycle"), given) is None  # explicit
