"""Events at the edges of what numbers can hold: on a boundary at the start, beside fast states."""

from itertools import product

import pytest

import cosim
from casadi_models.dae import Model

WAYS = ["dop853", "cvodes", "CoSimulation", "ModelExchange"]


def runs(dae, folder, ways):
    path = cosim.export_fmu(dae, folder / "model.fmu")
    for way in ways:
        if way in {"dop853", "cvodes"}:
            yield cosim.simulate(dae, solver=way, stop_time=2.5)
        else:
            yield cosim.simulate_fmu(path, interface=way, stop_time=2.5)


def ball(condition, speed, rate=0.0, unit=1.0):
    """A ball that starts on the ground, at g = 1 unit/s2, beside a state that grows."""
    model = Model("ball")
    h = model.state("h", "m", 0.0, "height", nominal=unit)
    v = model.state("v", "m/s", speed * unit, "speed", nominal=unit)
    fast, n = model.state("fast", "1", 0.0, "fast"), model.discrete("n", "1", 0, "events")
    model.derivative(h, v)
    model.derivative(v, -unit)
    model.derivative(fast, rate)
    model.when(condition(h, model.t), {n: n + 1, v: v * 0.5}, name="hit")
    return model.freeze()


# A condition that its boundary value leaves false becomes true with the first motion, as in
# Modelica; one that it makes true has been true before the start.
AT_THE_START = {
    "h < 0": (lambda h, t: h < 0, {-1: [0.0], 1: [2.0]}),
    "h <= 0": (lambda h, t: h <= 0, {-1: [], 1: [2.0]}),
    "h > 0": (lambda h, t: h > 0, {-1: [], 1: [0.0]}),
    "h >= 0": (lambda h, t: h >= 0, {-1: [], 1: []}),
    "t > 0": (lambda h, t: t > 0, {-1: [0.0], 1: [0.0]}),
    "t >= 0": (lambda h, t: t >= 0, {-1: [], 1: []}),
}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "speed"), [*product(AT_THE_START, [-1, 1])])
def test_a_start_on_the_boundary(name, speed, tmp_path):
    condition, times = AT_THE_START[name]
    for run in runs(ball(condition, speed), tmp_path, WAYS):
        assert [event.time for event in run.events] == pytest.approx(times[speed], abs=1e-6)
        assert run.final["n"] == pytest.approx(len(times[speed]), rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "unit"), [(1e11, 1.0), (1e16, 1e-16)])
def test_what_counts_as_zero_has_the_size_of_the_own_states(rate, unit, tmp_path):
    dae = ball(lambda h, t: h < 0, 1, rate, unit)
    for run in runs(dae, tmp_path, ["dop853", "CoSimulation", "ModelExchange"]):
        assert [event.time for event in run.events] == pytest.approx([2.0], abs=1e-6)
