"""Findings about a model description: the schema, its structure, its variables and units."""

import zipfile
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import cache, partial
from importlib.resources import files
from math import isclose, isfinite, prod
from typing import Any
from xml.etree import ElementTree as ET

from casadi_models.units import Unit, conversion, parse_unit
from cosim.fmi.archive import DESCRIPTION, entry_content
from cosim.fmi.check.finding import RULES, Finding, Rule
from cosim.fmi.check.parsed import BUILD, Described, Description, Unknown
from cosim.fmi.run.typed_values import NUMERIC, REALS
from cosim.fmi.units import BASE_UNITS

_ROUNDING = 1e-5  # of factors, as people write them
_MOST = 10  # findings in a file: one fault can have hundreds
_SCHEMAS = {  # of what layered standards add, the standards have their own
    BUILD: "fmi3/fmi3BuildDescription.xsd",
    "terminalsAndIcons/terminalsAndIcons.xml": "fmi3/fmi3TerminalsAndIcons.xsd",
}
_OF_TERMINALS = "//@variableName | //@inStreamVariableName | //@outStreamVariableName"


def schema_findings(archive: zipfile.ZipFile, version: str) -> Iterator[Finding]:
    """Return violations of the FMI's schemas, at most ten for a file, and unknown members."""
    names = set[str]()  # of variables and their aliases
    own = {DESCRIPTION: f"fmi{version}/fmi{version}ModelDescription.xsd"}
    for entry, name in (own | _SCHEMAS).items():
        if entry in archive.namelist():
            yield from _against(name, entry, entry_content(archive, entry), names)


def _against(schema: str, entry: str, content: bytes, names: set[str]) -> Iterator[Finding]:
    from lxml import etree

    try:
        tree = etree.fromstring(content, etree.XMLParser(resolve_entities=False, no_network=True))
    except etree.XMLSyntaxError as error:
        yield RULES["xml"].at(entry, f"not well-formed: {error}")
        return
    names |= {*tree.xpath("ModelVariables/*//@name")}
    for name in tree.xpath(_OF_TERMINALS) if names else ():
        if name not in names:
            yield RULES["refers"].at(entry, f"{name.getparent().tag} '{name}' is no variable")
    known = _schema(schema)
    if known.validate(tree):
        return
    for fault in list(known.error_log)[:_MOST]:
        yield RULES["schema"].at(f"{entry} line {fault.line}", fault.message.rstrip("."))


@cache
def _schema(name: str) -> Any:
    """Return a schema by its place in fmpy's folder."""
    from lxml import etree

    return etree.XMLSchema(file=str(files("fmpy") / "schema" / name))


def structure_findings(described: Description) -> Iterator[Finding]:
    """Return the faults of value references and model structure."""
    yield from _references(described)
    variables = described.variables
    outputs = [i for i, v in enumerate(variables) if v.causality == "output"]
    rates = [i for i, v in enumerate(variables) if v.derivative_of is not None]
    states = {v.derivative_of for v in variables if v.derivative_of is not None}
    moving = {i for i, v in enumerate(variables) if v.causality in ("input", "independent")}
    knowns = moving | {i for i, v in enumerate(variables) if v.initial == "exact"}
    parameters = {i for i, v in enumerate(variables) if v.causality == "parameter"}
    if described.version == "2":  # there, only those that change during a run
        parameters = {i for i in parameters if variables[i].variability == "tunable"}
    running = moving | states | parameters
    for name, expected, known in (
        ("Outputs", outputs, running),
        ("Derivatives", rates, running),
        ("InitialUnknowns", _initial_unknowns(described, {*outputs, *rates, *states}), knowns),
    ):
        listed = described.sections[name]
        strict = name == "Outputs"
        for rule, fault in (
            *_entries(described, listed, expected, strict=strict),
            *_needs(described, listed, known),
        ):
            yield rule.at(name, fault)


def _references(described: Description) -> Iterator[Finding]:
    """Value references number the variables of a type (FMI 3: all variables) without gaps."""
    second = described.version == "2"
    shared = RULES["alias"] if second else RULES["shared-reference"]  # FMI 2.0 allows aliases
    for kind in sorted({v.kind for v in described.variables} if second else {""}):
        texts = [v.reference for v in described.variables if kind in ("", v.kind)]
        for text, count in Counter(texts).items():
            if count > 1:
                yield shared.about(DESCRIPTION, f"{count} variables share value reference {text}")
        unused = sorted(set(map(str, range(len(texts)))) - set(texts), key=int)
        if unused:
            fault = (
                f"value references are not consecutive from 0: {', '.join(unused[:5])} is unused"
            )
            yield RULES["references"].about(DESCRIPTION, fault)


