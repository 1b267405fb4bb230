"""What else is inside an FMU - results, parameters - and the manifest that tells of it."""

from collections.abc import Mapping
from xml.etree import ElementTree as ET

from cosim.fmi.aliases import flat_names
from cosim.fmi.archive import DESCRIPTION
from cosim.fmi.export.documents.related import LS_REF_FOLDER, MANIFEST, Related, manifest
from cosim.fmi.parameter_set import TYPE, parameter_set, to_file

REFERENCE = "documentation/reference.csv"
MEASURED = "documentation/reference.json"
Sets = Mapping[str, tuple[str, Mapping[str, float]]]  # a line of text and values, SI, by name


def related_files(files: Mapping[str, bytes], sets: Sets) -> dict[str, bytes]:
    """Return files of parameters, and the manifest that tells of them and of the reference."""
    description = ET.fromstring(files[DESCRIPTION])
    known = {flat: name for name, flat in flat_names(description).items()}
    units = _settable(description)
    made: dict[str, bytes] = {}
    related: list[Related] = []
    if REFERENCE in files:
        rows = "a result computed without the FMU; reference.json tells its tolerance and bound"
        related.append(Related(REFERENCE, "text/csv", "result", rows))
        told = "how near the FMU came to the reference result when it was exported"
        related.append(Related(MEASURED, "application/json", "report", told))
    for name, (about, values) in sets.items():
        own = {known.get(n, n): value for n, value in values.items() if known.get(n, n) in units}
        if own:
            path = f"{LS_REF_FOLDER}/{name}.ssv"
            made[path] = to_file(parameter_set(name, own, units, about))
            related.append(Related(path, TYPE, "parameter", about))
    return made | ({MANIFEST: manifest(related)} if related else {})


def _settable(description: ET.Element) -> dict[str, str | None]:
    """Return the units of what an importer may set before a run, by name."""
    units = {}
    for variable in description.findall("ModelVariables/*"):
        facts = variable if variable.get("unit") else next(iter(variable), variable)
        if variable.get("initial") == "exact" or variable.get("causality") == "input":
            units[variable.get("name", "")] = facts.get("unit")
    return units
