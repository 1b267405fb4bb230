"""Places of terms that grow, or that relations shift: importers and lanes pass over none."""

import casadi as ca
import numpy as np
import pytest
from casadi import SX

import cosim
from cosim.codegen.landmarks import landmarks

INTERFACES = ["CoSimulation", "ModelExchange"]
AREA, SPEED, WIDTH = np.sqrt(np.pi), 10.0, 1e-4  # of exp(-c**2)


def turning(term, p=(), **starts):
    """Return the integral of a term of a circle's coordinates, over seven of its radians."""
    x, w, y = SX.sym("x"), SX.sym("w"), SX.sym("y")
    laws = {"x": ca.vertcat(x, w, y), "p": ca.vertcat(*p), "ode": ca.vertcat(w, -x, term(x, w))}
    options = {"name": "turning", "stop_time": 7, "output_interval": 0.5}
    return cosim.from_casadi(laws, {"w": 1.0, **starts}, **options)


K = 1e6
GROWING = {  # with their integrals, in the times in which they fall by a factor of exp(1 / 2)
    "one state": (lambda x, w: ca.exp(K * (x - 1)), 1.0),
    "in both directions": (lambda x, w: ca.exp(K / 2 * (x * x - 1)), 2.0),
    "with a factor": (lambda x, w: x * ca.exp(K * (x - 1)), 1.0),
    "several states": (lambda x, w: ca.exp(K * (x + w - np.sqrt(2))), 2**-0.25),
}


@pytest.mark.slow_rows("both", "factor")
@pytest.mark.parametrize("shape", GROWING)
def test_nothing_steps_over_a_term_that_grows_up_to_where_states_turn(shape, tmp_path):
    form, share = GROWING[shape]
    dae = turning(lambda x, w: np.sqrt(K / (2 * np.pi)) * form(x, w))
    path = cosim.export_fmu(dae, tmp_path / "x.fmu")
    tight = {"relative_tolerance": 1e-10}
    for interface in INTERFACES:
        run = cosim.simulate_fmu(path, interface=interface, **tight)
        assert run.final["y"] == pytest.approx(share, rel=1e-2)  # before: 0
    many = cosim.simulate_many(dae, {"w": [1.0, 1.0]}, solver="dop853", **tight)
    np.testing.assert_allclose(many["y"][:, -1], share, rtol=1e-3)  # before: 0


def test_places_of_a_term_that_grows_follow_its_parameters(tmp_path):
    k, top = SX.sym("k"), SX.sym("top")
    dae = turning(lambda x, w: ca.sqrt(k) * ca.exp(k * (x - top)), (k, top), k=1e5, top=1.0)
    path = cosim.export_fmu(dae, tmp_path / "x.fmu")
    for height in (1.0, 2.0):
        values = {"k": 1e6, "top": height, "w": height}
        run = cosim.simulate_fmu(path, interface="CoSimulation", start_values=values)
        right = np.sqrt(2 * np.pi / height)
        assert run.final["y"] == pytest.approx(right, rel=1e-3)  # before: 0


@pytest.mark.parametrize(
    "force",
    [
        lambda v: ca.exp(v),
        lambda v: ca.exp(v / 0.026),  # a diode
        lambda v: ca.cosh(v),
        lambda v: v**3,
        lambda v: 1 / (v - 0.5) ** 2,
        lambda v: ca.tanh(v / 1e-4),
    ],
)
def test_terms_that_grow_slowly_have_no_places(force):
    assert landmarks(turning(lambda x, w: force(w))).arguments.numel() == 0


def on_way(road, more=(), rates=()):
    """Return the integral of a term of a way and time."""
    t, s, y = SX.sym("t"), SX.sym("s"), SX.sym("y")
    laws = {"t": t, "x": ca.vertcat(s, y, *more), "ode": ca.vertcat(SPEED, road(t, s), *rates)}
    return cosim.from_casadi(laws, name="way", stop_time=7, output_interval=0.5)


