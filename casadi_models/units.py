"""Units: names, products of powers, and conversion by exponents, factor and offset.

SI inside; a number is converted once, where it is first written: ``6 * INCH`` is a length in meter.
"""

import re
import reprlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import inf, pi
from typing import Any

INCH = 0.0254  # m, exact
FOOT = 0.3048  # m, exact (12 * 0.0254 is one rounding off)
POUND = 4.4482216152605  # N, exact
SLUG = 14.593902937206364  # kg, 1 lbf.s2/ft (POUND / FOOT is one rounding off)
FOOT_POUND = FOOT * POUND  # N.m
DEGREE = pi / 180  # rad
RPM = pi / 30  # rad/s

# Display units of the examples in Unit 7, by SI unit
BOOK_UNITS = {
    "rad": "deg",
    "N": "lbf",
    "N.m": "ft.lbf",
    "J": "ft.lbf",
    "m": "in",
    "kg": "slug",
    "N.m/rad": "ft.lbf/rad",
    "N.m.s/rad": "ft.lbf.s/rad",
}


@dataclass(frozen=True)
class Unit:
    """A unit by the definition of FMI's BaseUnit: SI value = factor * value + offset.

    Attributes:
        factor: One of this unit in SI base units.
        base: Exponents by FMI's names of base units: kg, m, s, A, K, mol, cd, rad.
        offset: SI value of 0 in this unit; only units of temperature have one.
    """

    factor: float
    base: tuple[tuple[str, int], ...]
    offset: float = 0.0

    @property
    def is_si(self) -> bool:
        """Whether a value in this unit is the SI value."""
        return self.factor == 1 and self.offset == 0

    def measures_like(self, other: "Unit") -> bool:
        """Return whether both measure the same kind of quantity."""
        return dict(self.base) == dict(other.base)

    def difference(self) -> "Unit":
        """Return the unit of a difference of two values, such as that of two temperatures."""
        return Unit(self.factor, self.base)


def converted(value: Any, source: Unit, target: Unit) -> Any:
    """Convert a number or an array between two units that measure the same kind of quantity."""
    shift = source.offset - target.offset
    if source.factor == target.factor and not shift:
        return value
    in_si = value * source.factor
    return (in_si + shift if shift else in_si) / target.factor


def conversion(source: Unit, target: Unit) -> tuple[float, float]:
    """Return factor and offset: value in target = factor * value in source + offset.

    Raises:
        ValueError: The two do not measure the same kind of quantity.
    """
    if not source.measures_like(target):
        raise ValueError("not the same kind of unit")
    return converted(1.0, source.difference(), target.difference()), converted(0.0, source, target)


def _unit(factor: float = 1.0, offset: float = 0.0, **base: int) -> Unit:
    return Unit(factor, tuple(base.items()), offset)


class Units(dict[str, Unit]):
    """Units by name; a product of powers is one, too; an unknown one is a number with factor 1."""

    def __missing__(self, name: str) -> Unit:
        return parse_unit(name) or _unit()


