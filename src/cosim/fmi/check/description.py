"""What a model description must get right beyond its schema, as FMI 2.0.4 and 3.0.2 have it."""

from collections import Counter
from collections.abc import Iterator
from math import isfinite
from xml.etree import ElementTree as ET

from cosim.fmi.archive import DESCRIPTION
from cosim.fmi.check import rules
from cosim.fmi.check.finding import Finding, Rule
from cosim.fmi.check.parsed import REAL, Described, Description
from cosim.fmi.check.structure import structure_findings

BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
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
    """Tell what is wrong with a model description."""
    yield from _head(described)
    yield from _units(described)
    for variable in described.variables:
        for rule, told in _variable_findings(described, variable):
            yield rule.at(f"variable '{variable.name}'", told)
    yield from _name_findings(described)
    yield from structure_findings(described)


def _name_findings(described: Description) -> Iterator[Finding]:
    for name, count in Counter(v.name for v in described.variables).items():
        if count > 1:
            yield rules.NAME.at(f"variable '{name}'", f"{count} variables have this name")


def _head(described: Description) -> Iterator[Finding]:
    root = described.root
    if not described.token.strip():
        yield rules.TOKEN.about(DESCRIPTION, "the GUID or instantiation token is missing")
    if not described.interfaces and root.find("ScheduledExecution") is None:
        yield rules.INTERFACE.about(
            DESCRIPTION, "there is neither model exchange nor co-simulation"
        )
    for name, attributes in described.interfaces.items():
        identifier = attributes.get("modelIdentifier", "")
        if not (identifier.isascii() and identifier.isidentifier()):
            yield rules.IDENTIFIER.at(name, f"modelIdentifier '{identifier}' is no C name")
    experiment = root.find("DefaultExperiment")
    numbers = {} if experiment is None else {k: _finite(v) for k, v in experiment.attrib.items()}
    for name, value in numbers.items():
        if value is None or (name in ("tolerance", "stepSize") and value <= 0):
            told = f"{name} is no finite number in its range"
            yield rules.EXPERIMENT.at("DefaultExperiment", told)
    start, stop = numbers.get("startTime", 0.0), numbers.get("stopTime")
    if start is not None and stop is not None and stop <= start:
        yield rules.EXPERIMENT.at("DefaultExperiment", "stopTime is not after startTime")


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
            yield rules.UNIT.about(DESCRIPTION, f"unit '{name}' is defined {count} times")
    for unit, name in zip(defined, names, strict=True):
        if unit.find("BaseUnit") is None:
            yield rules.UNIT_HOUSE.about(DESCRIPTION, f"unit '{name}' has no base units")
        if name not in used:
            yield rules.UNIT_HOUSE.about(DESCRIPTION, f"unit '{name}' is not used")
        for element in (*unit.findall("BaseUnit"), *unit.findall("DisplayUnit")):
            factor = _finite(element.get("factor", "1"))
            if not factor or _finite(element.get("offset", "0")) is None:
                told = f"unit '{name}': factor or offset of {element.tag} is no finite number"
                yield rules.UNIT.about(DESCRIPTION, told)
    for name in sorted(used - set(names)):
        yield rules.UNIT.about(DESCRIPTION, f"unit '{name}' is not defined")


def _variable_findings(described: Description, variable: Described) -> Iterator[tuple[Rule, str]]:
    texts = variable.texts
    kinds = (variable.causality, variable.variability)
    allowed = _INITIAL.get(kinds, ())
    if described.version == "3" and variable.causality == "input":
        allowed = (*allowed, "exact")
    if variable.initial not in allowed:
        told = (
            f"causality {kinds[0]}, variability {kinds[1]}, initial {variable.initial} is illegal"
        )
        yield rules.CAUSALITY, told
    if variable.variability == "continuous" and variable.kind not in REAL:
        yield rules.VARIABILITY, f"a {variable.kind} cannot be continuous"
    wanted = variable.initial in ("exact", "approx") or variable.causality == "input"
    if wanted != ("start" in texts) and variable.kind not in ("Clock", "Binary"):
        told = "the start value is missing" if wanted else "a start value is given, but calculated"
        yield rules.START, told
    if variable.kind not in REAL:
        return
    numbers = ("min", "max", "nominal", "start")
    number = {k: _finite(texts[k]) for k in numbers if k in texts and " " not in texts[k].strip()}
    for name, value in number.items():
        if value is None:
            yield rules.NUMBER, f"{name} = {texts[name]} is no finite number"
    ladder = [number[k] for k in ("min", "start", "max") if number.get(k) is not None]
    if ladder != sorted(ladder, key=lambda value: value or 0.0):
        yield rules.BOUNDS, f"min, start and max do not rise: {ladder}"
    if number.get("nominal", 1.0) == 0:
        yield rules.NOMINAL, "nominal is 0"
    yield from _unit_of(described, variable)


def _unit_of(described: Description, variable: Described) -> Iterator[tuple[Rule, str]]:
    unit, shown = variable.texts.get("unit"), variable.texts.get("displayUnit")
    units = {u.get("name"): u for u in described.root.findall("UnitDefinitions/Unit")}
    displays = [d.get("name") for d in units[unit].findall("DisplayUnit")] if unit in units else []
    if shown is not None and shown not in displays:
        yield rules.UNIT, f"display unit '{shown}' is not defined for unit '{unit}'"
    if variable.derivative_of is None:
        return
    if variable.derivative_of < 0:
        yield rules.DERIVATIVE, "it is the derivative of nothing"
        return
    state = described.variables[variable.derivative_of]
    if state is variable or state.kind not in REAL or state.variability != "continuous":
        told = f"'{state.name}', whose derivative it is, is not a continuous state"
        yield rules.DERIVATIVE, told
        return
    base, rate = (_base(units.get(v.texts.get("unit"))) for v in (state, variable))
    if base and rate and rate != base | {"s": base["s"] - 1}:
        yield rules.UNIT_OF_RATE, f"unit '{unit}' is not that of '{state.name}' per second"


def _base(unit: ET.Element | None) -> dict[str, float]:
    """Return factor and exponents of a unit; empty where the file does not tell them."""
    element = None if unit is None else unit.find("BaseUnit")
    if element is None:
        return {}
    exponents = {name: _finite(element.get(name, "0")) or 0.0 for name in BASE_UNITS}
    return exponents | {"factor": _finite(element.get("factor", "1")) or 0.0}
