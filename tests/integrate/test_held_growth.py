"""Deviations that grow by the equations, and that samples, impacts or friction hold back."""

import casadi as ca
import numpy as np
import pytest

import cosim

PUSH, RATE = 1e-13, 9.81  # rad/s2; 1/s2, of an upright pendulum


def held(period, gain, damping, release=np.inf, still=0.0, **options):
    """An upright pendulum that a sampled torque holds until it is released, s."""
    model = cosim.Model("held", **{"stop_time": 30.0, "output_interval": 0.1} | options)
    x, v = model.state("x", "rad", 0.1, "angle"), model.state("v", "rad/s", 0.0, "rate")
    torque = model.discrete("torque", "rad/s2", 0.0, "torque")
    model.derivative(x, v)
    model.derivative(v, RATE * ca.sin(x) + torque + PUSH)
    holds = 1 if release == np.inf else model.t < release
    model.every(period, {torque: ca.if_else(holds, -gain * x - damping * v, 0)})
    if still:
        model.stop(ca.logic_and(model.t > 10, v * v < still**2), "it is still")
    return model.freeze()


def on_a_ball(rate, factor):
    """An amount that a bouncing ball changes at each impact."""
    model = cosim.Model("on_a_ball", stop_time=30.0, output_interval=0.05)
    h, v = model.state("h", "m", 1.0, "height"), model.state("v", "m/s", 0.0, "speed")
    y = model.state("y", "1", 0.0, "amount")
    model.derivative(h, v)
    model.derivative(v, -9.81)
    model.derivative(y, rate * y + PUSH)
    model.when(h < 0, {v: -v, y: factor * y})
    return model.freeze()


def by_relays(kind):
    """Unstable motions that a sign or friction holds."""
    model = cosim.Model(kind, stop_time=20.0, output_interval=0.05)
    x, v = model.state("x", "1", 0.0, "place"), model.state("v", "1", 0.0, "rate")
    model.derivative(x, v)
    if kind == "sliding":
        model.derivative(v, 2 * x - 3 * ca.sign(v + 2 * x) + PUSH)
    else:
        model.derivative(v, x + 0.2 - 2 * ca.sign(v))
    return model.freeze()


HELD = {
    "fast samples": lambda: held(0.02, 30.0, 8.0),
    "slow samples": lambda: held(0.2, 15.0, 4.0),
    "stiff control": lambda: held(0.002, 1e4, 200.0, stop_time=5.0),
    "impacts": lambda: on_a_ball(0.5, 0.1),
    "sliding": lambda: by_relays("sliding"),
    "friction": lambda: by_relays("friction"),
}


@pytest.mark.parametrize("case", HELD)
@pytest.mark.parametrize("solver", ["cvodes", "dop853"])
@pytest.mark.slow_rows("cvodes-fast samples", "cvodes-stiff control")
def test_growth_that_events_hold_back_is_no_note(case, solver):
    note = cosim.simulate(HELD[case](), solver=solver).stats.get("note") or ""
    assert "grows by e" not in note  # before: at each


def test_growth_that_events_hold_back_is_no_note_of_many_runs():
    runs = cosim.simulate_many(held(0.2, 15.0, 4.0), {"x": [0.05, 0.1]})
    assert not runs.notes


def test_growth_after_events_have_held_it_is_said():
    dae = held(0.2, 15.0, 4.0, release=20.0, stop_time=60.0)
    note = cosim.simulate(dae, solver="cvodes").stats.get("note") or ""
    assert "grows by e" in note


@pytest.mark.parametrize("still", [1e-11, 1e-3])
def test_growth_is_judged_where_deviating_motions_end_at_other_times(still):
    run = cosim.simulate(held(0.2, 15.0, 4.0, still=still))
    assert "it is still from 10" in run.stats["stop"]
    assert abs(run.final["v"]) <= still


@pytest.mark.parametrize("master", ["c", "fmpy"])
def test_a_state_that_grows_only_between_samples_does_not_grow_again(master, tmp_path):
    path = cosim.export_fmu(held(0.2, 15.0, 4.0), tmp_path / "held.fmu")
    run = cosim.simulate_fmu(path, interface="ModelExchange", master=master)
    assert "shrinks" not in (run.stats.get("note") or "")  # before: at 13.6 s
