"""Formulas: values as in Python, with `^` as a power, and numbers with units."""

from math import atan2, pi, radians, sin

import casadi as ca
import pytest

import cosim
from casadi_models.dae import Model
from cosim.errors import ParameterError, UnknownName
from cosim.model import formula
from cosim.model.driving import with_laws
from cosim.model.quantities import quantity

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
        ("-5degC", 268.15),  # the minus belongs to the temperature
        ("max(-5degC, - 10degC)", 268.15),
        ("where(t > 0 and -5degC > 200, 1, 0)", 1.0),
        ("300 - 5degC", 300 - 278.15),
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


@pytest.mark.parametrize(
    "text",
    [
        "9.81m/s^2*m",
        "100N/m*l",
        "1kg*g",
        "10N-m",
        "3cm ^2",
        "3cm ** 2",
        "3cm^(2)",
        "2cm^m",
        "3m2^2",
    ],
)
def test_units_that_can_be_read_in_two_ways_are_rejected(text):
    with pytest.raises(ParameterError, match="can be read in two ways"):
        formula.expression("a test", text, dict.fromkeys("mgl", T))


def test_blanks_end_a_unit():
    found = formula.expression("a test", "9.81m/s^2 * m - 1m*s/s", {"m": T})
    assert float(ca.Function("f", [T], [found])(2.0)) == pytest.approx(18.62)


def turned():
    """Return an angle in deg that its input, in deg/s, changes."""
    model = Model("turned", stop_time=1.0)
    angle = model.state("angle", "deg", 0.0, "angle")
    model.derivative(angle, model.input("rate", "deg/s", 0.0, "rate"))
    return model.freeze()


@pytest.mark.slow
def test_quantities_are_converted_to_the_unit_of_their_input(tmp_path):
    fmu = cosim.export_fmu(turned(), tmp_path / "turned.fmu")
    for run in (
        cosim.simulate(with_laws(turned(), (("rate", "5deg/s"),))),
        cosim.simulate(turned(), inputs={"rate": "5deg/s"}),
        cosim.simulate_fmu(fmu, inputs={"rate": "5deg/s"}),
    ):
        assert run["angle"][-1] == pytest.approx(5.0, rel=1e-6)


def test_numbers_with_units_do_not_mix_with_variables_in_other_units(tmp_path):
    fmu = cosim.export_fmu(turned(), tmp_path / "turned.fmu")
    for call in (
        lambda: cosim.simulate(turned(), inputs={"rate": "5deg/s*time"}),
        lambda: cosim.simulate_fmu(fmu, inputs={"rate": "5deg/s*time"}),
        lambda: cosim.simulate(turned(), inputs={"rate": "5"}, stop_when="angle > 3deg"),
    ):
        with pytest.raises(ParameterError, match=r"is in deg.*without units"):
            call()
    run = cosim.simulate(turned(), inputs={"rate": "5"}, stop_when="angle > 3")
    assert run.time[-1] == pytest.approx(0.6, rel=1e-6)


UNITS = {
    **{"phi": "rad", "omega": "rad/s", "x": "m", "r": "m", "area": "m2", "v": "m/s", "mass": "kg"},
    **{"F": "N", "E": "J", "M": "N.m", "stiffness": "N.m/rad", "tau": "s", "rate": "1/s"},
    **{"angle": "deg", "T": "degC", "TK": "K", "gain": "1", "own": "furlong", "slip": "%"},
}
SYMBOLS = {name: ca.SX.sym(name) for name in UNITS} | {"t": T}


@pytest.mark.parametrize(
    "text",
    [
        "phi > 3m",
        "-phi > 3m",
        "0 < phi < 3m",
        "t > 3m",
        "not (phi > x) and x > 2",
        "phi + x > 3m",
        "x/r > 3m",
        "where(t > 1, x, phi) > 3",
        "where(phi > 3m, 1, 0) > 0.5",
        "max(x, phi) > 1ft",
        "atan2(x, F) > 30deg",
        "atan2(x, r) > 30m",
        "sqrt(E/mass) > x",
        "(x - r)^2 > 3cm",
        "omega > 3Hz",
        "M > stiffness",
        "mass > 3lb",
        "x > sin(x) + 3m",
        "sin(3m) > 0",
        "exp(-x/2s) > 0.1",
        "2^x > 3m/s*t",
        "angle > phi",
        "T > TK",
        "slip > x",
    ],
)
def test_different_dimensions_are_rejected(text):
    with pytest.raises(ParameterError, match=r"a test: in '.* is in .*; combine quantities of one"):
        formula.condition("a test", text, SYMBOLS, UNITS)


