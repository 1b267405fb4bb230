"""Events between parts that tell no rates, or hold their inputs, against matrix exponentials."""

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm

import cosim
from cosim.errors import SolverError

NEVER = 10.0
CASES = {  # heat, loss, rate, limits and start of a room, then when its relay switches, s
    "rising": (
        (3.237080898841792, 0.8512773409671586, 7.44884463095329),
        (1.3431887472358124, 0.4549108309622829),
        (0.0, 0.0),
        (0.6526378876252462, 2.2878107631611435, 2.805752297279066),
    ),
    "from a limit": (
        (4.8148371917927815, 0.27914860366783084, 4.145865227305459),
        (0.800878943148129, 0.5376430231851077),
        (0.6140826580658575, 0.800878943148129),
        (0.07696275722247146, 2.431791245178908, 2.6277488877067015),
    ),
}


def room():
    """Air T and a wall W: T' = heat q - loss T, W' = rate (T - W)."""
    model = cosim.Model("room", stop_time=3.0, output_interval=0.02)
    heat, loss, rate = (model.parameter(n, "1", 1.0, n) for n in ("heat", "loss", "rate"))
    air, wall = model.state("T", "1", 0.0, "air"), model.state("W", "1", 0.0, "wall")
    model.derivative(air, heat * model.input("q", "1", 0.0, "heating") - loss * air)
    model.derivative(wall, rate * (air - wall))
    return model.freeze()


def relay():
    model = cosim.Model("relay", stop_time=3.0, output_interval=0.02)
    high, low = (model.parameter(n, "1", 1.0, n) for n in ("high", "low"))
    seen, on = model.input("s", "1", 0.0, "wall"), model.discrete("q", "1", 1.0, "heating")
    model.when(seen > high, {on: 0}, name="off")
    model.when(seen < low, {on: 1}, name="on")
    return model.freeze()


def walls(numbers, start, switches, times):
    """Return W at times."""
    heat, loss, rate = numbers
    found, at, since, on = np.empty(len(times)), np.array([*start, 1.0]), 0.0, 1.0
    for until in (*switches, NEVER):
        law = np.array([[-loss, 0, heat * on], [rate, -rate, 0], [0, 0, 0]])
        for row in np.flatnonzero((times >= since) & (times < until)):
            found[row] = (expm(law * (times[row] - since)) @ at)[1]
        at, since, on = expm(law * (until - since)) @ at, until, 1 - on
    return found


@pytest.mark.slow_rows("rising-{'relay': 'no interpolation'}")
@pytest.mark.parametrize(
    "abilities", [{"room": "no rates"}, {"relay": "no interpolation"}], ids=str
)
@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_a_relay_of_few_abilities_switches_once_at_each_limit(case, abilities, tmp_path):
    """'(Zeno)' without rates, and events that cause each other with held inputs, before."""
    numbers, limits, start, switches = case
    files = {
        "room": cosim.export_fmu(room(), tmp_path / "room.fmu", fmi=3),
        "relay": cosim.export_fmu(relay(), tmp_path / "relay.fmu", fmi=3),
    }
    names = ("room.heat", "room.loss", "room.rate", "relay.high", "relay.low", "room.T", "room.W")
    values = dict(zip(names, (*numbers, *limits, *start), strict=True))
    wires = {"room.q": "relay.q", "relay.s": "room.W"}
    system = cosim.couple(files, wires, start_values=values, abilities=abilities)
    run = system.simulate(accuracy=1e-3, stop_time=3.0, output_interval=0.02)
    error = np.abs(run["room.W"] - walls(numbers, start, switches, run.time)).max()
    assert error <= run.stats["error_estimate"] <= 1e-3
    turned = np.flatnonzero(np.diff(run["relay.q"]))
    assert [*run.time[turned]] == pytest.approx([*switches], abs=0.021)
    if "room" in abilities:
        assert [event.time for event in run.events] == pytest.approx([*switches], abs=1e-8)


def test_iteration_that_cannot_take_a_step_back_is_an_error_that_says_so(tmp_path):
    """A clutch that is almost dry friction; before, it was restored to a state that it never had.

    That was a segmentation fault in files of other tools.
    """
    rotor, clutch = cosim.Model("rotor", stop_time=1.0), cosim.Model("clutch", stop_time=1.0)
    v, x = rotor.state("v", "m/s", 0.5, "speed"), clutch.state("x", "m/s", 0.0, "speed")
    rotor.derivative(v, 0.3 - rotor.input("F", "N", 0.0, "force"))
    force = ca.tanh(1e4 * (clutch.input("u", "m/s", 0.0, "speed") - x))
    clutch.derivative(x, force)
    clutch.output("F", "N", force, "force")
    models = rotor.freeze(), clutch.freeze()
    files = {m.name: cosim.export_fmu(m, tmp_path / f"{m.name}.fmu") for m in models}
    wires, abilities = {"rotor.F": "clutch.F", "clutch.u": "rotor.v"}, {"clutch": "no rollback"}
    system = cosim.couple(files, wires, abilities=abilities)
    with pytest.raises(
        SolverError, match=r"the iteration of the input .* diverges after .* give macro"
    ):
        system.simulate(accuracy=1e-2)


def test_events_that_no_step_can_end_at_are_in_the_estimate():
    """A third part cannot go back; with estimate 0.097, the error was 0.66."""
    numbers, limits, start, switches = CASES["from a limit"]
    lag = cosim.Model("lag", stop_time=3.0)
    y = lag.state("y", "1", 0.0, "output")
    lag.derivative(y, 10 * (lag.input("u", "1", 0.0, "input") - y))
    names = ("room.heat", "room.loss", "room.rate", "relay.high", "relay.low", "room.T", "room.W")
    values = dict(zip(names, (*numbers, *limits, *start), strict=True))
    system = cosim.couple(
        {"room": room(), "relay": relay(), "lag": lag.freeze()},
        {"relay.s": "room.W", "room.q": "relay.q", "lag.u": "room.T"},
        start_values=values,
        abilities={"lag": "no rollback"},
    )
    run = system.simulate(stop_time=3.0, accuracy=0.1, outputs=["room.W", "lag.y"])
    error = np.abs(run["room.W"] - walls(numbers, start, switches, run.time)).max()
    assert error <= run.stats["error_estimate"] <= 0.1
