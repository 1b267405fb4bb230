"""modelDescription.xml and buildDescription.xml of FMI 2.0 and 3.0."""

import re
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from math import inf, isfinite
from xml.etree import ElementTree as ET

from casadi_models.dae import Start
from casadi_models.units import UNITS, conversion
from cosim.errors import ExportError
from cosim.fmi.archive import TOOL
from cosim.fmi.export.dependencies import Dependencies
from cosim.fmi.export.dialect import LOG_CATEGORIES, QUANTITIES, Dialect
from cosim.fmi.export.options import ABOUT
from cosim.fmi.export.plan import Plan
from cosim.fmi.export.variables import VALID, FmuVariable, Role, units_of_rates
from cosim.model.reduction import Pattern

_FAR = 1e9
_GENERATOR = f"cosim-rigid {version('cosim-rigid')}"


def model_description(plan: Plan, sources: Sequence[str]) -> ET.Element:
    """Return what `modelDescription.xml` contains, with an empty GUID or token."""
    dae, variables, dialect = plan.dae, plan.variables, plan.dialect
    common = {
        "modelName": plan.name,
        "description": dae.description,
        "version": "1",
        **{ABOUT[key]: text for key, text in (plan.options.about or {}).items()},
        "generationTool": _GENERATOR,
        "variableNamingConvention": "structured",
    }
    own = {"fmiVersion": dialect.version, dialect.token: ""}
    if dialect.version == "2.0":
        own["numberOfEventIndicators"] = str(plan.indicators)
    root = ET.Element("fmiModelDescription", own | common)
    root.extend(_interfaces(plan, sources))
    root.append(unit_definitions(variables))
    root.append(_type_definitions(variables, dialect))
    categories = ET.SubElement(root, "LogCategories")
    for name, meaning in LOG_CATEGORIES.items():
        ET.SubElement(categories, "Category", name=name, description=meaning)
    ET.SubElement(
        root,
        "DefaultExperiment",
        startTime="0",
        stopTime=shortest(dae.experiment.stop_time),
        tolerance=shortest(plan.options.tolerance),
        stepSize=shortest(dae.experiment.output_interval),
    )
    listed = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(variables):
        listed.append(_element(reference, variable, dialect))
    root.append(model_structure(variables, plan.depends, dialect, plan.indicators))
    return root


def _type_definitions(variables: Sequence[FmuVariable], dialect: Dialect) -> ET.Element:
    """Return the declared type of each quantity in use."""
    element = ET.Element("TypeDefinitions")
    for unit in sorted({v.unit for v in variables} & set(QUANTITIES), key=QUANTITIES.__getitem__):
        name = QUANTITIES[unit]
        facts = {"quantity": name, "unit": unit}
        element.append(_typed(dialect, "SimpleType", dialect.real_type, {"name": name}, facts))
    return element


def _typed(
    dialect: Dialect, tag: str, kind: str, general: Mapping[str, str], facts: Mapping[str, str]
) -> ET.Element:
    """Return an element with general attributes and those of its type."""
    if not dialect.nested:
        return ET.Element(kind, {**general, **facts})
    element = ET.Element(tag, {**general})
    ET.SubElement(element, kind, {**facts})
    return element


def _element(reference: int, variable: FmuVariable, dialect: Dialect) -> ET.Element:
    general, facts = _attributes(reference, variable, dialect.first)
    kind = dialect.real
    if variable.role is Role.VALIDITY:
        kind, facts = "Boolean", {}
        general["valueReference"] = "0" if dialect.types_apart else str(reference)
    if dialect.version == "3.0" and causality(variable) in ("input", "output"):
        general["intermediateUpdate"] = "true"
    element = _typed(dialect, "ScalarVariable", kind, general, facts)
    if variable.alias:
        element.append(_alias(variable.alias, variable.meaning, dialect))
    return element


def _alias(name: str, meaning: str, dialect: Dialect) -> ET.Element:
    """Return an annotation with a variable's second name.

    In FMI 2.0 a second variable with the same reference would be a second output; in FMI 3.0,
    FMPy up to 0.3.32 requires an `Alias` of an output among the unknowns.
    """
    annotations = ET.Element("Annotations")
    tag, owner = dialect.annotation
    annotation = ET.SubElement(annotations, tag, {owner: TOOL})
    ET.SubElement(annotation, "Alias", name=name, description=meaning)
    return annotations


