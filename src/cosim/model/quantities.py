"""`60deg`, `9.81 m/s^2`, `0.5 N*m`: a number and a unit as people write them, to a plain number."""

import re
from collections.abc import Callable, Mapping
from functools import lru_cache
from math import pi

from casadi_models.units import FOOT, INCH, PARTS, POUND, UNITS, Unit
from cosim.errors import ParameterError

_NUMBER = r"[-+]?(?:\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+(?:[eE][-+]?\d+)?|inf|nan)"
_QUANTITY = re.compile(rf"\s*({_NUMBER})\s*(.*?)\s*")
_FACTOR = re.compile(r"([A-Za-z\u00b0\u03a9\u00b5%]+|1)(?:(?:\^|\*\*)?([-+]?\d+))?")
_SEPARATOR = re.compile(r"\s*([.*\u00b7/-]|\s)\s*")
_MASS_POUND, _MILE = 0.45359237, 5280 * FOOT  # kg, m; exact


def _unit(factor: float = 1.0, **base: int) -> Unit:
    return Unit(factor, tuple(base.items()))


# Besides the units that models are written in; what electrical people bring along, too.
MORE: Mapping[str, Unit] = {
    "us": _unit(1e-6, s=1),
    "RPM": UNITS["rpm"],
    "\u00b0": UNITS["deg"],
    "degree": UNITS["deg"],
    "degrees": UNITS["deg"],
    "mrad": _unit(1e-3, rad=1),
    "yd": _unit(3 * FOOT, m=1),
    "mi": _unit(_MILE, m=1),
    "mph": _unit(_MILE / 3600, m=1, s=-1),
    "kph": UNITS["km/h"],
    "l": _unit(1e-3, m=3),
    "lbm": _unit(_MASS_POUND, kg=1),
    "lb": UNITS["lbf"],  # as the book; a mass where only a mass fits
    "mN": _unit(1e-3, kg=1, m=1, s=-2),
    "kN": _unit(1e3, kg=1, m=1, s=-2),
    "kJ": _unit(1e3, kg=1, m=2, s=-2),
    "kW": _unit(1e3, kg=1, m=2, s=-3),
    "kPa": _unit(1e3, kg=1, m=-1, s=-2),
    "MPa": _unit(1e6, kg=1, m=-1, s=-2),
    "bar": _unit(1e5, kg=1, m=-1, s=-2),
    "psi": _unit(POUND / INCH**2, kg=1, m=-1, s=-2),
    "mA": _unit(1e-3, A=1),
    "mV": _unit(1e-3, kg=1, m=2, s=-3, A=-1),
    "\u03a9": _unit(kg=1, m=2, s=-3, A=-2),
    "mH": _unit(1e-3, kg=1, m=2, s=-2, A=-2),
    "turn": _unit(2 * pi, rad=1),
}


def quantity(name: str, text: str, unit: str) -> float:
    """Read `VALUE[UNIT]` as a number in a variable's own unit.

    The unit may be a product of powers: `N*m`, `N.m`, `ft-lb`, `m/s^2`, `kg m2`.

    Args:
        name: The variable, for messages.
        text: What the user wrote.
        unit: The variable's unit.

    Raises:
        ParameterError: It is not a number, or its unit does not fit.

    Example:
        >>> round(quantity("phi", "60 deg", "rad"), 6)
        1.047198
        >>> quantity("speed", "36 km/h", "m/s")
        10.0
    """
    match = _QUANTITY.fullmatch(text)
    if not match:
        raise ParameterError(
            f"{name}: '{text}' is not a number with a unit; write e.g. 1.5{unit.strip('1')}"
        )
    value, written = float(match[1]), match[2]
    if written.startswith(","):
        raise ParameterError(f"{name} = {text}: write a decimal point, and no other comma")
    if not written:
        return value
    wanted = parse_unit(unit)
    if wanted is None:  # of somebody's own
        raise ParameterError(f"{name} = {text}: give a number in {unit}, without a unit")
    source = parse_unit(written, like=wanted)
    if source is None:
        fitting = ", ".join(known for known, one in UNITS.items() if one.measures_like(wanted))
        raise ParameterError(f"{name} = {text}: unit '{written}' is unknown; fitting: {fitting}")
    if not source.measures_like(wanted):
        raise ParameterError(
            f"{name} = {text}: '{written}' cannot be converted to '{unit}': not the same kind of "
            "unit"
        )
    return value if source.factor == wanted.factor else value * source.factor / wanted.factor


@lru_cache(1024)
def parse_unit(text: str, like: Unit | None = None) -> Unit | None:
    """Return the unit that a text names; None when a part of it is unknown.

    Args:
        text: A known unit, or a product of powers of them.
        like: What it shall measure; a pound is a force unless only a mass fits.
    """
    if text in UNITS:
        return UNITS[text]
    unit = _product(text, _known)
    if unit is not None and like is not None and not unit.measures_like(like) and "lb" in text:
        by_mass = _product(text, lambda name: MORE["lbm"] if name == "lb" else _known(name))
        if by_mass is not None and by_mass.measures_like(like):
            return by_mass
    return unit


def _known(name: str) -> Unit | None:
    return UNITS.get(name) or PARTS.get(name) or MORE.get(name)


def _product(text: str, known: Callable[[str], Unit | None]) -> Unit | None:
    """Return a product of powers; after a `/` everything divides, as FMI and people write it."""
    factor, base, sign = 1.0, dict[str, int](), 1
    position, text = 0, text.strip()
    expected = True
    while position < len(text):
        separator = _SEPARATOR.match(text, position)
        if separator and not expected:
            sign = -1 if separator[1] == "/" else sign
            position, expected = separator.end(), True
            continue
        match = _FACTOR.match(text, position)
        unit = known(match[1]) if match and expected else None
        if match is None or unit is None:
            return None
        power = sign * int(match[2] or 1)
        factor *= unit.factor**power
        for name, exponent in unit.base:
            base[name] = base.get(name, 0) + power * exponent
        position, expected = match.end(), False
    if expected:
        return None
    return Unit(factor, tuple((name, n) for name, n in base.items() if n))