# Torque per angle is distinct from torque: kg.m2/s2 with and without the radian.
UNITS = Units(
    {
        "1": _unit(),
        "s": _unit(s=1),
        "ms": _unit(1e-3, s=1),
        "rad": _unit(rad=1),
        "deg": _unit(DEGREE, rad=1),
        "rev": _unit(2 * pi, rad=1),
        "rad/s": _unit(rad=1, s=-1),
        "deg/s": _unit(DEGREE, rad=1, s=-1),
        "rpm": _unit(RPM, rad=1, s=-1),
        "rad/s2": _unit(rad=1, s=-2),
        "deg/s2": _unit(DEGREE, rad=1, s=-2),
        "1/s": _unit(s=-1),
        "m": _unit(m=1),
        "mm": _unit(1e-3, m=1),
        "cm": _unit(1e-2, m=1),
        "in": _unit(INCH, m=1),
        "ft": _unit(FOOT, m=1),
        "m/s": _unit(m=1, s=-1),
        "km/h": _unit(1 / 3.6, m=1, s=-1),
        "ft/s": _unit(FOOT, m=1, s=-1),
        "m/s2": _unit(m=1, s=-2),
        "ft/s2": _unit(FOOT, m=1, s=-2),
        "kg": _unit(kg=1),
        "g": _unit(1e-3, kg=1),
        "slug": _unit(SLUG, kg=1),
        "kg/m3": _unit(kg=1, m=-3),
        "slug/ft3": _unit(SLUG / FOOT**3, kg=1, m=-3),
        "kg.m2": _unit(kg=1, m=2),
        "slug.ft2": _unit(SLUG * FOOT**2, kg=1, m=2),
        "kg.m2/s": _unit(kg=1, m=2, s=-1),
        "N": _unit(kg=1, m=1, s=-2),
        "lbf": _unit(POUND, kg=1, m=1, s=-2),
        "N.m": _unit(kg=1, m=2, s=-2),
        "ft.lbf": _unit(FOOT_POUND, kg=1, m=2, s=-2),
        "J": _unit(kg=1, m=2, s=-2),
        "W": _unit(kg=1, m=2, s=-3),
        "N/m": _unit(kg=1, s=-2),
        "N.s/m": _unit(kg=1, s=-1),
        "N.m/rad": _unit(kg=1, m=2, s=-2, rad=-1),
        "ft.lbf/rad": _unit(FOOT_POUND, kg=1, m=2, s=-2, rad=-1),
        "N.m.s/rad": _unit(kg=1, m=2, s=-1, rad=-1),
        "ft.lbf.s/rad": _unit(FOOT_POUND, kg=1, m=2, s=-1, rad=-1),
    }
)