def _attributes(
    reference: int, variable: FmuVariable, first: int
) -> tuple[dict[str, str], dict[str, str]]:
    """Return the attributes of a variable, and those that belong to its type in FMI 2.0."""
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
        facts["derivative"] = str(first + variable.derivative_of)
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
    """Return the bounds that a model description shows.

    Bounds of a billionth and a billion times the nominal value or beyond only prevent overflow of a
    positive parameter. The description then shows 0 and no upper bound; the runtime checks both.
    """
    guards = variable.role is Role.PARAMETER and 0 < variable.minimum <= variable.nominal / _FAR
    lowest = 0.0 if guards else variable.minimum
    highest = inf if guards and variable.maximum >= variable.nominal * _FAR else variable.maximum
    return lowest, highest


def unit_definitions(variables: Sequence[FmuVariable]) -> ET.Element:
    """Return the units in use, each with its base units and the display units in use."""
    element = ET.Element("UnitDefinitions")
    displays: dict[str, set[str]] = {}
    for variable in (v for v in variables if v.unit):
        displays.setdefault(variable.unit, set())
        if variable.display_unit:
            displays[variable.unit].add(variable.display_unit)
    rates = units_of_rates(variables)
    for name in sorted(displays):
        unit = rates.get(name) or UNITS[name]
        entry = ET.SubElement(element, "Unit", name=name)
        base = {name: str(exponent) for name, exponent in unit.base}
        ET.SubElement(entry, "BaseUnit", base | _scaled(unit.factor, unit.offset))
        for display in sorted(displays[name]):
            factor, offset = conversion(unit, UNITS[display])
            scaled = _scaled(factor, offset, always=True)
            ET.SubElement(entry, "DisplayUnit", {"name": display, **scaled})
    return element


def _scaled(factor: float, offset: float, *, always: bool = False) -> dict[str, str]:
    """Return the attributes `factor` and `offset`, without those that are the default."""
    facts = {"factor": shortest(factor)} if always or factor != 1 else {}
    return facts | ({"offset": shortest(offset)} if offset else {})


_NO_CHARACTER = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")  # of XML


def to_bytes(root: ET.Element) -> bytes:
    """Return an XML file's content, indented.

    Raises:
        ExportError: A text has a character that XML cannot hold.
    """
    for element in root.iter():
        for name, text in element.attrib.items():
            if found := _NO_CHARACTER.search(text):
                raise ExportError(
                    f"{name} of {element.tag} has the character {found[0]!a}, which XML "
                    "cannot hold; leave it out"
                )
    ET.indent(root)
    content: bytes = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    return content + b"\n"


def initial_of(variable: FmuVariable) -> str | None:
    """Return FMI's attribute `initial`."""
    if variable.role in (Role.TIME, Role.INPUT):
        return None
    if variable.start_kind is Start.EXACT:  # initial guesses of algebraic unknowns are not exported
        return "exact"
    calculated = variable.role is Role.STATE and variable.start is not None
    return "approx" if calculated else "calculated"


def variability(variable: FmuVariable) -> str:
    """Return FMI's attribute `variability`."""
    if variable.role in (Role.VALIDITY, Role.MODE):
        return "discrete"
    if variable.role is not Role.PARAMETER:
        return "continuous"
    return "tunable" if variable.tunable else "fixed"


def shortest(value: float) -> str:
    """Return a number as text with the fewest digits that identify it."""
    return repr(float(value))


def causality(variable: FmuVariable) -> str:
    """Return FMI's attribute `causality`; variables that are not observed are local."""
    plain = {Role.TIME: "independent", Role.INPUT: "input", Role.PARAMETER: "parameter"}
    return plain.get(variable.role, "output" if variable.observed else "local")


_OF_DERIVATIVES = {
    "providesDirectionalDerivative",
    "providesDirectionalDerivatives",
    "maxOutputDerivativeOrder",
}
_OF_UPDATES = {"canReturnEarlyAfterIntermediateUpdate", "providesIntermediateUpdate"}


def _interfaces(plan: Plan, sources: Sequence[str]) -> list[ET.Element]:
    """Return the elements of model exchange and co-simulation."""
    dialect = plan.dialect
    second = dialect.version == "2.0"
    common = {"modelIdentifier": plan.name, **dialect.both}
    if plan.options.adjoint:
        common["providesAdjointDerivatives"] = "true"
    step = "completedIntegratorStepNotNeeded" if second else "needsCompletedIntegratorStep"
    exchange = {step: str(plan.watches_steps is not second).lower()}
    elements = [
        ET.Element("ModelExchange", common | exchange),
        ET.Element("CoSimulation", common | dict(dialect.co_simulation)),
    ]
    if plan.step_size is not None and not second:
        elements[1].set("fixedInternalStepSize", shortest(plan.step_size))
    if plan.system and plan.system.relations and not second:
        elements[1].set("hasEventMode", "true")
    lacking = set[str]()
    if not plan.options.derivatives:
        lacking |= _OF_DERIVATIVES
    if not plan.updates_within_steps:
        lacking |= _OF_UPDATES
    for element in elements:
        for name in lacking.intersection(element.attrib):
            del element.attrib[name]
    for element in elements if second else ():
        files = ET.SubElement(element, "SourceFiles")
        for name in sources:
            ET.SubElement(files, "File", name=name)
    return elements


