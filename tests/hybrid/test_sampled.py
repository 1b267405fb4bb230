"""Sampled systems: a lag whose input a controller sets at its samples.

x' = w (u - x) + r is exact between samples; from one to the next,
x_next = u + r / w + (x - u - r / w) exp(-w T) is the oracle.
"""

import numpy as np
import pytest
from helpers.hybrid_engines import exported, run_on

import cosim
import cosim.integrate.events as course
import cosim.integrate.nominal as nominal
from cosim.solvers import Dop853, Ode8, Rk4

COMPILED = {
    "dop853": Dop853(relative_tolerance=1e-12, absolute_tolerance=1e-14),
    "rk4": Rk4(step_size=1e-3),
    "ode8": Ode8(step_size=0.01),
}
RATE, GAIN = 3.0, -1.5


def sampled(period="every"):
    """Return the lag; its samples have a period, or each one plans the next."""
    model = cosim.Model("sampled", stop_time=5.0, output_interval=0.05)
    w = model.parameter("w", "1/s", RATE, "rate")
    r = model.input("r", "1/s", 0.0, "disturbance")
    x = model.state("x", "1", 1.0, "controlled")
    first = period == "planned"  # a condition that is true at the start does not become true
    u = model.discrete("u", "1", GAIN * first, "set at samples")
    n = model.discrete("n", "1", 1.0 * first, "samples")
    model.derivative(x, w * (u - x) + r)
    rule = {u: GAIN * x, n: n + 1}
    if period == "every":
        model.every(0.1, rule, name="sample")
    else:  # planned anew at each sample
        due = model.discrete("due", "s", 0.1, "next sample")
        model.when(model.t >= due, {**rule, due: due + 0.1}, name="sample")
    return model.freeze()


def exact(times, interval=0.1, disturbance=0.0):
    """Return x at times, each of them a sample or half-way between two."""
    x, found = 1.0, []
    for k in range(len(times)):
        step = k % 2
        if step == 0:
            u, start = GAIN * x, x
        found.append(x)
        rest = u + disturbance / RATE
        x = rest + (start - rest) * np.exp(-RATE * interval * (1 + step) / 2)
    return np.array(found)


def advances(monkeypatch):
    """Return a list that grows with each piece of a run that Python begins."""
    found = []
    own = course._Course._advance

    def counted(self):
        found.append(self.at.t)
        return own(self)

    monkeypatch.setattr(course._Course, "_advance", counted)
    return found


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("planned-dop853")
@pytest.mark.parametrize("solver", COMPILED)
@pytest.mark.parametrize("period", ["every", "planned"])
def test_a_compiled_solver_goes_through_samples_by_itself(solver, period, monkeypatch):
    begun = advances(monkeypatch)
    run = cosim.simulate(sampled(period), solver=COMPILED[solver])
    bound = 1e-6 if solver == "rk4" else 1e-10  # measured: 5e-9, 3e-14
    np.testing.assert_allclose(run["x"], exact(run.time), atol=bound)
    assert run["n"][-1] == 51
    assert len(begun) < 10  # 51 and more before


@pytest.mark.parametrize("solver", COMPILED)
def test_samples_between_the_jumps_of_a_table(solver, monkeypatch):
    begun = advances(monkeypatch)
    table = cosim.InputSeries(("r",), [0, 2.05, 2.05, 5], [[0], [0], [1], [1]])
    run = cosim.simulate(sampled(), solver=COMPILED[solver], inputs=table)
    x = run["x"]
    np.testing.assert_allclose(x[:42], exact(run.time[:42]), atol=1e-6)
    u = GAIN * x[40]
    for k in range(41, 101):  # from the jump on, half a sample at a time
        if k % 2 == 0:
            u = GAIN * x[k]
        rest = u + 1 / RATE
        if k < 100:
            right = rest + (x[k] - rest) * np.exp(-RATE * 0.05)
            assert x[k + 1] == pytest.approx(right, abs=1e-6)
    assert run["n"][-1] == 51
    assert len(begun) < 10


@pytest.mark.slow
def test_many_samples_need_more_than_one_call(monkeypatch):
    begun = advances(monkeypatch)
    run = cosim.simulate(sampled(), solver="dop853", stop_time=2000.0, output_interval=0.5)
    assert run["n"][-1] == 20001
    assert 1 < len(begun) < 40  # the room for events of one call is limited


def test_a_sample_that_ends_the_run_is_left_to_the_caller():
    model = cosim.Model("counter", stop_time=5.0)
    x = model.state("x", "1", 0.0, "time")
    n = model.discrete("n", "1", 0.0, "samples")
    model.derivative(x, 1.0)
    model.every(0.1, {n: n + 1}, name="sample")
    model.stop(n > 10.5, "enough")
    run = cosim.simulate(model.freeze(), solver="dop853")
    assert run.stats.stop_time == pytest.approx(1.0, abs=1e-14)
    assert run["n"][-1] == 11


@pytest.mark.parametrize("solver", ["cvodes", "idas", "erk", "rosenbrock"])
def test_pieces_between_samples_share_one_engine_though_an_input_follows_a_table(
    solver, monkeypatch
):
    built = []
    own = nominal.engine_of
    monkeypatch.setattr(nominal, "engine_of", lambda *given: built.append(given) or own(*given))
    times = np.linspace(0, 5, 101)
    table = cosim.InputSeries(("r",), times, np.sin(times)[:, None])
    run = cosim.simulate(sampled(), solver=solver, inputs=table, relative_tolerance=1e-8)
    exactly = cosim.simulate(sampled(), solver=COMPILED["dop853"], inputs=table)
    np.testing.assert_allclose(run["x"], exactly["x"], atol=1e-5)  # measured: 1e-8 to 8e-7
    assert len(built) < 10  # one for each of 50 samples before


def summing():
    """Return the sum of an input's samples, 0.1 s apart."""
    model = cosim.Model("summing", stop_time=1.0, output_interval=0.05)
    model.derivative(model.state("x", "s", 0.0, "time"), 1)
    u, total = model.input("u", "1", 0.0, "u"), model.discrete("n", "1", 0.0, "sum")
    model.every(0.1, {total: total + u}, name="sample")
    return model.freeze()


SUMMING = summing()


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("time", [0.3, 3 * 0.1, 0.7, 7 * 0.1])  # rows and samples differ by 6e-17
@pytest.mark.parametrize("engine", ["cvodes", "fmu2 cs fmpy", "dop853", "fmu2 me fmpy", "fmu3 cs"])
def test_a_sample_takes_the_new_value_of_an_input_that_jumps_there_but_for_rounding(engine, time):
    jump = cosim.InputSeries(("u",), [0, time, time, 2], [[0], [0], [1], [1]])
    if engine == "fmu3 cs":  # whose steps are equal
        path = exported(SUMMING, 3, solver="rk4")
        run = cosim.simulate_fmu(path, interface="CoSimulation", inputs=jump)
    else:
        run = run_on(engine, SUMMING, inputs=jump)
    assert run.final["n"] == 11 - round(10 * time)
