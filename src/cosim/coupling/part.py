"""`Part`: a model or an FMU in a coupled system, with its variables."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import Any

import casadi as ca

from casadi_models.dae import Dae
from casadi_models.dae.coupled import Connection
from casadi_models.dae.expressions import operations
from casadi_models.dae.variables import is_name
from casadi_models.units import Unit
from cosim.errors import UnknownName, UsageError
from cosim.fmi.archive import unpacked
from cosim.fmi.export.events import has_fmu_events
from cosim.fmi.run.arrays import with_elements
from cosim.fmi.run.description import by_name, read_description, unit_of
from cosim.fmi.run.request import holds_value, is_settable
from cosim.fmi.run.typed_values import NUMERIC, RANGES, REALS
from cosim.fmi.units import Measured, change_of_units, is_relative, units_for
from cosim.memo import cached_per_thread
from cosim.model.catalogue import model_of


@dataclass(frozen=True)
class Variable:
    """A variable of a part: its unit (None if the part does not name one) and what it may be.

    Attributes:
        name, unit: Name and unit.
        is_input, is_source, is_start: Whether it can be driven, can drive, has a start value.
        units: Definitions of units by name, with that of its own unit if there is one.
        type: Of its values, as the FMI calls it; "array" for an array as a whole.
        declaredType: fmpy's type with the items of an enumeration.
        is_difference: Whether its values are differences, for which an offset does not count.
    """

    name: str
    unit: str | None
    is_input: bool
    is_source: bool
    is_start: bool
    units: Mapping[str, Unit] = field(default_factory=dict)
    type: str = "Real"
    declaredType: Any = None  # noqa: N815 # as fmpy calls it, for `typed_value`
    variability: str = "continuous"
    is_difference: bool = False

    @property
    def definition(self) -> Unit | None:
        """What the unit means; None if there is no unit, or nothing defines it."""
        return self.measured.definition

    @property
    def measured(self) -> Measured:
        """The unit with its meaning."""
        return Measured.of(self.unit, self.units)._replace(is_difference=self.is_difference)

    @property
    def items(self) -> dict[str, int]:
        """The values of an enumeration by name; of another type none."""
        listed = self.declaredType.items if self.type == "Enumeration" and self.declaredType else ()
        return {item.name: int(item.value) for item in listed}

    @property
    def range(self) -> tuple[float, float]:
        """The smallest and the largest integer that it may be; infinity for other types."""
        values = [*self.items.values()] or [*RANGES.get(self.type, ())]
        return min(values, default=-inf), max(values, default=inf)

    def takes(self, driving: "Variable") -> bool:
        """Tell whether it has every value of another one, so that nothing is rounded or wrapped."""
        if self.type in REALS:
            return driving.type in REALS or driving.type in RANGES
        if self.type in RANGES:
            (low, high), (least, most) = driving.range, self.range
            return driving.type != "Boolean" and least <= low and high <= most
        if self.type == "Enumeration" and driving.type in RANGES:  # which of its items, as in FMI
            return True
        return self.type == driving.type and self.items == driving.items


@dataclass(frozen=True, eq=False)
class Part:
    """A part: a model, or the path of an FMU.

    Attributes:
        name: Of the part, an identifier.
        subject: The model or the file.
        variables: By name.
        origin: Its name in the file that declares it, if that is no identifier.
    """

    name: str
    subject: Dae | Path
    variables: dict[str, Variable]
    origin: str = ""

    def variable(self, name: str) -> Variable:
        """Return a variable.

        Raises:
            UnknownName: The part has none of this name.
        """
        UnknownName.reject(f"part '{self.name}'", "variable", self.variables, name)
        return self.variables[name]

    def numbers(self, name: str) -> list[str]:
        """Return the variables that can be recorded by a name: itself, or elements of an array."""
        array = self.variables[name].type == "array"
        own = [v.name for v in self.variables.values() if v.name.startswith(f"{name}[")]
        numbers = own if array else [name]
        return [one for one in numbers if NUMERIC.fullmatch(self.variables[one].type)]

    @property
    def version_to_run(self) -> int:
        """The version of the FMI in which a model is exported to be a part.

        Events end macro steps by the event mode of FMI 3.0. Where outputs that drive others call
        tables it is 2.0, whose model exchange has rates on both sides of a corner.
        """
        dae = self.subject
        if not isinstance(dae, Dae) or not has_fmu_events(dae):
            return 2
        return 2 if ca.OP_CALL in operations(dae.driving_outputs) and not dae.algebraics else 3


def part_of(name: str, subject: object, folder: Path = Path()) -> Part:
    """Return a part.

    Args:
        name: Of the part.
        subject: A `Dae`, the name of a model, "PATH.py:FUNCTION" or the path of an FMU; paths are
            relative to `folder`.

    Raises:
        UsageError: The name is no identifier, or the subject none of these.
        CosimError: The model or the file cannot be loaded.
    """
    if not is_name(name):
        raise UsageError(f"part {name!r}: use letters, digits and _ for the name of a part")
    if isinstance(subject, os.PathLike) or (
        isinstance(subject, str) and subject.lower().endswith(".fmu")
    ):
        path = folder / subject
        return Part(name, path, _of_fmu(path))
    if isinstance(subject, str):
        place, colon, function = subject.rpartition(".py:")
        subject = model_of("part", f"{folder / place}.py:{function}" if colon else subject)
    if not isinstance(subject, Dae):
        raise UsageError.of_type(f"part '{name}'", subject, "a model, its name, or an FMU file")
    return Part(name, subject, _of_model(subject))


@cached_per_thread(16)
def _of_model(dae: Dae) -> dict[str, Variable]:
    inputs = {v.name for v in dae.inputs}
    sources = {v.name for v in (*dae.states, *dae.algebraics, *dae.output_variables)}
    starts = inputs | {v.name for v in (*dae.states, *dae.parameters) if v.start is not None}
    starts |= {through.variable.name for through in dae.start_outputs}
    return {
        v.name: Variable(v.name, v.unit, v.name in inputs, v.name in sources, v.name in starts)
        for v in dae.variables
    }


def _of_fmu(path: Path) -> dict[str, Variable]:
    with unpacked(path, to_run=True) as folder:
        description = with_elements(read_description(folder, path))
    if description.coSimulation is None and description.modelExchange is None:
        raise UsageError(
            f"{path} is for scheduled execution only, and a part of a system cannot be; export it "
            "for co-simulation or model exchange"
        )
    found = {}
    for name, variable in by_name(description).items():
        is_input = holds_value(variable) and variable.causality == "input"
        source = holds_value(variable) and variable.causality in ("output", "local")
        # sizes are those of the file
        start = is_settable(variable) and variable.causality != "structuralParameter"
        units = units_for(variable, description)
        kind = "array" if variable.dimensions else variable.type
        facts = unit_of(variable), is_input, source, start, units, kind, variable.declaredType
        own = {"variability": variable.variability, "is_difference": is_relative(variable)}
        found[name] = Variable(variable.name, *facts, **own)
    return found


def reject_types(
    sink: str, driven: Variable, source: str, driving: Variable, *, changed: bool
) -> None:
    """Raise UsageError if a connection cannot carry the values of `source` to `sink`.

    Args:
        changed: Whether it has a linear transformation.
    """
    for name, variable in ((sink, driven), (source, driving)):
        if variable.type == "array":
            raise UsageError(f"{name} is an array; connect its elements, such as {name}[1]")
        if NUMERIC.fullmatch(variable.type) is None and variable.type != "String":
            raise UsageError(
                f"{name} is of type {variable.type}, which connections do not carry; connect "
                "numbers, Booleans, enumerations or texts"
            )
    if not driven.takes(driving):
        other = " with other items" if driven.type == driving.type == "Enumeration" else ""
        raise UsageError(
            f"{source} ({driving.type}) cannot drive {sink} ({driven.type}{other}), which does not "
            "have all its values; connect variables of one type"
        )
    if changed and driven.type not in REALS:
        raise UsageError(
            f"{source} cannot drive {sink} by a linear transformation, as {sink} is of type "
            f"{driven.type}; transform real numbers only"
        )


def split_name(parts: Mapping[str, Part], name: object) -> tuple[str, str]:
    """Return part and variable of "part.variable".

    Raises:
        UnknownName: There is no such part or variable.
    """
    part, _, variable = str(name).partition(".")
    if part not in parts:
        raise UnknownName.among("the system", "part", part, parts)
    return part, parts[part].variable(variable).name


def free_name(parts: Mapping[str, Part], name: str) -> str:
    """Return a name that no part has: the given one, or one with underscores behind it."""
    while name in parts:
        name += "_"
    return name


def split_key(name: str) -> tuple[str, str]:
    """Return part and variable of "part.variable"; names of parts have no dot."""
    part, _, variable = name.partition(".")
    return part, variable


def connection_of(parts: Mapping[str, Part], sink: str, source: str) -> Connection:
    """Return the connection of an input and what drives it, with the conversion of their units.

    Raises:
        UnknownName, UsageError: See `couple`.
    """
    ends = split_name(parts, sink), split_name(parts, source)
    driven, driving = (parts[part].variable(name) for part, name in ends)
    reject_types(sink, driven, source, driving, changed=False)
    if not driven.is_input:
        inputs = [v.name for v in parts[ends[0][0]].variables.values() if v.is_input]
        raise UsageError(
            f"{sink} is no input; connect an input: {', '.join(inputs) or 'this part has none'}"
        )
    if not driving.is_source:
        raise UsageError(f"{source} is no output and no state; connect one that is")
    return Connection(*ends, *change_of_units(sink, driven.measured, source, driving.measured))


def undefined_units(
    parts: Mapping[str, Part], connections: Sequence[Connection]
) -> Mapping[str, str]:
    """Return the first connection of each unit without a definition, if both ends have units."""
    found = dict[str, str]()
    for wire in connections:
        ends = [parts[part].variable(name) for part, name in (wire.output, wire.input)]
        if None in (ends[0].unit, ends[1].unit) or ends[0].unit == ends[1].unit:
            continue
        for end in ends:
            if end.definition is None:
                text = f"{'.'.join(wire.output)} to {'.'.join(wire.input)}"
                found.setdefault(str(end.unit), text)
    return found
