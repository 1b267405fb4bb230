"""Related files of an FMU: parameter sets, and the FMI-LS-REF manifest that lists all."""

from collections.abc import Mapping
from xml.etree import ElementTree as ET

from cosim.fmi.archive import DESCRIPTION, flat_names
from cosim.fmi.export.model_description import to_bytes
from cosim.fmi.ssp import TYPE, parameter_set, to_file

LS_REF_FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
MANIFEST = f"{LS_REF_FOLDER}/fmi-ls-manifest.xml"
_MANIFEST = "http://fmi-standard.org/fmi-ls-manifest"
_FACTS = {
    "fmi-ls-name": "org.fmi-standard.fmi-ls-ref",
    "fmi-ls-version": "1.0.0-alpha.1",
    "fmi-ls-description": (
        "Layered Standard providing information on related files included in an FMU."
    ),
}


REFERENCE = "documentation/reference.csv"
MEASURED = "documentation/reference.json"
Sets = Mapping[str, tuple[str, Mapping[str, float]]]  # a line of text and values, SI, by name


def related_files(files: Mapping[str, bytes], sets: Sets) -> dict[str, bytes]:
    """Return parameter sets as files, and the manifest of them and of the reference result."""
    description = ET.fromstring(files[DESCRIPTION])
    known = {flat: name for name, flat in flat_names(description).items()}
    units = _settable(description)
    ET.register_namespace("fmi-ls", _MANIFEST)
    root = ET.Element("fmiReferences", {f"{{{_MANIFEST}}}{n}": text for n, text in _FACTS.items()})

    def list_file(source: str, kind: str, role: str, about: str) -> None:
        ET.SubElement(root, "Related", type=kind, source=source, role=role, description=about)

    if REFERENCE in files:
        rows = "a result computed without the FMU; reference.json tells its tolerance and bound"
        list_file(f"../../{REFERENCE}", "text/csv", "result", rows)
        measured = "how near the FMU came to the reference result when it was exported"
        list_file(f"../../{MEASURED}", "application/json", "report", measured)
    made: dict[str, bytes] = {}
    for name, (about, values) in sets.items():
        own = {known.get(n, n): value for n, value in values.items() if known.get(n, n) in units}
        if own:
            file = f"{name}.ssv"
            made[f"{LS_REF_FOLDER}/{file}"] = to_file(parameter_set(name, own, units, about))
            list_file(file, TYPE, "parameter", about)
    if not len(root):
        return {}
    return {**made, MANIFEST: to_bytes(root)}


def _settable(description: ET.Element) -> dict[str, str | None]:
    """Return the units of the variables that an importer may set before a run, by name."""
    units = {}
    for variable in description.findall("ModelVariables/*"):
        facts = variable if variable.get("unit") else next(iter(variable), variable)
        if variable.get("initial") == "exact" or variable.get("causality") == "input":
            units[variable.get("name", "")] = facts.get("unit")
    return units
