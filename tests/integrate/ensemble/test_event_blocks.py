"""Runs of models with events in blocks are those of `simulate`, bit for bit."""

import os
import pickle
import signal
import threading
import time
from random import Random

import casadi as ca
import numpy as np
import pytest
from helpers import event_models
from helpers.hybrid_cases import frozen
from helpers.mechanical_cases import MECHANICS
from helpers.random_hybrids import FAMILIES, model_of
from helpers.switching_cases import SWITCHING

import cosim
from casadi_models.dae import Dae, Model
from cosim.errors import CosimError, Interrupted, SolverError
from cosim.integrate.ensemble.ensemble import RunState
from cosim.integrate.ensemble.event_blocks import EventBlocks
from cosim.integrate.families.explicit import NonStiffDop853

CASES = MECHANICS | SWITCHING
UNSAVED = {"solve_time", "wall_time", "compile_time"}


@pytest.fixture
def taken(monkeypatch):
    """Whether each run came from a block."""
    found, take = [], EventBlocks.take

    def noting(self, position):
        row = take(self, position)
        found.append(row is not None)
        return row

    monkeypatch.setattr(EventBlocks, "take", noting)
    return found


def expect_the_bits_of_single_runs(dae: Dae, columns: dict, **options) -> None:
    options |= {"solver": "dop853"}
    many = cosim.simulate_many(dae, columns, **options)
    for i in range(len(many)):
        given = {name: column[i] for name, column in columns.items()}
        try:
            one = cosim.simulate(dae, start_values=given, **options)
        except CosimError as error:
            assert many.states[i] is not RunState.COMPLETE
            one = getattr(error, "partial", None)
            if one is None:
                continue
        run, own = many.run(i), {k: v for k, v in one.stats.items() if k not in UNSAVED}
        np.testing.assert_array_equal(run.time, one.time)
        np.testing.assert_array_equal(run.values, one.values)
        np.testing.assert_array_equal(many.values[i][: len(one) - 1], one.values[:-1])
        events = [(e.time, e.name, e.before, e.after) for e in one.events]
        assert [(e.time, e.name, e.before, e.after) for e in run.events] == events
        assert {name: run.stats[name] for name in own if name in run.stats} == {
            name: value for name, value in own.items() if name in run.stats
        }
        assert (many.steps[i], many.notes.get(i)) == (own["steps"], own.get("note"))


def wall() -> Dae:
    """Return a pendulum that meets a wall; its sines are terms that steps might pass over."""
    model = Model("wall", stop_time=3.0)
    q = model.state("q", "rad", 1.0, "angle")
    w = model.state("w", "rad/s", 0.0, "rate")
    e = model.parameter("e", "1", 0.7, "restitution")
    model.derivative(q, w)
    model.derivative(w, -9.81 * ca.sin(q) - 0.05 * w + ca.sin(2 * model.t))
    model.when(q < -0.3, {w: -e * w}, name="impact")
    model.limit(1.2 - q, "small angle")
    return model.freeze()


BLOCKS = {
    "ball": (event_models.ball(), {"h": np.linspace(0.5, 3.0, 8)}),
    "wall": (wall(), {"e": np.linspace(0.5, 1.0, 6), "q": np.linspace(0.2, 1.4, 6)}),
    "sampled": (event_models.sampled(), {"x": np.linspace(-2.0, 2.0, 6)}),
    "counting": (event_models.counting(7), {"x": np.linspace(0.0, 1.0, 3)}),
    "stopping": (event_models.stopping(), {"x": np.linspace(-2.0, 0.5, 6)}),
    "everything": (event_models.everything(slides=False), {"x": np.linspace(-0.2, 0.6, 6)}),
}


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("everything-None", "wall-None")
@pytest.mark.parametrize("output_times", [None, "few"])
@pytest.mark.parametrize("name", BLOCKS)
def test_runs_in_blocks_are_single_runs(name, output_times, taken):
    dae, columns = BLOCKS[name]
    times = output_times and [0.4 * dae.experiment.stop_time, dae.experiment.stop_time]
    options = {"output_times": times} if times else {}
    expect_the_bits_of_single_runs(dae, columns, **options)
    assert sum(taken) >= len(taken) / 3  # of `stopping`, those that are not stopped


