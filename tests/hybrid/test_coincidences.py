"""What coincides at an instant but for rounding, or for the tolerance of an importer."""

import ctypes

import casadi as ca
import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Model
from helpers.hybrid_engines import ENGINES, exported, run_on

import cosim

ME = [("fmpy", tolerance) for tolerance in (1e-10, 1e-11)] + [("c", 1e-9)]


def samples():
    """Return crossings, of squares and cubes of the time, and a sample, all of them at 1 s."""
    model = cosim.Model("samples", stop_time=2.0, output_interval=0.25)
    x = model.state("x", "1", 0.0, "time")
    square, cube = model.state("y", "1", 0.0, "square"), model.state("z", "1", 0.0, "cube")
    n, late = model.discrete("n", "1", 0.0, "samples"), model.discrete("late", "1", 0.0, "1: late")
    crossed = model.discrete("crossed", "1", 0.0, "crossings")
    model.derivative(x, 1)
    model.derivative(square, 2 * x)
    model.derivative(cube, 3 * x**2)
    model.when(square >= 1, {crossed: crossed + 1}, name="square")
    model.when(cube >= 1, {crossed: crossed + 1}, name="cube")
    model.when(model.t >= 1, {late: late + 1}, name="late")
    model.every(0.5, {n: n + 1}, name="sample")
    return model.freeze()


def reached():
    """Return a moving state, and a threshold that an event puts just where it is."""
    model = cosim.Model("reached", stop_time=2.0, output_interval=0.25)
    rate = model.parameter("rate", "1", 1.0, "rate")
    x = model.state("x", "1", 0.0, "moves")
    beyond = model.state("beyond", "1", 0.0, "way beyond the threshold")
    low, high = model.discrete("low", "1", -5.0, "low"), model.discrete("high", "1", 50.0, "high")
    n = model.discrete("n", "1", 0.0, "how often x reached the low threshold, which is below it")
    model.derivative(x, rate)
    model.derivative(beyond, ca.if_else(x > high, rate, 0))
    model.when(x >= 0.3, {low: 0.3, high: 0.3}, name="put")
    model.when(x >= low, {n: n + 1}, name="low")
    return model.freeze()


def taken_away():
    """Return a speed that friction brings to rest just when an event sets it to 1."""
    model = cosim.Model("taken_away", stop_time=2.0, output_interval=0.25)
    v, w = model.state("v", "1", 1.0, "braked"), model.state("w", "1", 0.0, "rises")
    model.derivative(w, 2)
    model.derivative(v, -2 * ca.sign(v))
    model.when(w >= 1, {v: 1}, name="again")
    return model.freeze()


def followed():
    """Return a moving state, and a threshold that samples move to where it is."""
    model = cosim.Model("followed", stop_time=2.0, output_interval=0.1)
    x = model.state("x", "1", 0.0, "moves")
    low, n = model.discrete("low", "1", 0.0, "low"), model.discrete("n", "1", 0.0, "reached low")
    model.derivative(x, 1)
    model.every(0.1, {low: low + 0.1}, offset=0.1, name="sample")
    model.when(x >= low, {n: n + 1}, name="low")
    return model.freeze()


def teeth():
    """Return resets in each tenth of a second, and sums that reach limits just at a reset."""
    model = cosim.Model("teeth", stop_time=2.0, output_interval=0.25)
    x, y = model.state("x", "1", 0.0, "since the last"), model.state("y", "1", 0.0, "time")
    n, m = model.discrete("n", "1", 0.0, "resets"), model.discrete("m", "1", 0.0, "resets before")
    model.derivative(x, 1)
    model.derivative(y, 1)
    model.when(x >= 0.1, {n: n + 1, x: 0}, name="tooth")
    model.when(x + y >= 1.1, {m: m + n}, name="sum")
    model.when(x + y >= 2.1, {m: m + n}, name="last")
    return model.freeze()


def turned():
    """Return two crossings at 1.5 s, after new values at two others; one takes the other away."""
    model = cosim.Model("turned", stop_time=2.0, output_interval=0.25)
    x, y = model.state("x", "1", -1.0, "rises"), model.state("y", "1", 0.0, "turns")
    n, d = model.discrete("n", "1", 0.0, "crossings"), model.discrete("d", "1", -1.0, "direction")
    model.derivative(x, 1)
    model.derivative(y, -2 * d)
    model.when(x >= 0, {n: n + 1, d: -d, y: x}, name="turn")
    model.when(y - x + 1 <= 0, {n: n + 1, x: -x / 2}, name="back")
    return model.freeze()


SAMPLES, REACHED, FOLLOWED, TAKEN = samples(), reached(), followed(), taken_away()
TEETH, TURNED = teeth(), turned()


@pytest.mark.parametrize(("master", "tolerance"), ME)
def test_an_importer_comes_early_to_several_events_at_a_sample(master, tolerance):
    run = cosim.simulate_fmu(
        exported(SAMPLES, 2),
        interface="ModelExchange",
        master=master,
        relative_tolerance=tolerance,
    )
    assert run.final["n"] == 5
    assert run.final["late"] == 1
    assert run.final["crossed"] == 2