@pytest.mark.parametrize(
    "text",
    [
        "phi > 45deg and omega > 30rpm",
        "phi > 3 and x > pi",
        "phi*180/pi > 45",
        "x/r > phi",
        "v/r > omega",
        "omega*r > v",
        "F*x > E and M > 3J and M > stiffness*phi",
        "mass*v^2/2 + mass*9.81*x > 3J",
        "sqrt(2*E/mass) > v and sqrt(E/mass) > 3km/h",
        "(x*r)^0.5 > 2cm and x^2 > area and area*x^-2 > 3",
        "atan2(x, r) > 30deg",
        "sign(x)*F > 3N",
        "sin(t) > 0.5*t and sin(3*x) > exp(-t/tau) and sin(2*pi*rate*t) > exp(-t/2s)",
        "floor(t) > 2 and abs(t - 1) > 2min and 2^t > 3",
        "gain*x > 3N and own > 3N and gain > 3deg",
        "TK > 20degC and TK - 273.15 > 20",
        "T > 20 and angle > 3",
        "F/mass > 9.81m/s^2 and F/mass > 9.81",
        "x > 3",
        "-phi - omega > 0.2 and sin(x) > 0.5 and 2^x > 3 and sin(angle) > 0.5",  # gains of 1
        "2*phi > 3m and 2*phi + omega > 3rad/s",  # a factor without a unit may have any
    ],
)
def test_what_may_be_of_one_dimension_is_accepted(text):
    formula.condition("a test", text, SYMBOLS, UNITS)


@pytest.mark.parametrize(
    ("text", "accepted"),
    [
        ("2N/s*t", True),
        ("5N*sin(t)", True),
        ("5N*exp(-t/3s) - 2lbf", True),
        ("where(t > 1s, 5N, 0)", True),
        ("5kg*9.81m/s^2", True),
        ("t", True),
        ("-2*x - v", True),
        ("-x", True),  # without units: SI numbers
        ("2N*t", True),  # time is a number
        ("5N*sin(t + 30deg)", True),
        ("3m + 0*t", False),
        ("where(t > 1s, 5m, 0)", False),
        ("-x - v", True),
        ("2N - x - v", False),
    ],
)
def test_values_of_formulas_with_units_have_the_unit_of_their_input(text, accepted):
    units = UNITS | {"": "N"}
    if accepted:
        formula.expression("a test", text, SYMBOLS, units)
    else:
        with pytest.raises(ParameterError, match=r"in '.* (instead of N|but . in m); combine"):
            formula.expression("a test", text, SYMBOLS, units)


def test_min_is_a_function_and_no_minute():
    assert value("3rad/s*min(t, 1)", 0.5) == value("3rad/s*max(t, 0.5)", 0.5) == 1.5
    assert value("3rad/min*20", 0.5) == pytest.approx(1.0)


@pytest.mark.parametrize("text", ["10*(t > 1)", "2*(t > 1 and t < 2)"])
def test_condition_as_a_factor_names_where(text):
    with pytest.raises(ParameterError, match=r"' is no number; write where\(t > 1, 2, 0\)"):
        value(text)


def test_an_angle_cannot_reach_a_length():
    with pytest.raises(ParameterError, match="in 'phi > 3m', phi is in rad, but 3m in m; combine"):
        cosim.simulate("bicycle", stop_when="phi > 3m")
    with pytest.raises(ParameterError, match=r"steer_torque: in '2m.* is m instead of N.m"):
        cosim.simulate("bicycle", inputs={"steer_torque": "2m*sin(t)"})


def test_name_of_time_belongs_to_time():
    model = Model("plate", stop_time=1.0)
    x, thickness = model.state("x", "m", 0.0, "x"), model.parameter("t", "m", 5.0, "thickness")
    model.derivative(x, model.input("u", "m/s", 0.0, "u") + 0 * thickness)
    dae = model.freeze()
    with pytest.raises(UnknownName, match="no name 't'"):
        cosim.simulate(dae, inputs={"u": "2*t"})
    assert cosim.simulate(dae, inputs={"u": "2*time"})["x"][-1] == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize("text", ["1 150 rpm", "12 150", "1 1000/min", "3 1^2 rpm"])
def test_numbers_within_units_are_rejected(text):
    with pytest.raises(ParameterError, match="is unknown"):
        quantity("omega", text, "rad/s")
    assert quantity("rate", "600 1/min", "1/s") == pytest.approx(10.0)
