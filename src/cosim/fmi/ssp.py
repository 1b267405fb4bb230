"""Writing of SSP 1.0 files: system description, parameter sets (.ssv) and FMUs."""

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from casadi_models.units import Unit, parse_unit
from cosim.errors import FmuError, ParameterError, UnknownName, UsageError
from cosim.files import write_atomically
from cosim.fmi.archive import DESCRIPTION, SYSTEM_DESCRIPTION, flat_names, unpacked
from cosim.fmi.export.package import zipped
from cosim.fmi.run.arrays import with_elements
from cosim.fmi.run.description import unit_of
from cosim.fmi.run.typed_values import RANGES, REALS, start_value, typed_value
from cosim.fmi.units import definitions
from cosim.model.values import number
from cosim.text import counted
from cosim.trajectory import shortest

SSC = "http://ssp-standard.org/SSP1/SystemStructureCommon"
SSV = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"
SSD = "http://ssp-standard.org/SSP1/SystemStructureDescription"
TYPE = "application/x-ssp-parameter-set"
_File = str | os.PathLike[str]


def parameter_set(
    name: str, values: Mapping[str, float], known: Mapping[str, Any], defined: Mapping[str, Unit]
) -> ET.Element:
    """Return a parameter set.

    Args:
        values: Values by variable, in the variables' units.
        known: fmpy's variables by name.
        defined: Definitions of units by name.
    """
    root = ET.Element(f"{{{SSV}}}ParameterSet", version="1.0", name=name)
    parameters = ET.SubElement(root, f"{{{SSV}}}Parameters")
    used = {v: unit for v in values if (unit := unit_of(known[v])) is not None}
    for variable, value in values.items():
        entry = ET.SubElement(parameters, f"{{{SSV}}}Parameter", name=variable)
        measured = {"unit": used[variable]} if variable in used else {}
        kind, text = _kind(known[variable]), str(value)
        if kind == "Real":
            text = shortest(value)
        elif kind == "Boolean":
            text = str(bool(value)).lower()
        elif kind == "Enumeration":
            items = known[variable].declaredType.items
            text = next(item.name for item in items if int(item.value) == value)
        ET.SubElement(entry, f"{{{SSV}}}{kind}", {"value": text} | measured)
    if used:
        root.extend(unit_list(f"{{{SSV}}}Units", used.values(), defined))
    return root


def _kind(variable: Any) -> str:
    """Return the type of a variable of fmpy's as SSP 1.0 calls it."""
    if variable.type in RANGES:
        return "Integer"
    return "Real" if variable.type in REALS else str(variable.type)


def unit_list(tag: str, names: Iterable[str], defined: Mapping[str, Unit]) -> list[ET.Element]:
    """Return the element with the definitions of units, without repetition; [] if it is empty.

    A name without a definition has its usual meaning.
    """
    element = ET.Element(tag)
    for name in sorted(set(names)):
        unit = defined.get(name) or parse_unit(name)
        if unit is None:
            continue
        base = {symbol: str(exponent) for symbol, exponent in unit.base}
        factor = {} if unit.factor == 1 else {"factor": shortest(unit.factor)}
        factor |= {"offset": shortest(unit.offset)} if unit.offset else {}
        entry = ET.SubElement(element, f"{{{SSC}}}Unit", name=name)
        ET.SubElement(entry, f"{{{SSC}}}BaseUnit", base | factor)
    return [element] if len(element) else []


def to_file(root: ET.Element) -> bytes:
    """Return the content of a file of the SSP standard."""
    for prefix, uri in (("ssd", SSD), ("ssc", SSC), ("ssv", SSV)):
        ET.register_namespace(prefix, uri)
    ET.indent(root)
    content: bytes = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    return content


