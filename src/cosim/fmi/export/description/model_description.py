"""`modelDescription.xml`: all but what the versions of FMI say in different ways."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf, isfinite
from xml.etree import ElementTree as ET

from casadi_models.dae import Dae, Start
from casadi_models.units import UNITS, Unit
from cosim.fmi.aliases import TOOL
from cosim.fmi.export.dependencies import Dependencies
from cosim.fmi.export.description.quantities import QUANTITIES
from cosim.fmi.export.description.structure import StructureTags, model_structure
from cosim.fmi.export.variables import FmuVariable, Role, rate_unit

REAL, BOOLEAN = "real", "boolean"  # types of variables
_FAR = 1e9

LOG_CATEGORIES = {
    "logStatusWarning": "what was done although it may not be meant",
    "logStatusDiscard": "evaluations that gave no finite result",
    "logStatusError": "calls that were refused, and why",
}


@dataclass(frozen=True)
class Identity:
    """What an FMU says of itself.

    Attributes:
        identifier, guid, tool, tolerance: C identifier, GUID, exporting tool, relative tolerance.
        sources: Files to compile, by name.
        adjoint: Whether it offers adjoint derivatives (FMI 3.0).
        about: author, license and generationDateAndTime, as far as they are given.
        indicators: Number of event indicators.
        watches_steps: Whether it must be told of every step in model exchange.
    """

    identifier: str
    guid: str
    tool: str
    sources: tuple[str, ...]
    tolerance: float
    adjoint: bool = False
    about: Mapping[str, str] = field(default_factory=dict)
    indicators: int = 0
    watches_steps: bool = False


@dataclass(frozen=True)
class Dialect:
    """Where the versions of FMI differ.

    Attributes:
        root: Attributes of the whole, from the identity.
        interfaces: Elements of model exchange and co-simulation.
        quantity: Element of a declared type, likewise.
        variable: Element of a variable, from its type, its attributes and those of its type.
        annotation: Tag of an annotation, and its attribute that says whose it is.
        structure: How the model structure is written.
        fixed_are_knowns: Whether unknowns depend on fixed parameters, too.
        numbers_types_apart: Whether the value references of each type begin at 0.
    """

    root: Callable[[Identity], dict[str, str]]
    interfaces: Callable[[Identity], list[ET.Element]]
    quantity: Callable[[dict[str, str], dict[str, str]], ET.Element]
    variable: Callable[[str, dict[str, str], dict[str, str]], ET.Element]
    annotation: tuple[str, str]
    structure: StructureTags
    fixed_are_knowns: bool
    numbers_types_apart: bool


def model_description(
    dae: Dae,
    identity: Identity,
    variables: Sequence[FmuVariable],
    depends: Dependencies,
    dialect: Dialect,
) -> bytes:
    """Return the content of `modelDescription.xml`."""
    common = {
        "modelName": identity.identifier,
        "description": dae.description,
        "version": "1",
        **identity.about,
        "generationTool": identity.tool,
        "variableNamingConvention": "structured",
    }
    root = ET.Element("fmiModelDescription", dialect.root(identity) | common)
    root.extend(dialect.interfaces(identity))
    root.append(unit_definitions(variables))
    root.append(_type_definitions(variables, dialect))
    root.append(log_categories())
    root.append(default_experiment(dae, identity.tolerance))
    listed = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(variables):
        listed.append(_element(reference, variable, dialect))
    structure = model_structure(
        variables, depends, identity.indicators, fixed_are_knowns=dialect.fixed_are_knowns
    )
    root.append(dialect.structure.element(structure))
    return to_bytes(root)


def _type_definitions(variables: Sequence[FmuVariable], dialect: Dialect) -> ET.Element:
    """Return a declared type for each quantity in use."""
    element = ET.Element("TypeDefinitions")
    for unit in sorted({v.unit for v in variables} & set(QUANTITIES), key=QUANTITIES.__getitem__):
        name = QUANTITIES[unit]
        element.append(dialect.quantity({"name": name}, {"quantity": name, "unit": unit}))
    return element


def _element(reference: int, variable: FmuVariable, dialect: Dialect) -> ET.Element:
    general, facts = _attributes(reference, variable)
    kind = REAL
    if variable.role is Role.VALIDITY:
        kind, facts = BOOLEAN, {}
        general["valueReference"] = "0" if dialect.numbers_types_apart else str(reference)
    element = dialect.variable(kind, general, facts)
    if variable.alias:
        element.append(_alias(variable.alias, variable.meaning, dialect))
    return element


def _alias(name: str, meaning: str, dialect: Dialect) -> ET.Element:
    """Return an annotation with a variable's second name.

    In FMI 2.0 a second variable of the same reference would be an output twice; in FMI 3.0, FMPy up
    to 0.3.32 wants an `Alias` of an output among the unknowns.
    """
    annotations = ET.Element("Annotations")
    tag, owner = dialect.annotation
    annotation = ET.SubElement(annotations, tag, {owner: TOOL})
    ET.SubElement(annotation, "Alias", name=name, description=meaning)
    return annotations


def _attributes(reference: int, variable: FmuVariable) -> tuple[dict[str, str], dict[str, str]]:
    """Return the attributes of a variable, and those that FMI 2.0 gives to its type."""
    general = {
        "name": variable.name,
        "valueReference": str(reference),
        "description": variable.meaning,
        "causality": causality(variable),
        "variability": variability(variable),
    }
    if initial := initial_of(variable):
        general["initial"] = initial
    facts = {"unit": variable.unit}
    if variable.unit in QUANTITIES:
        facts["declaredType"] = QUANTITIES[variable.unit]
    if variable.display_unit:
        facts["displayUnit"] = variable.display_unit
    if variable.derivative_of is not None:
        facts["derivative"] = str(variable.derivative_of)
    lowest, highest = meant_bounds(variable)
    for name, bound in (("min", lowest), ("max", highest)):
        if isfinite(bound):
            facts[name] = shortest(bound)
    if variable.nominal != 1:
        facts["nominal"] = shortest(variable.nominal)
    if variable.start is not None and initial in ("exact", "approx", None):
        facts["start"] = shortest(variable.start)
    return general, facts


def meant_bounds(variable: FmuVariable) -> tuple[float, float]:
    """Return the bounds as a reader means them.

    What guards a positive number against overflow, a billionth and a billion times its size or
    beyond, is 0 and no bound at all; the runtime keeps to the guard.
    """
    guards = variable.role is Role.PARAMETER and 0 < variable.minimum <= variable.nominal / _FAR
    lowest = 0.0 if guards else variable.minimum
    return (
        lowest,
        inf if guards and variable.maximum >= variable.nominal * _FAR else variable.maximum,
    )


def unit_definitions(variables: Sequence[FmuVariable]) -> ET.Element:
    """Return the units in use, each with its base units and the display units in use."""
    element = ET.Element("UnitDefinitions")
    displays: dict[str, set[str]] = {}
    for variable in (v for v in variables if v.unit):
        displays.setdefault(variable.unit, set())
        if variable.display_unit:
            displays[variable.unit].add(variable.display_unit)
    rates = dict(rate_unit(v.unit) for v in variables if v.role is Role.STATE)
    for name in sorted(displays):
        unit = rates.get(name) or UNITS[name]
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


def initial_of(variable: FmuVariable) -> str | None:
    """Return FMI's initial: a calculated state begins near a number, others are results."""
    if variable.role in (Role.TIME, Role.INPUT):
        return None
    if variable.start_kind is Start.EXACT:  # algebraic guesses stay inside
        return "exact"
    calculated = variable.role is Role.STATE and variable.start is not None
    return "approx" if calculated else "calculated"


def variability(variable: FmuVariable) -> str:
    """Return FMI's variability."""
    if variable.role is Role.VALIDITY:
        return "discrete"
    if variable.role is not Role.PARAMETER:
        return "continuous"
    return "tunable" if variable.tunable else "fixed"


def shortest(value: float) -> str:
    """Write a number with the fewest digits that are read as the same number."""
    return repr(float(value))


def causality(variable: FmuVariable) -> str:
    """Return FMI's causality; what is not observed is local."""
    plain = {Role.TIME: "independent", Role.INPUT: "input", Role.PARAMETER: "parameter"}
    return plain.get(variable.role, "output" if variable.observed else "local")
