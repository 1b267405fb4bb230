"""The XML files of an FMU against the FMI's own schemas, which come with fmpy."""

import re
import zipfile
from collections.abc import Iterator
from functools import cache
from importlib.resources import files
from typing import Any

from cosim.fmi.archive import DESCRIPTION, content_of
from cosim.fmi.check import rules
from cosim.fmi.check.finding import Finding, Rule
from cosim.fmi.check.parsed import BUILD, fmi_version

_MOST = 10  # findings in a file: one fault can have hundreds
_SCHEMAS = (
    (BUILD, "fmi3/fmi3BuildDescription.xsd", rules.SCHEMA),
    ("terminalsAndIcons/terminalsAndIcons.xml", "fmi3/fmi3TerminalsAndIcons.xsd", rules.SCHEMA),
    (r"extra/.*/fmi-ls-manifest.xml", "fmi3/fmi3LayeredStandardManifest.xsd", rules.MANIFEST),
)


def schema_findings(archive: zipfile.ZipFile) -> Iterator[Finding]:
    """Tell what the schemas of the FMI do not allow, at most ten findings a file."""
    content = content_of(archive, DESCRIPTION)
    version = fmi_version(content)[:1]
    if version in ("2", "3"):
        name = f"fmi{version}/fmi{version}ModelDescription.xsd"
        yield from _against(name, rules.SCHEMA, DESCRIPTION, content)
    for pattern, name, rule in _SCHEMAS:
        for entry in archive.namelist():
            if re.fullmatch(pattern, entry):
                yield from _against(name, rule, entry, content_of(archive, entry))


def _against(schema: str, rule: Rule, entry: str, content: bytes) -> Iterator[Finding]:
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
        yield rule.at(f"{entry} line {fault.line}", fault.message.rstrip("."))


@cache
def _schema(name: str) -> Any:
    """Return a schema by its place in fmpy's folder."""
    from lxml import etree

    return etree.XMLSchema(file=str(files("fmpy") / "schema" / name))
