"""How FMI 2.0 writes a model description."""

from xml.etree import ElementTree as ET

from cosim.fmi.aliases import TOOL
from cosim.fmi.export.description.model_description import BOOLEAN, REAL, Dialect, Identity
from cosim.fmi.export.description.structure import Structure


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
    exchange = {"completedIntegratorStepNotNeeded": "true"}
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


def _alias(name: str, meaning: str) -> ET.Element:
    """Return an annotation: a second variable of the same reference would be an output twice."""
    annotations = ET.Element("Annotations")
    tool = ET.SubElement(annotations, "Tool", name=TOOL)
    ET.SubElement(tool, "Alias", name=name, description=meaning)
    return annotations


def _structure(structure: Structure) -> ET.Element:
    """Return the unknowns by index, which is the value reference plus one."""
    element = ET.Element("ModelStructure")
    sections = {
        "Outputs": structure.outputs,
        "Derivatives": structure.derivatives,
        "InitialUnknowns": structure.initial_unknowns,
    }
    for tag, unknowns in sections.items():
        if unknowns:
            section = ET.SubElement(element, tag)
            for unknown in unknowns:
                needs = " ".join(str(reference + 1) for reference in unknown.dependencies)
                index = str(unknown.reference + 1)
                ET.SubElement(section, "Unknown", index=index, dependencies=needs)
    return element


FMI2 = Dialect(
    _root,
    _interfaces,
    _quantity,
    _variable,
    _alias,
    _structure,
    fixed_are_knowns=False,
    numbers_types_apart=True,
)
