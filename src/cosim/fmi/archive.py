"""FMU archives: opened and unpacked safely; flat names of variables with structured names."""

import os
import re
import stat
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, BinaryIO
from xml.etree import ElementTree as ET
from xml.parsers import expat

from cosim.errors import CosimError, FmuError, SecurityError, UsageError
from cosim.files import opened_plain
from cosim.host.temporary import fmu_folder

TOOL = "cosim-rigid"  # the name in its annotations


def flat_names(root: ET.Element) -> dict[str, str]:
    """Return the flat names of variables that also have a structured name, by the latter.

    Args:
        root: Of `modelDescription.xml`, FMI 2.0 or 3.0. Files of other tools have no flat names.
    """
    if not (root.get("generationTool") or "").startswith(TOOL):
        return {}
    version_3 = root.get("fmiVersion", "").startswith("3")
    place = f"Annotation[@type='{TOOL}']" if version_3 else f"Tool[@name='{TOOL}']"
    found = {}
    for variable in root.findall("ModelVariables/*"):
        alias = variable.find(f"Annotations/{place}/Alias")
        if alias is not None:
            found[variable.get("name", "")] = alias.get("name", "")
    return found


MOST_BYTES = 2**30  # of an unpacked FMU
MOST_ENTRIES = 10_000
MOST_XML_BYTES = 2**26
MOST_XML_DEPTH = 64
DESCRIPTION = "modelDescription.xml"
SYSTEM_DESCRIPTION = "SystemStructure.ssd"
READ_BY_TOOLS = (DESCRIPTION, "sources/buildDescription.xml")
_READ_BY_NO_RUN = re.compile(r"documentation/|sources/.*\.h$")

_KINDS = {DESCRIPTION: "an FMU", SYSTEM_DESCRIPTION: "an SSP file"}
Source = str | os.PathLike[str] | BinaryIO


@contextmanager
def opened(
    source: Source, *, most_bytes: int = MOST_BYTES, description: str = DESCRIPTION
) -> Iterator[zipfile.ZipFile]:
    """Open an FMU, or an SSP file, whose entries and XML files are harmless.

    Args:
        source: The file, by name or open for reading.
        most_bytes: Of all entries, unpacked.
        description: The entry that makes it such a file.

    Raises:
        FmuError: The file is missing, damaged or no archive, or has no model description.
        SecurityError: An entry lies outside the archive, is a link, occurs twice or is too large,
            or an XML file declares entities.
    """
    name = source if isinstance(source, str | os.PathLike) else "this file"
    if not (name is source or hasattr(source, "seek")):
        raise UsageError.of_type("an FMU's reader", source, "a file name")
    with ExitStack() as held:
        try:
            if isinstance(source, str | os.PathLike):
                source = held.enter_context(opened_plain(source))
            archive = held.enter_context(zipfile.ZipFile(source))
        except (OSError, zipfile.BadZipFile, ValueError, NotImplementedError) as error:
            reason = getattr(error, "strerror", None) or "it is not a zip archive"
            raise FmuError(f"cannot read {name}: {reason}; give {_KINDS[description]}") from error
        try:
            _reject_dangerous_entries(archive, most_bytes)
            for entry in READ_BY_TOOLS:
                if entry in archive.namelist():
                    reject_dangerous_xml(entry, entry_content(archive, entry, MOST_XML_BYTES))
            if description not in archive.namelist():
                raise FmuError(f"it has no {description}; give {_KINDS[description]}")
        except FmuError as error:
            raise type(error)(f"{name}: {error}") from error.__cause__
        yield archive


@contextmanager
def unpacked(source: Source, *, to_run: bool = False, **options: Any) -> Iterator[Path]:
    """Unpack an FMU, or an SSP file, into a folder that is gone afterwards.

    Args:
        source, options: See `opened`.
        to_run: Whether to leave out what no run reads: documentation and C headers.

    Raises:
        FmuError, SecurityError: See `opened`.
    """
    with opened(source, **options) as archive, fmu_folder() as folder:
        try:
            names = (n for n in archive.namelist() if not (to_run and _READ_BY_NO_RUN.match(n)))
            archive.extractall(folder, names)
        except Exception as error:  # of any decoder
            reason = why_unreadable(error)
            cure = "; make room, or set TMPDIR" if isinstance(error, OSError) else ""
            raise FmuError(f"cannot unpack {source}: {reason}{cure}") from error
        yield folder.resolve()


