"""`modelDescription.xml` of FMI 2.0."""

from collections.abc import Iterable, Sequence
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
        fmiVersion="2.0",
        modelName=identity.identifier,
        guid=identity.guid,
        description=dae.description,
        version="1",
        generationTool=identity.tool,
        variableNamingConvention="structured",
        numberOfEventIndicators="0",
    )
    for element in _interfaces(identity):
        root.append(element)
    root.append(unit_definitions(variables))
    root.append(log_categories())
    root.append(default_experiment(dae, identity.tolerance))
    listed = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(variables):
        listed.append(_scalar_variable(reference, variable))
    root.append(_structure(model_structure(variables, depends)))
    return to_bytes(root)


def _interfaces(identity: Identity) -> Iterable[ET.Element]:
    common = {
        "modelIdentifier": identity.identifier,
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "providesDirectionalDerivative": "true",
    }
    exchange = {"completedIntegratorStepNotNeeded": "true"}
    stepping = {
        "canHandleVariableCommunicationStepSize": "true",
        "canInterpolateInputs": "true",
        "maxOutputDerivativeOrder": "1",
    }
    for kind, own in (("ModelExchange", exchange), ("CoSimulation", stepping)):
        element = ET.Element(kind, common | own)
        files = ET.SubElement(element, "SourceFiles")
        for name in identity.sources:
            ET.SubElement(files, "File", name=name)
        yield element


def _scalar_variable(reference: int, variable: FmuVariable) -> ET.Element:
    element = ET.Element(
        "ScalarVariable",
        name=variable.name,
        valueReference=str(reference),
        description=variable.meaning,
        causality=causality(variable),
        variability="fixed" if variable.role is Role.PARAMETER else "continuous",
    )
    has_initial = variable.role not in (Role.TIME, Role.INPUT)
    if has_initial:
        element.set("initial", "exact" if may_be_set(variable) else "calculated")
    real = ET.SubElement(element, "Real", unit=variable.unit)
    if variable.display_unit:
        real.set("displayUnit", variable.display_unit)
    if variable.derivative_of is not None:
        real.set("derivative", str(variable.derivative_of + 1))
    for name, bound in (("min", variable.minimum), ("max", variable.maximum)):
        if isfinite(bound):
            real.set(name, shortest(bound))
    if variable.nominal != 1:
        real.set("nominal", shortest(variable.nominal))
    if may_be_set(variable) and variable.start is not None:
        real.set("start", shortest(variable.start))
    return element


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
