"""Value references and model structure: complete, in order, and made of what may stand there."""

from collections import Counter
from collections.abc import Iterator, Sequence

from cosim.fmi.archive import DESCRIPTION
from cosim.fmi.check import rules
from cosim.fmi.check.finding import Finding, Rule
from cosim.fmi.check.parsed import Description, Unknown

Told = tuple[Rule, str]  # what is found in a section


def structure_findings(described: Description) -> Iterator[Finding]:
    """Tell what is wrong with value references and model structure."""
    yield from _references(described)
    variables = described.variables
    states = {v.derivative_of for v in variables if v.derivative_of is not None}
    moving = {i for i, v in enumerate(variables) if v.causality in ("input", "independent")}
    given = moving | {i for i, v in enumerate(variables) if v.initial == "exact"}
    parameters = {i for i, v in enumerate(variables) if v.causality == "parameter"}
    if described.version == "2":  # there, only those that change during a run
        parameters = {i for i in parameters if variables[i].variability == "tunable"}
    running = moving | states | parameters
    for name, wanted, known in (
        ("Outputs", _output_positions(described), running),
        ("Derivatives", _derivatives(described), running),
        ("InitialUnknowns", _initial_unknowns(described), given),
    ):
        listed = described.sections[name]
        strict = name == "Outputs"
        for rule, told in (
            *_entries(described, listed, wanted, strict=strict),
            *_needs(described, listed, known),
        ):
            yield rule.at(name, told)


def _references(described: Description) -> Iterator[Finding]:
    """Value references number the variables of a type (FMI 3: all variables) without gaps."""
    second = described.version == "2"
    shared = rules.ALIAS if second else rules.SHARED_REFERENCE  # FMI 2.0 allows aliases
    for kind in sorted({v.kind for v in described.variables} if second else {""}):
        texts = [v.reference for v in described.variables if kind in ("", v.kind)]
        for text, count in Counter(texts).items():
            if count > 1:
                yield shared.about(DESCRIPTION, f"{count} variables share value reference {text}")
        unused = sorted(set(map(str, range(len(texts)))) - set(texts), key=int)
        if unused:
            told = f"value references are not consecutive from 0: {', '.join(unused[:5])} is unused"
            yield rules.REFERENCES.about(DESCRIPTION, told)


def _output_positions(described: Description) -> list[int]:
    return [i for i, v in enumerate(described.variables) if v.causality == "output"]


def _derivatives(described: Description) -> list[int]:
    return [i for i, v in enumerate(described.variables) if v.derivative_of is not None]


def _initial_unknowns(described: Description) -> list[int]:
    """FMI 2.0.4, 2.2.8: what initialization computes of outputs, states and derivatives."""
    variables = described.variables
    derivatives = _derivatives(described)
    states = [place for i in derivatives if (place := variables[i].derivative_of) is not None]
    members = {*_output_positions(described), *derivatives, *states} - {-1}
    members |= {i for i, v in enumerate(variables) if v.causality == "calculatedParameter"}
    clocked = {i for i in members if variables[i].kind == "Clock" or "clocks" in variables[i].texts}
    members -= clocked  # which initialization does not compute
    return [i for i in sorted(members) if variables[i].initial in ("approx", "calculated")]


def _entries(
    described: Description, listed: Sequence[Unknown], wanted: Sequence[int], *, strict: bool
) -> Iterator[Told]:
    rule = rules.LISTED if strict else rules.LISTED_LIGHTLY
    places = [unknown.position for unknown in listed]
    if -1 in places:
        yield rules.REFERS, "an entry refers to no variable"
    for place, count in Counter(places).items():
        if count > 1 and place >= 0:
            yield rules.LISTED, f"'{described.variables[place].name}' is listed {count} times"
    for place in sorted(set(wanted) - set(places)):
        yield rule, f"'{described.variables[place].name}' is missing"
    for place in sorted(set(places) - set(wanted) - {-1}):
        yield rule, f"'{described.variables[place].name}' does not belong there"
    if places != sorted(places):
        yield rules.ORDER, "the entries are not in ascending order"


def _needs(described: Description, listed: Sequence[Unknown], known: set[int]) -> Iterator[Told]:
    for unknown in listed:
        needs = unknown.needs or ()
        name = "?" if unknown.position < 0 else described.variables[unknown.position].name
        if -1 in needs:
            yield rules.REFERS, f"'{name}' depends on what does not exist"
        for place in sorted(set(needs) - known - {-1}):
            other = described.variables[place].name
            yield rules.KNOWNS, f"'{name}' depends on '{other}', which is not a known"
        if list(needs) != sorted(set(needs)):
            yield rules.ORDER, f"dependencies of '{name}' are not ascending"
