"""`values_of`: start values of a coupled system, by names of its parts and of its connectors."""

from collections.abc import Collection, Mapping
from typing import NamedTuple

from casadi_models.units import Unit
from cosim.coupling.connectors import Connector, End, transformed
from cosim.coupling.part import Part, split_name
from cosim.errors import UsageError
from cosim.fmi.run.typed_values import REALS, typed_value, value_of_text
from cosim.model.quantities import quantity
from cosim.model.values import number


class Target(NamedTuple):
    """What a name of a system sets.

    Attributes:
        key: Its owner and its name.
        ends: The variables of parts.
        unit: Of its value; None if it has none.
        units: What units mean, by name.
    """

    key: tuple[str, str]
    ends: tuple[End, ...]
    unit: str | None
    units: Mapping[str, Unit]


def target(parts: Mapping[str, Part], connectors: Mapping[str, Connector], name: str) -> Target:
    """Return what "part.variable" or the name of an input of the whole system sets.

    Raises:
        UnknownName: There is no such part or variable.
    """
    connector = connectors.get(name)
    if connector is not None and connector.is_input:
        key = "the system", name
        return Target(key, connector.ends, connector.unit, dict(connector.units))
    key = split_name(parts, name)
    variable = parts[key[0]].variable(key[1])
    return Target(key, (End(key, 1.0, 0.0),), variable.unit, dict(variable.units))


def values_of(
    parts: Mapping[str, Part],
    given: Mapping[str, float | str],
    connectors: Mapping[str, Connector],
    driven: Collection[tuple[str, str]] = (),
) -> dict[tuple[str, str], float]:
    """Return values by part and variable.

    Args:
        given: Numbers in the variable's unit, or texts with a unit, by "part.variable" or by the
            name of a connector of the whole system.
        driven: Inputs that are connected, which take no values, by part and variable.

    Raises:
        CosimError: A name does not exist, a value does not fit, or a variable takes none.
    """
    UsageError.reject("start_values", given, Mapping, "values by name, e.g. {'a.x': 1}")
    found = dict[tuple[str, str], float]()
    for name, value in given.items():
        key, ends, unit, units = target(parts, connectors, name)
        variables = [parts[part].variable(own) for (part, own), *_ in ends]
        if not all(variable.is_start for variable in variables):
            raise UsageError(f"{name} cannot be given; it is calculated")
        if any(end.variable in driven for end in ends):
            raise UsageError(f"{name} is connected and given a value; drop one")
        pairs = [*zip(ends, variables, strict=True)]
        other = next((v for end, v in pairs if end.is_same and v.type not in REALS), None)
        if other is None:
            if isinstance(value, str):
                value = quantity(".".join(key), value, unit or "1", definitions=units)
            plain = number(*key, value)
        else:
            plain = value_of_text(key[0], other, value)
            plain = int(plain) if isinstance(plain, bool) else plain
        for end, variable in pairs:
            own = transformed(plain, end.factor, end.offset)
            found[end.variable] = typed_value(end.variable[0], variable, own)
    return found
