"""The flat names of FMUs that were exported with structured ones."""

from xml.etree import ElementTree as ET

TOOL = "cosim-rigid"  # whose annotations are understood


def flat_names(root: ET.Element) -> dict[str, str]:
    """Return the flat name of each variable that has one besides its own.

    Args:
        root: Of `modelDescription.xml`, FMI 2.0 or 3.0; what other tools wrote has none.
    """
    if not (root.get("generationTool") or "").startswith(TOOL):
        return {}
    version_3 = root.get("fmiVersion", "").startswith("3")
    place = f"Annotation[@type='{TOOL}']" if version_3 else f"Tool[@name='{TOOL}']"
    found = {}
    for variable in root.findall("ModelVariables/*"):
        alias = variable.find(f"Annotations/{place}/Alias")
        if alias is not None:
            found[variable.get("name", "")] = alias.get("name", "")
    return found
