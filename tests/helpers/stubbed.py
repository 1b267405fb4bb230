"""FMUs of hand-written C: functions that nobody needs answer that all is well."""

import inspect
import re
from collections.abc import Collection
from pathlib import Path

import fmpy
from fmpy.fmi2 import FMU2Model, FMU2Slave
from fmpy.fmi3 import FMU3Model, FMU3Slave

from cosim.codegen.compiler import compile_library
from cosim.fmi.export.package import zipped

_INTERFACES = {2: (FMU2Model, FMU2Slave), 3: (FMU3Model, FMU3Slave)}


def stubbed(
    source: Path, folder: Path, fmi: int, description: str, own: Collection[str] = ()
) -> Path:
    """Build an FMU of a C file, which sees the version as `FMI`.

    Args:
        source: The file; its name is the model identifier.
        folder: Where to write the FMU.
        fmi: Version of FMI.
        description: Content of modelDescription.xml.
        own: Functions that macros of the file define.
    """
    text = source.read_text()
    found = {name for one in _INTERFACES[fmi] for name, _ in inspect.getmembers(one)}
    names = sorted(name for name in found - {*own} if name.startswith(f"fmi{fmi}"))
    missing = [name for name in names if not re.search(rf"\b{name}\b", text)]
    stubs = "\n".join(f"int {name}(void) {{ return 0; }}" for name in missing)
    code = folder / f"{source.stem}_{fmi}.c"
    code.write_text(f"#define FMI {fmi}\n{text}\n{stubs}\n")
    library = folder / f"{source.stem}{fmpy.sharedLibraryExtension}"
    compile_library([code], library)
    platform = fmpy.platform if fmi == 2 else fmpy.platform_tuple
    files = {"modelDescription.xml": description.encode()}
    files[f"binaries/{platform}/{library.name}"] = library.read_bytes()
    path = code.with_suffix(".fmu")
    path.write_bytes(zipped(files))
    return path
