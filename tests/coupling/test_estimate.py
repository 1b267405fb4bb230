"""The error estimate of two co-simulation runs with different tolerances, in closed form."""

import numpy as np
import pytest

import cosim
from cosim.coupling.estimate import BY_CHANCE, UNKNOWN, estimated_error, noise_by_restarts
from cosim.coupling.stability import Ranges
from cosim.errors import SolverError


@pytest.mark.parametrize(
    ("change", "before", "least", "right"),
    [
        (7e-4, 0.0, 0.0, 1e-4),  # order 4: a sixteenth of the tolerance leaves an eighth
        (7e-4, 0.0, UNKNOWN, 7e-4),
        (7e-4, 0.0, BY_CHANCE, 3 * 7e-4),
        (1e-4, 2e-3, BY_CHANCE, 3 * 5e-4),  # 2e-3 before explains a quarter of that, no less
        (2e-3, 0.0, 0.0, 2e-3),  # above the accuracy, no order has been observed yet
        (2e-3, 8e-3, 0.0, 2e-3 / 3),
        (2e-3, 2e-3, 0.0, 2e-3),
        (0.0, 0.0, 0.0, 0.0),
    ],
)
def test_order_counts_where_it_is_observed(change, before, least, right):
    found = estimated_error(change, before, 1 / 16, 1e-3, 0.0, least=least)
    assert found == pytest.approx(right, rel=1e-12)


def test_agreement_of_runs_shows_nothing_below_the_tolerance_of_the_parts():
    assert estimated_error(0.0, 0.0, 1 / 16, 1e-3, 1e-7, least=0.0) == 1e-6


@pytest.mark.parametrize("grid", [0.0, 1e-6, 1e-4, 1e-3, 1e-2])
def test_noise_of_parts_that_start_again_is_that_of_their_rounding(grid):
    """Two lags x' = u - x that round their results; 32 short runs before."""
    runs = []

    def in_steps(length, steps):
        runs.append(steps)
        shown = [np.array([1.0, 0.0])]
        for _ in range(steps):
            fed = shown[-1][::-1]
            x = fed + (shown[-1] - fed) * np.exp(-length / steps)
            shown.append(np.round(x / grid) * grid if grid else x)
        halves = shown[: steps // 2 + 1], shown
        low, high = ([end(half, axis=0) for half in halves] for end in (np.min, np.max))
        return Ranges(np.array(low), np.array(high), np.ones(2), 0.0)

    noise = noise_by_restarts(in_steps, 1.0, np.array([True, True]))
    assert noise == 0 if grid == 0 else grid / 2 <= noise <= 5 * grid  # measured 1 to 3
    assert len(runs) == 13


def sampler(name, gain, start):
    model = cosim.Model(name, stop_time=3.0)
    u, q = model.input("u", "1", 0.0, "input"), model.discrete("q", "1", start, "held")
    model.every(0.1, {q: gain * u}, offset=0.1)
    model.output("y", "1", q + 0, "output")
    return model.freeze()


@pytest.mark.slow_rows("3.0-1.0")
@pytest.mark.parametrize(("gain", "accuracy"), [(3.0, 1.0), (10.0, 1e-3)])
def test_rounding_of_what_grows_counts(gain, accuracy):
    """Two samplers in a loop: gain^30; 'at most about 1.6e-06' before, with an error of 1.4e14."""
    parts = {"a": sampler("a", gain, 1.0), "b": sampler("b", gain, 0.5)}
    system = cosim.couple(parts, {"a.u": "b.y", "b.u": "a.y"})
    if gain > 3:
        with pytest.raises(SolverError, match=r"double precision carries a\.q to 2e\+14 nominal"):
            system.simulate(accuracy=accuracy)
        return
    run = system.simulate(accuracy=accuracy)
    assert run.final["a.q"] == gain**30
    assert run.stats["error_estimate"] > np.spacing(gain**30)


def charges(size, time):
    """Two capacitors and a resistor: q1' = -i, q2' = i, i = (q1 - q2)/time; q1 from `size`."""
    first, second = (cosim.Model(name, stop_time=3 * time) for name in ("first", "second"))
    q, other = first.state("q", "C", size, "charge"), first.input("other", "C", 0.0, "charge")
    first.derivative(q, (other - q) / time)
    first.output("i", "A", (q - other) / time, "current")
    q, i = second.state("q", "C", 0.0, "charge"), second.input("i", "A", 0.0, "current")
    second.derivative(q, i)
    wires = {"first.other": "second.q", "second.i": "first.i"}
    return cosim.couple({"first": first.freeze(), "second": second.freeze()}, wires)


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("1e-06-0.001")
@pytest.mark.parametrize("accuracy", [1e-3, 1e-6])
@pytest.mark.parametrize("time", [1e-6, 1.0, 1e5])
def test_small_inputs_are_resolved_as_large_ones_are(time, accuracy):
    """Currents of 5e-14 A were rounding: 3.8e-4 of the charge off before, estimate 7.3e-7."""
    run = charges(5e-9, time).simulate(accuracy=accuracy, output_interval=0.03 * time)
    exact = 2.5e-9 * (1 + np.exp(-2 * run.time / time))
    error = np.abs(run["first.q"] - exact).max() / 5e-9
    assert error <= run.stats["error_estimate"] <= accuracy


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e9])
def test_a_large_input_that_begins_at_zero_is_no_jump(size):
    """2.5e-6 of the size off before, with a note of a jump."""
    run = charges(size, 1.0).simulate(macro_step=0.02, output_interval=0.02)
    exact = size / 2 * (1 + np.exp(-2 * run.time))
    assert np.abs(run["first.q"] - exact).max() < 5e-9 * size  # measured 1.4e-9
    assert "jumps" not in run.stats.get("note", "")


def test_events_within_steps_leave_no_order_to_an_estimate():
    """The part has no event mode: an error of 9.8e-6 was 'at most about 1.6e-6'."""
    plant, controller = (cosim.Model(name, stop_time=3.0, output_interval=0.01) for name in "pc")
    x, v = plant.state("x", "1", 1.0, "place"), plant.state("v", "1", 0.3, "speed")
    plant.derivative(x, v)
    plant.derivative(v, plant.input("u", "1", 0.0, "force") - x - 0.1 * v)
    y, w = (controller.input(name, "1", 0.0, name) for name in "yw")
    held = controller.discrete("h", "1", 0.0, "force")
    controller.every(0.15, {held: -3 * y - 2 * w})
    wires = {"p.u": "c.h", "c.y": "p.x", "c.w": "p.v"}
    parts, abilities = {"p": plant.freeze(), "c": controller.freeze()}, {"c": "no event mode"}
    system = cosim.couple(parts, wires, abilities=abilities)
    run = system.simulate(accuracy=1e-4)
    exact = cosim.simulate(system.dae, output_interval=0.01, relative_tolerance=1e-11)
    error = max(np.abs(run[name] - exact[name]).max() for name in ("p.x", "p.v"))
    assert error <= run.stats["error_estimate"] <= 1e-4
