"""`sources/buildDescription.xml`: how importers compile an FMU where it has no binary."""

from xml.etree import ElementTree as ET

from cosim.fmi.export.description.model_description import Identity, to_bytes


def build_description(identity: Identity) -> bytes:
    """Return the file's content; FMI 2.0.4 takes it over from FMI 3.0 (2.3)."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(
        root, "BuildConfiguration", modelIdentifier=identity.identifier, description="all platforms"
    )
    files = ET.SubElement(configuration, "SourceFileSet", language="C11")
    for name in identity.sources:
        ET.SubElement(files, "SourceFile", name=name)
    # in the shared library that is compiled from this file, functions have FMI's own names
    ET.SubElement(files, "PreprocessorDefinition", name="FMI3_OVERRIDE_FUNCTION_PREFIX", value="1")
    ET.SubElement(configuration, "Library", name="m", external="true")
    return to_bytes(root)
