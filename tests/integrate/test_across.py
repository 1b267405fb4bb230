"""Positions where constraints lose rank, nobody naming a solver: passed with evidence, or not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cosim
from casadi_models.dae import Dae
from cosim.errors import SolverError
from cosim.integrate import across
from cosim.integrate.across import _Crossed, _jump, _passing
from cosim.integrate.diagnosis.crossing import rank_losses

FOUR_BARS = f"{Path(__file__).parents[2] / 'examples' / 'four_bars_a02.py'}:build"
FIRST = 0.7144  # s, when all bars lie in a line
NAMED = [
    {"solver": "idas"},
    {"solver": "ode15s"},
    {"solver": "rosenbrock"},
    {"drift_control": "baumgarte"},
    {"compiled": False},
]


@pytest.fixture(scope="module")
def bars() -> Dae:
    return cosim.load(FOUR_BARS)


def test_run_goes_on_along_its_branch_and_says_how(bars):
    """The cranks stay parallel; what the energy does was not looked at when the run was taken."""
    run = cosim.simulate(bars, stop_time=2.0)
    np.testing.assert_allclose(run["y1"], run["y0"], rtol=0, atol=1e-9)
    near = run["y0"] ** 2 < 1e-4  # outputs next to a position carry its condition
    energy = run["energy"][~near]
    np.testing.assert_allclose(energy, energy[0], rtol=1e-7)  # measured 3e-9
    assert run.stats.solver == "dop853"
    assert "constraints lose rank near 0.71 s" in run.stats["note"]
    assert "speeds go on at 2 such positions" in run.stats["note"]
    assert "invalid" not in run.stats


def test_run_is_what_its_solver_gives_when_it_is_named(bars):
    run = cosim.simulate(bars, stop_time=1.0)
    solver = cosim.solvers.Dop853(relative_tolerance=run.stats.relative_tolerance)
    same = cosim.simulate(bars, stop_time=1.0, solver=solver, drift_control="projection")
    np.testing.assert_array_equal(run.values, same.values)


@pytest.mark.parametrize("named", NAMED, ids=str)
def test_what_is_named_is_taken_at_its_word(bars, named):
    with pytest.raises(SolverError, match="dop853 with projection steps across") as caught:
        cosim.simulate(bars, stop_time=1.0, on_invalid="stop", **named)
    assert "tried" not in str(caught.value)


@pytest.mark.parametrize("stop", [0.7147, 0.717, 0.72, 1.25])
def test_position_in_the_last_interval_is_seen(bars, stop):
    assert "speeds go on" in cosim.simulate(bars, stop_time=stop).stats["note"]


def test_motion_that_stays_where_rank_is_lost_is_told_once(bars):
    """Two cranks that lock in line: the condition, once lost, does not fall again."""
    time = np.linspace(0.0, 0.2, 21)
    states, unknowns = np.zeros((12, 21)), np.zeros((11, 21))
    states[:6] = [[0.0], [1.0], [1.0], [1.0], [2.0], [1.0]]
    rank = np.where(time < 0.105, 0.5, 1e-7)
    losses = rank_losses(bars, time, states, unknowns, np.empty((0, 1)), np.empty(0), rank)
    assert [(loss.position, loss.distance) for loss in losses] == [(10, 1e-7)]


@pytest.mark.parametrize("wanted", [{"stop_when": "y0 < -0.5"}, {"output_times": [0.5, 1.0]}])
def test_every_way_to_ask_for_a_run_passes(bars, wanted):
    run = cosim.simulate(bars, outputs=["y0", "y1"], **wanted)
    np.testing.assert_allclose(run["y1"], run["y0"], rtol=0, atol=1e-9)


def test_variants_pass_like_single_runs(bars):
    asked = {"outputs": ["y0", "y1"], "stop_time": 1.0}
    many = cosim.simulate_many(bars, {"x0_dot": [1.0, 3.0]}, **asked)
    assert many.complete.all()
    one = cosim.simulate(bars, start_values={"x0_dot": 3.0}, **asked)
    np.testing.assert_array_equal(many.run(1)["y0"], one["y0"])
    assert "run 1: constraints lose rank near 0.4" in many.stats["note"]
    asked |= {"solver": "idas", "on_invalid": "stop"}
    assert not cosim.simulate_many(bars, {"x0_dot": [1.0]}, **asked).complete.any()


def test_reduced_model_is_watched_like_the_whole(bars):
    run = cosim.simulate(cosim.reduce(bars, ["x0", "y0"]), stop_time=2.0)
    assert run.names == ("x0", "y0")
    assert "speeds go on at 2 such positions" in run.stats["note"]


def test_refusal_says_why_nothing_else_was_taken(bars, monkeypatch):
    monkeypatch.setattr(across, "SMOOTH", 0.0)
    with pytest.raises(SolverError, match=r"tried, and not taken: a state is .* off its way"):
        cosim.simulate(bars, stop_time=1.0, on_invalid="stop")


def test_failure_elsewhere_is_left_alone(bars):
    """The model ends where it has no solution; its constraints keep their rank."""
    ending = replace(bars, alg=bars.alg / (bars.t < 0.3))
    with pytest.raises(SolverError, match=r"idas stopped after 0\.[23]") as caught:
        cosim.simulate(ending, stop_time=0.5)
    assert "tried" not in str(caught.value)


def test_another_branch_is_seen_by_its_speeds(bars):
    """Behind the position, one crank turns back: its height and speed change sign."""
    projected = {"solver": "dop853", "drift_control": "projection"}
    run = cosim.simulate(bars, outputs=bars.observed, stop_time=1.0, **projected)
    states = np.array([run[v.name] for v in bars.states])
    assert _jump(run.time, states, FIRST) < across.SMOOTH  # measured 1.4e-4
    for name in ("y2", "y2_dot"):
        states[[v.name for v in bars.states].index(name), run.time > FIRST] *= -1
    assert _jump(run.time, states, FIRST) > 1.0


def crossed(end: float, *, jump: float = 0.0, when: float = FIRST) -> _Crossed:
    return _Crossed(np.array([[0.0, np.nan, end]]), (when,), jump)


def passing(runs: list[_Crossed | None]) -> list[float]:
    """Return the tolerances that are taken, of runs in their order; None is one that ended."""
    left = iter(runs)

    def judged(_tolerance: float) -> _Crossed:
        found = next(left, None)
        if found is None:
            raise SolverError("it ended")
        return found

    return [tolerance for tolerance, _ in _passing(judged, 1e-8, (0.70, 0.72))]


def test_run_is_taken_where_another_one_arrives_at_the_same():
    assert passing([None, crossed(1.0), crossed(1.0 + 2e-6), crossed(1.0 + 5e-7)]) == [
        pytest.approx(1e-8 * 10**-0.75)
    ]


@pytest.mark.parametrize(
    ("runs", "why"),
    [
        ([], "no run arrives"),
        ([crossed(1.0)], "no second run arrives"),
        ([crossed(1.0), crossed(1.1)], "differ by 0.1 of a state's size"),
        ([crossed(1.0, jump=0.2), crossed(1.0, jump=0.2)], "0.2 of its size off its way"),
        ([crossed(1.0, when=5.0)], "no constraints lose rank from 0.7 to 0.72 s"),
    ],
)
def test_run_is_not_taken_without_evidence(runs, why):
    with pytest.raises(SolverError, match=why):
        passing(runs)
