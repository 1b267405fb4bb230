"""The monolith of a coupled system against the same equations written as one model."""

import casadi as ca
import numpy as np
import pytest

import cosim
from casadi_models.dae import Model
from cosim.coupling.files import read_system
from cosim.drawing.pose import motion
from cosim.errors import UsageError

FOLDER = "examples/coupled"


def whole_quarter_car():
    model = Model("car", stop_time=3.0)
    x = model.state("x", "m", 0.0, "wheel")
    v = model.state("v", "m/s", 0.0, "wheel")
    y, w = model.state("y", "m", 0.0, "chassis"), model.state("w", "m/s", 0.0, "chassis")
    force = 15e3 * (y - x) + 1e3 * (w - v)
    road = 0.1 * ca.exp(-(((model.t - 1) / 0.15) ** 2))
    model.derivative(x, v)
    model.derivative(v, (force - 150e3 * (x - road)) / 40)
    model.derivative(y, w)
    model.derivative(w, -force / 400)
    return model.freeze()


@pytest.mark.slow
def test_quarter_car_is_the_model_written_as_one():
    ways = {"solver": "dop853", "relative_tolerance": 1e-11}
    system = read_system(f"{FOLDER}/quarter_car.toml")
    whole, coupled = cosim.simulate(whole_quarter_car(), **ways), cosim.simulate(system.dae, **ways)
    for one, other in (("x", "wheel.x"), ("w", "chassis.v")):
        np.testing.assert_allclose(coupled[other], whole[one], rtol=0, atol=1e-11)
    force = 15e3 * (whole["y"] - whole["x"]) + 1e3 * (whole["w"] - whole["v"])
    np.testing.assert_allclose(coupled["wheel.force"], force, rtol=0, atol=1e-7)


@pytest.mark.slow
def test_one_model_may_occur_twice_and_units_are_converted():
    def clock(unit, factor):
        model = Model("clock")
        angle = model.state("angle", "rad", 0.0, "angle")
        rate = model.input("rate", "rad/s", 1.0, "rate")
        model.derivative(angle, rate)
        model.output("shown", unit, factor * angle, "the angle")
        return model.freeze()

    degrees = clock("deg", 180 / np.pi)
    turned = Model("turned")
    angle = turned.input("angle", "rad", 0.0, "angle")
    turned.output("copy", "rad", 1 * angle, "the same")
    wires = {"c.angle": "a.shown"}
    parts = {"a": degrees, "b": degrees, "c": turned.freeze()}
    system = cosim.couple(parts, wires, start_values={"b.rate": "60 deg/s"})
    run = cosim.simulate(system.dae, stop_time=2)
    np.testing.assert_allclose(run["c.copy"], run.time, atol=1e-12)
    np.testing.assert_allclose(run.final["b.angle"], 2 * np.pi / 3, atol=1e-12)
    cs = system.simulate(stop_time=2, accuracy=1e-6)
    np.testing.assert_allclose(cs["c.copy"], cs.time, atol=1e-9)


def lag(gain, square=0.0):
    model = Model("lag", stop_time=1.0)
    x, u = model.state("x", "1", 1.0, "state"), model.input("u", "1", 0.0, "input")
    model.derivative(x, u - x)
    model.output("y", "1", x + gain * u + square * u**2, "output")
    return model.freeze()


@pytest.mark.slow
@pytest.mark.parametrize("gain", [-0.4, -2.5, 0.5])
def test_linear_loop_is_solved_and_adds_no_unknowns(gain):
    """With y1 = x1 + u1, y2 = x2 + gain u2 and equal x: u1 = y2, u2 = y1."""
    system = cosim.couple({"a": lag(1.0), "b": lag(gain)}, {"a.u": "b.y", "b.u": "a.y"})
    assert not system.dae.algebraics
    u1 = (1 + gain) / (1 - gain)  # u1 = x2 + gain (x1 + u1) at x1 = x2 = 1
    run = system.simulate(stop_time=1, accuracy=1e-7)
    assert run["a.u"][0] == pytest.approx(u1, rel=1e-12)
    whole = cosim.simulate(system.dae, stop_time=1, solver="dop853", relative_tolerance=1e-11)
    np.testing.assert_allclose(run["a.u"], whole["a.u"], rtol=0, atol=1e-7)


@pytest.mark.slow
def test_nonlinear_loop_becomes_an_algebraic_unknown():
    system = cosim.couple({"a": lag(0.3), "b": lag(0.3, 0.1)}, {"a.u": "b.y", "b.u": "a.y"})
    assert {v.name for v in system.dae.algebraics} == {"a.u", "b.u"}
    run = cosim.simulate(system.dae, stop_time=1, solver="dop853", relative_tolerance=1e-11)
    coupled = system.simulate(stop_time=1, accuracy=1e-7)
    np.testing.assert_allclose(coupled["a.u"], run["a.u"], rtol=0, atol=1e-7)


def test_loop_without_a_solution_is_named():
    system = cosim.couple({"a": lag(1.0), "b": lag(1.0)}, {"a.u": "b.y", "b.u": "a.y"})
    with pytest.raises(UsageError, match=r"loop through a\.u, b\.u has no unique solution"):
        system.dae  # noqa: B018 # it is computed on demand
    with pytest.raises(cosim.errors.CosimError, match=r"loop .* drives [ab]\.u has no solution"):
        system.simulate(stop_time=1, macro_step=0.1)
    apart = cosim.couple({"c": lag(0.5), "a": lag(1.0)}, {"c.u": "a.x", "a.u": "a.y"})
    with pytest.raises(cosim.errors.CosimError, match=r"loop .* drives a\.u has no solution"):
        apart.simulate(stop_time=1, macro_step=0.1)


def test_events_limits_drawings_and_names_of_modes_of_parts_are_kept():
    system = read_system(f"{FOLDER}/ride.toml")
    bicycle = cosim.load("bicycle")
    assert len(system.dae.limits) == len(bicycle.limits) > 0
    assert system.dae.limits[0][1].startswith("bicycle: ")
    assert len(system.dae.drawing.shapes) == len(bicycle.drawing.shapes)
    assert {"world", "bicycle.fork"} <= {body.name for body in system.dae.drawing.bodies}
    (weave,) = system.dae.mode_names
    assert (weave.state, *weave.oscillating) == ("bicycle.delta", "weave")
    known = {v.name for v in (*system.dae.variables, *system.dae.parameters)}
    assert {symbol.name() for symbol in ca.symvar(motion(system.dae.drawing))} <= known


@pytest.mark.slow
def test_joint_cut_pendulum_starts_at_its_hinge():
    """The start of the lower bar follows from an input: it is settled before the run."""
    system = read_system(f"{FOLDER}/cut_pendulum.toml")
    run = system.simulate(stop_time=0.1, accuracy=1e-4)
    assert run["lower.x_hinge"][0] == pytest.approx(np.sin(1), rel=1e-14)
    assert run["lower.fx"][0] == pytest.approx(0, abs=1e-9)
    assert cosim.simulate(system.dae, stop_time=0.1)["lower.y"][0] == pytest.approx(
        -np.cos(1) - 0.5, rel=1e-12
    )
