"""Equations as formulas: every name has its letters, and parentheses keep the meaning."""

import re

import casadi as ca
import pytest

import cosim
from casadi_models.dae import Model
from cosim.present.formulas import formulas, symbol

x, y = ca.SX.sym("x"), ca.SX.sym("y")


def letters(text):
    """Return MathML as one line of text, with fractions and powers as in a program."""
    for tag, sign in (("mfrac", "/"), ("msup", "^"), ("msub", "_")):
        text = re.sub(f"<{tag}>", f"<{tag}>{sign}", text)
    return re.sub("<[^>]*>", "", text).replace("\u2062", "*")


def written(law):
    model = Model("law", stop_time=1.0)
    own = [model.state(name, "1", 0.5, "state") for name in "xy"]
    model.derivative(own[0], ca.substitute(ca.SX(law), ca.vertcat(x, y), ca.vertcat(*own)))
    model.derivative(own[1], 0)
    return [letters(line) for line in formulas(model.freeze())]


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
        ("f1_G_F", "_f1_G_F"),
        ("k2", "_k2"),
        ("lambda", "λ"),
        ("mA", "mA"),
    ],
)
def test_names_are_greek_letters_with_index_and_dot(name, text):
    assert letters(symbol(name)) == text


def test_models_that_nobody_reads_have_no_formulas():
    assert formulas(cosim.load("bicycle")) == []
    assert len(formulas(cosim.load("bar_on_frame"))) == 4
