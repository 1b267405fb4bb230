"""What is wrong with anybody's FMU: rule, place in the file, what was found, and the cure.

`check_fmu` holds our own files to rules of the house, too; of others only the FMI is asked here.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass

from cosim.fmi.archive import DESCRIPTION, Source, content_of, opened
from cosim.fmi.check.check import problems_of
from cosim.fmi.check.finding import ADVICE, WRONG, Finding
from cosim.fmi.check.libraries import library_findings


@dataclass(frozen=True)
class _Rule:
    pattern: str
    level: str  # "" where only our own files are asked to keep it
    name: str
    cure: str
    found: str = ""


_NAMED = "list every variable of its kind there, once"
_RULES = (
    _Rule(r"has a backslash or is not ASCII", ADVICE, "entry-name", "name files in ASCII, with /"),
    _Rule(r"neither stored nor deflated", WRONG, "compression", "pack with method deflate"),
    _Rule(r"is damaged(: |$)", WRONG, "archive", "pack the file again"),
    _Rule(r"not well-formed", WRONG, "xml", "write well-formed XML"),
    _Rule(r"fmiVersion is", WRONG, "version", "give an FMU of FMI 2.0 or 3.0"),
    _Rule(r"GUID or instantiation token is missing", WRONG, "token", "give the token a value"),
    _Rule(r"neither model exchange nor", WRONG, "interface", "declare an interface"),
    _Rule(r"is no C name", WRONG, "identifier", "use letters, digits and _ only"),
    _Rule(r"DefaultExperiment: ", ADVICE, "experiment", "give finite numbers, stop after start"),
    _Rule(r"unit '.*' (has no base units|is not used)$", "", "unit", ""),
    _Rule(r"unit '.*' is not that of", ADVICE, "unit-of-rate", "make it the state's unit per s"),
    _Rule(r"unit '", WRONG, "unit", "define each unit once, with finite factors"),
    _Rule(r"initial \w+ is illegal", WRONG, "causality", "see the table of `initial` in the FMI"),
    _Rule(r"cannot be continuous", WRONG, "variability", "make it discrete"),
    _Rule(r"start value is (missing|given)", WRONG, "start", "a start with exact, approx, input"),
    _Rule(r"is no finite number", WRONG, "number", "write a finite number"),
    _Rule(r"min, start and max do not rise", WRONG, "bounds", "put start between min and max"),
    _Rule(r"nominal is 0", WRONG, "nominal", "write a nominal value above 0"),
    _Rule(r"whose derivative it is|derivative of nothing", WRONG, "derivative", "name its state"),
    _Rule(r"not consecutive from 0", "", "value-reference", ""),
    _Rule(r"share value reference", WRONG, "value-reference", "number every variable once"),
    _Rule(r"not (in )?ascending", "", "order", ""),
    _Rule(r"refers to no variable|does not exist", WRONG, "structure", "name what is described"),
    _Rule(r"is listed \d+ times|Outputs: '.*' (is missing|does not b)", WRONG, "structure", _NAMED),
    _Rule(r"' (is missing|does not belong there)$", ADVICE, "structure", _NAMED),
    _Rule(r"which is not a known", "", "dependencies", ""),  # parameters are listed by many
    _Rule(r"is listed, but missing", WRONG, "sources", "add the file or do not list it"),
    _Rule(r"binaries/\S+ is missing", WRONG, "binary", "name the library like modelIdentifier"),
    _Rule(
        *(r"another GUID", ADVICE, "token", "check with --run that it instantiates"),
        found="the library does not hold the GUID or token: it reads it elsewhere, or is another's",
    ),
    _Rule(r" lacks fmi", WRONG, "functions", "export every function of its interfaces"),
    _Rule(r": it is for ", WRONG, "platform", "put the library into its own platform's folder"),
    _Rule(r"binaries/", WRONG, "binary", "compile it as a 64-bit shared library"),
)
_PLACES = (
    *(r"(entry '(?P<place>.*?)') (?P<found>.*)", r"(?P<place>binaries/\S+?):? (?P<found>.*)"),
    rf"{DESCRIPTION}: (?P<place>variable '.*?'|[A-Z]\w+): (?P<found>.*)",
    *(rf"(?P<place>{DESCRIPTION}): (?P<found>.*)", r"(?P<found>.*)(?P<place>)"),
)


def examine(source: Source) -> tuple[Finding, ...]:
    """Return what is to be said of an FMU without running any of its code.

    Args:
        source: The file, by name or open for reading.

    Raises:
        FmuError, SecurityError: The file is no FMU or dangerous, see `cosim.fmi.archive`.
    """
    with opened(source) as archive:
        text = content_of(archive, DESCRIPTION)
        aliases = re.search(rb"fmiVersion\s*=\s*.2", text) is not None  # FMI 2 allows them
        told = _told(problems_of(archive), aliases=aliases)
        return (*told, *library_findings(archive))


def _told(problems: Iterator[str], *, aliases: bool) -> Iterator[Finding]:
    for problem in problems:
        rule = next((r for r in _RULES if re.search(r.pattern, problem)), None)
        if rule is None:
            rule = _Rule("", WRONG, "other", "see the FMI")
        if not rule.level or (aliases and rule.name == "value-reference"):
            continue
        place = next(m for pattern in _PLACES if (m := re.fullmatch(pattern, problem, re.DOTALL)))
        found = rule.found or place["found"]
        yield Finding(rule.level, rule.name, place["place"] or "archive", found, rule.cure)
