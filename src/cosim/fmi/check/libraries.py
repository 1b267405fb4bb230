"""Where the libraries of an FMU load: what they need, how new a system, which folders."""

import re
import zipfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import PurePosixPath

from cosim.fmi.archive import entry_content
from cosim.fmi.check import rules
from cosim.fmi.check.finding import Finding, Rule
from cosim.fmi.shared_library import Library, read_libraries

_SUFFIXES = (".so", ".dll", ".dylib")
_RUNTIME = re.compile(  # of C and C++, whose names all have versions
    r"(libc|libm|libdl|libpthread|librt|libgcc_s|libstdc\+\+|libmvec|ld-linux[\w-]*)\.so\.\d+(\.\d+)*"
)
_EVERYWHERE = {  # on every computer with that system
    "linux": re.compile(_RUNTIME.pattern),
    "windows": re.compile(
        r"(api-ms-win-[\w-]+|kernel32|kernelbase|ntdll|user32|gdi32|advapi32|shell32|shlwapi|ole32"
        r"|oleaut32|ws2_32|mswsock|iphlpapi|winmm|rpcrt4|bcrypt|crypt32|secur32|psapi|version"
        r"|dbghelp|setupapi|comdlg32|comctl32|msvcrt|ucrtbase)\.dll",
        re.IGNORECASE,
    ),
    "darwin": re.compile(r"/usr/lib/.*|/System/Library/.*"),
}
_OLDEST = {  # systems of 2020
    "GLIBC": ((2, 31), rules.GLIBC),  # Debian 11, Ubuntu 20.04
    "macOS": ((11, 0), rules.MACOS),
}
_VERSION = re.compile(r"(GLIBC|macOS)_(\d+)\.(\d+)(\.\d+)?")
_BESIDE = ("$ORIGIN", "${ORIGIN}", "@loader_path")
_TUPLE = re.compile(r"(x86|x86_64|aarch32|aarch64|riscv32|riscv64|ppc32|ppc64)-\w+(-\w+)?")
_FMI2_FOLDER = re.compile(r"(win|linux|darwin)(32|64)")
_NAMES = 3  # in one finding


def library_findings(archive: zipfile.ZipFile) -> Iterator[Finding]:
    """Tell what keeps the libraries of an FMU from loading elsewhere."""
    for name in archive.namelist():
        path = PurePosixPath(name)
        if len(path.parts) == 3 and path.parts[0] == "binaries" and path.suffix in _SUFFIXES:
            with suppress(ValueError):  # which the other checks tell
                for library in read_libraries(entry_content(archive, name)):
                    for rule, told in _elsewhere(archive, path, library):
                        yield rule.at(name, told)


def folder_findings(archive: zipfile.ZipFile, version: str) -> Iterator[Finding]:
    """Tell which folders of libraries no importer looks into, and that there is nothing to run."""
    names = archive.namelist()
    parts = {PurePosixPath(n).parts for n in names if not n.endswith("/")}
    folders = {p[1] for p in parts if len(p) > 2 and p[0] == "binaries"}
    pattern = _FMI2_FOLDER if version == "2" else _TUPLE
    for folder in sorted(f for f in folders if not pattern.fullmatch(f)):
        other = _TUPLE if version == "2" else _FMI2_FOLDER
        if other.fullmatch(folder):  # else it may be what two tools have agreed on
            yield rules.FOLDER.at(f"binaries/{folder}", f"FMI {version}.0 has no such folder")
    if not folders and not any(p[0] == "sources" for p in parts):
        yield rules.NOTHING_TO_RUN.about("archive", "it has neither libraries nor sources")


def _elsewhere(
    archive: zipfile.ZipFile, path: PurePosixPath, library: Library
) -> Iterator[tuple[Rule, str]]:
    beside = {PurePosixPath(other).name for other in archive.namelist()}
    everywhere = _EVERYWHERE[library.system]
    needed = sorted(n for n in library.needs if n.rpartition("/")[2] not in beside)
    if foreign := [name for name in needed if not everywhere.fullmatch(name)]:
        yield rules.IMPORTS, f"it loads {', '.join(foreign)}, not in the FMU"
    missing = sorted(library.undefined)
    if missing and all(_RUNTIME.fullmatch(name) for name in library.needs):
        shown = ", ".join(missing[:_NAMES]) + (", ..." if len(missing) > _NAMES else "")
        yield rules.UNDEFINED, f"it names no library that has {shown} ({len(missing)} symbols)"
    found = [m for text in library.versions if (m := _VERSION.fullmatch(text))]
    for system, (oldest, rule) in _OLDEST.items():
        newest = max(((int(m[2]), int(m[3])) for m in found if m[1] == system), default=(0, 0))
        if newest > oldest:
            called = {"GLIBC": "glibc"}.get(system, system)
            yield rule, f"it needs {called} {newest[0]}.{newest[1]} or newer"
    for folder in library.run_paths:
        if not folder.startswith(_BESIDE):
            yield rules.RUN_PATH, f"it looks for libraries in {folder}"