def bump(c):
    return ca.exp(-((c / WIDTH) ** 2)) / WIDTH


OTHER = SX.sym("v")
SHIFTED = {  # bumps that relations shift, with their number at the speed of the way
    "remainder of time": (lambda t, s: bump(ca.fmod(t, 1) - 0.5), 7 * SPEED),
    "remainder of the way": (lambda t, s: bump(ca.fmod(s, 7) - 3.5), 10),
    "distance": (lambda t, s: bump(ca.fabs(s - 50.3) - 1), 2),
    "limit": (lambda t, s: bump(ca.fmin(ca.fmax(s - 50.3, -3), 3) - 1), 1),
    "branch": (lambda t, s: bump(s - ca.if_else(t > 4, 50.3, 30)), 2),
    "window": (lambda t, s: bump(s - ca.if_else(ca.logic_and(t > 1, t < 4), 30, 50.3)), 2),
    "branch by or": (lambda t, s: bump(s - ca.if_else(ca.logic_or(t < 1, t > 4), 50.3, 30)), 2),
    "slope of a branch": (lambda t, s: bump(ca.if_else(s > 40, s - 50.3, 2 * (s - 30.3))), 1.5),
    "two states": (lambda t, s: bump(s + OTHER - 13 * ca.floor(t) - 5.3), 7 / 1.3),
}


@pytest.mark.slow_rows("time", "distance", "branch", "window", "slope", "states")
@pytest.mark.parametrize("shape", SHIFTED)
def test_nothing_steps_over_a_bump_that_relations_shift(shape, tmp_path):
    form, count = SHIFTED[shape]
    both = ((OTHER,), (3.0,)) if shape == "two states" else ((), ())
    dae, right = on_way(form, *both), count * AREA / SPEED
    run = cosim.simulate(dae, solver="dop853")
    assert run.final["y"] == pytest.approx(right, rel=1e-4)  # before: 0 between limits, with a note
    assert "note" not in run.stats
    path = cosim.export_fmu(dae, tmp_path / "x.fmu")
    for interface in INTERFACES:
        run = cosim.simulate_fmu(path, interface=interface)
        assert run.final["y"] == pytest.approx(right, rel=1e-3)  # before: 0


def sine(s):
    return np.sin(s) if isinstance(s, np.ndarray) else ca.sin(s)


ARGUMENTS = {  # of a table, of what moves at a speed
    "square": (lambda s: s * s / 50, 46, 48, SPEED),
    "wave": (lambda s: 55 * sine(s / 10), 0, 70, SPEED),
    "square of time": (lambda t: t * t, 6, 7, 1),
}


@pytest.mark.slow_rows("wave", "time")
@pytest.mark.parametrize("shape", ARGUMENTS)
def test_nothing_steps_over_a_bump_of_a_table_whose_argument_is_no_line(shape, tmp_path):
    form, begin, end, speed = ARGUMENTS[shape]
    knots, values = [0, 44, 44.01, 44.02, 60], [0, 0, 100, 0, 0]
    table = ca.interpolant("table", "linear", [knots], values)
    t, s, y = ca.MX.sym("t"), ca.MX.sym("s"), ca.MX.sym("y")
    moving = t if "time" in shape else s
    laws = {"t": t, "x": ca.vertcat(s, y), "ode": ca.vertcat(SPEED, table(form(moving)))}
    dae = cosim.from_casadi(laws, name="curved", stop_time=7, output_interval=0.5)
    at = np.linspace(begin, end, 1_000_001)
    right = np.trapezoid(np.interp(form(at), knots, values), at) / speed
    run = cosim.simulate(dae, solver="dop853")
    assert run.final["y"] == pytest.approx(right, rel=1e-2)  # before: 0
    path = cosim.export_fmu(dae, tmp_path / "x.fmu")
    for interface in INTERFACES:
        run = cosim.simulate_fmu(path, interface=interface)
        assert run.final["y"] == pytest.approx(right, rel=1e-2)  # before: 0