def _initial_unknowns(described: Description, members: set[int]) -> list[int]:
    """FMI 2.0.4, 2.2.8: what initialization computes of outputs, states and derivatives."""
    variables = described.variables
    members = members - {-1} | {
        i for i, v in enumerate(variables) if v.causality == "calculatedParameter"
    }
    clocked = {i for i in members if variables[i].kind == "Clock" or "clocks" in variables[i].texts}
    members -= clocked  # which initialization does not compute
    return [i for i in sorted(members) if variables[i].initial in ("approx", "calculated")]


def _entries(
    described: Description, listed: Sequence[Unknown], expected: Sequence[int], *, strict: bool
) -> Iterator[tuple[Rule, str]]:
    rule = RULES["listed"] if strict else RULES["listed-lightly"]
    places = [unknown.position for unknown in listed]
    if -1 in places:
        yield RULES["refers"], "an entry refers to no variable"
    for place, count in Counter(places).items():
        if count > 1 and place >= 0:
            yield RULES["listed"], f"'{described.variables[place].name}' is listed {count} times"
    for place in sorted(set(expected) - set(places)):
        yield rule, f"'{described.variables[place].name}' is missing"
    for place in sorted(set(places) - set(expected) - {-1}):
        yield rule, f"'{described.variables[place].name}' does not belong there"
    if places != sorted(places):
        yield RULES["order"], "the entries are not in ascending order"


def _needs(
    described: Description, listed: Sequence[Unknown], known: set[int]
) -> Iterator[tuple[Rule, str]]:
    for unknown in listed:
        needs = unknown.needs or ()
        name = "?" if unknown.position < 0 else described.variables[unknown.position].name
        if -1 in needs:
            yield RULES["refers"], f"'{name}' depends on what does not exist"
        if len(unknown.kinds) not in (0, len(needs)):
            fault = f"'{name}' has {len(needs)} dependencies of {len(unknown.kinds)} kinds"
            yield RULES["refers"], fault
        for place in sorted(set(needs) - known - {-1}):
            other = described.variables[place].name
            yield RULES["knowns"], f"'{name}' depends on '{other}', which is not a known"
        if list(needs) != sorted(set(needs)):
            yield RULES["order"], f"dependencies of '{name}' are not ascending"


_INITIALS = ("exact", "approx", "calculated")
# FMI 2.0.4, 2.2.7; FMI 3.0.2, 2.4.7.5. None: the attribute is absent.
_INITIAL: dict[tuple[str, str], tuple[str | None, ...]] = {
    **{("parameter", v): ("exact",) for v in ("fixed", "tunable")},
    **{("structuralParameter", v): ("exact",) for v in ("fixed", "tunable")},
    **{("calculatedParameter", v): ("approx", "calculated") for v in ("fixed", "tunable")},
    **{("local", v): ("approx", "calculated") for v in ("fixed", "tunable")},
    **{("input", v): (None,) for v in ("discrete", "continuous")},
    **{(c, "constant"): ("exact",) for c in ("output", "local")},
    **{(c, v): _INITIALS for c in ("output", "local") for v in ("discrete", "continuous")},
    ("independent", "continuous"): (None,),
}


def description_findings(described: Description) -> Iterator[Finding]:
    """Return the faults of a model description."""
    yield from _head(described)
    yield from _units(described)
    for variable in described.variables:
        for rule, fault in _variable_findings(described, variable):
            yield rule.at(f"variable '{variable.name}'", fault)
    aliases = (alias.get("name", "") for alias in described.root.iterfind("ModelVariables/*/Alias"))
    for name, count in Counter([*(v.name for v in described.variables), *aliases]).items():
        if count > 1:
            yield RULES["name"].at(f"variable '{name}'", f"{count} variables have this name")
    yield from _repeated(described.root)
    yield from structure_findings(described)
    yield from _reference_findings(described)


def _repeated(root: ET.Element) -> Iterator[Finding]:
    """Return names that occur twice, and values of items of one enumeration."""
    types = root.findall("TypeDefinitions/*")
    lists = [("type", types, "name"), ("log category", root.findall("LogCategories/*"), "name")]
    for declared in types:
        items = [*declared.iter("Item")]
        lists += [(f"items of type '{declared.get('name')}'", items, a) for a in ("name", "value")]
    for place, elements, attribute in lists:
        for text, count in Counter(element.get(attribute) for element in elements).items():
            if count > 1:
                yield RULES["name"].at(place, f"{count} have the {attribute} '{text}'")


_REFERENCES = (  # places of attributes that name variables of FMI 3.0, and the kind of these
    ("ModelVariables/*/Dimension", "valueReference", "UInt64"),
    ("ModelVariables/*", "clocks", "Clock"),
    ("ModelVariables/*", "previous", "variable"),
    ("ModelStructure/EventIndicator", "valueReference", "variable"),
    ("ModelStructure/ClockedState", "valueReference", "variable"),
)