@contextmanager
def naming_places(places: Mapping[str, str]) -> Iterator[None]:
    """Replace temporary folders in messages by what they were unpacked from.

    Args:
        places: Names of files by folder; a folder within a file is one of its own.
    """
    try:
        yield
    except CosimError as error:
        error.args = (with_places(str(error), places),)
        raise


def with_places(text: object, places: Mapping[str, str]) -> str:
    """Return a text in which names of files stand for temporary folders; see `naming_places`."""
    shown = str(text)
    for folder, name in places.items():
        shown = shown.replace(f"{folder}{os.sep}", f"{name}: ").replace(folder, name)
    return shown


def entry_content(
    archive: zipfile.ZipFile, entry: str | zipfile.ZipInfo, most_bytes: int = MOST_BYTES
) -> bytes:
    """Return an entry's content.

    Raises:
        FmuError: It is damaged or encrypted.
        SecurityError: It is larger than `most_bytes`.
    """
    facts = archive.getinfo(entry) if isinstance(entry, str) else entry
    name = facts.filename
    if facts.file_size > most_bytes:
        raise SecurityError(f"entry '{name}' has more than {most_bytes} bytes; do not use it")
    try:
        return archive.read(entry)
    except Exception as error:  # of any decoder
        raise FmuError(f"entry '{name}' cannot be read: {why_unreadable(error)}") from error


def why_unreadable(error: Exception) -> str:
    """Return what is wrong with an entry, from the exception of what unpacks it.

    Raises:
        MemoryError: It is one, which is no fault of the entry.
    """
    if isinstance(error, MemoryError):
        raise error
    return getattr(error, "strerror", None) or str(error) or "the archive ends before it does"


def reject_dangerous_xml(name: str, content: bytes) -> None:
    """Refuse XML that declares a document type, the door to entities, or nests without end.

    Raises:
        FmuError: It is not well-formed.
        SecurityError: It has a document type, or elements within elements beyond all use.
    """
    depth = 0

    def doctype(*_declaration: object) -> None:
        raise SecurityError(f"{name} declares a document type; FMUs have none, do not use it")

    def enter(*_element: object) -> None:
        nonlocal depth
        depth += 1
        if depth > MOST_XML_DEPTH:
            raise SecurityError(f"{name} nests {depth} elements; do not use it")

    def leave(_element: object) -> None:
        nonlocal depth
        depth -= 1

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = doctype
    parser.StartElementHandler = enter
    parser.EndElementHandler = leave
    try:
        parser.Parse(content, True)
    except (expat.ExpatError, ValueError, LookupError) as error:  # the latter: unknown encoding
        raise FmuError(f"{name} is not well-formed: {error}") from error


def _reject_dangerous_entries(archive: zipfile.ZipFile, most_bytes: int) -> None:
    entries = archive.infolist()
    if len(entries) > MOST_ENTRIES:
        raise SecurityError(f"{len(entries)} entries are more than {MOST_ENTRIES}")
    size = sum(entry.file_size for entry in entries)
    if size > most_bytes:
        raise SecurityError(f"it unpacks to {size:.3g} bytes, more than {most_bytes}")
    seen = dict[str, zipfile.ZipInfo]()
    for entry in entries:
        name = entry.orig_filename
        if leaves_archive(name):
            raise SecurityError(f"entry {name!r} lies outside the archive; do not use it")
        kind = stat.S_IFMT(entry.external_attr >> 16)
        if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
            raise SecurityError(f"entry '{name}' is a link or device; do not use this file")
        first = seen.setdefault(name.lower().rstrip("/"), entry)
        if first is not entry and not _are_copies(archive, first, entry):
            raise SecurityError(f"entry '{name}' occurs twice; do not use this file")


def _are_copies(archive: zipfile.ZipFile, one: zipfile.ZipInfo, other: zipfile.ZipInfo) -> bool:
    """Tell whether entries of one name have one content, as of exporters that pack files twice."""
    kinds = {(entry.orig_filename, entry.file_size, entry.CRC) for entry in (one, other)}
    return len(kinds) == 1 and entry_content(archive, one) == entry_content(archive, other)


def leaves_archive(name: str) -> bool:
    """Tell whether an entry's name leads elsewhere on some operating system."""
    climbs = ".." in name.replace("\\", "/").split("/")
    has_drive = name[1:2] == ":"
    return climbs or name.startswith(("/", "\\")) or has_drive or "\0" in name
