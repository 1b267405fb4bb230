"""How FMI 3.0 writes a model description."""

from xml.etree import ElementTree as ET

from cosim.fmi.export.description.model_description import BOOLEAN, REAL, Dialect, Identity
from cosim.fmi.export.description.structure import StructureTags


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
    exchange = {"needsCompletedIntegratorStep": str(identity.watches_steps).lower()}
    stepping = {
        "canHandleVariableCommunicationStepSize": "true",
        "canReturnEarlyAfterIntermediateUpdate": "true",
        "maxOutputDerivativeOrder": "1",
        "providesIntermediateUpdate": "true",
    }
    return [
        ET.Element("ModelExchange", common | exchange),
        ET.Element("CoSimulation", common | stepping),
    ]


def _quantity(general: dict[str, str], facts: dict[str, str]) -> ET.Element:
    return ET.Element("Float64Type", general | facts)


def _variable(kind: str, general: dict[str, str], facts: dict[str, str]) -> ET.Element:
    return ET.Element({REAL: "Float64", BOOLEAN: "Boolean"}[kind], general | facts)


# The table of `dependencies` (2.4.8) counts all parameters as knowns.
FMI3 = Dialect(
    _root,
    _interfaces,
    _quantity,
    _variable,
    ("Annotation", "type"),
    StructureTags(
        ("Output", "ContinuousStateDerivative", "InitialUnknown", "EventIndicator"),
        unknown=None,
        reference="valueReference",
        first=0,
    ),
    fixed_are_knowns=True,
    numbers_types_apart=False,
)
