import math
import re
from fractions import Fraction

import pytest
from scipy import constants

from casadi_models.dae import Model
from casadi_models.units import UNITS, convert, parse_unit, quotient_name

# Independent of the product: CODATA and international definitions as SciPy states them
IN_SI = {
    "in": constants.inch,
    "ft": constants.foot,
    "lbf": constants.lbf,
    "slug": constants.slug,
    "deg": constants.degree,
    "rev": 2 * math.pi,
    "rpm": 2 * math.pi / constants.minute,
    "km/h": constants.kmh,
    "ft.lbf": constants.foot * constants.lbf,
    "slug/ft3": constants.slug / constants.foot**3,
    "slug.ft2": constants.slug * constants.foot**2,
    "mm": constants.milli,
    "cm": constants.centi,
    "ms": constants.milli,
    "g": constants.gram,
}
PARTS = {  # of which the names of compound units are made
    "1": {},
    "kg": {"kg": 1},
    "slug": {"kg": 1},
    "m": {"m": 1},
    "ft": {"m": 1},
    "km": {"m": 1},
    "s": {"s": 1},
    "h": {"s": 1},
    "rad": {"rad": 1},
    "deg": {"rad": 1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "lbf": {"kg": 1, "m": 1, "s": -2},
}


@pytest.mark.parametrize("unit", IN_SI)
def test_conversion_factor_equals_the_international_definition(unit):
    assert UNITS[unit].factor == pytest.approx(IN_SI[unit], rel=4e-16)  # measured 2e-16


@pytest.mark.parametrize("unit", [u for u in UNITS if re.search(r"[./]", u)])
def test_base_units_of_a_compound_follow_from_its_name(unit):
    base: dict[str, int] = {}
    numerator, *denominator = unit.split("/")
    for sign, part in ((1, numerator), *((-1, d) for d in denominator)):
        for factor in part.split("."):
            name, power = re.fullmatch(r"([A-Za-z]+|1)(\d?)", factor).groups()
            for symbol, exponent in PARTS[name].items():
                base[symbol] = base.get(symbol, 0) + sign * exponent * int(power or 1)
    assert dict(UNITS[unit].base) == {symbol: n for symbol, n in base.items() if n}


def test_units_of_the_book_are_the_doubles_nearest_to_their_definitions():
    foot, pound = Fraction("0.3048"), Fraction("4.4482216152605")
    assert convert(1.0, "ft", "m") == float(foot)
    assert convert(6.0, "in", "m") == 6 * 0.0254
    assert convert(1.0, "slug", "kg") == float(pound / foot)
    assert convert(1.0, "ft.lbf", "N.m") == float(pound * foot)
    assert convert(180.0, "deg", "rad") == math.pi


@pytest.mark.parametrize("unit", UNITS)
def test_conversion_there_and_back_returns_the_number(unit):
    for target in (u for u in UNITS if dict(UNITS[u].base) == dict(UNITS[unit].base)):
        back = convert(convert(0.1, unit, target), target, unit)
        assert back == pytest.approx(0.1, rel=5e-16)  # measured 3e-16


@pytest.mark.parametrize(("unit", "target"), [("m", "kg"), ("N.m", "N.m/rad"), ("1", "rad")])
def test_conversion_between_kinds_is_refused_with_both_names(unit, target):
    with pytest.raises(ValueError, match=f"'{unit}' cannot be converted to '{target}'"):
        convert(1.0, unit, target)


@pytest.mark.parametrize("unit", ["furlong", "M", "", None, 3, ["m"]])
def test_unknown_unit_is_refused_with_the_known_ones(unit):
    with pytest.raises(ValueError, match=r"is unknown; known are 1, s, ms, rad, deg"):
        convert(1.0, unit, "m")
    with pytest.raises(ValueError, match=r"is unknown; known are"):
        convert(1.0, "m", unit)


@pytest.mark.parametrize(
    ("value", "unit", "target", "expected"),
    [
        (300.0, "K", "degC", 26.85),
        (100.0, "degC", "degF", 212.0),
        (-40.0, "degF", "degC", -40.0),
        (0.0, "degC", "K", 273.15),
        (1.0, "kN", "N", 1e3),
        (1.0, "MPa", "kPa", 1e3),
        (3.6, "MJ", "kJ", 3600.0),
        (1.0, "kW", "W", 1e3),
        (1.0, "um", "mm", 1e-3),
        (60.0, "mph", "m/s", 26.8224),
        (1.0, "lb", "lbf", 1.0),
        (1.0, "lb", "kg", 0.45359237),
        (1.0, "kg", "lb", 1 / 0.45359237),
        (50.0, "%", "1", 0.5),
        (1.0, "W/(m2.K)", "W/(m2.degC)", 1.0),  # a difference of temperatures
        (1.0, "hPa", "mbar", 1.0),
        (1.0, "hp", "W", constants.hp),
        (1.0, "atm", "Pa", constants.atm),
        (760.0, "torr", "atm", 1.0),
        (1.0, "mmHg", "Torr", 133.322387415 / constants.torr),
        (29.92, "inHg", "mmHg", 29.92 * 25.4),
        (1.0, "ksi", "MPa", 1e-3 * constants.psi),
        (2.5, "kWh", "MJ", 9.0),
        (3.0, "L", "m3", 3e-3),
        (1.0, "mL", "cc", 1.0),
        (1.0, "gal/min", "m3/s", constants.gallon / 60),
        (1.0, "inch", "mm", 25.4),
        (10.0, "ft/s", "m/s", 3.048),
        (1.0, "knot", "m/s", constants.knot),
        (1.0, "nmi/h", "kn", 1.0),
        (1.5, "turn", "deg", 540.0),
        (6.0, "deg/s", "rpm", 1.0),
        (1.0, "rpm/s", "deg/s2", 6.0),
        (1.0, "r/min", "rpm", 1.0),
        (6.0, "/min", "1/s", 0.1),
        (6.0, " / min", "Hz", 0.1),
        (3.0, "/m/min", "1/(m.s)", 0.05),
        (1.0, "arcsec", "arcmin", 1 / 60),
        (200.0, "gon", "rad", math.pi),
        (1.0, "day", "h", 24.0),
        (1.0, "tonne", "lbm", 1000 / constants.lb),
        (1.0, "kgf", "N", constants.kgf),
        (1.0, "dyn", "uN", 10.0),
        (1.0, "kcal", "kJ", constants.calorie),
        (1.0, "BTU", "J", constants.Btu_IT),
        (1.0, "MeV", "J", 1e6 * constants.eV),
        (1.0, "PS", "W", 735.49875),
        (1.0, "cP", "mPa.s", 1.0),
        (1.0, "cSt", "mm2/s", 1.0),
        (459.67, "degR", "degF", 0.0),
        (1.0, "mAh", "C", 3.6),
        (1.0, "mT", "Wb/m2", 1e-3),
        (1.0, "1/kohm", "mS", 1.0),
        (1.0, "N.m/(rad/s)", "N.m.s/rad", 1.0),
        (30.0, "V/(rad/s)", "V/rpm", math.pi),
        (1.0, "deg/s/(m/s)", "deg/m", 1.0),
    ],
)
def test_units_of_models_are_those_that_people_type(value, unit, target, expected):
    found = convert(value, unit, target)
    assert found == pytest.approx(expected, rel=1e-14, abs=1e-13)  # measured 3e-15, 6e-14


AMBIGUOUS = ["W/(m.K).s", "(m", "m)", "kkg", "kdeg", "mrpm", "k", "kdegC", "mhp"]
AMBIGUOUS += ["m/(s", "m/(/s)", "//s", "/"]
BEHIND_A_QUOTIENT = ["N/(m/s)^2", "N/(m/s)2", "N.m/(rad/s)**2", "N/(m/s).kg"]


@pytest.mark.parametrize("unit", [*AMBIGUOUS, *BEHIND_A_QUOTIENT, "g0", "t"])  # t: time of formulas
def test_unit_that_can_be_read_in_two_ways_or_has_a_wrong_prefix_is_unknown(unit):
    assert parse_unit(unit) is None


@pytest.mark.parametrize("unit", ["kN", "kPa", "MPa", "kW", "kJ", "um", "mph", "lb", "degC"])
def test_model_may_declare_each_of_these_units(unit):
    model = Model("m")
    model.derivative(model.state("x", unit, 1.0, "state"), 0)
    assert model.freeze().states[0].unit == unit


@pytest.mark.parametrize(
    ("unit", "by", "expected"),
    [
        ("rad", "kg", "rad/kg"),
        ("rad", "rad/s", "s"),
        ("rad/s", "kg", "rad/(s.kg)"),
        ("N.m", "s", "N.m/s"),
        ("m/s2", "s", "m/s3"),
        ("W/(m.K)", "K", "W/(m.K2)"),
        ("1", "kg", "1/kg"),
        ("m", "m", "1"),
        ("furlong", "s", "furlong/s"),
        ("m", "furlong/s", "m/(furlong/s)"),
    ],
)
def test_quotient_of_units_has_its_usual_name(unit, by, expected):
    assert quotient_name(unit, by) == expected
    above, below, quotient = (parse_unit(name) for name in (unit, by, expected))
    if above and below:
        assert quotient.factor == pytest.approx(above.factor / below.factor)
        exponents = dict.fromkeys([*dict(above.base), *dict(below.base)], 0)
        for name, power in (*above.base, *((name, -power) for name, power in below.base)):
            exponents[name] += power
        assert dict(quotient.base) == {name: power for name, power in exponents.items() if power}