@pytest.mark.slow_rows("impacts")
@pytest.mark.quick_rows("impacts", "release")
@pytest.mark.parametrize("family", FAMILIES)
def test_random_runs_in_blocks_are_single_runs(family, taken):
    random, dae = Random(family), model_of(family)
    draws = [FAMILIES[family].numbers(random) for _ in range(8)]
    columns = {name: np.array([numbers[name] for numbers in draws]) for name in draws[0]}
    expect_the_bits_of_single_runs(dae, columns)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, case in CASES.items() if not case.inputs])
def test_cases_in_blocks_are_single_runs(name):
    case = CASES[name]
    dae = frozen(name, case.build, case.stop_time)
    columns = {k: np.full(2, v) for k, v in (case.start_values or {}).items()}
    first = dae.states[0]
    columns.setdefault(first.name, np.full(2, first.start or 0.0))
    columns[first.name] *= np.array([1.0, 1.001])
    expect_the_bits_of_single_runs(dae, columns)


def stuck() -> Dae:
    """Return a body that falls on a stiff damper, on which it comes to rest."""
    model = Model("stuck", stop_time=2.0)
    h = model.state("h", "m", 0.5, "height")
    v = model.state("v", "m/s", 0.0, "speed")
    d = model.parameter("d", "1/s", 1e6, "damping")
    model.derivative(h, v)
    model.derivative(v, -9.81 - ca.if_else(h < 0, 1e7 * h + d * v, 0))
    return model.freeze()


def test_events_are_in_blocks_by_default(taken):
    dae, heights = event_models.ball(), np.linspace(1.0, 3.0, 6)
    many = cosim.simulate_many(dae, {"h": heights})
    assert all(taken)
    assert many.stats["solver"] == "dop853"
    assert not many.notes
    for i, h in enumerate(heights):
        one = cosim.simulate(dae, start_values={"h": h})
        assert one.stats["solver"] == "cvodes"
        times = [event.time for event in many.run(i).events]
        np.testing.assert_allclose(times, [e.time for e in one.events], atol=1e-6)


def test_stiff_runs_leave_their_block_unless_its_solver_is_requested(taken):
    dae, damping = stuck(), [1e6, 20.0]
    options = {"output_times": [1.0, 2.0]}
    many = cosim.simulate_many(dae, {"d": damping}, **options)
    assert taken == [False, True]
    assert many.notes == {0: "computed by cvodes, not dop853"}
    one = cosim.simulate(dae, start_values={"d": damping[0]}, **options)
    np.testing.assert_array_equal(many.values[0], one.values)
    assert many.run(0).stats["solver"] == "cvodes"
    cosim.simulate_many(dae, {"d": [1e5, 1e3]}, solver="dop853", **options)
    assert taken[2:] == [True, True]


def test_runs_that_slide_or_stop_have_the_solver_of_the_blocks():
    places = [-2.0, 0.5]
    for dae in event_models.block(), event_models.stopping():
        many = cosim.simulate_many(dae, {"x": places}, outputs=["x"])
        for i, x in enumerate(places):
            options = {"outputs": ["x"], "solver": "dop853"}
            one = cosim.simulate(dae, start_values={"x": x}, **options)
            assert many.notes.get(i) == one.stats.get("note")
            np.testing.assert_array_equal(many.run(i).values, one.values)


@pytest.mark.slow
def test_runs_that_the_model_ends_are_not_repeated_by_another_solver():
    falls = event_models.ball(stop_time=6.0)  # it comes to rest after 2.6 s
    model = Model("limited", stop_time=2.0)
    h = model.state("h", "m", 1.0, "height")
    model.derivative(h, ca.if_else(h > 2, 2.0, 3.0))
    model.limit(4 - h, "above the roof")
    for dae, options, why in [
        (falls, {}, "'impact' happens ever faster before 2.5"),
        (model.freeze(), {"on_invalid": "stop"}, "above the roof"),
    ]:
        options |= {"output_interval": 0.1}
        many = cosim.simulate_many(dae, {"h": [1.0, 1.0]}, **options)
        with pytest.raises(SolverError, match=why) as caught:
            cosim.simulate(dae, start_values={"h": 1.0}, solver="dop853", **options)
        one = caught.value.partial
        assert many.notes == {}
        assert why in many.reason(0)
        np.testing.assert_array_equal(many.values[0][: len(one)], one.values)


