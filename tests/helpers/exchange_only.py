"""FMUs for model exchange only: files that were exported here without their co-simulation."""

import re
import zipfile
from pathlib import Path

from cosim.fmi.export.package import zipped

_CO_SIMULATION = re.compile(r"<CoSimulation\b[^>]*/>|<CoSimulation\b.*?</CoSimulation>", re.DOTALL)
WITHOUT_STATE = {
    "canGetAndSetFMUstate": "false",
    "canGetAndSetFMUState": "false",
    "canSerializeFMUstate": "false",
    "canSerializeFMUState": "false",
    "completedIntegratorStepNotNeeded": "true",
    "needsCompletedIntegratorStep": "false",
}


def exchange_only(path: Path, **attributes: str) -> Path:
    """Write a copy of an FMU without its co-simulation beside it, and with other attributes."""
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    text = _CO_SIMULATION.sub("", files["modelDescription.xml"].decode())
    for name, value in attributes.items():
        text = re.sub(rf'\b{name}="[^"]*"', f'{name}="{value}"', text)
    target = path.with_name(f"{path.stem}_exchange{len(attributes)}.fmu")
    target.write_bytes(zipped(files | {"modelDescription.xml": text.encode()}))
    return target
