"""`modelDescription.xml` and `sources/buildDescription.xml` of FMI 3.0."""

from collections.abc import Sequence
from math import isfinite
from xml.etree import ElementTree as ET

from casadi_models.dae import Dae
from cosim.fmi.export.description import (
    Identity,
    Structure,
    causality,
    default_experiment,
    log_categories,
    may_be_set,
    model_structure,
    shortest,
    to_bytes,
    unit_definitions,
)
from cosim.fmi.export.variables import Dependencies, FmuVariable, Role


def model_description(
    dae: Dae, identity: Identity, variables: Sequence[FmuVariable], depends: Dependencies
) -> bytes:
    """Return the file's content."""
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=identity.identifier,
        instantiationToken=identity.guid,
        description=dae.description,
        version="1",
        generationTool=identity.tool,
        variableNamingConvention="structured",
    )
    common = {
        "modelIdentifier": identity.identifier,
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
        "providesDirectionalDerivatives": "true",
        "providesAdjointDerivatives": "true",
    }
    stepping = {"canHandleVariableCommunicationStepSize": "true", "maxOutputDerivativeOrder": "1"}
    ET.SubElement(root, "ModelExchange", common | {"needsCompletedIntegratorStep": "false"})
    ET.SubElement(root, "CoSimulation", common | stepping)
    root.append(unit_definitions(variables))
    root.append(log_categories())
    root.append(default_experiment(dae, identity.tolerance))
    listed = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(variables):
        listed.append(_float64(reference, variable))
    root.append(_structure(model_structure(variables, depends)))
    return to_bytes(root)


def build_description(identity: Identity) -> bytes:
    """Return how importers compile the sources on platforms without a binary."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(
        root, "BuildConfiguration", modelIdentifier=identity.identifier, description="all platforms"
    )
    files = ET.SubElement(configuration, "SourceFileSet", language="C11")
    for name in identity.sources:
        ET.SubElement(files, "SourceFile", name=name)
    ET.SubElement(configuration, "Library", name="m", external="true")
    return to_bytes(root)


def _float64(reference: int, variable: FmuVariable) -> ET.Element:
    element = ET.Element(
        "Float64",
        name=variable.name,
        valueReference=str(reference),
        description=variable.meaning,
        causality=causality(variable),
        variability="fixed" if variable.role is Role.PARAMETER else "continuous",
    )
    if variable.role not in (Role.TIME, Role.INPUT):
        element.set("initial", "exact" if may_be_set(variable) else "calculated")
    element.set("unit", variable.unit)
    if variable.display_unit:
        element.set("displayUnit", variable.display_unit)
    if variable.derivative_of is not None:
        element.set("derivative", str(variable.derivative_of))
    for name, bound in (("min", variable.minimum), ("max", variable.maximum)):
        if isfinite(bound):
            element.set(name, shortest(bound))
    if variable.nominal != 1:
        element.set("nominal", shortest(variable.nominal))
    if may_be_set(variable) and variable.start is not None:
        element.set("start", shortest(variable.start))
    return element


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
