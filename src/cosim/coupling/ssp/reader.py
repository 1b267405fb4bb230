"""`read_ssp`: a coupled system from an SSP file of version 1.0 or 2.0."""

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from casadi_models.dae.coupled import Connection
from casadi_models.dae.variables import is_name
from cosim.coupling.connectors import Connector, End, transformed
from cosim.coupling.couple import system_of
from cosim.coupling.opened_part import Ability
from cosim.coupling.part import Part, Variable, part_of, reject_types
from cosim.coupling.ssp.connections import Connections, Node, Steps, Way
from cosim.coupling.ssp.package import Document, Package
from cosim.coupling.ssp.parameters import Value, bound_values, real
from cosim.coupling.ssp.structure import Declared, Element, Place, Role, whole_system
from cosim.coupling.system import System
from cosim.errors import CosimError, UnknownName
from cosim.fmi.archive import naming_places
from cosim.fmi.run.description import Interface
from cosim.fmi.run.typed_values import typed_value
from cosim.fmi.units import Measured


def read_ssp(path: str | os.PathLike[str], *, variant: str | None = None) -> System:
    """Read a coupled system from an SSP file of version 1.0 or 2.0.

    Its FMUs, also those of systems and SSP files within it, their connections with linear
    transformations and signal dictionaries, parameter values with mappings, connectors of the whole
    system, and the default experiment are read. A part of a system within is called `system_part`.

    Args:
        path: The file.
        variant: System description to read: the name of its file or its own name; the default one,
            SystemStructure.ssd, when None.

    Raises:
        FmuError, SecurityError: It is no SSP file, or unpacking it is not safe.
        UnknownName: A connection or a value refers to what does not exist.
        UsageError: Connections or names contradict each other, or it holds what cannot be
            simulated here, such as parts that are no FMUs.
        CosimError: See `couple`.

    Example:
        >>> import cosim
        >>> path = cosim.couple({"shaft": "crank_shaft"}, {}).write_ssp("shaft.ssp")
        >>> list(read_ssp(path).parts)
        ['shaft']
    """
    with ExitStack() as held:
        package = Package.outermost(Path(path), held)
        with naming_places(package.places):
            system = _System(package.variant(variant)).system()
        system.holds(held.pop_all(), *map(Path, package.places))
    return system


