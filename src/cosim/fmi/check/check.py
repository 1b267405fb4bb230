"""Checks of a finished FMU, above all of what `fmpy validate` does not look at."""

import re
import zipfile
from collections.abc import Iterator
from functools import cache
from pathlib import PurePosixPath
from xml.etree import ElementTree as ET

from cosim.fmi.archive import DESCRIPTION, Source, content_of, opened
from cosim.fmi.check.description import description_problems
from cosim.fmi.check.parsed import Description, parse
from cosim.fmi.export.build import fmi_headers
from cosim.fmi.platforms import PLATFORMS, Target
from cosim.fmi.shared_library import read_libraries

_ONLY = {
    "ModelExchange": r"NewDiscreteStates|EnterContinuousTimeMode|CompletedIntegratorStep|SetTime|"
    r"\w*ContinuousState\w*|GetDerivatives|GetEventIndicators|GetNumberOfEventIndicators|(?<=2)EnterEventMode",
    "CoSimulation": r"\w*RealInputDerivatives|Get\w*OutputDerivatives|DoStep|CancelStep|"
    r"Get\w*Status|EnterStepMode",
    "ScheduledExecution": r"\w*ScheduledExecution|ActivateModelPartition",
}
_COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # all that FMI allows


def check_fmu(source: Source) -> list[str]:
    """Return the problems of an FMU, one sentence each; none when it is sound.

    No code of the FMU runs: libraries are read as files.

    Args:
        source: The file, by name or open for reading.

    Raises:
        FmuError, SecurityError: The file is no FMU or dangerous, see `cosim.fmi.archive`.

    Example:
        >>> import cosim
        >>> check_fmu(cosim.export_fmu(cosim.load("crank_shaft"), "crank.fmu"))
        []
    """
    with opened(source) as archive:
        return list(problems_of(archive))


def problems_of(archive: zipfile.ZipFile) -> Iterator[str]:
    """Tell the problems of an opened FMU, one sentence each."""
    yield from _archive(archive)
    try:
        described = parse(content_of(archive, DESCRIPTION))
    except ValueError as error:
        yield f"{DESCRIPTION}: {error}"
        return
    yield from (f"{DESCRIPTION}: {problem}" for problem in description_problems(described))
    yield from _sources(archive, described)
    yield from _binaries(archive, described)


def _archive(archive: zipfile.ZipFile) -> Iterator[str]:
    for entry in archive.infolist():
        name = entry.orig_filename
        if "\\" in name or not name.isascii():
            yield f"entry '{name}' has a backslash or is not ASCII"
        if entry.compress_type not in _COMPRESSIONS:
            yield f"entry '{name}' is neither stored nor deflated"
    try:
        damaged = archive.testzip()
    except (zipfile.BadZipFile, RuntimeError, NotImplementedError, EOFError) as error:
        yield f"the archive is damaged: {error}"
        return
    if damaged:
        yield f"entry '{damaged}' is damaged"


def _sources(archive: zipfile.ZipFile, described: Description) -> Iterator[str]:
    if described.version == "2":
        listed = [e.get("name", "") for e in described.root.iterfind("*/SourceFiles/File")]
    elif "sources/buildDescription.xml" in archive.namelist():
        build = ET.fromstring(content_of(archive, "sources/buildDescription.xml"))
        listed = [e.get("name", "") for e in build.iter("SourceFile")]
    else:
        listed = []
    for name in dict.fromkeys(listed):
        if f"sources/{name}" not in archive.namelist():
            yield f"source file '{name}' is listed, but missing"


def _binaries(archive: zipfile.ZipFile, described: Description) -> Iterator[str]:
    """Every library exports all functions and holds the token that importers will pass."""
    identifiers = sorted({a.get("modelIdentifier", "") for a in described.interfaces.values()})
    present = {PurePosixPath(name).parent.as_posix() for name in archive.namelist()}
    known = {t.folder(int(described.version)): t for ts in PLATFORMS.values() for t in ts}
    for folder, target in known.items():  # what lies in other folders is the exporter's business
        for identifier in identifiers if f"binaries/{folder}" in present else ():
            name = f"binaries/{folder}/{identifier}{target.suffix}"
            if name not in archive.namelist():
                yield f"{name} is missing"
                continue
            content = content_of(archive, name)
            if described.token.encode() not in content:
                yield f"{name} was compiled for another GUID or instantiation token"
            yield from (f"{name}: {p}" for p in _library(content, target, described))


def _library(content: bytes, target: Target, described: Description) -> Iterator[str]:
    version = described.version
    try:
        libraries = read_libraries(content)
    except ValueError as error:
        yield str(error)
        return
    for library in libraries:
        # FMI 2.0 names no processor but x86; others share its folders
        processors = ("x86_64", "aarch64") if version == "2" else (target.processor,)
        if library.system != target.system or library.processor not in processors:
            yield f"it is for {library.processor}-{library.system}"
        missing = sorted(_needed_functions(described) - library.exports)
        if missing:
            yield f"{library.processor} lacks {', '.join(missing)}"


def _needed_functions(described: Description) -> frozenset[str]:
    """Return what importers may call: the functions of interfaces not offered may be missing."""
    spare = [name for name in _ONLY if name not in described.interfaces]
    only = [re.compile(rf"fmi\d({_ONLY[name]})") for name in spare]
    every = required_functions(described.version)
    return frozenset(f for f in every if not any(one.fullmatch(f) for one in only))


@cache
def required_functions(version: str) -> frozenset[str]:
    """Return the functions that every FMU must export, from the header of the FMI."""
    header = (fmi_headers() / f"fmi{version}Functions.h").read_text(encoding="utf-8")
    return frozenset(re.findall(rf"FMI{version}_Export\s+fmi\w+TYPE\s+(fmi\w+);", header))
