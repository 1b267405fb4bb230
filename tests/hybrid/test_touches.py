"""Boundaries that are only touched, and what crosses beside them."""

import casadi as ca
import pytest
from helpers.hybrid_engines import run_on

import cosim


def test_a_touched_relation_hides_no_other_one():
    """A block stops at 1 m, where errors of a solver touch a level; it went on for 0.5 s."""
    model = cosim.Model("stops", stop_time=5.0, output_interval=0.5)
    level = model.parameter("level", "m", 0.999999999, "level")
    x, v = model.state("x", "m", 0.0, "place"), model.state("v", "m/s", 1.0, "speed")
    model.derivative(x, v)
    model.derivative(v, -0.5 * ca.sign(v))
    for name, law in {"above": x > level, "below": x < level, "reached": x >= level}.items():
        times = model.discrete(name, "1", 0.0, "how often")
        model.when(law, {times: times + 1})
        model.derivative(model.state(f"{name}_for", "s", 0.0, "how long"), ca.if_else(law, 1, 0))
    run = run_on("cvodes", model.freeze())
    assert run.final["x"] == pytest.approx(1, abs=1e-6)
    assert run.events[-1].time == pytest.approx(2, abs=1e-6)


def test_fresh_steps_that_jump_beyond_a_crest_cross_there():
    """The errors of short runs of cvodes are not smooth; the end was found 0.2 s late."""
    model = cosim.Model("crest", stop_time=7.0, output_interval=0.5)
    x, v = model.state("x", "1", 0.0, "sine"), model.state("v", "1", 1e-3, "cosine")
    model.derivative(x, v)
    model.derivative(v, -x)
    h = x - 1e-3 * (1 - 1e-6)
    for name, law in {"above": h > 0, "reached": h >= 0, "below": h < 0, "not": h <= 0}.items():
        times = model.discrete(name, "1", 0.0, "how often")
        model.when(law, {times: times + 1})
        model.derivative(model.state(f"{name}_for", "s", 0.0, "how long"), ca.if_else(law, 1, 0))
    run = run_on("cvodes", model.freeze())
    assert run.final["above"] == run.final["below"] == 1
    assert 0 < run.final["above_for"] < 0.01  # 0.003, but for the error of cvodes


def test_a_dip_is_seen_whatever_side_rounding_puts_its_steps_on():
    model = cosim.Model("dip", stop_time=4.0, output_interval=0.5)
    a, c, depth = 1e-3, 1.2345, 1e-12
    x = model.state("x", "1", a * c**2, "parabola")
    v = model.state("v", "1/s", -2 * a * c, "slope")
    off = model.parameter("off", "1", -1e-9 * a, "depth")
    model.derivative(x, v)
    model.derivative(v, 2 * model.parameter("a", "1/s^2", a, "bend"))
    times = model.discrete("above", "1", 0.0, "how often")
    model.when(model.parameter("s", "1", 1.0, "sign") * (x + off) > 0, {times: times + 1})
    run = run_on("ode8", model.freeze())
    assert run.final["above"] == 1
    assert run.events[0].time == pytest.approx(c + (depth / a) ** 0.5, abs=1e-9)
