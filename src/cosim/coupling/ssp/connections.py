"""What drives each connector of an SSP file: declared connectors only, each driven at most once."""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import NamedTuple
from xml.etree import ElementTree as ET

from cosim.coupling.ssp.package import Document
from cosim.coupling.ssp.parameters import linear, truth
from cosim.coupling.ssp.structure import Declared, Element, Place, Role
from cosim.errors import UnknownName, UsageError
from cosim.fmi.units import Measured, change_of_units


class Node(NamedTuple):
    """A connector of an element, or a signal of a dictionary; `dictionary` is empty for others."""

    place: Place
    name: str
    dictionary: str = ""

    def __str__(self) -> str:
        inner = (self.dictionary,) if self.dictionary else ()
        return ".".join((*self.place, *inner, self.name))


class Driver(NamedTuple):
    """What drives a connector: `factor` times the value of `source`, plus `offset`.

    Attributes:
        keeps_unit: Whether the units of the two are not converted.
        document: Where the connection is.
    """

    source: Node
    factor: float
    offset: float
    keeps_unit: bool
    document: Document


Steps = list[tuple[Node, Driver]]


class Way(NamedTuple):
    """How a connector is driven: from `source`, which nothing drives, by steps to `sink`."""

    source: Node
    steps: Steps
    sink: Node

    @property
    def nodes(self) -> list[Node]:
        """All connectors on the way, the source first."""
        return [self.source, *(node for node, _ in self.steps)]


class _End(NamedTuple):
    node: Node
    role: Role  # seen from the system that has the connection: IN can be driven


