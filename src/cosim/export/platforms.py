"""Where an FMU's binary can run: folder names of FMI, and how to compile for them."""

import platform as machine
import sys
from dataclasses import dataclass

from cosim.errors import ExportError

# FMI functions alone are visible; no contraction of a * b + c, so that all machines agree.
_PORTABLE = ("-std=c11", "-fvisibility=hidden", "-ffp-contract=off")


@dataclass(frozen=True)
class Platform:
    """A platform by FMI's name.

    Attributes:
        folder: Below `binaries/` in an FMI 2.0 FMU.
        suffix: Of the shared library.
        options: Of the compiler.
        command: The compiler; the machine's own when None.
    """

    folder: str
    suffix: str
    options: tuple[str, ...] = _PORTABLE
    command: tuple[str, ...] | None = None


def native_platform() -> Platform:
    """Return the platform of this machine.

    Raises:
        ExportError: FMI 2.0 has no name for it.
    """
    bits = "64" if sys.maxsize > 2**32 else "32"
    folders = {"linux": ("linux", ".so"), "win32": ("win", ".dll"), "darwin": ("darwin", ".dylib")}
    if sys.platform not in folders:
        raise ExportError(f"FMI 2.0 knows no platform {sys.platform} ({machine.machine()})")
    folder, suffix = folders[sys.platform]
    return Platform(folder + bits, suffix)
