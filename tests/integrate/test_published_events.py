"""Published problems with events: Robertson's roots, and the discontinuous problems of DETEST."""

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

import cosim
from casadi_models.dae import Model


def robertson():
    model = Model("robertson", stop_time=4e10, output_interval=4e7)
    y1, y2, y3 = (model.state(f"y{i}", "1", float(i == 1), "share") for i in (1, 2, 3))
    rate = -0.04 * y1 + 1e4 * y2 * y3
    model.derivative(y1, rate)
    model.derivative(y3, 3e7 * y2**2)
    model.derivative(y2, -rate - 3e7 * y2**2)
    count = model.discrete("count", "1", 0.0, "number of roots")
    model.when(y3 > 0.01, {count: count + 1}, name="y3")
    model.when(y1 < 1e-4, {count: count + 1}, name="y1")
    return model.freeze()


@pytest.mark.quick_rows("idas")
@pytest.mark.parametrize("solver", ["cvodes", "idas", "rosenbrock"])
def test_roots_of_robertsons_problem(solver):
    times = np.concatenate(([0.0], np.geomspace(1e-3, 4e10, 300)))
    run = cosim.simulate(
        robertson(), solver=solver, output_times=times, relative_tolerance=1e-9,
        absolute_tolerance=1e-14,
    )  # fmt: skip
    found = {event.name: event.time for event in run.events}
    assert found["y3"] == pytest.approx(0.26401908, rel=1e-6)
    assert found["y1"] == pytest.approx(2.07954969e7, rel=1e-5)
    assert run.final["count"] == 2


def detest(number):
    """Return a discontinuous problem of DETEST (Enright & Pryce 1987), F1 to F4."""
    model = Model(f"F{number}", stop_time=20.0, output_interval=0.1)
    t = model.t
    odd = ca.fmod(ca.floor(t), 2)
    y = model.state("y", "1", {1: 0.0, 2: 110.0, 3: 0.0, 4: 1.0}[number], "y")
    if number == 2:
        model.derivative(y, 55 - ca.if_else(odd > 0.5, 0.5, 1.5) * y)
    elif number == 4:
        early = -2 / 21 - 120 * (t - 5) / (1 + 4 * (t - 5) ** 2) ** 2
        model.derivative(y, ca.if_else(t <= 10, early, -2 * y))
    else:
        v = model.state("v", "1", 0.0, "v")
        model.derivative(y, v)
        if number == 1:
            force = ca.if_else(odd > 0.5, -1, 1)
            model.derivative(v, 0.2 * v - (np.pi**2 + 0.01) * y + force)
        else:
            force = ca.fabs(ca.sin(np.pi * t))
            model.derivative(v, 0.01 * v * (1 - y**2) - y - force)
    return model.freeze()


def smooth_pieces(number):
    """Return y(20) of a DETEST problem, integrated from switch to switch by scipy."""

    def law(t, y, side):
        if number == 1:
            return [y[1], 0.2 * y[1] - (np.pi**2 + 0.01) * y[0] + (-1) ** side]
        if number == 2:
            return [55 - (0.5 if side % 2 else 1.5) * y[0]]
        if number == 3:
            force = (-1) ** side * np.sin(np.pi * t)
            return [y[1], 0.01 * y[1] * (1 - y[0] ** 2) - y[0] - force]
        if side < 10:
            return [-2 / 21 - 120 * (t - 5) / (1 + 4 * (t - 5) ** 2) ** 2]
        return [-2 * y[0]]

    y = {1: [0.0, 0.0], 2: [110.0], 3: [0.0, 0.0], 4: [1.0]}[number]
    for side in range(20):
        found = solve_ivp(law, (side, side + 1), y, "DOP853", args=(side,), rtol=1e-13, atol=1e-15)
        y = found.y[:, -1]
    return y[0]


@pytest.mark.slow_rows("cvodes-1")
@pytest.mark.quick_rows("cvodes-1", "cvodes-2", "cvodes-3", "cvodes-4")
@pytest.mark.parametrize("number", [1, 2, 3, 4])
@pytest.mark.parametrize("solver", ["dop853", "cvodes", "erk"])
def test_discontinuous_problems_of_detest(number, solver):
    run = cosim.simulate(detest(number), solver=solver, relative_tolerance=1e-10)
    scale = max(1.0, abs(run["y"]).max())
    error = 1e-7 if solver == "cvodes" else 2e-9
    assert run.final["y"] == pytest.approx(smooth_pieces(number), abs=error * scale)


