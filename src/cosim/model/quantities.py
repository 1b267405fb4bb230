"""Parser of quantities such as `60deg`, `9.81 m/s^2` or `0.5 N*m` to SI numbers."""

import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from math import inf
from pathlib import Path

from casadi_models.units import PARTS, UNITS, Unit
from cosim.errors import ParameterError
from cosim.text import LONGEST_WORD, bounded

_NUMBER = r"[-+]?(?:\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+(?:[eE][-+]?\d+)?|inf|nan)"
_QUANTITY = re.compile(rf"\s*({_NUMBER})\s*(.*?)\s*")
_FACTOR = re.compile(
    r"([A-Za-z\u00b0\u03a9\u00b5\u03bc%]+)(?:(?:\^|\*\*)?([-+]?\d{1,2})(?!\d))?|1(?![\d^*])"
)
_SEPARATOR = re.compile(r"\s*([.*\u00b7/-]|\s)\s*")


def _more_units() -> Mapping[str, Unit]:
    """Return the units beside those of the models, by name."""
    table = tomllib.loads(Path(__file__).with_name("units.toml").read_text(encoding="utf-8"))
    aliases = {name: UNITS[known] for name, known in table["aliases"].items()}
    units = {name: Unit(u.pop("factor"), tuple(u.items())) for name, u in table["units"].items()}
    return aliases | units


MORE = _more_units()


def quantity(name: str, text: str, unit: str) -> float:
    """Read `VALUE[UNIT]` as a number in a variable's own unit.

    The unit may be a product of powers: `N*m`, `N.m`, `ft-lb`, `m/s^2`, `kg m2`.

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
    given = f"{name} = {bounded(text, LONGEST_WORD)}"
    if "," in written:
        raise ParameterError(f"{given}: write a decimal point, and one number only")
    if not written or written == unit:
        return value
    target = parse_unit(unit)
    if target is None:  # not in the table
        raise ParameterError(f"{given}: give a number in {unit}, without a unit")
    source = parse_unit(written, like=target)
    if source is None:
        fitting = ", ".join(known for known, one in UNITS.items() if one.measures_like(target))
        raise ParameterError(f"{given}: unit '{written}' is unknown; fitting: {fitting}")
    if not source.measures_like(target):
        reason = f"'{written}' cannot be converted to '{unit}': not the same kind of unit"
        raise ParameterError(f"{given}: {reason}")
    return value if source.factor == target.factor else value * source.factor / target.factor


def reject_mixed_units(name: str, words: Sequence[str]) -> None:
    """Reject a list of quantities in which one has a unit and another, which is not 0, has none.

    Raises:
        ParameterError: It is such a list, e.g. 100,200,300rpm.
    """
    found = [match for match in map(_QUANTITY.fullmatch, words) if match]
    without = [match[0].strip() for match in found if not match[2] and float(match[1])]
    if without and (others := [match[0].strip() for match in found if match[2]]):
        raise ParameterError(
            f"{name}: {without[0]} has no unit and {others[0]} has one; write the unit at each"
        )


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
        by_mass = _product(text, lambda one: MORE["lbm"] if one in {"lb", "lbs"} else _known(one))
        if by_mass is not None and by_mass.measures_like(like):
            return by_mass
    return unit


def _known(name: str) -> Unit | None:
    return UNITS.get(name) or PARTS.get(name) or MORE.get(name)


def _product(text: str, known: Callable[[str], Unit | None]) -> Unit | None:
    """Return a product of powers; all factors after a `/` divide, as in FMI."""
    factor, base, sign = 1.0, dict[str, int](), 1
    position, text = 0, text.strip().replace("\u00b2", "2").replace("\u00b3", "3")
    expected = True
    while position < len(text):
        separator = _SEPARATOR.match(text, position)
        if separator and not expected:
            sign = -1 if separator[1] == "/" else sign
            position, expected = separator.end(), True
            continue
        match = _FACTOR.match(text, position)
        unit = known(match[1] or "1") if match and expected else None
        if match is None or unit is None:
            return None
        power = sign * int(match[2] or 1)
        try:
            factor *= unit.factor**power
        except OverflowError:
            return None
        for name, exponent in unit.base:
            base[name] = base.get(name, 0) + power * exponent
        position, expected = match.end(), False
    if expected or not 0 < factor < inf:
        return None
    return Unit(factor, tuple((name, n) for name, n in base.items() if n))
