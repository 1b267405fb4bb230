"""Stiff interfaces with given macro steps: at rest, and with parts that know no such inputs."""

import numpy as np
import pytest
from helpers.crane import REST, crane
from helpers.samples import sampled

import cosim

# which the export of the arm says to importers with a solver of their own; here the parts have one
pytestmark = pytest.mark.filterwarnings("ignore:arm. terms of q1, q2 change:UserWarning")
STEPS = sampled([0.002, 0.01, 0.02], quick=[0.01])


@pytest.fixture(scope="module")
def hydraulic():
    return crane()


@pytest.mark.parametrize("step", STEPS)
def test_a_crane_at_rest_stays_there(hydraulic, step):
    run = hydraulic.simulate(stop_time=1.0, macro_step=step, output_interval=0.02)
    assert np.abs(run["arm.s"] - REST).max() < 1e-9  # measured 1e-12
    assert "note" not in run.stats  # differences as small as the rounding of parts are none


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("more", [1e-3, 1e-2])
def test_an_iterate_that_a_part_discards_is_not_the_last_word(hydraulic, more, step):
    """Pressures that begin off balance; 'a singularity' before."""
    start = {"cylinder.p1": hydraulic.parts["cylinder"].subject.states[0].start * (1 + more)}
    settings = {"stop_time": 1.0, "output_interval": 0.02, "start_values": start}
    run = hydraulic.simulate(macro_step=step, **settings)
    exact = hydraulic.simulate(accuracy=1e-6, **settings)
    assert np.abs(run["arm.s"] - exact["arm.s"]).max() < 0.05 * more  # measured 0.03


def test_a_small_heat_capacity_off_balance_is_reported():
    """1e-4 between two of 1: its temperature jumps within a step, whose cubic cannot follow."""

    def body(name, start, capacity, neighbors):
        model = cosim.Model(name, stop_time=1.0)
        t, flow = model.state("T", "1", start, "temperature"), 0
        for i in range(neighbors):
            flow += model.input(f"u{i}", "1", start, "neighbor") - t
        model.derivative(t, flow / capacity)
        return model.freeze()

    parts = {"a": body("a", 1.0, 1.0, 1), "b": body("b", 0.2, 1e-4, 2), "c": body("c", 0.0, 1.0, 1)}
    system = cosim.couple(parts, {"a.u0": "b.T", "b.u0": "a.T", "b.u1": "c.T", "c.u0": "b.T"})
    run = system.simulate(stop_time=1.0, output_interval=0.1, macro_step=0.1)
    assert run.stats["interface_error"] > 1
    assert "of their size; give a shorter macro_step, or accuracy" in run.stats["note"]
    run = system.simulate(stop_time=1.0, output_interval=0.1, accuracy=1e-6)
    assert run.final["b.T"] == pytest.approx((run.final["a.T"] + run.final["c.T"]) / 2, abs=1e-4)
    assert run.final["a.T"] + run.final["c.T"] == pytest.approx(1.0, abs=1e-4)
