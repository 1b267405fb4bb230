"""Elements of a system description: systems, FMUs and references to signal dictionaries."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum, auto
from typing import NamedTuple
from xml.etree import ElementTree as ET

from casadi_models.units import Unit
from cosim.coupling.ssp.package import Document
from cosim.errors import FmuError
from cosim.fmi.run.description import INTERFACES
from cosim.fmi.units import Measured

Place = tuple[str, ...]  # names of the systems around an element, and its own

_FMU = "application/x-fmu-sharedlibrary"
_PACKAGE, _DEFINITION = "application/x-ssp-package", "application/x-ssp-definition"
_DICTIONARY = "application/x-ssp-signal-dictionary"
_MOST_ELEMENTS = 10_000
_MOST_LEVELS = 64  # of systems within each other


class Role(Enum):
    """Where a connector's signal goes, seen from outside of its element."""

    IN = auto()
    OUT = auto()
    EITHER = auto()


_ROLES = {
    **dict.fromkeys(("input", "parameter", "structuralParameter"), Role.IN),
    **dict.fromkeys(("output", "local", "constant", "calculatedParameter"), Role.OUT),
    **dict.fromkeys(("inout", "unspecified"), Role.EITHER),
}


@dataclass(frozen=True)
class Declared:
    """A connector as it is declared.

    Attributes:
        role: Its direction.
        unit: What it is measured in.
        name: The one that counts, for a variable with several names.
    """

    role: Role
    unit: Measured
    name: str


@dataclass(frozen=True)
class Dictionary:
    """A signal dictionary: where it is declared, and the units of its signals by name."""

    place: Place
    signals: Mapping[str, Measured]


@dataclass(frozen=True, eq=False)
class Element:
    """An element of a system, or the whole system.

    Attributes:
        place: Where it is.
        connectors: By name.
        bound: Descriptions that bind its parameters, later ones replace values of earlier ones.
        fmu: Entry of its FMU, for a component that has one.
        interface: Of the FMU, that the component asks for, or "any".
        dictionary: What it refers to, for a reference to a signal dictionary.
        elements: What it contains, by name.
        connections: Within it.
    """

    place: Place
    connectors: Mapping[str, Declared]
    bound: tuple[tuple[Document, ET.Element], ...] = ()
    fmu: tuple[Document, str] | None = None
    interface: str = "any"
    dictionary: tuple[str, Dictionary] | None = None
    elements: Mapping[str, "Element"] = field(default_factory=dict)
    connections: tuple[tuple[Document, ET.Element], ...] = ()

    def walk(self) -> Iterator["Element"]:
        """Yield all elements within, those of a system before the system, and this one."""
        for element in self.elements.values():
            yield from element.walk()
        yield self


class _Context(NamedTuple):
    """Where an element stands.

    Attributes:
        document: The description that has it.
        place: Its own.
        known: Signal dictionaries of the systems around it, by name.
        level: Number of these systems.
    """

    document: Document
    place: Place
    known: Mapping[str, Dictionary]
    level: int

    @property
    def called(self) -> str:
        """What messages call the element."""
        return f"'{'.'.join(self.place)}'" if self.place else "the whole system"


def whole_system(document: Document) -> Element:
    """Return the system that a description describes.

    Raises:
        CosimError: It has none, or elements that are not unique or cannot be simulated.
    """
    return _Reader().description(_Context(document, (), {}, 0))


