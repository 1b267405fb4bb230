"""Parts whose inputs rest exactly on a threshold of theirs, and then leave it: closed forms."""

import numpy as np
import pytest

import cosim

LEVEL = 1.2
RATES = (0.7, 3.0, 5.0)


def heated(lags, *, on):
    """Lags in series behind a heater, all at the threshold, and the relay that switches it off."""
    room, relay = cosim.Model("room", stop_time=1.0, output_interval=0.05), cosim.Model("relay")
    states = [room.state(f"x{i}", "1", LEVEL, "temperature") for i in range(lags)]
    before = 2 * room.input("heat", "1", 0.0, "heating") * LEVEL
    for state, rate in zip(states, RATES, strict=False):
        room.derivative(state, rate * (before - state))
        before = state
    seen = relay.input("seen", "1", 0.0, "temperature")
    q = relay.discrete("q", "1", float(on), "heating")
    relay.when(seen > LEVEL, {q: 0}, name="off")
    wires = {"room.heat": "relay.q", "relay.seen": f"room.x{lags - 1}"}
    return cosim.couple({"room": room.freeze(), "relay": relay.freeze()}, wires)


@pytest.mark.slow_rows("1e-06")
@pytest.mark.parametrize("accuracy", [1e-6, 1e-8])
@pytest.mark.parametrize("on", [True, False])
@pytest.mark.parametrize("lags", [2, 3])
def test_an_input_that_leaves_its_rest_on_a_threshold_has_left_it_at_once(lags, on, accuracy):
    """Off at 0; with two lags at 4e-8 s before, 2.3e-7 off, and with three at 2e-6 s."""
    run = heated(lags, on=on).simulate(accuracy=accuracy)
    rates = np.array(RATES[:lags])
    shares = [np.prod([r / (r - own) for r in rates if r != own]) for own in rates]
    exact = LEVEL * np.exp(-np.outer(run.time, rates)) @ shares
    assert [event.time for event in run.events] == [0.0] * on
    error = np.abs(run[f"room.x{lags - 1}"] - exact).max()
    assert error <= run.stats["error_estimate"] <= accuracy