def write_ssp(
    target: str | os.PathLike[str],
    components: Mapping[str, _File | tuple[_File, str]],
    connections: Sequence[tuple[str, str]],
    *,
    values: Mapping[str, float] | None = None,
    start_time: float = 0.0,
    stop_time: float | None = None,
    name: str | None = None,
    parameter_files: bool = False,
    open_inputs: Sequence[str] = (),
    transformations: Mapping[str, tuple[float, float]] | None = None,
) -> Path:
    """Write an SSP file whose connectors and values have units.

    Args:
        target: The file, replaced when everything has succeeded.
        components: By name the path of the FMU, or (path, "ModelExchange" or "CoSimulation").
        connections: ("FROM.OUTPUT", "TO.INPUT") pairs.
        values: Start values and parameters by "COMPONENT.VARIABLE", in the FMUs' units.
        start_time, stop_time: Of the default experiment, s.
        name: Of the system; that of the file when None.
        parameter_files: Whether the values are written to separate files, `resources/NAME.ssv`,
            which can be exchanged; otherwise the system description contains them.
        open_inputs: Inputs that keep their start values, which are written as values.
        transformations: Factor and offset by "TO.INPUT" of a connection, which replace the
            conversion of units: input = factor output + offset.

    Returns:
        Path of the file.

    Raises:
        UnknownName: A component or a variable does not exist.
        UsageError: A connection does not lead from an output to an input, or an input has several;
            or a transformed one has none.
        ParameterError: A time is not finite, the stop time is not after the start time, or a
            variable does not have a value.
        FmuError, ExportError: A file cannot be read or written.

    Example:
        >>> import cosim
        >>> path = cosim.export_fmu(cosim.load("crank_shaft"), "crank.fmu")
        >>> write_ssp("shaft.ssp", {"crank": path}, [], values={"crank.omega": 10.0}).name
        'shaft.ssp'
    """
    start_time = number("write_ssp", "start_time", start_time)
    if stop_time is not None:
        stop_time = number("write_ssp", "stop_time", stop_time, positive=start_time == 0)
        if not stop_time > start_time:
            raise ParameterError(
                f"write_ssp: stop_time = {stop_time:g} s is not after start_time = {start_time:g} s"
            )
    pairs = {n: one if isinstance(one, tuple) else (one, "any") for n, one in components.items()}
    described = {name: _described(path) for name, (path, _) in pairs.items()}
    defined = _defined_units(description for description, _ in described.values())
    ends = [_ends(described, pair) for pair in connections]
    given = dict[tuple[str, str], Any]()
    for key, value in (values or {}).items():
        component, entry = _side(described, key, None)
        variable = described[component][1][entry]
        given[component, entry] = typed_value("write_ssp", variable, value)
    for key in open_inputs:
        component, entry = _side(described, key, "input")
        given.setdefault((component, entry), start_value(described[component][1][entry]))
    changes = _changes(described, [sink for _, sink in ends], transformations or {})
    name, files = name or Path(target).stem, dict[str, bytes]()
    places = _file_names(described)
    root = ET.Element(f"{{{SSD}}}SystemStructureDescription", version="1.0", name=name)
    system = ET.SubElement(root, f"{{{SSD}}}System", name=name)
    elements = ET.SubElement(system, f"{{{SSD}}}Elements")
    for component, (description, variables) in described.items():
        own = {entry: value for (owner, entry), value in given.items() if owner == component}
        units = {v.name: unit_of(v) for v in description.modelVariables}
        element = _component(component, places[component], description, units, pairs[component][1])
        if own:
            chosen = parameter_set("initialValues", own, variables, defined)
            file = f"resources/{places[component]}.ssv" if parameter_files else ""
            if file:
                files[file] = to_file(chosen)
            element.append(_binding(chosen, file))
        elements.append(element)
    if ends:
        joints = ET.SubElement(system, f"{{{SSD}}}Connections")
        joints.extend(_connection(source, sink, changes.get(sink)) for source, sink in ends)
    if used := {unit_of(v) or "" for d, _ in described.values() for v in d.modelVariables} - {""}:
        root.extend(unit_list(f"{{{SSD}}}Units", used, defined))
    if stop_time is not None or start_time:
        span = {"startTime": shortest(start_time)}
        span |= {} if stop_time is None else {"stopTime": shortest(stop_time)}
        ET.SubElement(root, f"{{{SSD}}}DefaultExperiment", span)
    fmus = {f"resources/{places[c]}.fmu": Path(one).read_bytes() for c, (one, _) in pairs.items()}
    return write_atomically(target, zipped({SYSTEM_DESCRIPTION: to_file(root), **files, **fmus}))


def _changes(
    described: Mapping[str, Any],
    sinks: Sequence[tuple[str, str]],
    transformations: Mapping[str, tuple[float, float]],
) -> dict[tuple[str, str], list[float]]:
    """Return the transformations of inputs, each of which has one connection."""
    changes = dict[tuple[str, str], list[float]]()
    for key, pair in transformations.items():
        if not isinstance(pair, tuple | list) or len(pair) != 2:
            raise UsageError.of_type("write_ssp: transformations", pair, "pairs (FACTOR, OFFSET)")
        changes[_side(described, key, "input")] = [number("write_ssp", key, one) for one in pair]
    for sink in (*changes, *sinks):
        if sinks.count(sink) != 1:
            count = counted(sinks.count(sink), "connection")
            raise UsageError(f"write_ssp: {'.'.join(sink)} has {count}; give it one")
    return changes


