"""Short changes that inputs or outputs of coupled parts pass: right, or a note names them."""

from math import pi, sqrt

import casadi as ca
import numpy as np
import pytest
from casadi import MX, SX

import cosim

PLACE, STOP = 5.03, 10.0  # s; the moving input is the time
SAID = "jumps over a short change of the equations"


def gauss(q, width):
    return ca.exp(-(((q - PLACE) / width) ** 2)) / (width * sqrt(pi))


def two_slopes(q, width):
    d = (q - PLACE) / width
    return (ca.tanh(4 * (d + 1)) - ca.tanh(4 * (d - 1))) / (4 * width)


def tent(q, width):
    return ca.fmax(0, 1 - ca.fabs(q - PLACE) / width) / width


def parabola(q, width):
    return 0.75 * ca.fmax(0, 1 - ((q - PLACE) / width) ** 2) / width


def window(q, width):
    return ca.if_else(ca.logic_and(q > PLACE - width, q < PLACE + width), 0.5 / width, 0)


def table(q, width):
    knots = np.array([-20, PLACE - width, PLACE, PLACE + width, 30])
    return ca.interpolant("table", "linear", [knots], [0, 0, 1 / width, 0, 0])(q)


def clock():
    """s' = 1."""
    return cosim.from_casadi({"x": SX.sym("s"), "ode": SX(1)}, name="clock")


def summed(law, width, kind=SX):
    """v' = law(u), whose integral over u is 1."""
    u, v = kind.sym("u"), kind.sym("v")
    return cosim.from_casadi({"x": v, "u": u, "ode": law(u, width)}, name="sum")


def system_with(part, **more):
    return cosim.couple({"a": clock(), "b": part}, {"b.u": "a.s"}, **more)


def outcome(system, method, variable="b.v", **step):
    run = system.simulate(stop_time=STOP, output_interval=0.3, method=method, **step)
    return run.final[variable], run.stats.get("note", "")


LAWS = [gauss, two_slopes, tent, parabola, window, table]


@pytest.mark.parametrize("law", LAWS)
def test_macro_steps_with_constant_inputs_name_what_they_jump_over(law):
    width = 1e-3
    system = system_with(summed(law, width, MX if law is table else SX))
    for method, step in (("jacobi", 0.1), ("gauss_seidel", 0.3)):
        value, note = outcome(system, method, macro_step=step)
        assert abs(value) < 1e-3  # before: no note
        assert SAID in note
        assert "u jumps" in note
        assert "give a shorter macro_step, another method, or accuracy" in note


@pytest.mark.parametrize("law", LAWS)
def test_no_note_where_macro_steps_resolve_a_change(law):
    width = 0.1
    system = system_with(summed(law, width, MX if law is table else SX))
    value, note = outcome(system, "jacobi", macro_step=width / 4)
    assert value == pytest.approx(1, abs=0.02)  # measured 6e-4 with the parabola
    assert SAID not in note


@pytest.mark.parametrize("law", LAWS)
def test_inputs_that_move_within_macro_steps_pass_over_nothing(law):
    system = system_with(summed(law, 1e-4, MX if law is table else SX))
    for method in ("iterated", "extrapolated"):
        for step in ({"macro_step": 0.3}, {"accuracy": 1e-5}):
            value, note = outcome(system, method, **step)
            assert value == pytest.approx(1, abs=1e-6)  # measured 2e-9
            assert not note


@pytest.mark.parametrize(("fmi", "solver", "abilities"), [
    (2, "dop853", None),
    (2, "rosenbrock", None),
    (3, "dop853", None),
    (3, "dop853", "no co-simulation"),
])  # fmt: skip
def test_a_part_that_is_an_fmu_tells_it_too(tmp_path, fmi, solver, abilities):
    path = cosim.export_fmu(summed(gauss, 1e-3), tmp_path / "b.fmu", fmi=fmi, solver=solver)
    system = system_with(path, abilities={"b": abilities} if abilities else None)
    value, note = outcome(system, "jacobi", macro_step=0.1)
    assert abs(value) < 1e-3
    assert SAID in note
    assert not outcome(system, "iterated", macro_step=0.1)[1]


