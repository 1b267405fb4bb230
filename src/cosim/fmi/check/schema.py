"""The XML files of an FMU against the FMI's own schemas, which come with fmpy."""

import zipfile
from collections.abc import Iterator
from functools import cache
from importlib.resources import files
from typing import Any

from cosim.fmi.archive import DESCRIPTION, entry_content
from cosim.fmi.check import rules
from cosim.fmi.check.finding import Finding
from cosim.fmi.check.parsed import BUILD

_MOST = 10  # findings in a file: one fault can have hundreds
_SCHEMAS = {  # of what layered standards add, the standards have their own
    BUILD: "fmi3/fmi3BuildDescription.xsd",
    "terminalsAndIcons/terminalsAndIcons.xml": "fmi3/fmi3TerminalsAndIcons.xsd",
}


def schema_findings(archive: zipfile.ZipFile, version: str) -> Iterator[Finding]:
    """Tell what the schemas of the FMI do not allow, at most ten findings a file."""
    own = {DESCRIPTION: f"fmi{version}/fmi{version}ModelDescription.xsd"}
    for entry, name in (own | _SCHEMAS).items():
        if entry in archive.namelist():
            yield from _against(name, entry, entry_content(archive, entry))


def _against(schema: str, entry: str, content: bytes) -> Iterator[Finding]:
    from lxml import etree

    try:
        tree = etree.fromstring(content, etree.XMLParser(resolve_entities=False, no_network=True))
    except etree.XMLSyntaxError as error:
        yield rules.XML.at(entry, f"not well-formed: {error}")
        return
    known = _schema(schema)
    if known.validate(tree):
        return
    for fault in list(known.error_log)[:_MOST]:
        yield rules.SCHEMA.at(f"{entry} line {fault.line}", fault.message.rstrip("."))


@cache
def _schema(name: str) -> Any:
    """Return a schema by its place in fmpy's folder."""
    from lxml import etree

    return etree.XMLSchema(file=str(files("fmpy") / "schema" / name))
