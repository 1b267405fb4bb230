"""How FMI 2.0 writes a model description."""

from xml.etree import ElementTree as ET

from cosim.fmi.export.description.model_description import BOOLEAN, REAL, Dialect, Identity
from cosim.fmi.export.description.structure import StructureTags


def _root(identity: Identity) -> dict[str, str]:
    return {
        "fmiVersion": "2.0",
        "guid": identity.guid,
        "numberOfEventIndicators": str(identity.indicators),
    }


def _interfaces(identity: Identity) -> list[ET.Element]:
    common = {
        "modelIdentifier": identity.identifier,
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "providesDirectionalDerivative": "true",
        "canNotUseMemoryManagementFunctions": "true",
    }
    exchange = {"completedIntegratorStepNotNeeded": str(not identity.watches_steps).lower()}
    stepping = {
        "canHandleVariableCommunicationStepSize": "true",
        "canInterpolateInputs": "true",
        "maxOutputDerivativeOrder": "1",
    }
    elements = [
        ET.Element("ModelExchange", common | exchange),
        ET.Element("CoSimulation", common | stepping),
    ]
    for element in elements:
        files = ET.SubElement(element, "SourceFiles")
        for name in identity.sources:
            ET.SubElement(files, "File", name=name)
    return elements


def _quantity(general: dict[str, str], facts: dict[str, str]) -> ET.Element:
    element = ET.Element("SimpleType", general)
    ET.SubElement(element, "Real", facts)
    return element


def _variable(kind: str, general: dict[str, str], facts: dict[str, str]) -> ET.Element:
    element = ET.Element("ScalarVariable", general)
    if "derivative" in facts:  # an index, the value reference plus one
        facts = facts | {"derivative": str(int(facts["derivative"]) + 1)}
    ET.SubElement(element, {REAL: "Real", BOOLEAN: "Boolean"}[kind], facts)
    return element


FMI2 = Dialect(
    _root,
    _interfaces,
    _quantity,
    _variable,
    ("Tool", "name"),
    StructureTags(("Outputs", "Derivatives", "InitialUnknowns"), "Unknown", "index", first=1),
    fixed_are_knowns=False,
    numbers_types_apart=True,
)