# Further names of units, which count everywhere like those above; names of one unit together
_BY_NAMES = {
    "A": _unit(A=1),
    "K": _unit(K=1),
    "mol": _unit(mol=1),
    "cd": _unit(cd=1),
    "%": _unit(0.01),
    "ppm": _unit(1e-6),
    "degC \u00b0C": _unit(offset=273.15, K=1),
    "degF \u00b0F": _unit(5 / 9, offset=459.67 * 5 / 9, K=1),
    "degR": _unit(5 / 9, K=1),
    "Hz": _unit(s=-1),
    "Pa": _unit(kg=1, m=-1, s=-2),
    "bar": _unit(1e5, kg=1, m=-1, s=-2),
    "psi": _unit(6894.757293168361, kg=1, m=-1, s=-2),
    "ksi": _unit(6894757.293168361, kg=1, m=-1, s=-2),
    "atm": _unit(101325.0, kg=1, m=-1, s=-2),
    "Torr torr": _unit(101325 / 760, kg=1, m=-1, s=-2),
    "mmHg": _unit(133.322387415, kg=1, m=-1, s=-2),
    "inHg": _unit(25.4 * 133.322387415, kg=1, m=-1, s=-2),
    "V": _unit(kg=1, m=2, s=-3, A=-1),
    "C": _unit(s=1, A=1),
    "Ohm \u03a9 ohm": _unit(kg=1, m=2, s=-3, A=-2),
    "F": _unit(kg=-1, m=-2, s=4, A=2),
    "H": _unit(kg=1, m=2, s=-2, A=-2),
    "S": _unit(kg=-1, m=-2, s=3, A=2),
    "T": _unit(kg=1, s=-2, A=-1),
    "Wb": _unit(kg=1, m=2, s=-2, A=-1),
    "Ah": _unit(3600.0, s=1, A=1),
    "lm": _unit(cd=1),
    "lx": _unit(m=-2, cd=1),
    "min": _unit(60.0, s=1),
    "h hr": _unit(3600.0, s=1),
    "sec": _unit(s=1),
    "day": _unit(86400.0, s=1),
    "turn": _unit(2 * pi, rad=1),
    "degree degrees \u00b0": _unit(DEGREE, rad=1),
    "gon": _unit(pi / 200, rad=1),
    "arcmin": _unit(DEGREE / 60, rad=1),
    "arcsec": _unit(DEGREE / 3600, rad=1),
    "RPM r/min": _unit(RPM, rad=1, s=-1),
    "inch": _unit(INCH, m=1),
    "feet": _unit(FOOT, m=1),
    "yd": _unit(3 * FOOT, m=1),
    "mi": _unit(1609.344, m=1),
    "nmi": _unit(1852.0, m=1),
    "mph": _unit(0.44704, m=1, s=-1),
    "kph kmh": _unit(1 / 3.6, m=1, s=-1),
    "kn knot knots": _unit(1852 / 3600, m=1, s=-1),
    "ha": _unit(1e4, m=2),
    "l L": _unit(1e-3, m=3),
    "cc": _unit(1e-6, m=3),
    "gal": _unit(231 * INCH**3, m=3),  # of the United States
    "lb lbs": _unit(POUND, kg=1, m=1, s=-2),  # as in the book; a mass where only a mass fits
    "lbm": _unit(0.45359237, kg=1),
    "tonne": _unit(1e3, kg=1),
    "kgf": _unit(9.80665, kg=1, m=1, s=-2),
    "dyn": _unit(1e-5, kg=1, m=1, s=-2),
    "Nm": _unit(kg=1, m=2, s=-2),
    "kNm": _unit(1e3, kg=1, m=2, s=-2),
    "Nms": _unit(kg=1, m=2, s=-1),
    "Wh": _unit(3600.0, kg=1, m=2, s=-2),
    "eV": _unit(1.602176634e-19, kg=1, m=2, s=-2),
    "cal": _unit(4.184, kg=1, m=2, s=-2),
    "BTU": _unit(1055.05585262, kg=1, m=2, s=-2),
    "hp": _unit(550 * FOOT_POUND, kg=1, m=2, s=-3),
    "PS": _unit(75 * 9.80665, kg=1, m=2, s=-3),
    "P": _unit(0.1, kg=1, m=-1, s=-1),
    "St": _unit(1e-4, m=2, s=-1),
}
MORE = {name: unit for names, unit in _BY_NAMES.items() for name in names.split()}
PREFIXES = {
    **{"p": 1e-12, "n": 1e-9, "u": 1e-6, "\u00b5": 1e-6, "\u03bc": 1e-6, "m": 1e-3, "c": 1e-2},
    **{"d": 1e-1, "da": 1e1, "h": 1e2, "k": 1e3, "M": 1e6, "G": 1e9, "T": 1e12},
}
PREFIXED = (
    *("m", "g", "s", "rad", "A", "K", "mol", "N", "J", "W", "Pa", "bar", "l"),
    *("Hz", "V", "C", "Ohm", "ohm", "\u03a9", "F", "H", "S", "T", "Wb", "L"),
    *("Wh", "Ah", "eV", "cal", "lm", "P", "St"),
)
_LETTERS = r"[A-Za-z\u00b0\u03a9\u00b5\u03bc%]+"
_FACTOR = re.compile(rf"({_LETTERS})(?:(?:\^|\*\*)?([-+]?\d{{1,2}})(?!\d))?|1(?![\d^*])")
_SEPARATOR = re.compile(r"\s*([.*\u00b7/-]|\s)\s*")
_ENDS = r"(?=\s*(?:/|$))"  # no power or factor may follow
_BRACKETS = re.compile(rf"\(([^()/]*)\){_ENDS}")
_BY_A_QUOTIENT = re.compile(rf"\A(.*)/\s*\(([^()/]*)/([^()/]*)\){_ENDS}")


def single_unit(name: str) -> Unit | None:
    """Return the unit of a name without factors and powers; None if it is unknown."""
    known = dict.get(UNITS, name) or MORE.get(name)
    if known is not None:
        return known
    for letters in (2, 1):
        prefix, own = PREFIXES.get(name[:letters]), name[letters:]
        if prefix is not None and own in PREFIXED:
            base = dict.get(UNITS, own) or MORE[own]
            return Unit(base.factor * prefix, base.base)
    return None


