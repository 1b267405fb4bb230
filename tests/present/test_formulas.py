"""Equations as formulas: every name has its letters, and parentheses keep the meaning."""

import re

import casadi as ca
import numpy as np
import pytest

import casadi_models
import cosim
from casadi_models.dae import Model
from casadi_models.dae.expressions import operation_count
from cosim.present.formulas import MOST_FORMULAS, formulas, linear_formulas, symbol

x, y = ca.SX.sym("x"), ca.SX.sym("y")


def letters(text):
    """Return MathML as one line of text, with fractions and powers as in a program."""
    for tag, sign in (("mfrac", "/"), ("msup", "^"), ("msub", "_")):
        text = re.sub(f"<{tag}>", f"<{tag}>{sign}", text)
    text = re.sub("<[^>]*>", "", text).replace("\u2062", "*").replace("\u2003", " ")
    return text.replace("\u2212", "-")


def written(law):
    model = Model("law", stop_time=1.0)
    own = [model.state(name, "1", 0.5, "state") for name in "xy"]
    model.derivative(own[0], ca.substitute(ca.SX(law), ca.vertcat(x, y), ca.vertcat(*own)))
    model.derivative(own[1], 0)
    found = formulas(model.freeze())
    return [letters(line) for line in (*found.named, *found.equations)]


@pytest.mark.parametrize(
    ("law", "text"),
    [
        (x - (y - 1), "x-(y-1)"),
        (-(x + y), "-(x+y)"),
        (3 * (x + y), "3*(x+y)"),
        ((x + y) ** 2, "^(x+y)2"),
        ((-x) ** 2 / y, "/^x2y"),
        (1 / (x + y), "/1x+y"),
        (ca.atan2(x, -y), "atan2(x,-y)"),
        (ca.sqrt(2 * x), "2*x"),
        ((x / y) ** 2, "^(/xy)2"),
        (ca.logic_and(ca.logic_or(x < 1, y), x), "((x&lt;1)\u2228y)∧x"),
    ],
)
def test_formula_has_the_parentheses_that_it_needs(law, text):
    assert written(law)[0] == f"/dxdt={text}"


def test_part_that_occurs_twice_has_a_name():
    lines = written(ca.sin(x + y) * ca.cos(x + y))
    assert lines == ["_c1=x+y", "/dxdt=sin(_c1)*cos(_c1)", "/dydt=0"]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("theta1_dot", "_θ˙1"),
        ("Omega", "Ω"),
        ("f1_G_F", "_f1,G,F"),
        ("M_phi", "_Mφ"),
        ("arm_mass", "arm_mass"),
        ("fx_A", "_fxA"),
        ("k2", "_k2"),
        ("lambda", "λ"),
        ("mA", "_mA"),
        ("IAxx", "IAxx"),
        ("thetaR_dot", "_θ˙R"),
        ("steer_torque", "steer_torque"),
        ("slip_1", "_slip1"),
    ],
)
def test_names_are_greek_letters_with_index_and_dot(name, text):
    assert letters(symbol(name)) == text


def test_output_in_another_formula_has_its_name():
    model = Model("law", stop_time=1.0)
    x = model.state("x", "1", 0.5, "state")
    rate = ca.sin(x) * ca.exp(-x)
    model.derivative(x, 2 * rate)
    model.output("x_dot", "1/s", rate, "half of the rate")
    model.output("same", "1/s", rate, "the same")
    found = formulas(model.freeze())
    assert [letters(line) for line in found.equations] == ["/dxdt=2*same"]
    assert [letters(line) for line in found.outputs] == ["x˙=same", "same=sin(x)*exp(-x)"]


def test_large_equation_is_a_function_of_its_arguments():
    model = Model("law", stop_time=1.0)
    x, u = model.state("x", "1", 0.5, "state"), model.input("u", "1", 0.0, "input")
    k, idle = model.parameter("k", "1", 2.0, "factor"), model.state("idle", "1", 0.0, "state")
    value = x
    for _ in range(2000):  # deeper than Python's recursion
        value = ca.sin(value) + k
    model.derivative(x, value * model.t)
    model.derivative(idle, u)
    found = formulas(model.freeze())
    texts = [letters(line) for line in found.equations]
    assert texts == ["/dxdt=_f1(x,t;p) (4001 operations)", "/didledt=u"]
    assert found.large == ("x",)
    assert found.named == ()