@pytest.mark.parametrize("law", [
    lambda u: ca.fabs(u),
    lambda u: ca.fmin(ca.fmax(u, -5), 5),
    lambda u: ca.fmax(u - 1, 0) + ca.fmin(u + 1, 0),
    lambda u: ca.floor(u),
    lambda u: ca.if_else(u > 1, 1.0, 0) + ca.if_else(u > -1, 2.0, 0),
    lambda u: ca.tanh(50 * u),
])  # fmt: skip
def test_saturations_and_steps_that_an_input_jumps_over_are_no_short_changes(law):
    t, s, u, v = (SX.sym(name) for name in "tsuv")
    bang = {"t": t, "x": s, "ode": SX(0)}
    parts = {
        "a": cosim.from_casadi(bang, outputs={"w": 10 * ca.sign(ca.sin(3 * t))}, name="bang"),
        "b": cosim.from_casadi({"x": v, "u": u, "ode": law(u)}, name="sum"),
    }
    system = cosim.couple(parts, {"b.u": "a.w"})
    assert SAID not in outcome(system, "jacobi", macro_step=0.1)[1]


def chain(of, width):
    """A bump in the output of a part, which another part sums: of time, a state, or an input."""
    t, s, u, y, v = (SX.sym(name) for name in "tsuyv")
    law = {"x": s, "t": t, "u": u, "ode": SX(of == "state")}
    moving = {"time": t, "state": s, "input": u}[of]
    parts = {
        "a": cosim.from_casadi(law, outputs={"y": gauss(moving, width)}, name="bump"),
        "b": cosim.from_casadi({"x": v, "u": y, "ode": y}, name="sum"),
        "clock": clock(),
    }
    return cosim.couple(parts, {"b.y": "a.y", "a.u": "clock.s"})


@pytest.mark.parametrize("width", [1e-3, 1e-5])  # s; of the narrow ones, no step settled
@pytest.mark.parametrize("of", ["time", "state", "input"])
def test_a_short_change_of_an_output_reaches_the_part_that_it_drives(of, width):
    system = chain(of, width)
    value, note = outcome(system, "iterated", accuracy=1e-5)
    assert value == pytest.approx(1, abs=1e-5)  # before: 0, with an estimated error of 3e-8
    assert not note
    value, note = outcome(system, "jacobi", macro_step=0.1)
    assert abs(value - 1) < 0.05 or "inputs and outputs differ by up to" in note or SAID in note


def test_a_short_pulse_that_drives_an_open_input_is_not_stepped_over():
    u, v = SX.sym("u"), SX.sym("v")
    parts = {"b": cosim.from_casadi({"x": v, "u": u, "ode": u}, name="sum"), "a": clock()}
    run = cosim.couple(parts, {}).simulate(
        stop_time=STOP, accuracy=1e-5, inputs={"b.u": f"1000*exp(-((t - {PLACE})/1e-3)^2)"}
    )
    assert run.final["b.v"] == pytest.approx(sqrt(pi), abs=1e-5)  # before: 0


@pytest.mark.parametrize("step", [{"macro_step": 0.01}, {"accuracy": 1e-6}])
@pytest.mark.parametrize("width", [1e-3, 0.03])  # a corner is, or is not, where a macro step ends
@pytest.mark.parametrize(("size", "switches"), [(1.0, False), (1e4, False), (1.0, True)])
def test_corners_of_a_table_that_drives_a_part_keep_their_slopes(size, switches, width, step):
    """v' = f, the table over the time, whose integral is its size.

    Slopes were means of both sides, which made 8 % of v, or macro steps that became too short.
    """
    force = cosim.Model("force", stop_time=STOP)
    x = force.state("x", "1", 0.0, "ramp")
    force.derivative(x, 0.1)
    if switches:
        force.when(x > 0.75, {x: 0.0})
    force.output("f", "1", size * table(force.t, width), "force")
    mass = cosim.Model("mass", stop_time=STOP)
    mass.derivative(mass.state("v", "1", 0.0, "speed"), mass.input("f", "1", 0.0, "force"))
    parts = {"a": force.freeze(), "b": mass.freeze()}
    run = cosim.couple(parts, {"b.f": "a.f"}).simulate(stop_time=STOP, **step)
    assert run.final["b.v"] == pytest.approx(size, rel=1e-6)
    assert "jumps" not in run.stats.get("note", "")
