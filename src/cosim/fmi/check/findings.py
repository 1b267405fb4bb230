"""What is wrong with anybody's FMU: rule, place in the file, what was found, and the cure.

`check_fmu` holds our own files to rules of the house, too; of others only the FMI is asked here.
"""

from cosim.fmi.archive import Source, opened
from cosim.fmi.check.check import findings_of
from cosim.fmi.check.finding import HOUSE, Finding
from cosim.fmi.check.libraries import library_findings
from cosim.fmi.check.schema import schema_findings


def examine(source: Source) -> tuple[Finding, ...]:
    """Return what is to be said of an FMU without running any of its code.

    Args:
        source: The file, by name or open for reading.

    Raises:
        FmuError, SecurityError: The file is no FMU or dangerous, see `cosim.fmi.archive`.
    """
    with opened(source) as archive:
        every = (*findings_of(archive), *schema_findings(archive), *library_findings(archive))
        return tuple(finding for finding in every if finding.level != HOUSE)
