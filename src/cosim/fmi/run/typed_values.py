"""Values of FMU variables, checked against the type of the variable."""

import re
from numbers import Integral
from typing import Any

from cosim.errors import FmuError, ParameterError, UsageError
from cosim.model.values import number

NUMERIC = re.compile("Real|Integer|Boolean|Enumeration|Float..|U?Int.{1,2}")
REALS = ("Real", "Float64", "Float32")
_WORDS = {"true": True, "false": False, "0": False, "1": True}
RANGES = {"Integer": (-(2**31), 2**31 - 1)}
for _bits in (8, 16, 32, 64):
    RANGES[f"Int{_bits}"] = (-(2 ** (_bits - 1)), 2 ** (_bits - 1) - 1)
    RANGES[f"UInt{_bits}"] = (0, 2**_bits - 1)
_EXACT = 2**53  # doubles below it hold every integer
_LARGEST_FLOAT32 = 3.4028234663852886e38


def is_number(variable: Any) -> bool:
    """Tell whether a variable holds one number."""
    return NUMERIC.fullmatch(variable.type) is not None and not variable.dimensions


def is_continuous(variable: Any) -> bool:
    """Tell whether an input may change at any time."""
    return variable.type in REALS and variable.variability == "continuous"


def start_number(variable: Any) -> float:
    """Return the start value of a variable of fmpy's; 0 if it has none or is a text."""
    if variable.type == "String":
        return 0.0
    return float(_WORDS.get(variable.start, variable.start or 0.0))


def start_value(variable: Any) -> Any:
    """Return the start value of a variable of fmpy's as its type has it; 0 or "" if it has none."""
    if variable.type == "String":
        return variable.start or ""
    if variable.type in RANGES or variable.type == "Enumeration":
        return int(variable.start or 0)
    return start_number(variable)


def typed_value(owner: str, variable: Any, value: Any) -> Any:
    """Return a value as the type of a variable requires; nothing is rounded or wrapped.

    Args:
        owner: Of the variable, for errors.
        variable: Of fmpy's model description.
        value: A number in the variable's unit; for a Boolean also a truth value or its word, for an
            enumeration also the name of an item, for a String a text.

    Raises:
        ParameterError: The type does not have this value.
    """
    name, kind = variable.name, variable.type
    if kind == "Boolean":
        found = _WORDS.get(str(value).lower().removesuffix(".0"))
        if found is None:
            raise ParameterError(f"{owner}: {name} = {value} is no Boolean; give true or false")
        return found
    if kind == "Enumeration" and variable.declaredType is not None:
        items = {item.name: int(item.value) for item in variable.declaredType.items}
        if isinstance(value, str) and value in items:
            return items[value]
        if not isinstance(value, str) and value in items.values():
            return int(value)
        allowed = ", ".join(f"{item} ({n})" for item, n in items.items())
        raise ParameterError(f"{owner}: {name} = {value} is no item of it; give one of {allowed}")
    if kind == "String":
        if not isinstance(value, str) or "\0" in value:
            raise ParameterError(f"{owner}: {name} = {value!r} is no String; give a text")
        return value
    if isinstance(value, str):
        raise ParameterError(
            f"{owner}: {name} = {value!r} is not a real number; give a number in the FMU's own "
            "unit, and no unit"
        )
    if kind in RANGES:
        low, high = RANGES[kind]
        plain = number(owner, name, value)
        whole = int(value if isinstance(value, Integral) else plain)
        if whole != value or not low <= whole <= high:
            raise ParameterError(
                f"{owner}: {name} = {value!r} is no {kind}; give a whole number from {low} to "
                f"{high}"
            )
        return whole
    plain = number(owner, name, value)
    if kind == "Float32" and abs(plain) > _LARGEST_FLOAT32:
        raise ParameterError(f"{owner}: {name} = {value!r} is too large for a Float32")
    return plain


def value_of_text(owner: str, variable: Any, value: object) -> Any:
    """Return a value, or what a text says, as the type of a variable requires."""
    plain = isinstance(value, str) and variable.type != "String"
    whole = plain and str(value).strip().removeprefix("-").isdecimal()
    return typed_value(owner, variable, int(str(value)) if whole else value)


def series_value(owner: str, variable: Any, value: object) -> float:
    """Return the number of a value that an input may have within a time series.

    Raises:
        UsageError: No input of its type follows one.
        ParameterError: The type does not have this value.
    """
    if NUMERIC.fullmatch(variable.type) is None:
        raise UsageError(
            f"{owner}: {variable.name} is of type {variable.type}, which follows no time series; "
            "give it a constant value"
        )
    found = value_of_text(owner, variable, value)
    if variable.type in RANGES and abs(found) >= _EXACT:
        raise ParameterError(
            f"{owner}: {variable.name} = {found}: time series hold integers below 2^53 only"
        )
    return float(found)


def bounds_of(variable: Any) -> list[str | None]:
    """Return the bounds of a variable or of its type, as texts."""
    places = variable, getattr(variable, "declaredType", None)
    return [
        next((bound for one in places if (bound := getattr(one, end, None))), None)
        for end in ("min", "max")
    ]


def reject_beyond_bounds(variable: Any, value: Any) -> None:
    """Reject a number that the bounds in a file exclude, where its FMU has accepted it.

    Raises:
        FmuError: The number is out of its bounds.
    """
    low, high = bounds_of(variable)
    if isinstance(value, str | bool) or variable.type == "Enumeration":
        return
    if (low and value < float(low)) or (high and value > float(high)):
        raise FmuError(
            f"{variable.name} = {value:g} is out of its range {low or '-infinity'} ... "
            f"{high or 'infinity'}, which the FMU does not say; give a value within"
        )