def _reference_findings(described: Description) -> Iterator[Finding]:
    """Return names of variables and types that the file does not describe or that are others."""
    root, rule = described.root, RULES["refers"]
    kinds = {v.reference: v.kind for v in described.variables}
    for path, attribute, kind in _REFERENCES:
        for element in root.iterfind(path):
            place = element.get("name", element.tag)
            for text in element.get(attribute, "").split():
                if text not in kinds or kind not in ("variable", kinds[text]):
                    yield rule.at(place, f"{attribute} {text} is that of no {kind}")
    declared = {t.get("name"): t for t in root.iterfind("TypeDefinitions/*")}
    for v in (v for v in described.variables if "declaredType" in v.texts):
        name, start = v.texts["declaredType"], v.texts.get("start")
        found = declared.get(name, ET.Element("none"))
        if v.kind not in {found.tag.removesuffix("Type"), *(child.tag for child in found)}:
            yield rule.at(v.name, f"its type '{name}' is not described, or not of {v.kind}")
        items = {item.get("value") for item in found.iter("Item")}
        if items and start is not None and not {*start.split()} <= items:
            yield rule.at(v.name, f"its start value {start} is no item of type '{name}'")


def _head(described: Description) -> Iterator[Finding]:
    root = described.root
    if not described.token.strip():
        yield RULES["token"].about(DESCRIPTION, "the GUID or instantiation token is missing")
    if not described.interfaces and root.find("ScheduledExecution") is None:
        yield RULES["interface"].about(
            DESCRIPTION, "there is neither model exchange nor co-simulation"
        )
    for name, attributes in described.interfaces.items():
        identifier = attributes.get("modelIdentifier", "")
        if not (identifier.isascii() and identifier.isidentifier()):
            yield RULES["identifier"].at(name, f"modelIdentifier '{identifier}' is no C name")
        if attributes.get("needsExecutionTool") in ("true", "1"):
            tool = root.get("generationTool") or "a tool that it does not name"
            yield RULES["execution-tool"].at(name, f"it needs {tool} where it runs")
    count = sum(v.causality == "independent" for v in described.variables)
    if count > 1 or (count == 0 and described.version == "3" and described.interfaces):
        yield RULES["causality"].at("ModelVariables", f"{count} variables are independent")
    experiment = root.find("DefaultExperiment")
    numbers = {} if experiment is None else {k: _finite(v) for k, v in experiment.attrib.items()}
    for name, value in numbers.items():
        if value is None or (name in ("tolerance", "stepSize") and value <= 0):
            fault = f"{name} is no finite number in its range"
            yield RULES["experiment"].at("DefaultExperiment", fault)
    start, stop = numbers.get("startTime", 0.0), numbers.get("stopTime")
    if start is not None and stop is not None and stop <= start:
        yield RULES["experiment"].at("DefaultExperiment", "stopTime is not after startTime")


