"""Units as files define them by FMI's `BaseUnit` and `DisplayUnit`, in FMI 2.0, FMI 3.0 and SSP."""

from collections.abc import Mapping
from functools import lru_cache, partial
from math import isclose, isfinite
from types import MappingProxyType
from typing import Any, NamedTuple

from casadi_models.units import MORE, UNITS, Unit, conversion, parse_unit
from cosim.errors import UsageError
from cosim.fmi.run.description import unit_of

BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
_ROUNDING = 1e-6  # relative, of a factor that a file writes with few digits


def base_unit(attributes: Mapping[str, Any]) -> Unit:
    """Return the unit that the attributes of a `BaseUnit` define.

    Args:
        attributes: Exponents of the base units, `factor` and `offset`; all of them are optional.

    Raises:
        ValueError: One of them is no number, or the factor is 0 or not finite.

    Example:
        >>> from casadi_models.units import conversion
        >>> pascal = base_unit({"kg": "1", "m": "-1", "s": "-2"})
        >>> bar = base_unit({"kg": "1", "m": "-1", "s": "-2", "factor": "1e5"})
        >>> conversion(pascal, bar)
        (1e-05, 0.0)
    """
    exponents = {name: int(attributes.get(name) or 0) for name in BASE_UNITS}
    factor, offset = float(attributes.get("factor", 1)), float(attributes.get("offset", 0))
    if not (factor and isfinite(factor) and isfinite(offset)):
        raise ValueError(f"factor {factor} and offset {offset} define no unit")
    return Unit(factor, tuple((name, n) for name, n in exponents.items() if n), offset)


class Measured(NamedTuple):
    """The name of a unit, and what it means; None for what is missing.

    Attributes:
        is_difference: Whether its values are differences, for which an offset does not count.
    """

    name: str | None = None
    definition: Unit | None = None
    is_difference: bool = False

    @classmethod
    def of(cls, name: str | None, defined: Mapping[str, Unit]) -> "Measured":
        """Return a unit by its definition in a file, or else with its usual meaning."""
        usual = parse_unit(name.strip("[]")) if name else None  # tables have units in brackets
        return cls() if name is None else cls(name, defined.get(name) or usual)

    def difference(self) -> "Measured":
        """Return the unit of differences."""
        definition = self.definition and self.definition.difference()
        return Measured(self.name, definition, is_difference=True)


def change_of_units(
    sink: str, driven: Measured, source: str, driving: Measured
) -> tuple[float, float]:
    """Return factor and offset from one unit to another; units without definition are equal.

    Raises:
        UsageError: They measure different quantities.
    """
    if driving.definition is None or driven.definition is None:
        return 1.0, 0.0
    try:
        return conversion(driving.definition, driven.definition)
    except ValueError as error:
        ends = f"{source} [{driving.name}] cannot drive {sink} [{driven.name}]"
        raise UsageError(f"{ends}: {error}") from error


@lru_cache(8)
def definitions(description: Any) -> Mapping[str, Unit]:
    """Return the units that a file defines, by name.

    Args:
        description: fmpy's model description.
    """
    found = {}
    for unit in description.unitDefinitions:
        base = unit.baseUnit
        if base is not None:
            attributes = {n: getattr(base, n) for n in (*BASE_UNITS, "factor", "offset")}
            try:
                found[unit.name] = base_unit(attributes)
            except (TypeError, ValueError):
                continue  # as if it were not defined
    return MappingProxyType(found)


def definition_of(variable: Any, description: Any) -> Unit | None:
    """Return the unit of a variable by the definition in its file.

    A name that the file uses without a definition has its usual meaning.

    Returns:
        None if the variable has no unit, or one that is neither defined nor known.
    """
    name = unit_of(variable)
    if name is None:
        return None
    unit = definitions(description).get(name) or parse_unit(name)
    return unit.difference() if unit is not None and is_relative(variable) else unit


def units_for(variable: Any, description: Any) -> Mapping[str, Unit]:
    """Return the units by name in which a value of a variable may be written.

    Those of the file, and the display units of the variable's unit.
    """
    own = definition_of(variable, description)
    known = dict(definitions(description))
    if own is None:
        return known
    for name, (factor, offset) in _displays(description).get(unit_of(variable), {}).items():
        known.setdefault(
            name, Unit(own.factor / factor, own.base, own.offset - own.factor * offset / factor)
        )
    if is_relative(variable):
        usual = {name: unit for name, unit in (UNITS | MORE).items() if unit.offset}
        known = {name: unit.difference() for name, unit in (usual | known).items()}
    return known | {str(unit_of(variable)): own}


def display_of(variable: Any, description: Any) -> tuple[str | None, float | None, float]:
    """Return the display unit of a variable, and its factor and offset by the file.

    Returns:
        The name, None if the file does not define it; the factor, None if the definition is that
        which the name has anyway; and the offset.
    """
    declared = variable.declaredType
    unit, name = unit_of(variable), variable.displayUnit
    name = name or (declared.displayUnit if declared else None)
    if name is None or name == unit:
        return None, None, 0.0
    found = _displays(description).get(unit, {}).get(name)
    own, shown = parse_unit(unit or ""), parse_unit(name)
    usual = None
    if own is not None and shown is not None and own.measures_like(shown):
        usual = conversion(own, shown)
    if found is None:
        return (name if usual else None), None, 0.0
    factor, offset = found
    is_close = partial(isclose, rel_tol=_ROUNDING, abs_tol=1e-12)
    if usual and all(map(is_close, (factor, offset), usual)):
        return name, None, 0.0
    return name, factor, offset


@lru_cache(8)
def _displays(description: Any) -> Mapping[str | None, Mapping[str, tuple[float, float]]]:
    """Return factor and offset of the display units by unit and name."""
    found = dict[str | None, Mapping[str, tuple[float, float]]]()
    for unit in description.unitDefinitions:
        own = {d.name: (float(d.factor), float(d.offset)) for d in unit.displayUnits}
        found[unit.name] = {
            name: (factor, offset)
            for name, (factor, offset) in own.items()
            if factor and isfinite(factor) and isfinite(offset)
        }
    return found


def is_relative(variable: Any) -> bool:
    """Tell whether a variable is a difference, for which the offset of its unit does not count."""
    declared = variable.declaredType
    return bool(variable.relativeQuantity or (declared and declared.relativeQuantity))
