"""Impacts conserve momentum and lose the energy of their restitution; friction sticks."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from casadi import SX

import cosim
from casadi_models.dae import Model
from casadi_models.mechanics.contact import friction, impact
from cosim.errors import CosimError, FmuError, SolverError

FOLDER = Path(__file__).parents[2] / "examples"


def carts(masses, restitution, stop_time):
    """Return carts of width 0 on a track of length 1 between walls that return them."""
    model = Model("carts", stop_time=stop_time, output_interval=0.05)
    n = len(masses)
    x = ca.vertcat(*(model.state(f"x{i}", "m", (i + 0.5) / n, "place") for i in range(n)))
    v = ca.vertcat(*(model.state(f"v{i}", "m/s", 0.3 + 0.77 * i**2, "speed") for i in range(n)))
    model.derivative(x, v)
    model.derivative(v, ca.SX.zeros(n))
    gaps = [x[0], *(x[i + 1] - x[i] for i in range(n - 1)), 1 - x[n - 1]]
    for k, gap in enumerate(gaps):
        rows = ca.jacobian(gap, x).T
        impact(model, gap < 0, v, ca.diag(ca.SX(masses)), rows, restitution, name=f"contact {k}")
    model.output("energy", "J", sum(m * v[i] ** 2 / 2 for i, m in enumerate(masses)), "energy")
    return model.freeze()


@pytest.mark.slow
def test_elastic_impacts_keep_the_energy():
    run = cosim.simulate(
        carts([1.0, 2.0, 0.5], 1.0, 40.0), solver="dop853", relative_tolerance=1e-12
    )
    assert len(run.events) > 100
    np.testing.assert_allclose(run["energy"], run["energy"][0], rtol=1e-12)
    assert min(run["x0"].min(), (run["x1"] - run["x0"]).min(), (1 - run["x2"]).min()) > -1e-12


@pytest.mark.slow
def test_a_thousand_elastic_impacts_keep_the_energy():
    run = cosim.simulate(
        carts([1.0, 2.0, 0.5], 1.0, 320.0), solver="dop853", relative_tolerance=1e-12
    )
    assert len(run.events) > 1000
    assert abs(run["energy"] / run["energy"][0] - 1).max() < 1e-9


@pytest.mark.slow
def test_inelastic_impact_of_two_carts_conserves_momentum():
    run = cosim.simulate(carts([1.0, 3.0], 0.5, 2.0), solver="dop853")
    event = next(event for event in run.events if event.name == "contact 1")
    before, after = ([e["v0"], e["v1"]] for e in (event.before, event.after))
    assert np.dot([1, 3], before) == pytest.approx(np.dot([1, 3], after), rel=1e-14)
    assert after[1] - after[0] == pytest.approx(-0.5 * (before[1] - before[0]), rel=1e-13)


@pytest.mark.parametrize("size", [1e-20, 1e-13, 1.0, 1e13])
def test_balls_of_any_size_bounce_if_their_nominal_values_are_given(size):
    model = Model("ball", stop_time=1.0, output_interval=0.01)
    h = model.state("h", "m", size, "height", nominal=size)
    v = model.state("v", "m/s", 0.0, "speed", nominal=size)
    model.derivative(h, v)
    model.derivative(v, -9.81 * size)
    impact(model, h < 0, v, 1.0, SX(1), 0.7)
    run = cosim.simulate(model.freeze())
    (event,) = run.events  # before: none below 1e-12
    assert event.time == pytest.approx(np.sqrt(2 / 9.81), rel=1e-7)
    assert run["h"].min() > 0


@pytest.mark.slow
def test_two_contacts_close_at_once():
    """A plate that falls flat on two supports rebounds without turning."""
    model = Model("plate", stop_time=0.6)
    h, turn = model.state("h", "m", 1.0, "height"), model.state("turn", "rad", 0.0, "angle")
    v, w = model.state("v", "m/s", 0.0, "speed"), model.state("w", "rad/s", 0.0, "rate")
    model.derivative(ca.vertcat(h, turn), ca.vertcat(v, w))
    model.derivative(ca.vertcat(v, w), ca.vertcat(-9.81, 0))
    ends = ca.horzcat(ca.vertcat(1, 0.5), ca.vertcat(1, -0.5))
    speeds = ca.vertcat(v, w)
    impact(model, h < 0, speeds, ca.diag(ca.vertcat(2, 0.1)), ends, 0.5, name="supports")
    (event,) = cosim.simulate(model.freeze(), solver="dop853").events
    assert event.after["v"] == pytest.approx(-0.5 * event.before["v"], rel=1e-14)
    assert event.after["w"] == 0


def test_restitution_above_1_is_rejected():
    model = Model("ball")
    v = model.state("v", "m/s", 0.0, "speed")
    with pytest.raises(ValueError, match=r"restitution 1\.5 is not within 0 to 1"):
        impact(model, v < -1, v, 1, 1, 1.5)


@pytest.mark.parametrize("value", [1.5, -0.5])
@pytest.mark.parametrize("kind", ["parameter", "expression"])
def test_a_restitution_that_is_no_number_is_checked_when_it_runs(kind, value):
    model = Model("ball", stop_time=1.0)
    h, v = model.state("h", "m", 1.0, "height"), model.state("v", "m/s", 0.0, "speed")
    e = model.parameter("e", "1", 0.7, "restitution")
    model.derivative(h, v)
    model.derivative(v, -9.81)
    impact(model, h < 0, v, 1, 1, e if kind == "parameter" else e * (1 + 1e-3 * v))
    dae = model.freeze()
    assert [event.name for event in cosim.simulate(dae).events] == ["impact"]
    words = r"e = .* out of its range 0 \.\.\. 1" if kind == "parameter" else "'impact' gives .* no"
    with pytest.raises(CosimError, match=words):
        cosim.simulate(dae, start_values={"e": value})


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_the_bounds_of_a_restitution_are_no_error(value):
    model = Model("puck", stop_time=1.0)
    x, v = model.state("x", "m", 1.0, "place"), model.state("v", "m/s", -1.5, "speed")
    e = model.parameter("e", "1", value, "restitution")
    model.derivative(x, v)
    model.derivative(v, 0)
    impact(model, x < 0, v, 1, 1, 1 - (1 - e))
    assert cosim.simulate(model.freeze()).final["v"] == 1.5 * value


def resting_pendulum(restitution):
    dae = cosim.load(f"{FOLDER / 'pendulum_stop.py'}:build")
    return dae, {"stop": 0.2, "theta": 1.0, "e": restitution}  # gravity presses it on the stop


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("solver", ["dop853", "cvodes", "idas", "rk4"])
@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_a_body_that_comes_to_rest_on_another_does_not_sink_into_it(solver, restitution):
    dae, values = resting_pendulum(restitution)
    with pytest.raises(SolverError, match=r"'stop' happens ever faster .* let the motion rest"):
        cosim.simulate(dae, solver=solver, start_values=values)


@pytest.mark.parametrize("interface", ["CoSimulation", "ModelExchange"])
def test_a_body_at_rest_does_not_sink_in_an_fmu(interface, tmp_path):
    dae, values = resting_pendulum(0.0)
    file = cosim.export_fmu(dae, tmp_path / "stop.fmu")
    with pytest.raises(FmuError, match="'stop' happens ever faster"):
        cosim.simulate_fmu(file, interface=interface, start_values=values)


@pytest.mark.slow
def test_block_on_a_belt_sticks_and_slips():
    """Spring-loaded block: it sticks at the belt's speed until the spring reaches mu_s N."""
    model = Model("belt", stop_time=30.0, output_interval=0.05)
    x, v = model.state("x", "m", 0.0, "place"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(x, v)
    force = friction(v - 0.1, 1.0, 0.3, sticking=0.6, decay=1e-2)
    model.derivative(v, -x + force)
    run = cosim.simulate(model.freeze(), solver="dop853", relative_tolerance=1e-9)
    slips = [e for e in run.events if e.before["v"] == pytest.approx(0.1, abs=1e-9)]
    sticking = abs(run["v"] - 0.1) < 1e-12
    assert sticking.mean() > 0.3
    leaving = [e.before["x"] for e in run.events if e.before["x"] > 0.59]
    assert leaving  # the spring carries 0.6 N when it tears off
    assert max(leaving) == pytest.approx(0.6, abs=1e-6)
    period = np.diff([e.time for e in run.events if e.before["x"] > 0.59])
    np.testing.assert_allclose(period, period[0], rtol=1e-6)
    assert slips
