"""Formulas: values as in Python, with `^` as a power, and numbers with units."""

from math import atan2, pi, radians, sin

import casadi as ca
import pytest

from cosim.errors import ParameterError
from cosim.model import formula

T = ca.SX.sym("t")


def value(text, t=0.5):
    return float(ca.Function("f", [T], [formula.expression("a test", text, {"t": T})])(t))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2*t^2", 0.5),
        ("-2^2", -4.0),
        ("2^t + 1", 2**0.5 + 1),
        ("1 - t^2/2", 0.875),
        ("2^3^2", 512.0),
        ("2^-1", 0.5),
        ("(-t)^2", 0.25),
        ("2*t**2", 0.5),
        ("3m/s^2*t^2", 0.75),
        ("3cm^2 + t", 0.5003),
        ("3cm**2 + 2", 2.0003),
        ("2m*s^-2*t", 1.0),
        ("4kN/cm^2-2", 4e7 - 2),
        ("(3cm)^2", 9e-4),
        ("2deg*t", radians(1)),
        ("2deg*t^3", radians(2) / 8),
        ("1e-2^2", 1e-4),
        ("sin(2*pi*t^2) - atan2(1, t)^2", sin(pi / 2) - atan2(1, 0.5) ** 2),
        ("where(t^2 > 0.2, 2^2, 0)", 4.0),
        ("7 / 2 * 3 - 1 - 1", 8.5),
    ],
)
def test_values_are_those_of_arithmetic(text, expected):
    assert value(text) == pytest.approx(expected, rel=1e-14)


def test_conditions_hold_powers():
    holds = formula.condition("a test", "t^2 + 1 > 1.2 and not -t^2 > 0", {"t": T})
    assert [float(ca.Function("f", [T], [holds])(t)) for t in (0.5, 0.1)] == [1.0, 0.0]


@pytest.mark.parametrize("text", ["2^", "^2", "t ^^ 2", "2 ^ * t", "t | 2", "2 << t"])
def test_other_operators_are_rejected(text):
    with pytest.raises(ParameterError, match="a test: "):
        value(text)
