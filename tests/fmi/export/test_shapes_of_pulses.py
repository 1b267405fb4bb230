"""Short changes of terms that have no value, or grow beyond all numbers, elsewhere on the way."""

import casadi as ca
import numpy as np
import pytest

import cosim
from cosim.codegen.landmarks import landmarks

PLACE, WIDTH = 5.123, 1e-5  # of a state that goes from 0 to 10 in 10 s
AREA = np.sqrt(np.pi)


def share(s):
    return (s - PLACE) / WIDTH


def behind(s, force):
    return ca.if_else(s > PLACE, force, 0)


SHAPES = {  # with the area
    "logarithm": (lambda s: ca.exp(-((ca.log((s + 1e-3) / PLACE) / WIDTH) ** 2)) / PLACE, AREA),
    "inverse": (lambda s: ca.exp(-(((1 / (s + 0.1) - 0.2) / WIDTH) ** 2)), AREA / 0.2**2),
    "surge": (lambda s: behind(s, ca.exp(-share(s)) - ca.exp(-2 * share(s))), 0.5),
    "gamma": (lambda s: behind(s, share(s) * ca.exp(-share(s))), 1.0),
}


def pushed(shape, *, of_time=False):
    """Return a state that moves evenly, and the integral of a term of it, or of time."""
    model = cosim.Model("pushed", stop_time=10.0)
    s, y = (model.state(name, "1", 0.0, name) for name in ("s", "y"))
    model.derivative(s, 1.0)
    model.derivative(y, SHAPES[shape][0](model.t if of_time else s) / WIDTH)
    return model.freeze()


@pytest.mark.parametrize("of_time", [False, True], ids=["state", "time"])
@pytest.mark.parametrize("shape", SHAPES)
def test_no_step_passes_over_a_short_change_beside_other_values(shape, of_time):
    """Each contributed 0, with no note, but for the first of them in single runs."""
    dae, right = pushed(shape, of_time=of_time), SHAPES[shape][1]
    run = cosim.simulate(dae, solver="dop853", output_interval=0.5)
    assert run["y"][-1] == pytest.approx(right, rel=1e-3)
    many = cosim.simulate_many(dae, {"s": [0.0, 0.0]}, output_interval=0.5)
    np.testing.assert_allclose(many["y"][:, -1], right, rtol=1e-3)


@pytest.mark.parametrize("of_time", [False, True], ids=["state", "time"])
def test_a_power_of_a_term_beyond_all_numbers_has_bounds(of_time):
    model = cosim.Model("pushed", stop_time=10.0)
    s, y = (model.state(name, "1", 0.0, name) for name in ("s", "y"))
    model.derivative(s, 1.0)
    model.derivative(y, 1 / ca.cosh(share(model.t if of_time else s)) ** 2 / WIDTH)
    run = cosim.simulate(model.freeze(), solver="dop853", output_interval=0.5)
    assert run["y"][-1] == pytest.approx(2.0, rel=1e-3)  # before: 0


@pytest.mark.parametrize("interface", ["CoSimulation", "ModelExchange"])
@pytest.mark.parametrize("shape", SHAPES)
def test_no_importer_steps_over_a_short_change_beside_other_values(shape, interface, tmp_path):
    path = cosim.export_fmu(pushed(shape), tmp_path / "x.fmu")
    run = cosim.simulate_fmu(path, interface=interface, output_interval=0.5)
    assert run["y"][-1] == pytest.approx(SHAPES[shape][1], rel=1e-3)  # before: 0


def test_a_step_beyond_all_numbers_behind_an_event_is_shortened(tmp_path):
    """The sign of the share is that of before the event; the run ended with an error."""
    model = cosim.Model("pushed", stop_time=10.0)
    s, y = (model.state(name, "1", 0.0, name) for name in ("s", "y"))
    model.derivative(s, 1.0)
    model.derivative(y, ca.exp(-ca.fabs(share(s))) / WIDTH)
    path = cosim.export_fmu(model.freeze(), tmp_path / "x.fmu")
    run = cosim.simulate_fmu(path, interface="ModelExchange", output_interval=0.5)
    assert run["y"][-1] == pytest.approx(2.0, rel=1e-3)


@pytest.mark.parametrize("pole", [lambda s: 1 / s, lambda s: 1 / s**2, lambda s: ca.log(s) / s])
def test_a_pole_is_no_short_change(pole):
    s, y = ca.SX.sym("s"), ca.SX.sym("y")
    dae = cosim.from_casadi({"x": ca.vertcat(s, y), "ode": ca.vertcat(1, pole(s - 0.5))}, {"s": 1})
    assert landmarks(dae).arguments.numel() == 0


def test_places_that_are_equal_at_first_follow_their_own_parameters(tmp_path):
    model = cosim.Model("pushed", stop_time=10.0)
    s, y = (model.state(name, "1", 0.0, name) for name in ("s", "y"))
    one, other = (model.parameter(name, "1", PLACE, name) for name in ("one", "other"))
    model.derivative(s, 1.0)
    bumps = (ca.exp(-(((s - place) / WIDTH) ** 2)) for place in (one, other))
    model.derivative(y, (next(bumps) + 2 * next(bumps)) / WIDTH)
    path = cosim.export_fmu(model.freeze(), tmp_path / "x.fmu")
    for interface in ("CoSimulation", "ModelExchange"):
        for values in ({}, {"other": 3.3}, {"one": 3.3}):
            run = cosim.simulate_fmu(path, interface=interface, start_values=values)
            assert run["y"][-1] == pytest.approx(3 * AREA, rel=1e-3)  # before: 1 or 2 of the areas
