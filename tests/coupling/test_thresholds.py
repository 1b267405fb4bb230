"""Parts at thresholds: inputs that rest exactly on one, and two that reach theirs at once."""

import numpy as np
import pytest

import cosim

LEVEL = 1.2
RATES = (0.7, 3.0, 5.0, 2.0, 4.0, 1.3)


def heated(lags, *, on, rooms=1):
    """Lags in series behind a heater, all at the threshold, and the relay that switches it off."""
    relay = cosim.Model("relay")
    seen = relay.input("seen", "1", 0.0, "temperature")
    q = relay.discrete("q", "1", float(on), "heating")
    relay.when(seen > LEVEL, {q: 0}, name="off")
    parts, wires, source = {"relay": relay.freeze()}, {}, "relay.q"
    for n, own in enumerate(np.array_split(range(lags), rooms)):
        room = cosim.Model(f"room{n}", stop_time=1.0, output_interval=0.05)
        before = room.input("heat", "1", LEVEL, "temperature") if n else None
        before = before if n else 2 * room.input("heat", "1", 0.0, "heating") * LEVEL
        for i in own:
            state = room.state(f"x{i}", "1", LEVEL, "temperature")
            room.derivative(state, RATES[i] * (before - state))
            before = state
        parts[f"room{n}"], wires[f"room{n}.heat"] = room.freeze(), source
        source = f"room{n}.x{own[-1]}"
    return cosim.couple(parts, wires | {"relay.seen": source}), source


SLOW = [(2, 1, 1e-8), (3, 1, 1e-6), (4, 3, 1e-3), (5, 1, 1e-6), (6, 1, 1e-6)]


@pytest.mark.slow
@pytest.mark.parametrize("on", [True, False])
@pytest.mark.parametrize(("lags", "rooms", "accuracy"), SLOW)
def test_an_input_that_leaves_its_rest_on_a_threshold_has_left_it_at_once(
    lags, rooms, accuracy, on
):
    """Off at 0; with three lags it was 2e-6 s late, with four 3e-4 s, and in three rooms 1e-3 s."""
    system, last = heated(lags, on=on, rooms=rooms)
    run = system.simulate(accuracy=accuracy)
    rates = np.array(RATES[:lags])
    shares = [np.prod([r / (r - own) for r in rates if r != own]) for own in rates]
    exact = LEVEL * np.exp(-np.outer(run.time, rates)) @ shares
    assert [event.time for event in run.events] == [0.0] * on
    assert np.abs(run[last] - exact).max() <= run.stats["error_estimate"] <= accuracy


@pytest.mark.slow
def test_an_input_that_turns_back_to_a_threshold_passes_it_there():
    """x = t^3 - t^2/2 is 0 at 0.5 s; looks from 0 that are longer than that see a power of time."""
    mass, relay = cosim.Model("mass", stop_time=100.0, output_interval=5.0), cosim.Model("relay")
    t, x, v = (mass.state(name, "1", 0.0, name) for name in "txv")
    mass.derivative(t, 1)
    mass.derivative(x, v)
    mass.derivative(v, 6 * t - 1)
    seen = relay.input("seen", "1", 0.0, "place")
    relay.when(seen > 0, {relay.discrete("n", "1", 0.0, "count"): 1}, name="up")
    parts = {"mass": mass.freeze(), "relay": relay.freeze()}
    run = cosim.couple(parts, {"relay.seen": "mass.x"}).simulate(accuracy=1e-3)
    assert [event.time for event in run.events] == pytest.approx([0.5], abs=1e-6)
    assert "note" not in run.stats


def as_files(system, folder):
    """Return a system whose parts are files, which sessions open part by part."""
    wires = {".".join(wire.input): ".".join(wire.output) for wire in system.connections}
    files = {
        name: cosim.export_fmu(part.subject, folder / f"{name}.fmu", fmi=3)
        for name, part in system.parts.items()
    }
    return cosim.couple(files, wires, stop_time=1.0)


