"""Coupled systems as files: TOML, and SSP 1.0 and 2.0 packages."""

import os
import re
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from casadi_models.dae.variables import is_name
from cosim.coupling.system import System, couple
from cosim.errors import FmuError, UsageError
from cosim.fmi.archive import SYSTEM_DESCRIPTION, reject_dangerous_xml, unpacked
from cosim.toml_file import read_toml, typed
from cosim.trajectory import Trajectory

_TABLES = ("parts", "connections", "start_values", "abilities")
_KEYS = ("title", "stop_time", "output_interval", *_TABLES)
_FMU_TYPES = (None, "application/x-fmu-sharedlibrary")


def is_system(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is a coupled system: an .ssp file, or a TOML file with [parts]."""
    file = Path(path)
    if file.suffix == ".ssp":
        return True
    if file.suffix != ".toml" or not file.is_file():
        return False
    return re.search(r"^\s*\[parts\]", file.read_text(errors="replace"), re.MULTILINE) is not None


def read_system(path: str | os.PathLike[str]) -> System:
    """Read a coupled system from a TOML or an SSP file.

    Raises:
        CosimError: See `couple` and `read_ssp`; a message names the line of a TOML file.
    """
    return read_ssp(path) if Path(path).suffix == ".ssp" else _read_toml(Path(path))


def simulate_file(path: str | os.PathLike[str], **options: Any) -> Trajectory:
    """Read a system and simulate it; see `System.simulate`."""
    return read_system(path).simulate(**options)


def coupling_report(run: Trajectory) -> str:
    """Return one line about a co-simulation: its error where that was estimated, and its steps."""
    stats = run.stats
    steps = f"{stats['macro_steps']} macro steps, {stats['rejected_steps']} rejected"
    if "error_estimate" not in stats:
        return f"{run.model}: {steps}; the error of the coupling is not estimated (--accuracy does)"
    return (
        f"{run.model}: error of the coupling at most about {stats['error_estimate']:.1e} "
        f"({stats['error_estimate_of']}); {steps}"
    )


def _read_toml(path: Path) -> System:
    file = read_toml(path)
    file.reject_unknown((), file.data, _KEYS)
    parts, connections, values, abilities = (
        dict(typed(file.data.get(key, {}), dict, f"[{key}]", file.at(key))) for key in _TABLES
    )
    for key in ("parts", "connections"):
        for name, value in (parts if key == "parts" else connections).items():
            typed(value, str, "a text", file.at(key, name))
    times = {
        key: float(typed(file.data[key], int | float, "a number", file.at(key)))  # type: ignore[arg-type] # isinstance takes a union
        for key in ("stop_time", "output_interval")
        if key in file.data
    }
    title = typed(file.data.get("title", ""), str, "a text", file.at("title"))
    with file.naming("parts"):
        return couple(
            parts,
            connections,
            start_values=values,
            abilities=abilities,
            name=_identifier(path.stem),
            title=title,
            folder=path.parent,
            **times,
        )


def _identifier(text: str) -> str:
    name = re.sub(r"\W", "_", text, flags=re.ASCII)
    return name if is_name(name) else f"system_{name}"


def read_ssp(path: str | os.PathLike[str]) -> System:
    """Read a coupled system from an SSP file of version 1.0 or 2.0.

    Its FMUs, also those of systems within it, their connections with linear transformations, start
    values within the description or in .ssv files, and the default experiment are read. A part of a
    system within is called `system_part`.

    Args:
        path: The file.

    Raises:
        FmuError, SecurityError: It is no SSP file, or unpacking it is not safe.
        UsageError: It holds what cannot be simulated here: parts that are no FMUs, or parameters
            that a mapping renames.
        CosimError: See `couple`.

    Example:
        >>> import cosim
        >>> path = cosim.couple({"shaft": "crank_shaft"}, {}).write_ssp("shaft.ssp")
        >>> list(read_ssp(path).parts)
        ['shaft']
    """
    with ExitStack() as held:
        folder = held.enter_context(unpacked(path, description=SYSTEM_DESCRIPTION))
        system = _Description(Path(path), folder).system()
        system.holds(held.pop_all(), folder.resolve())
    return system


_Place = tuple[str, ...]  # names of the systems within which an element is, and its own
_Connector = tuple[_Place, str]


class _Description:
    """The system description of an unpacked SSP file."""

    def __init__(self, path: Path, folder: Path) -> None:
        self._path, self._folder = path, folder
        self._root = self._xml(SYSTEM_DESCRIPTION)
        found = self._root.find("{*}System")
        if found is None:
            raise FmuError(f"{path}: {SYSTEM_DESCRIPTION} describes no system")
        self._system = found

    def system(self) -> System:
        """Return the system.

        Raises:
            CosimError: See `read_ssp`.
        """
        parts = dict(self._parts(self._system, ()))
        experiment = self._root.find("{*}DefaultExperiment")
        times = {} if experiment is None else experiment.attrib
        stop, start = times.get("stopTime"), times.get("startTime", "0")
        if float(start):
            raise UsageError(f"{self._path} starts at {start} s; shift its times so that it is 0")
        names = {place: _identifier("_".join(place)) for place in parts}
        if len(set(names.values())) < len(names):
            raise UsageError(f"{self._path}: two parts have the same name; rename one")
        drives = dict(self._drives(self._system, ()))
        wires = dict[str, str]()
        changes = dict[str, tuple[float, float]]()
        for place, entry in drives:
            if place not in parts:
                continue
            source, factor, offset = drives[place, entry]
            while source in drives and source[0] not in parts:  # a connector of a system within
                source, inner, added = drives[source]
                factor, offset = factor * inner, factor * added + offset
            if source[0] in parts:  # else a connector of the whole system, which nothing drives
                sink = f"{names[place]}.{entry}"
                wires[sink] = f"{names[source[0]]}.{source[1]}"
                changes[sink] = factor, offset
        found = couple(
            {names[place]: self._inside(part.get("source", "")) for place, part in parts.items()},
            wires,
            start_values={
                f"{names[place]}.{variable}": value
                for place, variable, value in self._start_values(self._system, (), parts)
            },
            name=_identifier(self._system.get("name") or self._path.stem),
            title=self._system.get("description", ""),
            stop_time=None if stop is None else float(stop),
        )
        connections = []
        for wire in found.connections:  # which convert units; what the file declares comes on top
            factor, offset = changes[".".join(wire.input)]
            factor, offset = factor * wire.factor, factor * wire.offset + offset
            connections.append(wire._replace(factor=factor, offset=offset))
        return replace(found, connections=tuple(connections))

    def _parts(self, system: ET.Element, place: _Place) -> Iterator[tuple[_Place, ET.Element]]:
        """Yield the FMUs in a system and in the systems within it, by their places."""
        for element in system.iterfind("{*}Elements/*"):
            kind, inner = _local(element), (*place, element.get("name", ""))
            if kind == "System":
                yield from self._parts(element, inner)
            elif kind == "Component" and element.get("type") in _FMU_TYPES:
                yield inner, element
            else:
                raise UsageError(
                    f"{self._path}: '{inner[-1]}' ({kind}, {element.get('type') or 'no FMU'}) "
                    "cannot be simulated here; only FMUs can"
                )

    def _drives(
        self, system: ET.Element, place: _Place
    ) -> Iterator[tuple[_Connector, tuple[_Connector, float, float]]]:
        """Yield what drives a connector, with factor and offset."""
        driven = set[_Connector]()
        for connection in system.iterfind("{*}Connections/{*}Connection"):
            source, sink = (
                ((*place, *filter(None, [connection.get(f"{end}Element")])),
                 connection.get(f"{end}Connector", ""))
                for end in ("start", "end")
            )  # fmt: skip
            if sink in driven:
                raise UsageError(
                    f"{self._path}: {'.'.join((*sink[0], sink[1]))} is connected twice; connect it "
                    "once"
                )
            driven.add(sink)
            what = {_local(child) for child in connection if "Mapping" in child.tag}
            if connection.get("suppressUnitConversion") in ("true", "1"):
                what.add("suppressUnitConversion")
            if what:
                raise UsageError(
                    f"{self._path}: {min(what)} in the connection to {'.'.join(sink[0])}.{sink[1]} "
                    "cannot be read here; write a LinearTransformation"
                )
            linear = connection.find("{*}LinearTransformation")
            change = {} if linear is None else linear.attrib
            yield sink, (source, float(change.get("factor", 1)), float(change.get("offset", 0)))
        for inner in system.iterfind("{*}Elements/{*}System"):
            yield from self._drives(inner, (*place, inner.get("name", "")))

    def _inside(self, source: str) -> Path:
        file = (self._folder / source).resolve()
        if not file.is_relative_to(self._folder.resolve()) or not file.is_file():
            raise FmuError(f"{self._path}: it has no file {source}")
        return file

    def _start_values(
        self, system: ET.Element, place: _Place, parts: Mapping[_Place, ET.Element]
    ) -> Iterator[tuple[_Place, str, float | str]]:
        """Yield values of parts: those of the parts first, then those of the systems around."""
        for element in system.iterfind("{*}Elements/*"):
            inner = (*place, element.get("name", ""))
            if inner in parts:
                yield from ((inner, *pair) for pair in self._bound(element))
            else:
                yield from self._start_values(element, inner, parts)
        for name, value in self._bound(system):
            *owner, variable = name.split(".")
            for n in range(len(owner), 0, -1):  # names of variables may have dots, too
                if (*place, *owner[:n]) in parts:
                    yield (*place, *owner[:n]), ".".join((*owner[n:], variable)), value
                    break
            else:
                raise UsageError(f"{self._path}: no part has the parameter {name}; name its part")

    def _bound(self, element: ET.Element) -> Iterator[tuple[str, float | str]]:
        for binding in element.iterfind("{*}ParameterBindings/{*}ParameterBinding"):
            if binding.find("{*}ParameterMapping") is not None:
                raise UsageError(
                    f"{self._path}: the parameters of '{element.get('name')}' are renamed by a "
                    "mapping, which cannot be read here; write their own names"
                )
            source, own = binding.get("source"), binding.get("prefix", "")
            inside = binding.findall("{*}ParameterValues/*")
            for chosen in inside if source is None else [self._xml(source)]:
                for parameter in chosen.iterfind("{*}Parameters/{*}Parameter"):
                    for number in parameter:
                        yield own + parameter.get("name", ""), self._number(parameter, number)

    def _number(self, parameter: ET.Element, number: ET.Element) -> float | str:
        """Return a value in the variable's own unit; as a text if it has another one."""
        text, unit = number.get("value", ""), number.get("unit")
        value = {"true": 1.0, "false": 0.0}.get(text)
        try:
            value = float(text) if value is None else value
        except ValueError:
            value = float("nan")
        kind = _local(number)
        if not isfinite(value) or not kind.startswith(("Real", "Float", "Int", "UInt", "Boolean")):
            raise UsageError(
                f"{self._path}: {parameter.get('name')} = {text!r} ({kind}) is no number; only "
                "numbers can be set here"
            )
        return value if unit is None else f"{value!r} {unit}"

    def _xml(self, source: str) -> ET.Element:
        content = self._inside(source).read_bytes()
        reject_dangerous_xml(source, content)
        try:
            return ET.fromstring(content)
        except ET.ParseError as error:
            raise FmuError(f"{self._path}: {source} cannot be read: {error}") from error


def _local(element: ET.Element) -> str:
    return element.tag.rpartition("}")[2]
