"""System Structure and Parameterization: FMUs and their connections in one file (SSP 1.0)."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from cosim.errors import FmuError, UnknownName, UsageError
from cosim.files import write_atomically
from cosim.fmi.archive import unpacked
from cosim.fmi.export.package import zipped
from cosim.trajectory import repr_17

_SSD = "http://ssp-standard.org/SSP1/SystemStructureDescription"
_SSC = "http://ssp-standard.org/SSP1/SystemStructureCommon"
_SSV = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"


def write_ssp(
    target: str | os.PathLike[str],
    components: Mapping[str, str | os.PathLike[str]],
    connections: Sequence[tuple[str, str]],
    *,
    values: Mapping[str, float] | None = None,
    stop_time: float | None = None,
) -> Path:
    """Write an SSP file.

    Args:
        target: The file, replaced when everything has succeeded.
        components: FMU by the component's name.
        connections: ("FROM.OUTPUT", "TO.INPUT") pairs.
        values: Start values and parameters by "COMPONENT.VARIABLE", in the FMUs' units.
        stop_time: Of the default experiment, s.

    Returns:
        Path of the file.

    Raises:
        UnknownName: A component or a variable does not exist.
        UsageError: A connection does not lead from an output to an input.
        FmuError, ExportError: A file cannot be read or written.
    """
    described = {name: _described(path) for name, path in components.items()}
    ends = [(_side(described, a, "output"), _side(described, b, "input")) for a, b in connections]
    for prefix, uri in (("ssd", _SSD), ("ssc", _SSC), ("ssv", _SSV)):
        ET.register_namespace(prefix, uri)
    name = Path(target).stem
    root = ET.Element(f"{{{_SSD}}}SystemStructureDescription", version="1.0", name=name)
    system = ET.SubElement(root, f"{{{_SSD}}}System", name=name)
    elements = ET.SubElement(system, f"{{{_SSD}}}Elements")
    for component, description in described.items():
        own = {k: v for k, v in (values or {}).items() if k.partition(".")[0] == component}
        elements.append(_component(component, description, own))
    for key in values or {}:
        _side(described, key, None)
    joints = ET.SubElement(system, f"{{{_SSD}}}Connections")
    for (source, output), (sink, entry) in ends:
        ET.SubElement(
            joints,
            f"{{{_SSD}}}Connection",
            startElement=source,
            startConnector=output,
            endElement=sink,
            endConnector=entry,
        )
    if stop_time is not None:
        span = {"startTime": "0.0", "stopTime": repr_17(stop_time)}
        ET.SubElement(root, f"{{{_SSD}}}DefaultExperiment", span)
    ET.indent(root)
    structure: bytes = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    fmus = {f"resources/{c}.fmu": Path(path).read_bytes() for c, path in components.items()}
    return write_atomically(target, zipped({"SystemStructure.ssd": structure, **fmus}))


def _described(path: str | os.PathLike[str]) -> Any:
    from fmpy import read_model_description

    with unpacked(path) as folder:
        try:
            return read_model_description(str(folder), validate=False)
        except Exception as error:
            raise FmuError(f"{path}: modelDescription.xml cannot be read: {error}") from error


def _component(name: str, description: Any, values: Mapping[str, float]) -> ET.Element:
    component = ET.Element(
        f"{{{_SSD}}}Component",
        name=name,
        type="application/x-fmu-sharedlibrary",
        source=f"resources/{name}.fmu",
    )
    connectors = ET.SubElement(component, f"{{{_SSD}}}Connectors")
    for variable in description.modelVariables:
        if variable.causality in ("input", "output", "parameter"):
            connector = ET.SubElement(
                connectors, f"{{{_SSD}}}Connector", name=variable.name, kind=variable.causality
            )
            ET.SubElement(connector, f"{{{_SSC}}}Real")
    if values:
        bindings = ET.SubElement(component, f"{{{_SSD}}}ParameterBindings")
        binding = ET.SubElement(bindings, f"{{{_SSD}}}ParameterBinding")
        inline = ET.SubElement(binding, f"{{{_SSD}}}ParameterValues")
        own = {"version": "1.0", "name": "initialValues"}
        chosen = ET.SubElement(inline, f"{{{_SSV}}}ParameterSet", own)
        parameters = ET.SubElement(chosen, f"{{{_SSV}}}Parameters")
        for key, value in values.items():
            entry = ET.SubElement(parameters, f"{{{_SSV}}}Parameter", name=key.partition(".")[2])
            ET.SubElement(entry, f"{{{_SSV}}}Real", value=repr_17(value))
    return component


def _side(described: Mapping[str, Any], text: str, causality: str | None) -> tuple[str, str]:
    component, dot, name = text.partition(".")
    if not dot or component not in described:
        raise UnknownName.among("the SSP", "component", component, described)
    variables = {v.name: v for v in described[component].modelVariables}
    if name not in variables:
        raise UnknownName.among(component, "variable", name, variables)
    if causality is not None and variables[name].causality != causality:
        raise UsageError(f"{text} is no {causality}; connect an output to an input")
    return component, name
