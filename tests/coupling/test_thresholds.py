"""Parts at thresholds: inputs that rest exactly on one, and two that reach theirs at once."""

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


@pytest.mark.slow_rows("{'macro_step': 0.1}-3.0")
@pytest.mark.parametrize("size", [1.0, 3.0])
@pytest.mark.parametrize("settings", [{"accuracy": 1e-6}, {"macro_step": 0.1}], ids=str)
def test_what_two_relays_see_at_one_instant_happens_in_both(settings, size):
    """x' = q, q = -1 above 0.3 and 1 below 0: the second relay saw x only touch 0.3, 4 off."""
    parts, wires = {}, {}
    for name, factor in (("first", 1.0), ("second", size)):
        mass = cosim.Model(name, stop_time=1.0, output_interval=0.07)
        q = mass.input("q", "1", 1.0, "speed")
        mass.derivative(mass.state("x", "1", 0.0, "place"), q)
        relay = cosim.Model(f"{name}_relay")
        seen = relay.input("seen", "1", 0.0, "place of the first")
        q = relay.discrete("q", "1", 1.0, "speed")
        relay.when(factor * seen > factor * 0.3, {q: -1}, name="back")
        relay.when(seen < 0, {q: 1}, name="forth")
        parts |= {name: mass.freeze(), f"{name}_relay": relay.freeze()}
        wires |= {f"{name}.q": f"{name}_relay.q", f"{name}_relay.seen": "first.x"}
    run = cosim.couple(parts, wires).simulate(**settings)
    for name in ("first.x", "second.x"):
        exact = 0.3 - np.abs(run.time % 0.6 - 0.3)
        np.testing.assert_allclose(run[name], exact, rtol=0, atol=1e-12)
