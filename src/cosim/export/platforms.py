"""Where an FMU's binary can run: folder names of FMI, and how to compile for them."""

import platform as machine
import sys
from dataclasses import dataclass

from cosim.errors import ExportError

# FMI functions alone are visible; no contraction of a * b + c, so that all machines agree.
_PORTABLE = ("-std=c11", "-fvisibility=hidden", "-ffp-contract=off")


@dataclass(frozen=True)
class Platform:
    """A platform by FMI's names.

    Attributes:
        folder2, folder3: Below `binaries/` in FMUs of FMI 2.0 and 3.0.
        suffix: Of the shared library.
        options: Of the compiler.
        command: The compiler; the machine's own when None.
    """

    folder2: str
    folder3: str
    suffix: str
    options: tuple[str, ...] = _PORTABLE
    command: tuple[str, ...] | None = None

    def folder(self, fmi: int) -> str:
        """Return the folder's name in a version of FMI."""
        return self.folder2 if fmi == 2 else self.folder3


def native_platform() -> Platform:
    """Return the platform of this machine.

    Raises:
        ExportError: FMI has no name for it.
    """
    bits = "64" if sys.maxsize > 2**32 else "32"
    systems = {
        "linux": ("linux", "linux", ".so"),
        "win32": ("win", "windows", ".dll"),
        "darwin": ("darwin", "darwin", ".dylib"),
    }
    if sys.platform not in systems:
        raise ExportError(f"FMI knows no platform {sys.platform} ({machine.machine()})")
    old, new, suffix = systems[sys.platform]
    processor = machine.machine().lower()
    architecture = {"amd64": "x86_64", "arm64": "aarch64"}.get(processor, processor)
    return Platform(old + bits, f"{architecture}-{new}", suffix)