class _Reader:
    """Reads elements, and counts them: a small file may refer to another one many times."""

    def __init__(self) -> None:
        self._left = _MOST_ELEMENTS

    def description(self, here: _Context) -> Element:
        """Return the system of a whole description."""
        found = here.document.root.find("System")
        if found is None:
            raise here.document.fault("it describes no system", FmuError)
        return self._system(found, here)

    def _system(self, system: ET.Element, here: _Context) -> Element:
        document = here.document
        if here.level > _MOST_LEVELS:
            raise document.fault(f"more than {_MOST_LEVELS} systems within each other", FmuError)
        known = {**here.known, **_dictionaries(system, here)}
        elements = dict[str, Element]()
        for element in system.iterfind("Elements/*"):
            name = element.get("name")
            if not name:
                raise document.fault(f"a {element.tag} of {here.called} has no name; name it")
            if name in elements:
                raise document.fault(f"{here.called} has two elements '{name}'; rename one")
            self._left -= 1
            if self._left < 0:
                raise document.fault(f"it has more than {_MOST_ELEMENTS} elements", FmuError)
            inner = _Context(document, (*here.place, name), known, here.level + 1)
            elements[name] = self._element(element, inner)
        connections = system.iterfind("Connections/Connection")
        return Element(
            here.place,
            _connectors(system, here),
            bound=((document, system),),
            elements=elements,
            connections=tuple((document, connection) for connection in connections),
        )

    def _element(self, element: ET.Element, here: _Context) -> Element:
        if element.tag == "System":
            return self._system(element, here)
        if element.tag == "Component":
            return self._component(element, here)
        if element.tag == "SignalDictionaryReference":
            name = element.get("dictionary", "")
            if name not in here.known:
                raise here.document.fault(f"{here.called} refers to no signal dictionary: '{name}'")
            found = (name, here.known[name])
            return Element(here.place, _connectors(element, here), dictionary=found)
        raise here.document.fault(
            f"{here.called} ({element.tag}) cannot be simulated here; only FMUs can"
        )

    def _component(self, element: ET.Element, here: _Context) -> Element:
        document, own = here.document, (here.document, element)
        kind, source = element.get("type", _FMU), element.get("source")
        if source is None:  # a system without elements
            return Element(here.place, _connectors(element, here), bound=(own,))
        if kind in (_PACKAGE, _DEFINITION):
            inner = self._referred(kind, source, here)
            return replace(inner, bound=(*inner.bound, own))
        if kind != _FMU:
            raise document.fault(f"{here.called} ({kind}) cannot be simulated here; only FMUs can")
        interface = element.get("implementation", "any")
        if interface not in ("any", *INTERFACES):
            raise document.fault(
                f"{here.called} asks for {interface}, which cannot be simulated here; ask for "
                "CoSimulation or ModelExchange"
            )
        entry, _ = document.find(source)
        connectors = _connectors(element, here)
        return Element(
            here.place, connectors, bound=(own,), fmu=(document, entry), interface=interface
        )

    def _referred(self, kind: str, source: str, here: _Context) -> Element:
        """Return the system that a component refers to: of this file or of another one."""
        document = here.document
        if source.startswith("#"):
            for system in document.root.iter("System"):
                if system.get("id") == source[1:]:
                    return self._system(system, here)
            raise document.fault(f"{here.called} refers to no system with the id {source[1:]}")
        entry, fragment = document.find(source)
        if kind == _DEFINITION:
            found = document.package.document(entry, "SystemStructureDescription")
        else:
            found = document.package.inner(entry).variant(fragment or None)
        return self.description(here._replace(document=found))


def _connectors(element: ET.Element, here: _Context) -> dict[str, Declared]:
    """Return the declared connectors of an element."""
    found = dict[str, Declared]()
    for connector in element.iterfind("Connectors/Connector"):
        name, kind = connector.get("name", ""), connector.get("kind", "")
        if name in found:
            raise here.document.fault(f"{here.called} has two connectors '{name}'; rename one")
        if kind not in _ROLES:
            raise here.document.fault(
                f"connector '{name}' of {here.called} is of kind '{kind}'; give one of "
                f"{', '.join(_ROLES)}"
            )
        found[name] = Declared(_ROLES[kind], _unit(connector, here.document.units), name)
    return found


def _unit(element: ET.Element, defined: Mapping[str, Unit]) -> Measured:
    """Return the unit of the type in a connector or a signal."""
    names = (child.get("unit") for child in element if child.get("unit"))
    return Measured.of(next(names, None), defined)


def _dictionaries(system: ET.Element, here: _Context) -> dict[str, Dictionary]:
    """Return the signal dictionaries that a system declares."""
    document = here.document
    found = dict[str, Dictionary]()
    for declared in system.iterfind("SignalDictionaries/SignalDictionary"):
        name, source = declared.get("name", ""), declared.get("source")
        if name in found:
            raise document.fault(f"{here.called} has two dictionaries '{name}'; rename one")
        if declared.get("type", _DICTIONARY) != _DICTIONARY:
            raise document.fault(f"dictionary '{name}' is of type {declared.get('type')}")
        if source is None:
            holder, tables = document, declared.findall("SignalDictionary")
        else:
            holder = document.package.document(document.find(source)[0], "SignalDictionary")
            tables = [holder.root]
        signals = {
            entry.get("name", ""): _unit(entry, holder.units_in(table))
            for table in tables
            for entry in table.iterfind("DictionaryEntry")
        }
        found[name] = Dictionary(here.place, signals)
    return found
