"""`modelDescription.xml` of FMI 2.0."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import isfinite
from xml.etree import ElementTree as ET

from casadi_models.dae import Dae, Start
from casadi_models.units import UNITS, Unit
from cosim.export.variables import Dependencies, FmuVariable, Pattern, Role, rate_unit
from cosim.trajectory import repr_17

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


def model_description(
    dae: Dae, identity: Identity, variables: Sequence[FmuVariable], depends: Dependencies
) -> bytes:
    """Return the file's content."""
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=identity.identifier,
        guid=identity.guid,
        description=dae.description,
        version="1",
        generationTool=identity.tool,
        variableNamingConvention="structured",
        numberOfEventIndicators="0",
    )
    for element in _interfaces(identity):
        root.append(element)
    root.append(unit_definitions(variables))
    categories = ET.SubElement(root, "LogCategories")
    for name, meaning in LOG_CATEGORIES.items():
        ET.SubElement(categories, "Category", name=name, description=meaning)
    ET.SubElement(
        root,
        "DefaultExperiment",
        startTime="0",
        stopTime=repr_17(dae.experiment.stop_time),
        tolerance=repr_17(identity.tolerance),
        stepSize=repr_17(dae.experiment.output_interval),
    )
    listed = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(variables):
        listed.append(_scalar_variable(reference, variable))
    root.append(_structure(variables, depends))
    ET.indent(root)
    content: bytes = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    return content + b"\n"


def _interfaces(identity: Identity) -> Iterable[ET.Element]:
    common = {
        "modelIdentifier": identity.identifier,
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "providesDirectionalDerivative": "true",
    }
    stepping = {
        "canHandleVariableCommunicationStepSize": "true",
        "canInterpolateInputs": "true",
        "maxOutputDerivativeOrder": "1",
    }
    for kind, attributes in (("ModelExchange", common), ("CoSimulation", common | stepping)):
        element = ET.Element(kind, attributes)
        files = ET.SubElement(element, "SourceFiles")
        for name in identity.sources:
            ET.SubElement(files, "File", name=name)
        yield element


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
            ET.SubElement(entry, "DisplayUnit", name=display, factor=repr_17(factor))
    return element


def _base_unit(unit: Unit) -> dict[str, str]:
    attributes = {name: str(exponent) for name, exponent in unit.base}
    return attributes | ({} if unit.factor == 1 else {"factor": repr_17(unit.factor)})


def _scalar_variable(reference: int, variable: FmuVariable) -> ET.Element:
    element = ET.Element(
        "ScalarVariable",
        name=variable.name,
        valueReference=str(reference),
        description=variable.meaning,
        causality=_causality(variable),
        variability="fixed" if variable.role is Role.PARAMETER else "continuous",
    )
    has_initial = variable.role not in (Role.TIME, Role.INPUT)
    if has_initial:
        element.set("initial", "exact" if _has_start(variable) else "calculated")
    real = ET.SubElement(element, "Real", unit=variable.unit)
    if variable.display_unit:
        real.set("displayUnit", variable.display_unit)
    if variable.derivative_of is not None:
        real.set("derivative", str(variable.derivative_of + 1))
    for name, bound in (("min", variable.minimum), ("max", variable.maximum)):
        if isfinite(bound):
            real.set(name, repr_17(bound))
    if variable.nominal != 1:
        real.set("nominal", repr_17(variable.nominal))
    if _has_start(variable) and variable.start is not None:
        real.set("start", repr_17(variable.start))
    return element


def _has_start(variable: FmuVariable) -> bool:
    """Tell whether an importer may give the start; algebraic guesses stay inside."""
    return variable.start_kind is Start.EXACT


def _causality(variable: FmuVariable) -> str:
    plain = {Role.TIME: "independent", Role.INPUT: "input", Role.PARAMETER: "parameter"}
    return plain.get(variable.role, "output" if variable.observed else "local")


def _structure(variables: Sequence[FmuVariable], depends: Dependencies) -> ET.Element:
    positions = {role: [i for i, v in enumerate(variables) if v.role is role] for role in Role}
    time, states = positions[Role.TIME], positions[Role.STATE]
    inputs, parameters = positions[Role.INPUT], positions[Role.PARAMETER]
    computed = [*positions[Role.DERIVATIVE], *positions[Role.ALGEBRAIC], *positions[Role.OUTPUT]]
    running = _lists(computed, depends.running, [*time, *states, *inputs])
    running |= {i: [i] for i in states}
    initial = _lists([*states, *computed], depends.initial, [*time, *states, *inputs, *parameters])
    structure = ET.Element("ModelStructure")
    observed = [i for i, v in enumerate(variables) if v.observed]
    unknown = {i for i in observed if variables[i].start_kind is not Start.EXACT}
    unknown |= {i for i in states if variables[i].start_kind is not Start.EXACT}
    unknown |= set(positions[Role.DERIVATIVE])
    sections = (
        ("Outputs", observed, running),
        ("Derivatives", positions[Role.DERIVATIVE], running),
        ("InitialUnknowns", sorted(unknown), initial),
    )
    for tag, members, table in sections:
        if members:
            section = ET.SubElement(structure, tag)
            for i in members:
                needs = " ".join(str(j + 1) for j in sorted(table[i]))
                ET.SubElement(section, "Unknown", index=str(i + 1), dependencies=needs)
    return structure


def _lists(rows: Sequence[int], pattern: Pattern, columns: Sequence[int]) -> dict[int, list[int]]:
    return {
        row: [column for column, needed in zip(columns, line, strict=True) if needed]
        for row, line in zip(rows, pattern, strict=True)
    }
