"""The static check of an FMU: its archive, description, sources and libraries; no code of it runs.

`check_fmu` also applies this project's rules for its own exports; `examine` applies only the FMI's.
"""

import re
import zipfile
from collections.abc import Iterator
from functools import cache
from pathlib import PurePosixPath

from cosim.fmi.archive import DESCRIPTION, Source, entry_content, opened, why_unreadable
from cosim.fmi.check.description import description_findings, schema_findings
from cosim.fmi.check.finding import OWN, RULES, Finding, Rule
from cosim.fmi.check.libraries import folder_findings, library_findings
from cosim.fmi.check.parsed import Description, fmi_version, listed_sources, parse
from cosim.fmi.export.build import fmi_headers
from cosim.fmi.platforms import PLATFORMS, Target
from cosim.fmi.shared_library import read_libraries
from cosim.text import shortened


def examine(source: Source) -> tuple[Finding, ...]:
    """Return the findings about an FMU without running any of its code.

    Raises:
        FmuError, SecurityError: The file is no FMU or dangerous, see `cosim.fmi.archive`.
    """
    with opened(source) as archive:
        version = fmi_version(entry_content(archive, DESCRIPTION))[:1]
        every = [*findings_of(archive), *library_findings(archive)]
        if version in ("2", "3"):
            every += [*schema_findings(archive, version), *folder_findings(archive, version)]
        return tuple(finding for finding in every if finding.level != OWN)


_ONLY = {
    "ModelExchange": r"NewDiscreteStates|EnterContinuousTimeMode|CompletedIntegratorStep|SetTime|"
    r"\w*ContinuousState\w*|GetDerivatives|GetEventIndicators|GetNumberOfEventIndicators|(?<=2)EnterEventMode",
    "CoSimulation": r"\w*RealInputDerivatives|Get\w*OutputDerivatives|DoStep|CancelStep|"
    r"Get\w*Status|EnterStepMode",
    "ScheduledExecution": r"\w*ScheduledExecution|ActivateModelPartition",
}
_MOST_NAMES = 5
_COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # all that FMI allows


def check_fmu(source: Source, *, libraries: bool = True) -> list[str]:
    """Return the problems of an FMU, one sentence each; an empty list if there is none.

    No code of the FMU runs: libraries are read as files.

    Args:
        source: The FMU.
        libraries: Whether to read the libraries inside it, which needs LIEF.

    Raises:
        MissingTool: LIEF is not installed.
        FmuError, SecurityError: The file is no FMU or dangerous, see `cosim.fmi.archive`.

    Example:
        >>> import cosim
        >>> check_fmu(cosim.export_fmu(cosim.load("crank_shaft"), "crank.fmu"))
        []
    """
    with opened(source) as archive:
        return [finding.sentence for finding in findings_of(archive, libraries=libraries)]


def findings_of(archive: zipfile.ZipFile, *, libraries: bool = True) -> Iterator[Finding]:
    """Return the findings about an opened FMU, by the FMI and by this project's own rules."""
    yield from _archive(archive)
    content = entry_content(archive, DESCRIPTION)
    try:
        described = parse(content)
    except ValueError as error:
        rule = RULES["xml" if error.__cause__ else "version"]
        yield rule.about(DESCRIPTION, str(error)).within(DESCRIPTION)
        return
    yield from (finding.within(DESCRIPTION) for finding in description_findings(described))
    listed, present = dict.fromkeys(listed_sources(archive, described)), {*archive.namelist()}
    if missing := [f"'{name}'" for name in listed if f"sources/{name}" not in present]:
        found = f"listed source files are missing: {shortened(missing, _MOST_NAMES)}"
        yield RULES["sources"].about("archive", found)
    yield from _binaries(archive, described, libraries)


def _archive(archive: zipfile.ZipFile) -> Iterator[Finding]:
    for entry in archive.infolist():
        name = entry.orig_filename
        place = f"entry '{name}'"
        if "\\" in name or not name.isascii():
            found = "has a backslash or is not ASCII"
            yield RULES["entry-name"].at(place, found, f"{place} {found}")
        if entry.compress_type not in _COMPRESSIONS:
            found = "is neither stored nor deflated"
            yield RULES["compression"].at(place, found, f"{place} {found}")
    try:
        damaged = archive.testzip()
    except Exception as error:  # of any decoder
        yield RULES["archive"].about("archive", f"the archive is damaged: {why_unreadable(error)}")
        return
    if damaged:
        place = f"entry '{damaged}'"
        yield RULES["archive"].at(place, "is damaged", f"{place} is damaged")


def _binaries(
    archive: zipfile.ZipFile, described: Description, libraries: bool
) -> Iterator[Finding]:
    """Check that every library exports all functions and holds the token that importers pass."""
    identifiers = sorted({a.get("modelIdentifier", "") for a in described.interfaces.values()})
    present = {PurePosixPath(name).parent.as_posix() for name in archive.namelist()}
    known = {t.folder(int(described.version)): t for ts in PLATFORMS.values() for t in ts}
    for folder, target in known.items():  # other folders are not specified by the FMI
        for identifier in identifiers if f"binaries/{folder}" in present else ():
            name = f"binaries/{folder}/{identifier}{target.suffix}"
            if name not in archive.namelist():
                yield RULES["binary"].at(name, "is missing", f"{name} is missing")
                continue
            content = entry_content(archive, name)
            if described.token.encode() not in content:
                found = "the library does not hold the GUID or token: "
                found += "it reads it elsewhere, or belongs to another FMU"
                whole = f"{name} was compiled for another GUID or instantiation token"
                yield RULES["token-elsewhere"].at(name, found, whole)
            faults = _library_faults(content, target, described) if libraries else ()
            for rule, found in faults:
                yield rule.at(name, found)


def _library_faults(
    content: bytes, target: Target, described: Description
) -> Iterator[tuple[Rule, str]]:
    version = described.version
    try:
        libraries = read_libraries(content)
    except ValueError as error:
        yield RULES["binary"], str(error)
        return
    for library in libraries:
        # FMI 2.0 names no processor but x86; others share its folders
        processors = ("x86_64", "aarch64") if version == "2" else (target.processor,)
        if library.system != target.system or library.processor not in processors:
            yield RULES["platform"], f"it is for {library.processor}-{library.system}"
        missing = sorted(_needed_functions(described) - library.exports)
        if missing:
            yield RULES["functions"], f"{library.processor} lacks {', '.join(missing)}"


def _needed_functions(described: Description) -> frozenset[str]:
    """Return what importers may call: the functions of interfaces not offered may be missing."""
    missing = [name for name in _ONLY if name not in described.interfaces]
    only = [re.compile(rf"fmi\d({_ONLY[name]})") for name in missing]
    every = required_functions(described.version)
    return frozenset(f for f in every if not any(one.fullmatch(f) for one in only))


@cache
def required_functions(version: str) -> frozenset[str]:
    """Return the functions that every FMU must export, from the header of the FMI."""
    header = (fmi_headers() / f"fmi{version}Functions.h").read_text(encoding="utf-8")
    return frozenset(re.findall(rf"FMI{version}_Export\s+fmi\w+TYPE\s+(fmi\w+);", header))
