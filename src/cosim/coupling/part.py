"""`Part`: a model or an FMU in a coupled system, with its variables."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from casadi_models.dae import Dae
from casadi_models.dae.variables import is_name
from casadi_models.units import Unit, parse_unit
from cosim.errors import UnknownName, UsageError
from cosim.fmi.archive import unpacked
from cosim.fmi.run.instance import by_name, is_number, may_be_set, read_description, unit_of
from cosim.fmi.units import units_for
from cosim.integrate.keywords import named
from cosim.memo import cached_per_thread


@dataclass(frozen=True)
class Variable:
    """A variable of a part: its unit (None if the part does not name one) and what it may be.

    Attributes:
        name, unit: Name and unit.
        units: Definitions of units by name, with that of its own unit if there is one.
        is_input, is_source, is_start: Whether it can be driven, can drive, has a start value.
        other_type: Its type if it is no real number of double precision, which cannot be connected.
    """

    name: str
    unit: str | None
    is_input: bool
    is_source: bool
    is_start: bool
    units: Mapping[str, Unit] = field(default_factory=dict)
    other_type: str = ""

    @property
    def definition(self) -> Unit | None:
        """What the unit means; None if there is no unit, or nothing defines it."""
        return None if self.unit is None else self.units.get(self.unit) or parse_unit(self.unit)

    def reject_other_type(self, shown: str) -> None:
        """Raise UsageError if no connection can carry its type; `shown` names it in the system."""
        if self.other_type:
            raise UsageError(
                f"{shown} is of type {self.other_type}, and connections carry real numbers; "
                "connect a variable of type Real or Float64"
            )


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
        if name not in self.variables:
            raise UnknownName.among(f"part '{self.name}'", "variable", name, self.variables)
        return self.variables[name]


def part_of(name: str, subject: object, folder: Path) -> Part:
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
    if isinstance(subject, os.PathLike) or (isinstance(subject, str) and subject.endswith(".fmu")):
        path = folder / subject
        return Part(name, path, _of_fmu(path))
    if isinstance(subject, str):
        place, colon, function = subject.rpartition(".py:")
        subject = named(f"{folder / place}.py:{function}" if colon else subject)
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
    with unpacked(path) as folder:
        description = read_description(folder, path)
    if description.coSimulation is None:
        exchange = description.modelExchange is not None
        only = "model exchange" if exchange else "scheduled execution"
        raise UsageError(
            f"{path} is for {only} only, and a part of a system needs a solver of its own; "
            f"export it for co-simulation{', or simulate it alone' if exchange else ''}"
        )
    found = {}
    for name, variable in by_name(description).items():
        other = "array" if variable.dimensions else variable.type
        other = "" if other in ("Real", "Float64") else other
        continuous = not other
        is_input = continuous and variable.causality == "input"
        source = continuous and variable.causality in ("output", "local")
        start = is_number(variable) and may_be_set(variable)
        units = units_for(variable, description)
        unit = unit_of(variable)
        found[name] = Variable(variable.name, unit, is_input, source, start, units, other)
    return found


def split_name(parts: Mapping[str, Part], name: object) -> tuple[str, str]:
    """Return part and variable of "part.variable".

    Raises:
        UnknownName: There is no such part or variable.
    """
    part, dot, variable = str(name).partition(".")
    if not dot or part not in parts:
        raise UnknownName.among("the system", "part", part, parts)
    return part, parts[part].variable(variable).name


def split_key(name: str) -> tuple[str, str]:
    """Return part and variable of "part.variable"; names of parts have no dot."""
    part, _, variable = name.partition(".")
    return part, variable
