"""What happens at one instant: rows, samples and stops at its time, and rounding of that time."""

import casadi as ca
import numpy as np
import pytest
from helpers import event_models
from helpers.event_models import simulate

from casadi_models.dae import Model
from cosim.integrate.kernel import Kernel


@pytest.mark.quick_rows("rk4")
@pytest.mark.parametrize("solver", ["dop853", "rk4", "cvodes"])
def test_run_that_a_stop_ends_is_computed_again_at_just_the_requested_times(solver):
    model = Model("oscillator", stop_time=5.0)
    far = model.parameter("far", "m", 0.4, "distance")
    x, v = model.state("x", "m", 0.0, "place"), model.state("v", "m/s", 1.0, "speed")
    model.derivative(x, v)
    model.derivative(v, -0.3 * x)
    model.stop(x > far, "far")
    dae = model.freeze()
    for k in range(20):
        values = {"far": 0.4 + 0.01 * k, "v": 1 + 0.037 * k}
        run = simulate(dae, solver, start_values=values)
        end = run.time[-1]
        np.testing.assert_array_equal(run.at([0.1, 0.2, end]).time, [0.1, 0.2, end])
        for t in (0.1, 0.2, end):
            expected = np.interp(t, run.time, run["x"])
            assert run.at(t)["x"] == pytest.approx(expected, abs=1e-6)


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("period", [7, 10, 23])
@pytest.mark.parametrize("solver", ["dop853", "rk4", "cvodes"])
def test_samples_at_output_times_are_in_their_rows(solver, period):
    dae = event_models.counting(period)
    run = simulate(dae, solver)
    np.testing.assert_array_equal(run["n"], 1 + np.arange(301) // period)
    run = simulate(dae, solver, start_time=-0.05 * period, stop_time=0.05 * period)
    np.testing.assert_array_equal(np.diff(run["n"]).nonzero()[0] % period, period - 1)


@pytest.mark.parametrize("solver", ["dop853", "cvodes"])
def test_a_sample_at_0_is_in_the_row_that_rounding_leaves_before_it(solver):
    dae = event_models.counting(10)
    times = np.add.accumulate([-1.0] + [0.1] * 11)
    assert -1e-15 < times[10] < 0
    for rows in (times, times[:11]):
        run = simulate(dae, solver, start_time=-1.0, output_times=rows)
        assert run["n"].tolist() == [0] * 10 + [1, 2][: len(rows) - 10]


@pytest.mark.quick_rows("rk4")
@pytest.mark.parametrize("solver", ["dop853", "ode8", "rk4", "erk"])
def test_two_floors_of_a_steady_motion_are_no_zeno(solver):
    model = Model("floors", stop_time=2.0, output_interval=0.05)
    x, y = model.state("x", "m", 0.1, "place"), model.state("y", "m", 0.0, "sum")
    a = model.parameter("a", "m/s", 1.3, "speed")
    model.derivative(x, a)
    model.derivative(y, ca.floor(x / 0.4 * a) + ca.floor(x / 0.39))
    dae = model.freeze()
    for speed in (*np.random.default_rng(3).uniform(1, 2, 25), 1.3003):
        run = simulate(dae, solver, start_values={"a": speed})
        end = 0.1 + 2 * speed
        crossings = [k * size for size in (0.4 / speed, 0.39) for k in range(1, 99)]
        assert len(run.events) == sum(0.1 < crossing < end for crossing in crossings)


@pytest.mark.quick_rows("erk")
@pytest.mark.parametrize("solver", ["dop853", "erk", "rosenbrock"])
def test_event_of_a_state_at_the_instant_of_a_clock_happens_once(solver):
    model = Model("clocked", stop_time=1.0)
    c, period = model.parameter("c", "m/s2", 0.5, "c"), model.parameter("T", "s", 0.2, "period")
    x = model.state("x", "m", 0.0, "place")
    b, k = model.discrete("b", "1", 0.0, "passages"), model.discrete("k", "1", 0.0, "samples")
    model.derivative(x, 2 * c * model.t)
    model.when(x > c * (3 * period) ** 2, {b: b + 1}, name="passage")
    model.every(period, {k: k + 1}, name="sample")
    dae = model.freeze()
    for values in ((0.532, 0.14453), (0.78, 0.248974), (1.7935, 0.18403), (0.5, 1 / 6)):
        start = dict(zip(("c", "T"), values, strict=True))
        assert simulate(dae, solver, start_values=start).final["b"] == 1
    model = Model("clocked", stop_time=1.0)
    x, b = model.state("x", "m", 0.0, "place"), model.discrete("b", "1", 0.0, "passages")
    y = model.state("y", "m", 0.0, "another place")
    model.derivative(x, 1.0)
    model.derivative(y, x)
    model.when(x > 0.5, {b: b + 1}, name="passage")
    model.when(model.t > 0.5, {y: y + 1}, name="clock")
    assert simulate(model.freeze(), solver).final["b"] == 1


@pytest.mark.quick_rows("2 <= n-0.2")
@pytest.mark.parametrize(
    ("condition", "end"),
    [
        ("n >= 2", 0.2),
        ("2 <= n", 0.2),
        ("not n < 2", 0.2),
        ("x > 0.15 and n >= 1", 0.15),
        ("0.1 < x < 0.5", 0.1),
        ("n >= 9 or x >= 0.35", 0.35),
        ("where(n >= 3, x, 0) > 0", 0.3),
    ],
)
def test_stop_when_is_exact_at_equality(condition, end):
    model = Model("counter", stop_time=1.0)
    x, n = model.state("x", "m", 0.0, "place"), model.discrete("n", "1", 0.0, "number")
    model.derivative(x, 1.0)
    model.every(0.1, {n: n + 1}, offset=0.1, name="tick")
    run = simulate(model.freeze(), "dop853", stop_when=condition)
    assert run.time[-1] == pytest.approx(end, abs=1e-12)


@pytest.mark.parametrize("solver", ["dop853", "erk"])
def test_a_relation_that_rests_does_not_share_the_events_of_others(solver):
    model = Model("two", stop_time=2.0)
    resting, falling = model.state("a", "m", 0.0, "rests"), model.state("b", "m", 1.0, "falls")
    model.derivative(resting, -ca.fmax(resting, 0))
    model.derivative(falling, -1 - ca.fmax(falling, 0))
    (event,) = simulate(model.freeze(), solver, record_events=True).events
    assert event.name == "fmax of (-b)"


def test_the_time_of_the_last_event_tells_how_far_a_run_is(monkeypatch):
    seen, happen = [], Kernel.happen

    def noted(self, at, *more):
        found = happen(self, at, *more)
        seen.append((at.t, self.switching.last_event))
        return found

    monkeypatch.setattr(Kernel, "happen", noted)
    run = simulate(event_models.ball(), "cvodes", start_time=0.5, stop_time=2.0)
    told = [t for now, t in seen if t == now]  # before: 0.5 s, always
    np.testing.assert_array_equal(told, [event.time for event in run.events])
