"""What is wrong with anybody's FMU: rule, place in the file, what was found, and the cure.

`check_fmu` holds our own files to rules of the house, too; of others only the FMI is asked here.
"""

from cosim.fmi.archive import DESCRIPTION, Source, entry_content, opened
from cosim.fmi.check.check import findings_of
from cosim.fmi.check.finding import HOUSE, Finding
from cosim.fmi.check.libraries import folder_findings, library_findings
from cosim.fmi.check.parsed import fmi_version
from cosim.fmi.check.schema import schema_findings


def examine(source: Source) -> tuple[Finding, ...]:
    """Return what is to be said of an FMU without running any of its code.

    Args:
        source: The file, by name or open for reading.

    Raises:
        FmuError, SecurityError: The file is no FMU or dangerous, see `cosim.fmi.archive`.
    """
    with opened(source) as archive:
        version = fmi_version(entry_content(archive, DESCRIPTION))[:1]
        every = [*findings_of(archive), *library_findings(archive)]
        if version in ("2", "3"):
            every += [*schema_findings(archive, version), *folder_findings(archive, version)]
        return tuple(finding for finding in every if finding.level != HOUSE)
