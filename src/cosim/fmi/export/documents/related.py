"""FMI-LS-REF: a manifest that tells what the other files of an FMU are good for."""

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET

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


@dataclass(frozen=True)
class Related:
    """A file of an FMU.

    Attributes:
        path: In the FMU.
        type: MIME type.
        role: Of FMI-LS-REF, e.g. "result" or "parameter".
        meaning: One line.
    """

    path: str
    type: str
    role: str
    meaning: str


def manifest(files: Sequence[Related]) -> bytes:
    """Return the content of `fmi-ls-manifest.xml`."""
    ET.register_namespace("fmi-ls", _MANIFEST)
    facts = {f"{{{_MANIFEST}}}{name}": text for name, text in _FACTS.items()}
    root = ET.Element("fmiReferences", facts)
    for file in files:
        inside = file.path.removeprefix(f"{LS_REF_FOLDER}/")
        source = inside if inside != file.path else f"../../{file.path}"
        ET.SubElement(
            root,
            "Related",
            type=file.type,
            source=source,
            role=file.role,
            description=file.meaning,
        )
    ET.indent(root)
    content: bytes = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    return content + b"\n"