def _finite(text: str) -> float | None:
    """Return a finite number, None for anything else; NaN and INF are schema-valid."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if isfinite(value) else None


def _units(described: Description) -> Iterator[Finding]:
    used = {v.texts["unit"] for v in described.variables if "unit" in v.texts}
    defined = described.root.findall("UnitDefinitions/Unit")
    names = [unit.get("name", "") for unit in defined]
    for name, count in Counter(names).items():
        if count > 1:
            yield RULES["unit"].about(DESCRIPTION, f"unit '{name}' is defined {count} times")
    for unit, name in zip(defined, names, strict=True):
        base = _base(unit)
        measured = tuple((n, int(base[n])) for n in BASE_UNITS if base.get(n))
        own = parse_unit(name, Unit(1.0, measured)) if base else None
        if own:
            exponents = dict(own.base)
            same = all(base[n] == exponents.get(n, 0) for n in BASE_UNITS if n != "rad")
            close = isclose(base["factor"], own.factor, rel_tol=_ROUNDING)
            shifted = not isclose(base["offset"], own.offset, rel_tol=_ROUNDING)
            if not (same and close) or shifted:
                fault = "has base units of another quantity, another factor or an offset"
                yield RULES["unit-base"].about(DESCRIPTION, f"unit '{name}' {fault}")
        if not base:
            yield RULES["unit-unused"].about(DESCRIPTION, f"unit '{name}' has no base units")
        if name not in used:
            yield RULES["unit-unused"].about(DESCRIPTION, f"unit '{name}' is not used")
        for fault_rule, fault in _factor_faults(unit):
            yield fault_rule.about(DESCRIPTION, f"unit '{name}': {fault}")
    for name in sorted(used - set(names)):
        yield RULES["unit"].about(DESCRIPTION, f"unit '{name}' is not defined")


def _factor_faults(unit: ET.Element) -> Iterator[tuple[Rule, str]]:
    """Check factors and offsets; known display units have those of their names."""
    own = parse_unit(unit.get("name", ""))
    for element in (*unit.findall("BaseUnit"), *unit.findall("DisplayUnit")):
        factor, offset = (_finite(element.get(n, d)) for n, d in (("factor", "1"), ("offset", "0")))
        if not factor or offset is None:
            yield RULES["unit"], f"factor or offset of {element.tag} is no finite number"
            continue
        inverse = element.get("inverse") in ("true", "1")
        shown = None if inverse else parse_unit(element.get("name", ""))
        if own and shown and own.measures_like(shown):
            usual = conversion(own, shown)
            if not all(map(partial(isclose, rel_tol=_ROUNDING), (factor, offset), usual)):
                fault = f"display unit '{element.get('name')}' has factor {factor:g} and offset "
                fault += f"{offset:g} instead of {usual[0]:g} and {usual[1]:g}"
                yield RULES["unit-base"], fault


def _variable_findings(described: Description, variable: Described) -> Iterator[tuple[Rule, str]]:
    texts = variable.texts
    kinds = (variable.causality, variable.variability)
    allowed = _INITIAL.get(kinds, ())
    if described.version == "3" and variable.causality == "input":
        allowed = (*allowed, "exact")
    if variable.initial not in allowed:
        fault = (
            f"causality {kinds[0]}, variability {kinds[1]}, initial {variable.initial} is illegal"
        )
        yield RULES["causality"], fault
    if variable.variability == "continuous" and variable.kind not in REALS:
        yield RULES["variability"], f"a {variable.kind} cannot be continuous"
    required = variable.initial in ("exact", "approx") or variable.causality == "input"
    if required != ("start" in texts) and variable.kind not in ("Clock", "Binary"):
        fault = (
            "the start value is missing" if required else "a calculated variable has a start value"
        )
        yield RULES["start"], fault
    if not NUMERIC.fullmatch(variable.kind) or variable.kind == "Boolean":
        return
    attributes = [name for name in ("min", "max", "nominal", "start") if name in texts]
    number = {name: [*map(_finite, texts[name].split())] for name in attributes}
    for name, values in number.items():
        if None in values:
            yield RULES["number"], f"{name} = {texts[name]} is no finite number"
    low, high, nominal = (number.get(name, []) for name in ("min", "max", "nominal"))
    ladders = [[*low, start, *high] for start in number.get("start", [])] or [[*low, *high]]
    known = ([v for v in ladder if v is not None] for ladder in ladders)
    for ladder in [ladder for ladder in known if ladder != sorted(ladder)][:1]:
        yield RULES["bounds"], f"min, start and max do not rise: {ladder}"
    for value in [v for v in nominal if v is not None and v <= 0]:
        yield RULES["nominal"], f"nominal is {value:g}"
    sizes = [size for size in variable.shape if size is not None]
    if len(sizes) == len(variable.shape) and len(number.get("start", [0.0])) not in (
        1,
        prod(sizes),
    ):
        yield RULES["refers"], f"it has {len(number['start'])} start values, not {prod(sizes)}"
    yield from _unit_of(described, variable)


def _unit_of(described: Description, variable: Described) -> Iterator[tuple[Rule, str]]:
    unit, shown = variable.texts.get("unit"), variable.texts.get("displayUnit")
    units = described.units
    if shown is not None:
        displays = units[unit].findall("DisplayUnit") if unit in units else []
        if shown not in [d.get("name") for d in displays]:
            yield RULES["unit"], f"display unit '{shown}' is not defined for unit '{unit}'"
    if variable.derivative_of is None:
        return
    if variable.derivative_of < 0:
        yield RULES["derivative"], "it is the derivative of nothing"
        return
    state = described.variables[variable.derivative_of]
    if state is variable or state.kind not in REALS or state.variability != "continuous":
        fault = f"'{state.name}', whose derivative it is, is not a continuous state"
        yield RULES["derivative"], fault
        return
    base, rate = (_base(units.get(v.texts.get("unit"))) for v in (state, variable))
    per_second = base and base | {"s": base["s"] - 1, "offset": 0.0}  # differences have no offset
    if rate and any(not isclose(rate[n], per_second[n], rel_tol=_ROUNDING) for n in per_second):
        yield RULES["unit-of-rate"], f"unit '{unit}' is not that of '{state.name}' per second"


def _base(unit: ET.Element | None) -> dict[str, float]:
    """Return factor, offset and exponents of a unit; empty if the file does not define them."""
    element = None if unit is None else unit.find("BaseUnit")
    if element is None:
        return {}
    exponents = {name: _finite(element.get(name, "0")) or 0.0 for name in BASE_UNITS}
    factor, offset = element.get("factor", "1"), element.get("offset", "0")
    return exponents | {"factor": _finite(factor) or 0.0, "offset": _finite(offset) or 0.0}