def test_a_session_that_goes_back_to_a_threshold_leaves_it_as_before(tmp_path):
    """The relay was 3e-4 s late: the look whether it leaves at once was made once only."""
    system = as_files(heated(4, on=True)[0], tmp_path)
    with cosim.open(system, accuracy=1e-3) as session:
        start, found = session.save(), []
        for _ in range(2):
            session.restore(start)
            events = session.advance(to=0.1)
            found.append((session.get().tobytes(), [event.time for event in events]))
    assert found[0] == found[1]
    assert found[0][1] == [0.0]


def two_relays(size):
    """x' = q, q = -1 above 0.3 and 1 below 0, as two relays see it: x = 0.3 - |t mod 0.6 - 0.3|."""
    parts, wires = {}, {}
    for name, factor in (("first", 1.0), ("second", size)):
        mass = cosim.Model(name, stop_time=1.0, output_interval=0.07)
        q = mass.input("q", "1", 1.0, "speed")
        mass.derivative(mass.state("x", "1", 0.0, "place"), q)
        relay = cosim.Model(f"{name}_relay", stop_time=1.0)
        seen = relay.input("seen", "1", 0.0, "place of the first")
        q = relay.discrete("q", "1", 1.0, "speed")
        relay.when(factor * seen > factor * 0.3, {q: -1}, name="back")
        relay.when(seen < 0, {q: 1}, name="forth")
        parts |= {name: mass.freeze(), f"{name}_relay": relay.freeze()}
        wires |= {f"{name}.q": f"{name}_relay.q", f"{name}_relay.seen": "first.x"}
    return cosim.couple(parts, wires)


@pytest.mark.slow_rows("{'macro_step': 0.1}-3.0")
@pytest.mark.parametrize("size", [1.0, 3.0])
@pytest.mark.parametrize("settings", [{"accuracy": 1e-6}, {"macro_step": 0.1}], ids=str)
def test_what_two_relays_see_at_one_instant_happens_in_both(settings, size):
    """The second relay saw x only touch 0.3, 4 off."""
    run = two_relays(size).simulate(stop_time=10.0, **settings)
    for name in ("first.x", "second.x"):
        exact = 0.3 - np.abs(run.time % 0.6 - 0.3)
        np.testing.assert_allclose(run[name], exact, rtol=0, atol=1e-12)


def test_relays_of_a_session_that_lasts_longer_than_usual_see_one_instant(tmp_path):
    """From the usual stop time on, x was 3.6 off after 5 s."""
    with cosim.open(as_files(two_relays(3.0), tmp_path), macro_step=0.1) as session:
        session.advance(to=5.0)
        places = session["first.x"], session["second.x"]
    assert places == pytest.approx([0.2, 0.2], abs=1e-12)  # measured 1e-15


@pytest.mark.slow_rows("settings0")
@pytest.mark.parametrize("settings", [{}, {"method": "extrapolated"}, {"macro_step": 0.01}])
def test_a_start_exactly_at_a_threshold_switches_once(settings):
    """T' = 4 q - T from the upper threshold 2, heated: off at 0, on at ln 2, off at ln 3."""
    room, thermostat = cosim.Model("room", stop_time=1.5), cosim.Model("th", stop_time=1.5)
    t, q = room.state("T", "1", 2.0, "T"), room.input("q", "1", 1.0, "power")
    room.derivative(t, 4 * q - t)
    u, on = thermostat.input("T", "1", 2.0, "T"), thermostat.discrete("q", "1", 1.0, "power")
    thermostat.when(u > 2, {on: 0}, name="off")
    thermostat.when(u < 1, {on: 1}, name="on")
    parts = {"room": room.freeze(), "th": thermostat.freeze()}
    system = cosim.couple(parts, {"room.q": "th.q", "th.T": "room.T"})
    run = system.simulate(stop_time=1.5, output_interval=0.01, **settings)
    assert [event.time for event in run.events] == pytest.approx(
        [0, np.log(2), np.log(3)], abs=1e-9
    )
    assert run.final["room.T"] == pytest.approx(6 * np.exp(-1.5), abs=1e-6)

    assert run["th.q"][0] == 0  # a row has the values after its events
