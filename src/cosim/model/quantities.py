"""Parser of quantities such as `60deg`, `9.81 m/s^2` or `0.5 N*m` to SI numbers."""

import re
from collections.abc import Mapping, Sequence

from casadi_models.units import MORE, UNITS, Unit, converted, parse_unit
from cosim.errors import ParameterError
from cosim.text import LONGEST_WORD, bounded

_NUMBER = r"[-+]?(?:\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+(?:[eE][-+]?\d+)?|inf|nan)"
_QUANTITY = re.compile(rf"\s*({_NUMBER})\s*(.*?)\s*")


def quantity(
    name: str,
    text: str,
    unit: str,
    *,
    definitions: Mapping[str, Unit] | None = None,
    difference: bool = False,
) -> float:
    """Read `VALUE[UNIT]` as a number in a variable's own unit.

    The unit may be a product of powers: `N*m`, `N.m`, `ft-lb`, `m/s^2`, `kg m2`.

    Args:
        name: Of the variable, for errors.
        text: Number and unit.
        unit: The variable's own.
        definitions: Units by name that a file defines; they precede the known ones.
        difference: Whether it is a difference of two values, for which an offset does not count.

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
    own = definitions or {}
    target = own.get(unit) or parse_unit(unit)
    if target is None:  # neither known nor defined
        raise ParameterError(f"{given}: give a number in {unit}, without a unit")
    source = own.get(written) or parse_unit(written, like=target)
    if source is None or not source.measures_like(target):
        reason = f"unit '{written}' is unknown"
        if source is not None:
            reason = f"'{written}' cannot be converted to '{unit}': not the same kind of unit"
        fitting = ", ".join(
            [known for known, one in UNITS.items() if one.measures_like(target)]
            or [known for known, one in MORE.items() if one.measures_like(target)]
        )
        raise ParameterError(f"{given}: {reason}; fitting: {fitting}")
    if difference:
        source, target = source.difference(), target.difference()
    number: float = converted(value, source, target)
    return number


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