@pytest.mark.parametrize("engine", ["dop853", "idas", "fmu2 cs c", "fmu2 me fmpy", "fmu2 me c"])
def test_an_event_puts_a_threshold_where_a_state_moves(engine):
    for rate in np.linspace(0.5, 6.5, 13):
        start = {"rate": rate}
        if engine == "fmu2 me c":
            path = exported(REACHED, 2)
            run = cosim.simulate_fmu(
                path, interface="ModelExchange", master="c", start_values=start
            )
        else:
            run = run_on(engine, REACHED, start_values=start)
        assert run.final["n"] == 0
        assert run.final["beyond"] == pytest.approx(2 * rate - 0.3, abs=1e-9)


@pytest.mark.parametrize("engine", ["dop853", "rk4", "cvodes", "idas", "fmu2 cs c", "fmu2 me fmpy"])
def test_a_sample_puts_a_threshold_where_a_state_moves(engine):
    run = run_on(engine, FOLLOWED)
    assert run.final["low"] == pytest.approx(2, abs=1e-12)
    assert run.final["n"] == 0  # x >= low stays true


@pytest.mark.parametrize("engine", ["dop853", "rk4", "cvodes", "idas", "fmu2 cs c", "fmu2 me fmpy"])
def test_an_event_takes_away_what_came_to_rest_at_this_instant(engine):
    run = run_on(engine, TAKEN)
    assert run.at(0.75)["v"] == pytest.approx(0.5, abs=1e-5)
    assert run.final["v"] == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(("master", "tolerance"), ME)
def test_an_importer_locates_what_coincides_after_other_events(master, tolerance, fmi):
    options = {
        "interface": "ModelExchange",
        "master": master,
        "relative_tolerance": tolerance,
    }
    run = cosim.simulate_fmu(exported(TEETH, fmi), **options)
    found = [event.time for event in run.events if event.name != "tooth"]
    assert found == pytest.approx([1, 1.05, 2], abs=1e-12)  # measured 1e-13; before: 1.05, 1.1
    assert (run.final["n"], run.final["m"]) == (20, 9 + 10 + 19)
    run = cosim.simulate_fmu(exported(TURNED, fmi), **options)
    assert [event.time for event in run.events] == pytest.approx([1, 4 / 3, 1.5, 1.5], abs=1e-12)
    assert run.final["n"] == 4


class Importer:
    """An importer of model exchange that locates events to a tolerance, on either side of them."""

    def __init__(self, path, tolerance, late):
        description = fmpy.read_model_description(path)
        self.tolerance, self.late = tolerance, late
        self.x = np.zeros(description.numberOfContinuousStates)
        self.rates, self.signs = (
            np.zeros_like(self.x),
            np.zeros(description.numberOfEventIndicators),
        )
        self.n = next(v.valueReference for v in description.modelVariables if v.name == "n")
        name = description.modelExchange.modelIdentifier
        self.fmu = FMU2Model(
            guid=description.guid, unzipDirectory=fmpy.extract(path), modelIdentifier=name
        )
        self.fmu.instantiate()
        self.fmu.setupExperiment(startTime=0.0, stopTime=2.0)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def call(self, function, values):
        pointer = values.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
        function(pointer, len(values))
        return values.copy()

    def update(self):
        while self.fmu.newDiscreteStates()[0]:
            pass
        self.fmu.enterContinuousTimeMode()
        return self.call(self.fmu.getContinuousStates, self.x)

    def inside(self, t, x):
        self.fmu.setTime(t)
        self.call(self.fmu.setContinuousStates, x)
        return self.call(self.fmu.getEventIndicators, self.signs) > 0

    def count(self, step):
        """Return n at 2 s, by the method of Euler, which is exact for constant rates."""
        t, x = 0.0, self.update()
        while t < 2:
            inside = self.inside(t, x)
            low, high = t, min(t + step, 2.0) if 2 - t - step > 1e-12 else 2.0
            rates = self.call(self.fmu.getDerivatives, self.rates)
            event = any(self.inside(high, x + (high - t) * rates) != inside)
            while event and high - low > max(self.tolerance, 2**-52):
                middle = (low + high) / 2
                left = any(self.inside(middle, x + (middle - t) * rates) != inside)
                low, high = (low, middle) if left else (middle, high)
            end = low if event and not self.late and low > t else high
            x = x + (end - t) * rates
            t = end
            self.inside(t, x)
            if event:
                self.fmu.enterEventMode()
                x = self.update()
        return self.fmu.getReal([self.n])[0]


@pytest.mark.parametrize("late", [True, False])
@pytest.mark.parametrize("tolerance", [0, 1e-13, 1e-11])
def test_an_importer_comes_late_or_early_to_what_coincides(tolerance, late):
    for step in (0.25, 0.1, 0.0371):
        assert Importer(exported(TURNED, 2), tolerance, late).count(step) == 4
    assert Importer(exported(TEETH, 2), tolerance, late).count(0.03) == 20


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("engine", ENGINES)
def test_a_relation_that_passes_slowly_takes_no_other_one_with_it(engine):
    model = cosim.Model("flat", stop_time=5.0, output_interval=0.1)
    x, d = model.state("x", "1", 0.0, "position"), model.state("d", "1", -3.1, "distance")
    slow, w = model.state("slow", "s", 0.0, "how long"), model.state("w", "s", 0.0, "how long")
    model.derivative(x, 1)
    model.derivative(d, 1)
    model.derivative(slow, ca.if_else(d**3 > 0, 1, 0))
    model.derivative(w, ca.if_else(x > 4, 1, 0))  # before, in model exchange: from 3.1 on
    final = run_on(engine, model.freeze()).final
    assert final["slow"] == pytest.approx(1.9, abs=2e-4)
    assert final["w"] == pytest.approx(1, abs=1e-6)
