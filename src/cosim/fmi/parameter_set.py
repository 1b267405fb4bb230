"""Parameter sets as files of the SSP standard (`.ssv`, SSP 1.0), with their units."""

from collections.abc import Iterable, Mapping
from xml.etree import ElementTree as ET

from casadi_models.units import UNITS
from cosim.trajectory import repr_17

SSC = "http://ssp-standard.org/SSP1/SystemStructureCommon"
SSV = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"
SSD = "http://ssp-standard.org/SSP1/SystemStructureDescription"
TYPE = "application/x-ssp-parameter-set"


def parameter_set(
    name: str, values: Mapping[str, float], units: Mapping[str, str | None], about: str = ""
) -> ET.Element:
    """Return a parameter set.

    Args:
        name: Of the set.
        values: By variable, in the variables' units.
        units: Of the variables, as far as they have one.
        about: One line on the whole; left out when empty.
    """
    facts = {"version": "1.0", "name": name} | ({"description": about} if about else {})
    root = ET.Element(f"{{{SSV}}}ParameterSet", facts)
    parameters = ET.SubElement(root, f"{{{SSV}}}Parameters")
    used = {v: unit for v in values if (unit := units.get(v)) is not None}
    for variable, value in values.items():
        entry = ET.SubElement(parameters, f"{{{SSV}}}Parameter", name=variable)
        measured = {"unit": used[variable]} if variable in used else {}
        ET.SubElement(entry, f"{{{SSV}}}Real", {"value": repr_17(value)} | measured)
    if used:
        root.append(unit_list(f"{{{SSV}}}Units", used.values()))
    return root


def unit_list(tag: str, names: Iterable[str]) -> ET.Element:
    """Return the definitions of units, each once."""
    element = ET.Element(tag)
    for name in sorted(set(names)):
        unit = UNITS[name]
        base = {symbol: str(exponent) for symbol, exponent in unit.base}
        factor = {} if unit.factor == 1 else {"factor": repr_17(unit.factor)}
        entry = ET.SubElement(element, f"{{{SSC}}}Unit", name=name)
        ET.SubElement(entry, f"{{{SSC}}}BaseUnit", base | factor)
    return element


def to_file(root: ET.Element) -> bytes:
    """Return the content of a file of the SSP standard."""
    for prefix, uri in (("ssd", SSD), ("ssc", SSC), ("ssv", SSV)):
        ET.register_namespace(prefix, uri)
    ET.indent(root)
    content: bytes = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    return content
