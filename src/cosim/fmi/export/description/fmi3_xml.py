"""How FMI 3.0 writes a model description."""

from xml.etree import ElementTree as ET

from cosim.fmi.export.description.model_description import Dialect, Identity, Structure


def _root(identity: Identity) -> dict[str, str]:
    return {"fmiVersion": "3.0", "instantiationToken": identity.guid}


def _interfaces(identity: Identity) -> list[ET.Element]:
    common = {
        "modelIdentifier": identity.identifier,
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
        "providesDirectionalDerivatives": "true",
    }
    if identity.adjoint:
        common["providesAdjointDerivatives"] = "true"
    exchange = {"needsCompletedIntegratorStep": "false"}
    stepping = {"canHandleVariableCommunicationStepSize": "true", "maxOutputDerivativeOrder": "1"}
    return [
        ET.Element("ModelExchange", common | exchange),
        ET.Element("CoSimulation", common | stepping),
    ]


def _quantity(general: dict[str, str], facts: dict[str, str]) -> ET.Element:
    return ET.Element("Float64Type", general | facts)


def _variable(general: dict[str, str], facts: dict[str, str]) -> ET.Element:
    return ET.Element("Float64", general | facts)


def _structure(structure: Structure) -> ET.Element:
    element = ET.Element("ModelStructure")
    sections = {
        "Output": structure.outputs,
        "ContinuousStateDerivative": structure.derivatives,
        "InitialUnknown": structure.initial_unknowns,
    }
    for tag, unknowns in sections.items():
        for unknown in unknowns:
            needs = " ".join(map(str, unknown.dependencies))
            reference = str(unknown.reference)
            ET.SubElement(element, tag, valueReference=reference, dependencies=needs)
    return element


# The table of `dependencies` (2.4.8) counts all parameters as knowns.
FMI3 = Dialect(_root, _interfaces, _quantity, _variable, _structure, fixed_are_knowns=True)
