"""Units: exact conversion factors and what FMI needs to know of each unit.

SI inside; a number is converted once, where it is first written: ``6 * INCH`` is a length in meter.
"""

import re
from dataclasses import dataclass
from math import pi

INCH = 0.0254  # m, exact
FOOT = 0.3048  # m, exact (12 * 0.0254 is one rounding off)
POUND = 4.4482216152605  # N, exact
SLUG = 14.593902937206364  # kg, 1 lbf.s2/ft (POUND / FOOT is one rounding off)
FOOT_POUND = FOOT * POUND  # N.m
DEGREE = pi / 180  # rad
RPM = pi / 30  # rad/s


@dataclass(frozen=True)
class Unit:
    """A unit as factor times a product of SI base units.

    Attributes:
        factor: One of this unit in SI base units.
        base: Exponents by FMI's names of base units: kg, m, s, A, K, mol, cd, rad.
    """

    factor: float
    base: tuple[tuple[str, int], ...]

    def measures_like(self, other: "Unit") -> bool:
        """Return whether both measure the same kind of quantity."""
        return dict(self.base) == dict(other.base)


def _unit(factor: float = 1.0, **base: int) -> Unit:
    return Unit(factor, tuple(base.items()))


class Units(dict[str, Unit]):
    """Units by name; an unknown one counts as a number with factor 1."""

    def __missing__(self, name: str) -> Unit:
        return product(name) or _unit()


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

# Parts of products that are not in the table on their own
PARTS = {
    "A": _unit(A=1),
    "K": _unit(K=1),
    "mol": _unit(mol=1),
    "cd": _unit(cd=1),
    "Hz": _unit(s=-1),
    "Pa": _unit(kg=1, m=-1, s=-2),
    "V": _unit(kg=1, m=2, s=-3, A=-1),
    "C": _unit(s=1, A=1),
    "Ohm": _unit(kg=1, m=2, s=-3, A=-2),
    "F": _unit(kg=-1, m=-2, s=4, A=2),
    "H": _unit(kg=1, m=2, s=-2, A=-2),
    "min": _unit(60.0, s=1),
    "h": _unit(3600.0, s=1),
    "km": _unit(1e3, m=1),
}
_FACTOR = re.compile(r"([A-Za-z]+)(?:\^?(-?\d+))?")


def product(name: str) -> Unit | None:
    """Return the unit of a name like `kg.m2/s3` or `W/(m.K)`; None where a part is unknown."""
    if not isinstance(name, str):
        return None
    above, *below = re.sub(r"[() ]", "", name).replace("*", ".").split("/")
    factor, exponents = 1.0, dict[str, int]()
    for sign, text in ((1, above), *((-1, part) for part in below)):
        for part in text.split("."):
            if sign == 1 and part == "1":
                continue
            match = _FACTOR.fullmatch(part)
            unit = match and (dict.get(UNITS, match[1]) or PARTS.get(match[1]))
            if not (match and unit):
                return None
            power = sign * int(match[2] or 1)
            factor *= unit.factor**power
            for base, exponent in unit.base:
                exponents[base] = exponents.get(base, 0) + power * exponent
    return Unit(factor, tuple((base, n) for base, n in exponents.items() if n))


def known(name: object) -> bool:
    """Return whether a unit is in the table or a product of units that are."""
    return isinstance(name, str) and (name in UNITS or product(name) is not None)


def convert(value: float, unit: str, target: str) -> float:
    """Convert a number between two units of one kind.

    Raises:
        ValueError: A unit is unknown, or the two are not of one kind.
    """
    for name in (unit, target):
        if not known(name):
            raise ValueError(f"unit {name!r} is unknown; known are {', '.join(UNITS)}")
    source, target_unit = UNITS[unit], UNITS[target]
    if not source.measures_like(target_unit):
        raise ValueError(f"'{unit}' cannot be converted to '{target}': not the same kind of unit")
    return (
        value if source.factor == target_unit.factor else value * source.factor / target_unit.factor
    )