def test_a_stiff_run_ends_at_once_where_its_solver_may_leave_it():
    with pytest.raises(SolverError, match=r"stiff at t = 0\.3") as caught:
        cosim.simulate(stuck(), solver=NonStiffDop853())
    assert caught.value.partial.stats["steps"] < 1100
    assert cosim.simulate(stuck(), stop_time=0.4, solver="dop853").status == "complete"


def test_a_run_has_the_same_bits_whatever_runs_beside_it():
    dae, heights = event_models.ball(), np.linspace(0.5, 3.0, 40)
    options = {"solver": "dop853", "output_times": [1.0, 2.0]}
    many = cosim.simulate_many(dae, {"h": heights}, **options)
    other = cosim.simulate_many(dae, {"h": heights[::-3]}, **options)
    np.testing.assert_array_equal(other.values, many.values[::-3])


def test_impossible_and_failing_runs_are_rows_among_others():
    heights = [1.0, np.nan, -1.0, 2.0]
    many = cosim.simulate_many(event_models.ball(), {"h": heights}, solver="dop853")
    alone = cosim.simulate_many(event_models.ball(), {"h": [1.0, 2.0]}, solver="dop853")
    assert many.states[1] is RunState.REFUSED
    np.testing.assert_array_equal(many.values[[0, 3]], alone.values)


def test_events_survive_pickle_and_are_made_once():
    many = cosim.simulate_many(event_models.ball(), {"h": [1.0, 2.0]}, solver="dop853")
    assert many.run(1) is many.run(1)
    copied = pickle.loads(pickle.dumps(many.with_events))
    assert [e.time for e in copied[1].events] == [e.time for e in many.run(1).events]
    one = cosim.simulate(event_models.ball(), start_values={"h": 2.0}, solver="dop853")
    np.testing.assert_array_equal(many.run(1).at([0.123])["h"], one.at([0.123])["h"])


def test_extremes_of_runs_in_blocks_need_no_single_run(monkeypatch):
    dae, heights = event_models.ball(), np.array([1.0, 2.0])
    many = cosim.simulate_many(dae, {"h": heights})
    singles = [cosim.simulate(dae, start_values={"h": h}, solver="dop853") for h in heights]
    expected = [one.curves for one in singles]
    monkeypatch.setattr("cosim.integrate.run._run_once", None)
    for (_, found), known in zip(many.curves(), expected, strict=True):
        np.testing.assert_array_equal(found.extremes, known.extremes)
        np.testing.assert_array_equal(found.mean(), known.mean())
        assert found.first(0, 0.5) == known.first(0, 0.5)


def test_ctrl_c_keeps_the_runs_that_have_ended(monkeypatch):
    dae, heights = event_models.ball(), np.full(100_000, 2.0)
    cosim.simulate_many(dae, {"h": heights[:2]}, solver="dop853", output_times=[2.0])  # compiled
    timer = threading.Timer(0.01, os.kill, (os.getpid(), signal.SIGINT))  # within its 20 ms
    calls, call = [], EventBlocks._call

    def with_timer(*arguments):
        calls.append(timer.start() if len(calls) == 1 else None)  # in the second block
        return call(*arguments)

    monkeypatch.setattr(EventBlocks, "_call", with_timer)
    began = time.monotonic()
    with pytest.raises(Interrupted) as caught:
        cosim.simulate_many(dae, {"h": heights}, solver="dop853", output_times=[2.0])
    assert time.monotonic() - began < 5
    partial = caught.value.partial
    done = partial.complete
    assert 0 < done.sum() < len(heights)
    assert np.isfinite(partial["h"][done]).all()
    assert np.isnan(partial["h"][~done]).all()