def _connection(
    source: tuple[str, str], sink: tuple[str, str], change: Sequence[float] | None
) -> ET.Element:
    """Return the connection of an output with an input, with factor and offset between them."""
    begins = {"startElement": source[0], "startConnector": source[1]}
    ends = {"endElement": sink[0], "endConnector": sink[1]}
    joint = ET.Element(f"{{{SSD}}}Connection", begins | ends)
    if change:
        factor, offset = map(shortest, change)
        joint.set("suppressUnitConversion", "true")
        linear = {"factor": factor, "offset": offset}
        ET.SubElement(joint, f"{{{SSC}}}LinearTransformation", linear)
    return joint


def _defined_units(files: Iterable[Any]) -> dict[str, Unit]:
    """Return the definitions of units of FMUs.

    Raises:
        UsageError: Two of them define a unit differently.
    """
    found = dict[str, Unit]()
    for file in files:
        for name, unit in definitions(file).items():
            if found.setdefault(name, unit) != unit:
                raise UsageError(
                    f"two FMUs define the unit '{name}' differently, and an SSP file has one "
                    "definition; rename one"
                )
    return found


def _described(path: str | os.PathLike[str]) -> tuple[Any, dict[str, Any]]:
    """Return fmpy's model description with elements, and variables by name and by flat name."""
    from fmpy import read_model_description

    with unpacked(path, to_run=True) as folder:
        try:
            description = with_elements(read_model_description(str(folder), validate=False))
            flat = flat_names(ET.parse(folder / DESCRIPTION).getroot())
        except Exception as error:
            raise FmuError(f"{path}: modelDescription.xml cannot be read: {error}") from error
    known = {variable.name: variable for variable in description.modelVariables}
    return description, {flat.get(name, name): found for name, found in known.items()} | known


def _binding(chosen: ET.Element, file: str) -> ET.Element:
    """Return what binds a parameter set, or the file that has it unless its name is empty."""
    bindings = ET.Element(f"{{{SSD}}}ParameterBindings")
    binding = ET.SubElement(bindings, f"{{{SSD}}}ParameterBinding")
    if file:
        binding.attrib.update(type=TYPE, source=file)
    else:
        ET.SubElement(binding, f"{{{SSD}}}ParameterValues").append(chosen)
    return bindings


def _file_names(components: Iterable[str]) -> dict[str, str]:
    """Return names of files by component: plain, and apart on every system, as A and a."""
    found, taken = dict[str, str](), set[str]()
    for component in components:
        name = re.sub(r"[^\w.-]", "_", component, flags=re.ASCII)
        while name.lower() in taken:
            name += "_"
        taken.add(name.lower())
        found[component] = name
    return found


def _component(
    name: str, file: str, description: Any, units: Mapping[str, str | None], interface: str
) -> ET.Element:
    facts = {"type": "application/x-fmu-sharedlibrary", "source": f"resources/{file}.fmu"}
    if interface != "any":
        facts["implementation"] = interface
    component = ET.Element(f"{{{SSD}}}Component", {"name": name, **facts})
    connectors = ET.Element(f"{{{SSD}}}Connectors")
    for variable in description.modelVariables:
        whole = variable.dimensions  # which SSP 1.0 has not, its elements are variables
        if variable.causality in ("input", "output", "parameter") and not whole:
            facts = {"name": variable.name, "kind": variable.causality}
            connector = ET.SubElement(connectors, f"{{{SSD}}}Connector", facts)
            unit, kind = units[variable.name], _kind(variable)
            if kind != "Enumeration":  # whose type the FMU describes
                ET.SubElement(connector, f"{{{SSC}}}{kind}", {"unit": unit} if unit else {})
    component.extend([connectors] if len(connectors) else [])  # the schema has no empty list
    return component


def _ends(described: Mapping[str, Any], pair: Any) -> tuple[tuple[str, str], tuple[str, str]]:
    if not isinstance(pair, list | tuple) or [*map(type, pair)] != [str, str]:
        raise UsageError.of_type("write_ssp: connections", pair, "pairs of texts, (OUTPUT, INPUT)")
    source, sink = pair
    return _side(described, source, "output"), _side(described, sink, "input")


def _side(described: Mapping[str, Any], text: str, causality: str | None) -> tuple[str, str]:
    component, dot, name = text.partition(".")
    if not dot or component not in described:
        raise UnknownName.among("the SSP", "component", component, described)
    _, variables = described[component]
    UnknownName.reject(component, "variable", variables, name)
    if causality is not None and variables[name].causality != causality:
        raise UsageError(f"{text} is not an {causality}; connect an output to an input")
    return component, variables[name].name