class Connections:
    """The connections of a system and of those within it.

    Args:
        system: The whole system.
        variables: Variables of the FMUs as connectors, by place.

    Raises:
        UnknownName: A connection ends at nothing.
        UsageError: A connector is driven twice or drives itself, or a connection leads from an
            output to an output or from an input to an input.
    """

    def __init__(self, system: Element, variables: Mapping[Place, Mapping[str, Declared]]) -> None:
        self._variables = variables
        self._units = dict[Node, Measured]()
        self._drivers = dict[Node, Driver]()
        open_ends = list[tuple[_End, _End, Driver]]()
        for element in system.walk():
            for document, connection in element.connections:
                open_ends += self._read(element, document, connection)
        self._direct(open_ends)
        self._reject_rings()
        self._spread_differences()

    @property
    def driven(self) -> Iterator[Node]:
        """All connectors that something drives, in the order of the connections."""
        return iter(self._drivers)

    def way(self, sink: Node) -> Way:
        """Return the way on which a connector is driven."""
        steps: Steps = []
        node = sink
        while node in self._drivers:
            steps.append((node, self._drivers[node]))
            node = self._drivers[node].source
        return Way(node, steps[::-1], sink)

    def unit(self, node: Node) -> Measured:
        """Return the unit of a connector."""
        return self._units.get(node, Measured())

    def change(self, steps: Steps, unit: Measured) -> tuple[float, float]:
        """Return factor and offset along connections.

        Args:
            steps: Driven connectors with their drivers, the first driven one first.
            unit: Of the value that drives the first one.

        Raises:
            UsageError: Units do not fit.
        """
        factor, offset = 1.0, 0.0
        for node, driver in steps:
            own = self.unit(node)
            if not driver.keeps_unit:
                try:
                    scale, shift = change_of_units(str(node), own, str(driver.source), unit)
                except UsageError as error:
                    raise driver.document.fault(str(error)) from error
                factor, offset = scale * factor, scale * offset + shift
            factor, offset = driver.factor * factor, driver.factor * offset + driver.offset
            unit = own if own.name is not None or driver.keeps_unit else unit
        return factor, offset

    def _read(
        self, system: Element, document: Document, connection: ET.Element
    ) -> Iterator[tuple[_End, _End, Driver]]:
        """Store a connection whose direction follows from its ends, or yield it."""
        start, end = (self._end(system, document, connection, side) for side in ("start", "end"))
        where = f"the connection from {start.node} to {end.node}"
        tables = sorted(child.tag for child in connection if "Mapping" in child.tag)
        if tables:
            raise document.fault(
                f"{tables[0]} of {where} cannot be read here; write a LinearTransformation"
            )
        if any(connection.get(f"{side}Indices") for side in ("start", "end")):
            raise document.fault(f"{where} has indices; only connectors of one number are read")
        keeps_unit = truth(
            document,
            f"suppressUnitConversion of {where}",
            connection.get("suppressUnitConversion"),
        )
        driver = Driver(start.node, *linear(document, where, connection), keeps_unit, document)
        if start.role is end.role and start.role is not Role.EITHER:
            both = "can only be driven" if start.role is Role.IN else "cannot be driven"
            raise document.fault(f"{where}: both ends {both}; connect an output to an input")
        if start.role is Role.OUT or end.role is Role.IN:
            self._drive(end.node, driver)
        elif start.role is Role.IN or end.role is Role.OUT:
            self._drive(start.node, driver._replace(source=end.node))
        else:
            yield start, end, driver

    def _direct(self, open_ends: list[tuple[_End, _End, Driver]]) -> None:
        """Direct connections of connectors that may be both: away from those that are driven."""
        left = dict(enumerate(open_ends))
        touching = dict[Node, list[int]]()
        for number, (start, end, _) in left.items():
            touching.setdefault(start.node, []).append(number)
            touching.setdefault(end.node, []).append(number)
        driven = [node for node in touching if node in self._drivers]
        while left:
            if not driven:  # as written
                start, end, driver = left.pop(next(iter(left)))
                self._drive(end.node, driver)
                driven.append(end.node)
            node = driven.pop()
            for number in touching[node]:
                if number in left:
                    start, end, driver = left.pop(number)
                    other = end.node if start.node == node else start.node
                    self._drive(other, driver._replace(source=node))
                    driven.append(other)

    def _reject_rings(self) -> None:
        checked = set[Node]()
        for sink in self._drivers:
            way, node = dict[Node, Driver](), sink
            while node in self._drivers and node not in checked:
                if node in way:
                    ring = [str(one) for one in way][list(way).index(node) :]
                    raise way[node].document.fault(
                        f"connections drive {ring[0]} in a ring: "
                        f"{' <- '.join([*ring, ring[0]])}; remove one of them"
                    )
                way[node] = self._drivers[node]
                node = way[node].source
            checked.update(way)

    def _spread_differences(self) -> None:
        """Let connectors of systems have differences, which only variables of parts declare."""
        links = defaultdict[Node, list[Node]](list)
        for sink, driver in self._drivers.items():
            links[sink].append(driver.source)
            links[driver.source].append(sink)
        left = [node for node, unit in self._units.items() if unit.is_difference]
        while left:
            for node in links[left.pop()]:
                if node.place not in self._variables and not self.unit(node).is_difference:
                    self._units[node] = self.unit(node).difference()
                    left.append(node)

    def _drive(self, sink: Node, driver: Driver) -> None:
        if sink in self._drivers:
            raise driver.document.fault(
                f"{sink} is connected twice, to {self._drivers[sink].source} and to "
                f"{driver.source}; connect it once"
            )
        self._drivers[sink] = driver

    def _end(self, system: Element, document: Document, connection: ET.Element, side: str) -> _End:
        """Return an end of a connection: a connector of the system or of an element in it."""
        name, inner = connection.get(f"{side}Connector", ""), connection.get(f"{side}Element")
        element, owner = system, "the system"
        if system.place:
            owner = f"system '{'.'.join(system.place)}'"
        if inner:
            if inner not in system.elements:
                near = UnknownName.among(owner, "element", inner, system.elements)
                raise document.fault(f"a connection of '{name}': {near}", UnknownName)
            element, owner = system.elements[inner], f"'{'.'.join((*system.place, inner))}'"
        if element.dictionary is not None:
            return self._signal(element, document, name, owner)
        declared = self._variables.get(element.place, element.connectors)
        if name not in declared:
            kind = "variable" if element.place in self._variables else "connector"
            near = UnknownName.among(owner, kind, name, declared)
            raise document.fault(str(near), UnknownName)
        node = Node(element.place, declared[name].name)
        self._units[node] = declared[name].unit
        role = declared[name].role
        if element is system and role is not Role.EITHER:  # inside, its inputs drive
            role = Role.OUT if role is Role.IN else Role.IN
        return _End(node, role)

    def _signal(self, element: Element, document: Document, name: str, owner: str) -> _End:
        assert element.dictionary is not None
        called, dictionary = element.dictionary
        if name not in dictionary.signals:
            near = UnknownName.among(f"dictionary '{called}'", "signal", name, dictionary.signals)
            raise document.fault(f"{owner}: {near}", UnknownName)
        node = Node(dictionary.place, name, called)
        self._units[node] = dictionary.signals[name]
        role = element.connectors[name].role if name in element.connectors else Role.EITHER
        return _End(node, role)
