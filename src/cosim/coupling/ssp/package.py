"""`Package`: an unpacked SSP file, and its XML entries as `Document`."""

import posixpath
import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree as ET
from xml.parsers import expat

from casadi_models.units import Unit
from cosim.errors import CosimError, FmuError, SecurityError, UsageError
from cosim.fmi.archive import (
    MOST_BYTES,
    MOST_XML_BYTES,
    SYSTEM_DESCRIPTION,
    reject_dangerous_xml,
    unpacked,
)
from cosim.fmi.units import base_unit

_MOST_NESTED = 8  # SSP files within each other
_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:")


@dataclass
class _Opened:
    """What all packages of one file share: the folders to remove, and the bytes left to unpack."""

    held: ExitStack
    bytes_left: int = MOST_BYTES
    names: dict[str, str] = field(default_factory=dict)  # what messages say for a folder


class Package:
    """An unpacked SSP file.

    Args:
        path: The file.
        name: What messages call it.
        opened: What it shares with the package that contains it.
        nested: Number of packages around it.

    Raises:
        FmuError, SecurityError: It is no SSP file, or unpacking it is not safe.
    """

    def __init__(self, path: Path, name: str, opened: _Opened, nested: int = 0) -> None:
        self.name, self._opened, self._nested = name, opened, nested
        if nested > _MOST_NESTED:
            raise SecurityError(f"{name}: more than {_MOST_NESTED} SSP files within each other")
        source = unpacked(path, most_bytes=opened.bytes_left, description=SYSTEM_DESCRIPTION)
        self.folder = opened.held.enter_context(source)
        opened.names[str(self.folder)] = name
        files = [file for file in self.folder.rglob("*") if file.is_file()]
        opened.bytes_left -= sum(file.stat().st_size for file in files)
        self.entries = {file.relative_to(self.folder).as_posix(): file for file in files}
        self._inner = dict[str, Package]()
        self._documents = dict[str, Document]()

    @classmethod
    def outermost(cls, path: Path, held: ExitStack) -> "Package":
        """Unpack a file; `held` removes its folders."""
        return cls(path, str(path), _Opened(held))

    @property
    def places(self) -> dict[str, str]:
        """What messages say for the temporary folders of this file and those within it."""
        return self._opened.names

    @property
    def variants(self) -> list[str]:
        """Names of the system descriptions, the default one first."""
        others = (name for name in self.entries if name.endswith(".ssd") and "/" not in name)
        return sorted(others, key=lambda name: (name != SYSTEM_DESCRIPTION, name))

    def inner(self, entry: str) -> "Package":
        """Return an SSP file within this one, unpacked once."""
        if entry not in self._inner:
            name = f"{self.name}: {entry}"
            self._inner[entry] = Package(self.entries[entry], name, self._opened, self._nested + 1)
        return self._inner[entry]

    def document(self, entry: str, root: str) -> "Document":
        """Return an XML entry, which is read once.

        Args:
            entry: Its name in the package.
            root: Tag that its outermost element must have.

        Raises:
            FmuError: It is not well-formed, or has another outermost element.
            SecurityError: It declares a document type, or is too large.
        """
        place = f"{self.name}: {entry}"
        if entry not in self._documents:
            file = self.entries[entry]
            if file.stat().st_size > MOST_XML_BYTES:
                raise SecurityError(f"{place} has more than {MOST_XML_BYTES} bytes; do not use it")
            content = file.read_bytes()
            reject_dangerous_xml(place, content)
            self._documents[entry] = Document(self, entry, _local_tree(content))
        found = self._documents[entry]
        if found.root.tag != root:
            raise FmuError(f"{place}: its outermost element is {found.root.tag}, not {root}")
        return found

    def variant(self, name: str | None) -> "Document":
        """Return a system description: the default one, or that of a file or a name.

        Raises:
            UsageError: There is none of this name.
        """
        if name is None or name in self.variants:
            return self.document(name or SYSTEM_DESCRIPTION, "SystemStructureDescription")
        for entry in self.variants:
            found = self.document(entry, "SystemStructureDescription")
            if found.root.get("name") == name:
                return found
        raise UsageError(f"{self.name} has no variant '{name}'; it has {', '.join(self.variants)}")


@dataclass(frozen=True, eq=False)
class Document:
    """An XML entry of a package, with tags and attributes without prefixes.

    Attributes:
        package: Where it is.
        entry: Its name there.
        root: Its outermost element.
    """

    package: Package
    entry: str
    root: ET.Element

    def fault(self, text: str, kind: type[CosimError] = UsageError) -> CosimError:
        """Return an error that names the file and the entry."""
        return kind(f"{self.package.name}: {self.entry}: {text}")

    @cached_property
    def units(self) -> dict[str, Unit]:
        """The units that it defines, by name.

        Raises:
            UsageError: A definition is none.
        """
        found = dict[str, Unit]()
        for unit in self.root.iterfind("Units/Unit"):
            base = unit.find("BaseUnit")
            try:
                found |= {} if base is None else {unit.get("name", ""): base_unit(base.attrib)}
            except ValueError as error:
                reason = "has a factor, an offset or an exponent that defines no unit"
                raise self.fault(f"unit '{unit.get('name')}' {reason}") from error
        return found

    def units_in(self, table: ET.Element) -> dict[str, Unit]:
        """Return the units for a set or a dictionary in it, which may define its own."""
        return self.units | replace(self, root=table).units

    @contextmanager
    def naming(self) -> Iterator[None]:
        """Name the file and the entry in messages."""
        try:
            yield
        except CosimError as error:
            raise self.fault(str(error), type(error)) from error

    def find(self, source: str) -> tuple[str, str]:
        """Return the entry that a URI means, and its fragment.

        Raises:
            FmuError: The package has no such entry.
        """
        if _SCHEME.match(source):
            raise self.fault(f"'{source}' lies outside the file; only its entries are read")
        for uri in (source, unquote(source)):
            for path, _, fragment in ((uri, "", ""), uri.partition("#")):
                entry = posixpath.normpath(posixpath.join(posixpath.dirname(self.entry), path))
                if entry in self.package.entries:
                    return entry, fragment
        raise self.fault(f"it has no file {source}", FmuError)


def _local_tree(content: bytes) -> ET.Element:
    """Return a tree of local names: other tools write annotations with undeclared prefixes."""
    builder, parser = ET.TreeBuilder(), expat.ParserCreate()

    def begin(tag: str, attributes: dict[str, str]) -> None:
        own = {name: value for name, value in attributes.items() if ":" not in name}
        builder.start(_local(tag), own)

    def end(tag: str) -> None:
        builder.end(_local(tag))

    parser.StartElementHandler = begin
    parser.EndElementHandler = end
    parser.Parse(content, True)
    return builder.close()


def _local(tag: str) -> str:
    return tag.rpartition(":")[2]