class _System:
    """The system of a description, with its parts by place."""

    def __init__(self, document: Document) -> None:
        self._document = document
        self._whole = whole_system(document)
        fmus = {e.place: e for e in self._whole.walk() if e.fmu is not None}
        self._names = _part_names(fmus)
        self._parts = {place: self._part(element) for place, element in fmus.items()}
        declared = {p: _declared(e, self._parts[p]) for p, e in fmus.items()}
        self._connections = Connections(self._whole, declared)
        self._values = self._assigned()

    def system(self) -> System:
        """Return the system."""
        wires, values = list[Connection](), dict[tuple[str, str], float]()
        exposed = dict[str, list[Way]]()
        for sink in self._sinks():
            way = self._connections.way(sink)
            if way.steps and way.source.place in self._parts:
                wires.append(self._wire(way))
                continue
            if way.steps and way.source == Node((), way.source.name):
                exposed.setdefault(way.source.name, []).append(way)
            values |= self._start_value(way)
        root = self._whole.bound[0][1]
        return system_of(
            {part.name: part for part in self._parts.values()},
            wires,
            values,
            connectors={
                name: self._connector(name, declared, exposed.get(name, []))
                for name, declared in self._whole.connectors.items()
            },
            unused={
                self._names[element.place]: (Ability.CO_SIMULATION,)
                for element in self._whole.walk()
                if element.interface == Interface.MODEL_EXCHANGE
            },
            name=identifier(root.get("name") or Path(self._document.package.name).stem),
            title=root.get("description", ""),
            places=self._document.package.places,
            **self._times(),
        )

    def _times(self) -> dict[str, float]:
        experiment = self._document.root.find("DefaultExperiment")
        times = {} if experiment is None else experiment.attrib
        found = {
            name: real(self._document, attribute, times[attribute])
            for name, attribute in (("start_time", "startTime"), ("stop_time", "stopTime"))
            if attribute in times
        }
        start = found.setdefault("start_time", 0.0)
        if "stop_time" in found and not found["stop_time"] > start:
            raise self._document.fault(
                f"stopTime = {found['stop_time']:g} is not after startTime = {start:g}"
            )
        return found

    def _part(self, element: Element) -> Part:
        assert element.fmu is not None
        document, entry = element.fmu
        name = self._names[element.place]
        part = part_of(name, document.package.entries[entry], Path())
        origin = ".".join(element.place)
        return part if origin == name else replace(part, origin=origin)

    def _sinks(self) -> list[Node]:
        """Return the variables of parts that are driven or have a value."""
        nodes = dict.fromkeys([*self._connections.driven, *self._values])
        return [node for node in nodes if node.place in self._parts and not node.dictionary]

    def _key(self, node: Node) -> tuple[str, str]:
        """Return part and variable of a connector."""
        return self._parts[node.place].name, node.name

    def _variable(self, node: Node) -> Variable:
        return self._parts[node.place].variable(node.name)

    def _wire(self, way: Way) -> Connection:
        """Return the connection that drives an input from another part."""
        source, sink, document = way.source, way.sink, way.steps[-1][1].document
        if not self._variable(sink).is_input:
            raise document.fault(f"{sink} is no input, so {source} cannot drive it")
        if not self._variable(source).is_source:
            raise document.fault(f"{source} is no output, so it cannot drive {sink}")
        unit = self._connections.unit(source)
        change = self._connections.change(way.steps, unit)
        ends = str(sink), self._variable(sink), str(source), self._variable(source)
        with document.naming():
            reject_types(*ends, changed=change != (1.0, 0.0))
        return Connection(self._key(sink), self._key(source), *change)

    def _start_value(self, way: Way) -> dict[tuple[str, str], float]:
        """Return the value that a variable of a part gets: that of the first connector with one."""
        for number, node in enumerate(way.nodes):
            if node in self._values:
                document, _ = self._values[node]
                if not self._variable(way.sink).is_start:
                    raise document.fault(f"{way.sink} cannot be given; it is calculated")
                variable, value = self._variable(way.sink), self._value(node, way.steps[number:])
                if isinstance(value, str) and variable.type not in ("String", "Enumeration"):
                    what = f"{way.sink} = {value!r} is no number"
                    raise document.fault(f"{what}; only numbers can be set here")
                with document.naming():
                    return {self._key(way.sink): typed_value(way.sink.place[-1], variable, value)}
        return {}

    def _value(self, node: Node, steps: Steps) -> float | str:
        """Return the value that the last connector of some steps gets from one with a value."""
        document, value = self._values[node]
        unit = self._connections.unit(node)
        if node.place in self._parts:
            own = self._variable(node).measured
            unit = unit if own.name is None else own
        with document.naming():
            number = value.in_unit(str(node), unit)
        if unit.name is None:
            unit = value.unit.difference() if unit.is_difference else value.unit
        factor, offset = self._connections.change(steps, unit)
        return number if isinstance(number, str) else transformed(number, factor, offset)

    def _connector(self, name: str, declared: Declared, exposed: Sequence[Way]) -> Connector:
        """Return a connector of the whole system: what drives it, or what it drives."""
        way = self._connections.way(Node((), name))
        shown = [way] if way.steps and way.source.place in self._parts else []
        ends = tuple(
            End(
                self._key(one.source if shown else one.sink),
                *self._connections.change(one.steps, self._connections.unit(one.source)),
            )
            for one in shown or exposed
        )
        nodes = [node for one in (way, *exposed[:1]) for node in one.nodes]
        units = map(self._connections.unit, reversed(nodes) if shown else nodes)
        unit = next((one for one in (declared.unit, *units) if one.name), declared.unit)
        defined = {unit.name: unit.definition} if unit.name and unit.definition else {}
        is_input = declared.role is not Role.OUT and not way.steps
        text = any(self._variable(one.source).type == "String" for one in shown)
        return Connector(name, unit.name, is_input, ends, defined, text)

    def _assigned(self) -> dict[Node, tuple[Document, Value]]:
        """Return values by connector; those of a system replace those of its elements."""
        found, unmatched = dict[Node, tuple[Document, Value]](), dict[Any, CosimError | None]()
        for element in self._whole.walk():
            for document, xml in element.bound:
                for place, name, value in bound_values(document, xml, unmatched):
                    nodes = list(self._named(element, name))
                    if not nodes:
                        raise self._unknown(element, place, name)
                    found.update(dict.fromkeys(nodes, (place, value)))
        for error in filter(None, unmatched.values()):
            raise error
        return found

    def _named(self, element: Element, name: str) -> Iterator[Node]:
        """Yield every connector and variable that a hierarchical name means."""
        part = self._parts.get(element.place)
        if part is not None and name in part.variables:
            yield Node(element.place, part.variables[name].name)
        elif part is None and name in element.connectors:
            yield Node(element.place, name)
        for inner, child in element.elements.items():
            if name.startswith(f"{inner}."):
                yield from self._named(child, name[len(inner) + 1 :])

    def _unknown(self, element: Element, document: Document, name: str) -> CosimError:
        part = self._parts.get(element.place)
        if part is None:
            return document.fault(f"no part has the parameter {name}; name its part")
        near = UnknownName.among(f"part '{part.name}'", "variable", name, part.variables)
        return document.fault(str(near), UnknownName)


def _declared(element: Element, part: Part) -> dict[str, Declared]:
    """Return the variables of an FMU as connectors."""
    found = dict[str, Declared]()
    for name, variable in part.variables.items():
        written = element.connectors.get(name, Declared(Role.IN, Measured(), name))
        role = Role.IN if variable.is_input else Role.OUT if variable.is_source else written.role
        unit = written.unit if variable.unit is None else variable.measured
        found[name] = Declared(role, unit, variable.name)
    return found


def _part_names(places: Mapping[Place, Element]) -> dict[Place, str]:
    """Return identifiers of parts; one that several places would have gets a number."""
    wishes = {place: identifier("_".join(place), "part_") for place in places}
    exact = (place for place, wish in wishes.items() if "_".join(place) == wish)
    found, used = dict[Place, str](), set[str]()
    for place in sorted(exact, key=len):  # a name of one element is its own
        if wishes[place] not in used:
            found[place] = wishes[place]
            used.add(wishes[place])
    for place, wish in wishes.items():
        if place in found:
            continue
        name, number = wish, 2
        while name in used:
            name, number = f"{wish}_{number}", number + 1
        found[place] = name
        used.add(name)
    return {place: found[place] for place in places}


def identifier(text: str, prefix: str = "system_") -> str:
    """Return a text as an identifier: other characters become _; `prefix` helps if needed."""
    name = re.sub(r"\W", "_", text, flags=re.ASCII)
    return name if is_name(name) else f"{prefix}{name}"
