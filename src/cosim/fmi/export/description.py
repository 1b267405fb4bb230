"""What the model descriptions of FMI 2.0 and 3.0 have in common."""

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET

from casadi_models.dae import Dae, Start
from casadi_models.units import UNITS, Unit
from cosim.fmi.export.variables import Dependencies, FmuVariable, Role, rate_unit
from cosim.model.reduction.structure import Pattern

LOG_CATEGORIES = {
    "logStatusWarning": "what was done although it may not be meant",
    "logStatusDiscard": "evaluations that gave no finite result",
    "logStatusError": "calls that were refused, and why",
}


@dataclass(frozen=True)
class Identity:
    """What names an FMU: C identifier, GUID, tool, source files, tolerance."""

    identifier: str
    guid: str
    tool: str
    sources: tuple[str, ...]
    tolerance: float


@dataclass(frozen=True)
class Unknown:
    """A variable that the equations determine, and what it depends on, as value references."""

    reference: int
    dependencies: tuple[int, ...]


@dataclass(frozen=True)
class Structure:
    """The unknowns that an importer asks for, by FMI's sections, in ascending order."""

    outputs: tuple[Unknown, ...]
    derivatives: tuple[Unknown, ...]
    initial_unknowns: tuple[Unknown, ...]


def model_structure(variables: Sequence[FmuVariable], depends: Dependencies) -> Structure:
    """Return outputs, derivatives and initial unknowns with their true dependencies."""
    positions = {role: [i for i, v in enumerate(variables) if v.role is role] for role in Role}
    time, states = positions[Role.TIME], positions[Role.STATE]
    inputs, parameters = positions[Role.INPUT], positions[Role.PARAMETER]
    computed = [*positions[Role.DERIVATIVE], *positions[Role.ALGEBRAIC], *positions[Role.OUTPUT]]
    running = _lists(computed, depends.running, [*time, *states, *inputs])
    running |= {i: (i,) for i in states}
    initial = _lists([*states, *computed], depends.initial, [*time, *states, *inputs, *parameters])
    observed = [i for i, v in enumerate(variables) if v.observed]
    unknown = {i for i in (*observed, *states) if variables[i].start_kind is not Start.EXACT}
    unknown |= set(positions[Role.DERIVATIVE])

    def section(members: Sequence[int], table: dict[int, tuple[int, ...]]) -> tuple[Unknown, ...]:
        return tuple(Unknown(i, table[i]) for i in sorted(members))

    return Structure(
        section(observed, running),
        section(positions[Role.DERIVATIVE], running),
        section([*unknown], initial),
    )


def _lists(
    rows: Sequence[int], pattern: Pattern, columns: Sequence[int]
) -> dict[int, tuple[int, ...]]:
    return {
        row: tuple(sorted(c for c, needed in zip(columns, line, strict=True) if needed))
        for row, line in zip(rows, pattern, strict=True)
    }


def unit_definitions(variables: Sequence[FmuVariable]) -> ET.Element:
    """Return the units in use, each with its base units and the display units in use."""
    element = ET.Element("UnitDefinitions")
    displays: dict[str, set[str]] = {}
    for variable in variables:
        displays.setdefault(variable.unit, set())
        if variable.display_unit:
            displays[variable.unit].add(variable.display_unit)
    rates = dict(rate_unit(v.unit) for v in variables if v.role is Role.STATE)
    for name in sorted(displays):
        unit = UNITS.get(name) or rates[name]
        entry = ET.SubElement(element, "Unit", name=name)
        ET.SubElement(entry, "BaseUnit", _base_unit(unit))
        for display in sorted(displays[name]):
            factor = unit.factor / UNITS[display].factor
            ET.SubElement(entry, "DisplayUnit", name=display, factor=shortest(factor))
    return element


def _base_unit(unit: Unit) -> dict[str, str]:
    attributes = {name: str(exponent) for name, exponent in unit.base}
    return attributes | ({} if unit.factor == 1 else {"factor": shortest(unit.factor)})


def default_experiment(dae: Dae, tolerance: float) -> ET.Element:
    """Return the run that an importer makes without being told more."""
    return ET.Element(
        "DefaultExperiment",
        startTime="0",
        stopTime=shortest(dae.experiment.stop_time),
        tolerance=shortest(tolerance),
        stepSize=shortest(dae.experiment.output_interval),
    )


def log_categories() -> ET.Element:
    """Return the categories of the runtime's messages."""
    element = ET.Element("LogCategories")
    for name, meaning in LOG_CATEGORIES.items():
        ET.SubElement(element, "Category", name=name, description=meaning)
    return element


def to_bytes(root: ET.Element) -> bytes:
    """Return an XML file's content, indented."""
    ET.indent(root)
    content: bytes = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    return content + b"\n"


def may_be_set(variable: FmuVariable) -> bool:
    """Tell whether an importer may give the start; algebraic guesses stay inside."""
    return variable.start_kind is Start.EXACT


def shortest(value: float) -> str:
    """Write a number with the fewest digits that are read as the same number."""
    return repr(float(value))


def causality(variable: FmuVariable) -> str:
    """Return FMI's causality; what is not observed is local."""
    plain = {Role.TIME: "independent", Role.INPUT: "input", Role.PARAMETER: "parameter"}
    return plain.get(variable.role, "output" if variable.observed else "local")