def small(expression):
    function = ca.Function("row", ca.symvar(expression), [expression])
    return operation_count(function) <= 24


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("name", casadi_models.CATALOG)
def test_every_equation_of_a_system_is_printed_or_has_its_arguments(name):
    dae = cosim.load(name)
    found = formulas(dae)
    assert len(found.equations) == len(dae.states) + len(dae.algebraics)
    assert len(found.outputs) == len(dae.output_variables) + len(dae.limits)
    lines = (*found.equations, *found.outputs, *found.named)
    full = [line for line in lines if " operations)" not in line]
    short = [row for row in ca.vertsplit(ca.vertcat(dae.ode, dae.alg, dae.outputs)) if small(row)]
    assert len(full) <= 2 * MOST_FORMULAS  # short ones and their parts are printed in any case
    assert len(full) - len(found.named) >= len(short)  # all of them are printed
    assert max(len(re.findall("<m[in]>", line)) for line in full) <= 60  # fits on a page


def test_kinematics_of_the_bicycle_are_printed_in_full():
    texts = [letters(line) for line in formulas(cosim.load("bicycle")).equations]
    for row in ("/dφdt=φ˙", "/d_θRdt=_θ˙R", "/dψdt=ψ˙"):
        assert row in texts


def test_linear_equations_of_the_bicycle_are_the_published_ones():
    dae = cosim.load("bicycle")
    linear = cosim.linearize(dae, at="equilibrium", outputs=["fx_Q", "slip_1"])
    names = ("phi_dot", "delta_dot", "thetaR_dot", "slip_1")
    found = [letters(line) for line in linear_formulas(dae, linear, names)]
    # Meijaard et al. 2007: M q'' + v C1 q' + (g K0 + v^2 K2) q = f, q = (phi, delta)
    mass = np.array([[80.81722, 2.31941332208709], [2.31941332208709, 0.29784188199686]])
    static = 9.81 * np.array([[-80.95, -2.59951685249872], [-2.59951685249872, -0.80329488458618]])
    speed = 15.3333333 * 0.3
    static += speed**2 * np.array([[0, 76.59734589573222], [0, 2.65431523794604]])
    rates = speed * np.array([[0, 33.86641391492494], [-0.85035641456978, 1.68540397397560]])
    inverse = np.linalg.inv(mass)
    factors = np.hstack([-inverse @ static, -inverse @ rates, inverse @ [[0, 1], [1, 0]]])
    columns = ("φ", "δ", "φ˙", "δ˙", "steer_torque", "roll_torque")
    order = (0, 2)  # of the states: phi, thetaR, delta
    for text, row in zip([found[i] for i in order], factors, strict=True):
        terms = [f"{value:+.4g}*Δ{name}" for value, name in zip(row, columns, strict=True)]
        assert text.partition("=")[2] == "".join(terms).removeprefix("+")
    assert re.fullmatch(r"/d_θ˙Rdt=0\.1138\*Δrear_wheel_torque", found[1])  # no rounding errors
    assert found[3] == "_slip1=0"


def test_events_have_their_conditions_and_new_values():
    model = Model("ball", stop_time=1.0)
    h, v = (model.state(name, "1", 0.5, "state") for name in "hv")
    n = model.discrete("n", "1", 0, "number")
    model.derivative(h, v)
    model.derivative(v, -9.81)
    model.when(h < 0, {v: -0.7 * v, n: n + 1}, name="impact")
    model.every(0.1, {n: 0})
    model.stop(h > 2, "too high")
    found = formulas(model.freeze())
    assert [letters(line) for line in found.events] == [
        "impact: h&lt;0",
        "v\u2190(-0.7)*v",
        "n\u2190n+1",
        "every 0.1 s: floor(/time0.1)",
        "n\u21900",
        "stop: 2&lt;h",
    ]
    assert found.outputs == ()
