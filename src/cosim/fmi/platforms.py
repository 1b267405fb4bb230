"""Platforms of FMU binaries: the FMI's names, and how to compile for each.

The machine's own platform takes whatever compiler it has; all others, and its own by name, take
the one in the package `ziglang`, which brings the headers and libraries of every system along.
"""

import platform as machine
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from cosim.codegen.compiler import is_bundled
from cosim.errors import ExportError, MissingTool, UnknownName

_TABLES = tomllib.loads(Path(__file__).with_name("platforms.toml").read_text(encoding="utf-8"))


@dataclass(frozen=True)
class Target:
    """One processor and system that code is compiled for.

    Attributes:
        processor: "x86_64", "aarch64", or "wasm32" for a page.
        system: "linux", "windows", "darwin", or "wasi" for a page in a browser.
        triple: What the bundled compiler calls it; empty for the machine's own compiler.
    """

    processor: str
    system: str
    triple: str = ""

    @property
    def suffix(self) -> str:
        """Of a shared library."""
        return str(_TABLES["systems"][self.system]["suffix"])

    def folder(self, fmi: int) -> str:
        """Return the folder's name below `binaries/` in a version of FMI."""
        own = f"{self.processor}-{self.system}"
        return str(_TABLES["systems"][self.system]["fmi2"]) if fmi == 2 else own

    def command(self) -> tuple[str, ...] | None:
        """Return the compiler; None for the machine's own.

        Raises:
            MissingTool: The bundled compiler is not installed.
        """
        if not self.triple:
            return None
        if find_spec("ziglang") is None:
            extra = "live" if self.system == "wasi" else "zig"
            raise MissingTool(
                f"compiling for {self.processor}-{self.system} needs the compiler in ziglang; "
                f'bring it with: pip install "cosim-rigid[{extra}]"'
            )
        return (sys.executable, "-P", "-m", "ziglang", "cc", "-target", self.triple)

    def options(self, library: str, compiler: Sequence[str]) -> tuple[str, ...]:
        """Return the compiler's options for a library of this name that runs on every processor."""
        name = (f"-Wl,-install_name,@rpath/{library}",) if self.system == "darwin" else ()
        bundled = is_bundled(compiler)
        processors = [_TABLES["baselines"]["zig" if bundled else self.processor]]
        if self.system == "darwin" and self.processor == "aarch64" and not bundled:
            processors = []  # whose first of the kind is what Apple's compiler takes
        unused_code_out = _TABLES["systems"][self.system]["unused_code_out"]
        return (*_TABLES["options"], *processors, *unused_code_out, *name)


PLATFORMS: dict[str, tuple[Target, ...]] = {
    name: tuple(Target(*facts) for facts in members)
    for name, members in _TABLES["platforms"].items()
}
WEB_PAGE = Target("wasm32", "wasi", "wasm32-wasi")
NATIVE = "native"
ALL_PLATFORMS = "all"


def targets(names: Sequence[str], fmi: int) -> dict[str, tuple[Target, ...]]:
    """Return what to compile for platforms, by the folder that it goes to.

    Args:
        names: Of `PLATFORMS`, "native" or "all".
        fmi: Version of FMI; FMI 2.0 has one folder for both processors of macOS, and none for
            Linux on other processors than x86.

    Raises:
        UnknownName: There is no such platform.
        ExportError: FMI has no name for it, or two of them share a folder.
    """
    chosen: dict[str, tuple[Target, ...]] = {}
    if not names:
        raise ExportError("an FMU needs a platform; name one, or leave the choice out")
    UnknownName.reject("cosim export", "platform", (NATIVE, ALL_PLATFORMS, *PLATFORMS), *names)
    for name in dict.fromkeys(names):
        every = [n for n in PLATFORMS if fmi > 2 or n != "aarch64-linux"]
        for one in every if name == ALL_PLATFORMS else [name]:
            if one == "aarch64-linux" and fmi == 2:
                raise ExportError("FMI 2.0 has no folder for aarch64-linux; use --fmi 3")
            for target in (native_target(),) if one == NATIVE else PLATFORMS[one]:
                folder = target.folder(fmi)
                chosen[folder] = (*chosen.get(folder, ()), target)
    for folder, members in chosen.items():
        processors = [target.processor for target in members]
        if len(set(processors)) < len(processors):
            raise ExportError(f"'{NATIVE}' and '{folder}' are one folder here; name one of them")
    return chosen


def native_target() -> Target:
    """Return this machine.

    Raises:
        ExportError: FMI has no name for it.
    """
    systems = {"linux": "linux", "win32": "windows", "darwin": "darwin"}
    processor = machine.machine().lower()
    processor = {"amd64": "x86_64", "arm64": "aarch64"}.get(processor, processor)
    if sys.platform not in systems or processor not in ("x86_64", "aarch64"):
        raise ExportError(f"there is no FMU platform for {sys.platform} on {processor}")
    if sys.maxsize < 2**32:
        raise ExportError("FMUs are made by a 64-bit Python; this one has 32 bits")
    return Target(processor, systems[sys.platform])