def brake(decay):
    """Return a shaft under 5 N.m, braked by 40 N at 1 m from 0.5 to 2 s, as Rotational.Brake."""
    model = Model("brake", stop_time=3.0)
    w = model.state("w", "rad/s", 10.0, "speed")
    pressed = ca.logic_and(model.t >= 0.5, model.t < 2)
    normal = 40 * ca.if_else(pressed, 1, 0)
    torque = cosim.contact.friction(w, normal, 0.5, sticking=0.55, decay=decay)
    model.derivative(w, 5 + torque)
    model.output("torque", "N.m", torque, "braking torque")
    return model.freeze()


@pytest.mark.quick_rows("0.001-idas", "0.1-idas")
@pytest.mark.parametrize("solver", ["dop853", "erk", "rosenbrock", "cvodes", "idas"])
@pytest.mark.parametrize("decay", [1e-3, 0.1])
def test_brake_holds_a_shaft_from_its_closed_form_on(decay, solver):
    def slowness(w):
        return 1 / (15 + 2 * np.exp(-((w / decay) ** 2)))

    points = [decay, 2 * decay, 5 * decay, 10 * decay]
    rest = 0.5 + quad(slowness, 0, 12.5, points=points, epsabs=1e-15, limit=500)[0]
    run = cosim.simulate(brake(decay), solver=solver, relative_tolerance=1e-10)
    stop = next(event for event in run.events if event.name.startswith("sign"))
    assert stop.time == pytest.approx(rest, abs=1e-9)  # measured 1e-10
    held = (run.time > rest) & (run.time < 2)
    assert np.abs(run["w"][held]).max() < 1e-13
    np.testing.assert_allclose(run["torque"][held], -5, rtol=0, atol=1e-9)
    assert run.final["w"] == pytest.approx(5.0, abs=1e-12)


def clutches():
    """Return four inertias of 1 kg.m2 with three clutches, as Rotational CoupledClutches."""
    model = Model("clutches", stop_time=1.5, output_interval=0.003)
    t = model.t
    w = [model.state(f"w{i}", "rad/s", 10.0 if i == 1 else 0.0, "speed") for i in (1, 2, 3, 4)]
    normal = [20 * ca.fmax(0, ca.sin(0.4 * np.pi * t + 1.57))]
    normal += [20 * ca.if_else(t >= begin, 1, 0) for begin in (0.4, 0.9)]
    torques = [10 * ca.sin(10 * np.pi * t)]
    for i, force in enumerate(normal):
        friction = cosim.contact.friction(w[i] - w[i + 1], force, 0.5, sticking=0.55, decay=0.05)
        torques[i] += friction
        torques.append(-friction)
    for speed, torque in zip(w, torques, strict=True):
        model.derivative(speed, torque)
    return model.freeze()


# by scipy's DOP853 at 1e-12 with a state machine of sliding and sticking clutches
LOCKED = [0.709365, 0.790992, 0.831167, 0.898230, 1.000333, 1.143869]
SPEEDS = [3.24038813, 2.46541055, 2.46541055, 2.46541055]


@pytest.mark.slow
@pytest.mark.parametrize(
    "solver", ["dop853", "rk4", "ode8", "erk", "cvodes", "cvodes_adams", "idas"]
)
@pytest.mark.parametrize("tolerance", [1e-6, 1e-9])
def test_clutches_lock_and_slip_in_the_same_order(tolerance, solver):
    own = {} if solver in ("rk4", "ode8") else {"relative_tolerance": tolerance}
    run = cosim.simulate(clutches(), solver=solver, **own)
    times = [event.time for event in run.events if event.name.startswith("sign")]
    np.testing.assert_allclose(times, LOCKED, rtol=0, atol=50 * tolerance + 1e-6)  # 26
    speeds = [run.final[f"w{i}"] for i in (1, 2, 3, 4)]
    np.testing.assert_allclose(speeds, SPEEDS, rtol=0, atol=300 * tolerance)  # 114
    turned = 10 + (1 - np.cos(10 * np.pi * 1.5)) / np.pi  # momentum, by the torque from outside
    assert sum(speeds) == pytest.approx(turned, abs=600 * tolerance)