@lru_cache(1024)
def parse_unit(text: str, like: Unit | None = None) -> Unit | None:
    """Return the unit that a text names; None if a part of it is unknown.

    Args:
        text: A known unit, or a product of powers of them such as `kg.m2/s3` or `W/(m.K)`. The
            offset of a temperature counts only where the temperature stands alone. `/min` is
            `1/min`.
        like: What it shall measure; a pound is a force unless only a mass fits.
    """
    if (known := dict.get(UNITS, text)) is not None:
        return known
    unit = _product(text, single_unit)
    if unit is not None and like is not None and not unit.measures_like(like) and "lb" in text:
        by_mass = _product(
            text, lambda name: MORE["lbm"] if name in {"lb", "lbs"} else single_unit(name)
        )
        if by_mass is not None and by_mass.measures_like(like):
            return by_mass
    return unit


def _product(text: str, known: Callable[[str], Unit | None]) -> Unit | None:
    """Return a product of powers; None if a factor is unknown."""
    if (alone := known(_plain(text))) is not None:
        return alone
    if (powers := _powers(text, known)) is None:
        return None
    factor, base = 1.0, dict[str, int]()
    for _, unit, power in powers:
        try:
            factor *= unit.factor**power
        except OverflowError:
            return None
        for name, exponent in unit.base:
            base[name] = base.get(name, 0) + power * exponent
    if not 0 < factor < inf:
        return None
    return Unit(factor, tuple((name, n) for name, n in base.items() if n))


_Powers = list[tuple[str, Unit, int]]


def _plain(text: str) -> str:
    plain = text.strip().replace("\u00b2", "2").replace("\u00b3", "3")
    return f"1{plain}" if plain.startswith("/") else plain


def _powers(text: str, known: Callable[[str], Unit | None]) -> _Powers | None:
    """Return names, units and powers of factors; all after a `/` divide, as in FMI."""
    text = _BY_A_QUOTIENT.sub(r"\3.\1/\2", _plain(text))
    text = _BRACKETS.sub(r"\1", text)
    found, sign = _Powers(), 1
    position, expected = 0, True
    while position < len(text):
        separator = _SEPARATOR.match(text, position)
        if separator and not expected:
            sign = -1 if separator[1] == "/" else sign
            position, expected = separator.end(), True
            continue
        match = _FACTOR.match(text, position)
        name = (match[1] or "1") if match and expected else ""
        if match is None or (unit := known(name)) is None:
            return None
        power = int(match[2] or 1)
        if power == 0:  # as in g0, no unit
            return None
        found.append((name, unit, sign * power))
        position, expected = match.end(), False
    return None if expected else found


def quotient_name(unit: str, by: str) -> str:
    """Return the name of one unit divided by another, such as `rad/kg` or `s` for `rad/(rad/s)`."""
    above, below = _powers(unit, single_unit), _powers(by, single_unit)
    if above is None or below is None:
        return f"{unit}/{by}" if by.isalnum() else f"{unit}/({by})"
    powers = dict[str, int]()
    for factors, sign in ((above, 1), (below, -1)):
        for name, _, power in factors:
            powers[name] = powers.get(name, 0) + sign * power
    powers.pop("1", None)
    over, under = (
        [f"{name}{abs(n) if abs(n) > 1 else ''}" for name, n in powers.items() if sign * n > 0]
        for sign in (1, -1)
    )
    above_line, below_line = ".".join(over) or "1", ".".join(under)
    if not under:
        return above_line
    return f"{above_line}/({below_line})" if len(under) > 1 else f"{above_line}/{below_line}"


def represented(value: object) -> str:
    """Return a value in a message: one line of bounded length."""
    return " ".join(reprlib.repr(value).split())


def known(name: object) -> bool:
    """Return whether a name is that of a unit, or a product of powers of units."""
    return isinstance(name, str) and parse_unit(name) is not None


def convert(value: float, unit: str, target: str) -> float:
    """Convert a number between two units of one kind.

    Raises:
        ValueError: A unit is unknown, or the two are not of one kind.
    """
    for name in (unit, target):
        if not known(name):
            raise ValueError(f"unit {represented(name)} is unknown; known are {', '.join(UNITS)}")
    source = UNITS[unit]
    target_unit = parse_unit(target, source) or UNITS[target]
    source = parse_unit(unit, target_unit) or source
    if not source.measures_like(target_unit):
        raise ValueError(f"'{unit}' cannot be converted to '{target}': not the same kind of unit")
    result: float = converted(value, source, target_unit)
    return result
