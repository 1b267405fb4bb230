"""Numbers with units as people write them."""

import math

import pytest

from casadi_models.units import MORE, UNITS, parse_unit
from cosim.errors import ParameterError
from cosim.model.quantities import quantity
from cosim.series.csv_file import si_name


@pytest.mark.parametrize(
    ("text", "unit", "expected"),
    [
        ("60deg", "rad", math.pi / 3),
        ("-1.5e-3", "m", -1.5e-3),
        ("6 in", "m", 6 * 0.0254),
        (".5ft", "m", 0.1524),
        ("300rpm", "rad/s", 10 * math.pi),
        ("2lbf", "N", 2 * 4.4482216152605),
        ("0.02ft.lbf.s/rad", "N.m.s/rad", 0.02 * 1.3558179483314004),
        ("+7", "1", 7.0),
        ("5.kg", "kg", 5.0),
    ],
)
def test_quantity_is_converted_to_the_variable_s_unit(text, unit, expected):
    assert quantity("q", text, unit) == pytest.approx(expected, rel=4e-16)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "not a number with a unit"),
        ("deg", "not a number with a unit"),
        ("one", "not a number with a unit"),
        ("--1", "not a number with a unit"),
        ("0x10", "unit 'x10' is unknown"),
        ("1,5", "write a decimal point"),
        ("1deg, 2deg", "one number only"),
        ("1_000", "unit '_000' is unknown"),
        ("1furlong", "unit 'furlong' is unknown; fitting: rad, deg, rev$"),
        ("1kg", "'kg' cannot be converted to 'rad': not the same kind of unit"),
    ],
)
def test_text_that_is_no_quantity_is_refused_with_the_variable(text, reason):
    with pytest.raises(ParameterError, match=f"^phi.*{reason}"):
        quantity("phi", text, "rad")


@pytest.mark.parametrize(
    ("text", "unit", "expected"),
    [
        ("2 N*m", "N.m", 2.0),
        ("2 N m", "N.m", 2.0),
        ("9.81 m/s^2", "m/s2", 9.81),
        ("9.81m/s**2", "m/s2", 9.81),
        ("1 ft-lb", "N.m", 1.3558179483314004),
        ("-6.4994 lb", "N", -6.4994 * 4.4482216152605),
        ("10 lb", "kg", 4.5359237),  # only a mass fits
        ("10 lbs", "kg", 4.5359237),
        ("10 lbs", "N", 44.482216152605),
        ("5 \u00b5m", "m", 5e-6),
        ("5 \u03bcm", "m", 5e-6),
        ("3 RPM", "rad/s", 0.1 * math.pi),
        ("3 kN", "N", 3000.0),
        ("5Nm", "N.m", 5.0),
        ("2 kNm", "N.m", 2000.0),
        ("0.1 Nm/rad", "N.m/rad", 0.1),
        ("0.1 Nms/rad", "N.m.s/rad", 0.1),
        ("1 lb-ft", "N.m", 1.3558179483314003),
        ("36 kmh", "m/s", 10.0),
        ("36 km/hr", "m/s", 10.0),
        ("180 degree/sec", "rad/s", math.pi),
        ("180 deg/s", "rad/s", math.pi),
        ("2 inch", "m", 0.0508),
        ("2 feet", "m", 0.6096),
        ("9.81 m/s\u00b2", "m/s2", 9.81),
        ("2 min", "s", 120.0),
        ("60 mph", "m/s", 26.8224),
        ("45\u00b0", "rad", math.pi / 4),
        ("1 kg*m^2/s^2/rad", "N.m/rad", 1.0),
        ("1 N*m*s/rad", "N.m.s/rad", 1.0),
        ("1 psi", "N/m", None),
    ],
)
def test_products_and_powers_of_units_are_understood(text, unit, expected):
    if expected is None:
        with pytest.raises(ParameterError, match="cannot be converted"):
            quantity("q", text, unit)
    else:
        assert quantity("q", text, unit) == pytest.approx(expected, rel=4e-16)


@pytest.mark.parametrize(
    ("product", "alone"),
    [("V/A", "Ohm"), ("N/m2", "Pa"), ("V*A", "W"), ("V*s/A", "H"), ("A*s", "C")],
)
def test_electrical_units_fit_each_other(product, alone):
    assert parse_unit(product).measures_like(parse_unit(alone))
    assert parse_unit(product).factor == parse_unit(alone).factor


@pytest.mark.parametrize("text", ["", "/", "m/", "*m", "m//s", "m s 2", "2m", "mm2x", "furlong/s"])
def test_what_is_no_unit_is_none(text):
    assert parse_unit(text) is None


@pytest.mark.parametrize("name", [*UNITS, *MORE])
def test_every_unit_reads_as_itself(name):
    assert parse_unit(name) in (UNITS.get(name), MORE.get(name))


@pytest.mark.parametrize("name", [*UNITS, *MORE])
def test_si_unit_of_a_kind_has_factor_1(name):
    unit = parse_unit(name)
    si = si_name(name, unit)
    assert UNITS[si].factor == 1
    assert UNITS[si].measures_like(unit)