def build_description(plan: Plan, sources: Sequence[str]) -> bytes:
    """Return the content of `buildDescription.xml`, which FMI 2.0.4 adopts from FMI 3.0 (2.3)."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(
        root, "BuildConfiguration", modelIdentifier=plan.name, description="all platforms"
    )
    files = ET.SubElement(configuration, "SourceFileSet", language="C11")
    for name in sources:
        ET.SubElement(files, "SourceFile", name=name)
    # in the shared library that is compiled from this file, functions have FMI's own names
    ET.SubElement(files, "PreprocessorDefinition", name="FMI3_OVERRIDE_FUNCTION_PREFIX", value="1")
    ET.SubElement(configuration, "Library", name="m", external="true")
    return to_bytes(root)


Needs = dict[int, tuple[int, ...]]  # value references of the dependencies of each unknown


def model_structure(
    variables: Sequence[FmuVariable], depends: Dependencies, dialect: Dialect, indicators: int = 0
) -> ET.Element:
    """Return outputs, derivatives, initial unknowns and event indicators with their dependencies.

    Args:
        variables: All variables by value reference.
        depends: Their structural dependencies.
        dialect: Version of FMI.
        indicators: Number of outputs at the end of the list that are event indicators.
    """
    outputs = _references(variables, Role.OUTPUT)
    margins = outputs[len(outputs) - indicators :]
    observed = [i for i, v in enumerate(variables) if v.observed]
    running, initial = _needs(variables, depends, dialect)
    sections = (
        (observed, running),
        (_references(variables, Role.DERIVATIVE), running),
        (_unknown_at_start(variables), initial),
        (margins, running),
    )
    whole = ET.Element("ModelStructure")
    for tag, (unknowns, needs) in zip(dialect.sections, sections, strict=False):
        parent = ET.SubElement(whole, tag) if dialect.unknown and unknowns else whole
        for i in unknowns:
            others = " ".join(str(dialect.first + k) for k in needs[i])
            own = {dialect.reference: str(dialect.first + i), "dependencies": others}
            ET.SubElement(parent, dialect.unknown or tag, own)
    return whole


def _references(variables: Sequence[FmuVariable], role: Role) -> list[int]:
    return [i for i, variable in enumerate(variables) if variable.role is role]


def _unknown_at_start(variables: Sequence[FmuVariable]) -> list[int]:
    """Return the derivatives, and the states and outputs whose start values are not exact."""
    listed = (Role.STATE, Role.DERIVATIVE)
    return [
        i
        for i, variable in enumerate(variables)
        if (variable.observed or variable.role in listed) and variable.start_kind is not Start.EXACT
    ]


def _needs(
    variables: Sequence[FmuVariable], depends: Dependencies, dialect: Dialect
) -> tuple[Needs, Needs]:
    """Return the dependencies during a run and at its start."""
    states = _references(variables, Role.STATE)
    parameters = _references(variables, Role.PARAMETER)
    computed = [
        i
        for role in (Role.DERIVATIVE, Role.ALGEBRAIC, Role.OUTPUT)
        for i in _references(variables, role)
    ]
    knowns = [
        *_references(variables, Role.TIME),
        *states,
        *_references(variables, Role.INPUT),
        *parameters,
    ]
    running = _lists(computed, depends.running, knowns)
    if not dialect.fixed_are_knowns:
        fixed = {i for i in parameters if not variables[i].tunable}
        running = {i: tuple(k for k in needs if k not in fixed) for i, needs in running.items()}
    running |= {i: (i,) for i in states}
    initial = _lists([*states, *computed], depends.initial, knowns)
    outputs = [(i, variables[i]) for i in _references(variables, Role.OUTPUT)]
    margins = [i for i, v in outputs if (v.alias or v.name).startswith(f"{VALID}_margin_")]
    for needs in (running, initial):
        whole = tuple(sorted({k for margin in margins for k in needs[margin]}))
        needs |= dict.fromkeys(_references(variables, Role.VALIDITY), whole)
    return running, initial


def _lists(rows: Sequence[int], pattern: Pattern, columns: Sequence[int]) -> Needs:
    return {
        row: tuple(sorted(c for c, needed in zip(columns, line, strict=True) if needed))
        for row, line in zip(rows, pattern, strict=True)
    }
