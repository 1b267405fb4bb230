"""FMUs that misbehave as a file in their resources says: `FUNCTION ACTION [NUMBER]`.

One binary serves all; it does the action in the function, after what it usually does there.
"""

import re
from collections.abc import Callable
from pathlib import Path

from helpers.fmu_files import rewritten
from helpers.small_models import decay

from cosim.fmi.export.build import binaries
from cosim.fmi.export.options import FmuOptions
from cosim.fmi.export.package import source_files, zipped
from cosim.fmi.platforms import targets

FAULT = "resources/fault.txt"
_FUNCTION = re.compile(r"^(fmi2Status (fmi2\w+)\([^{;]*\) \{\n)", re.MULTILINE)
_INSTANTIATE = re.compile(r"^(fmi2Component fmi2Instantiate\([^{;]*\) \{\n)", re.MULTILINE)
_FREE = "void fmi2FreeInstance(fmi2Component c) {\n"
_NAMES = """
int fault(const char *function);
int fault_status(void);
void choose_fault(const char *resources);
"""
_CHOOSE = "choose_fault(fmuResourceLocation); if (fault(__func__)) return NULL;"


def hostile_binary(folder: Path) -> Path:
    """Build the FMU that can misbehave; without a fault in it, it does not."""
    files = source_files(decay(), FmuOptions(identifier="hostile"))
    for name, content in files.items():
        if re.fullmatch(r"sources/fmi2(_\w+)?\.c", name):
            text = _FUNCTION.sub(
                r"\1    if (fault(__func__)) return (fmi2Status)fault_status();\n", content.decode()
            )
            text = _INSTANTIATE.sub(rf"\1    {_CHOOSE}\n", text)
            text = text.replace(_FREE, f"{_FREE}    fault(__func__);\n")
            files[name] = (_NAMES + text).encode()
    files["sources/fault.c"] = Path(__file__).with_name("hostile.c").read_bytes()
    sources = {Path(name).name: c for name, c in files.items() if name.startswith("sources/")}
    path = folder / "hostile.fmu"
    path.write_bytes(zipped(files | binaries(sources, "hostile", targets(["native"], 2))))
    return path


def hostile(binary: Path) -> Callable[..., Path]:
    """Return what writes an FMU with a fault beside the binary."""

    def write(fault: str, name: str = "") -> Path:
        target = binary.parent / f"{name or re.sub('[^A-Za-z0-9]+', '_', fault)}.fmu"
        return rewritten(binary, target, {FAULT: fault.encode()})

    return write
