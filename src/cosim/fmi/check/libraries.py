"""Findings about the libraries and C sources of an FMU."""

import re
import subprocess
import sys
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree as ET

from cosim.codegen.compiler import find_compiler
from cosim.errors import MissingTool
from cosim.fmi.archive import entry_content
from cosim.fmi.check.finding import EVERYWHERE, RULES, TRIAL_RULES, Finding, Rule
from cosim.fmi.check.parsed import BUILD
from cosim.fmi.check.trials.bench import Bench, Skipped
from cosim.fmi.export.build import fmi_headers
from cosim.fmi.shared_library import Library, read_libraries
from cosim.text import shortened

_TIMEOUT = 60.0  # s, of one file
_SYSTEM = ("m", "dl", "pthread", "rt")  # libraries that come with a C compiler
_MESSAGE = re.compile(r".*\b(?:error|undefined reference)\b.*", re.IGNORECASE)


@dataclass
class _Build:
    """The sources of one library, to be compiled."""

    files: list[str] = field(default_factory=list)
    definitions: list[str] = field(default_factory=list)
    includes: list[str] = field(default_factory=list)
    libraries: list[str] = field(default_factory=list)


def sources(bench: Bench, kind: str) -> Iterator[Finding]:
    """Every listed source file compiles, and together they lack nothing."""
    identifier = bench.described.interfaces[kind].get("modelIdentifier", "")
    build = _listed(bench, kind, identifier)
    first = next(iter(bench.described.interfaces))
    if kind != first and build == _listed(bench, first, identifier):
        raise Skipped(f"they are those of {first}")
    Skipped.when(not build.files, "it lists no sources")
    if not all((bench.folder / "sources" / name).is_file() for name in build.files):
        raise Skipped("listed sources are missing")
    if foreign := [name for name in build.libraries if name not in _SYSTEM]:
        raise Skipped(f"its sources need {', '.join(foreign)}")
    if any(not name.endswith(".c") for name in build.files):
        raise Skipped("its sources are not all in C")
    try:
        compiler = find_compiler()
    except MissingTool as error:
        raise Skipped(str(error)) from error
    folder = bench.folder / "sources"
    call = [*compiler, "-O0", "-w", "-fPIC", *(f"-D{one}" for one in build.definitions)]
    call += [f"-I{place}" for place in (folder, *(folder / i for i in build.includes))]
    call += [f"-I{fmi_headers()}"]
    objects = []
    for i, name in enumerate(build.files):
        objects.append(Path(f"{i}.o").absolute())
        if fault := _fails([*call, "-c", name, "-o", str(objects[-1])], folder):
            yield TRIAL_RULES["uncompilable"].at(f"sources/{name}", f"it does not compile: {fault}")
            return
    whole = ["-Wl,--no-undefined"] if sys.platform == "linux" else []
    link = [*compiler, "-shared", *map(str, objects), *whole, "-o", str(Path("all.so").absolute())]
    libraries = [f"-l{name}" for name in {*build.libraries, "m"}]
    if fault := _fails([*link, *libraries], folder):
        yield TRIAL_RULES["uncompilable"].at("sources", f"they do not make a library: {fault}")


def _listed(bench: Bench, kind: str, identifier: str) -> _Build:
    """Return what `SourceFiles` (FMI 2.0) or the build description (FMI 3.0) lists."""
    if bench.second:
        files = bench.described.root.iterfind(f"{kind}/SourceFiles/File")
        return _Build([file.get("name", "") for file in files])
    build = _Build()
    if not (bench.folder / BUILD).is_file():
        return build
    root = ET.fromstring((bench.folder / BUILD).read_bytes())
    every = [c for c in root.iter("BuildConfiguration") if c.get("modelIdentifier") == identifier]
    own = [c for c in every if not c.get("platform")]
    for configuration in own[:1]:
        build.files = [e.get("name", "") for e in configuration.iter("SourceFile")]
        build.includes = [e.get("name", "") for e in configuration.iter("IncludeDirectory")]
        build.definitions = [
            e.get("name", "") + (f"={e.get('value')}" if e.get("value") else "")
            for e in configuration.iter("PreprocessorDefinition")
            if e.get("optional") not in ("true", "1")
        ]
        build.libraries = [e.get("name", "") for e in configuration.iter("Library")]
    return build


def _fails(call: Sequence[str], folder: Path) -> str:
    """Run a compiler; return the first line of what it says if it fails."""
    try:
        done = subprocess.run(
            call, cwd=folder, capture_output=True, timeout=_TIMEOUT, stdin=subprocess.DEVNULL
        )
    except subprocess.TimeoutExpired as error:
        raise Skipped(f"the compiler does not end within {_TIMEOUT:g} s") from error
    if not done.returncode:
        return ""
    messages = done.stderr.decode(errors="replace").splitlines() or ["no reason reported"]
    return next((line for line in messages if _MESSAGE.fullmatch(line)), messages[0]).strip()


_SUFFIXES = (".so", ".dll", ".dylib")
_OLDEST = {  # systems of 2020
    "GLIBC": ((2, 31), RULES["glibc"]),  # Debian 11, Ubuntu 20.04
    "macOS": ((11, 0), RULES["macos"]),
}
_VERSION = re.compile(r"(GLIBC|macOS)_(\d+)\.(\d+)(\.\d+)?")
_OWN_FOLDER = ("$ORIGIN", "${ORIGIN}", "@loader_path")
_TUPLE = re.compile(r"(x86|x86_64|aarch32|aarch64|riscv32|riscv64|ppc32|ppc64)-\w+(-\w+)?")
_FMI2_FOLDER = re.compile(r"(win|linux|darwin)(32|64)")
_NAMES = 3  # in one finding


def library_findings(archive: zipfile.ZipFile) -> Iterator[Finding]:
    """Return the reasons why libraries of an FMU may not load on other computers."""
    for name in archive.namelist():
        path = PurePosixPath(name)
        if len(path.parts) == 3 and path.parts[0] == "binaries" and path.suffix in _SUFFIXES:
            with suppress(ValueError):  # another check reports it
                for library in read_libraries(entry_content(archive, name)):
                    for rule, fault in _elsewhere(archive, path, library):
                        yield rule.at(name, fault)


def folder_findings(archive: zipfile.ZipFile, version: str) -> Iterator[Finding]:
    """Return library folders that no importer reads, and a finding if there is nothing to run."""
    names = archive.namelist()
    parts = {PurePosixPath(n).parts for n in names if not n.endswith("/")}
    folders = {p[1] for p in parts if len(p) > 2 and p[0] == "binaries"}
    pattern = _FMI2_FOLDER if version == "2" else _TUPLE
    for folder in sorted(f for f in folders if not pattern.fullmatch(f)):
        other = _TUPLE if version == "2" else _FMI2_FOLDER
        if other.fullmatch(folder):  # else it may be what two tools have agreed on
            yield RULES["folder"].at(f"binaries/{folder}", f"FMI {version}.0 has no such folder")
    if not folders and not any(p[0] == "sources" for p in parts):
        yield RULES["nothing-to-run"].about("archive", "it has neither libraries nor sources")


def _elsewhere(
    archive: zipfile.ZipFile, path: PurePosixPath, library: Library
) -> Iterator[tuple[Rule, str]]:
    present = {PurePosixPath(other).name for other in archive.namelist()}
    everywhere = EVERYWHERE[library.system]
    needed = sorted(n for n in library.needs if n.rpartition("/")[2] not in present)
    if foreign := [name for name in needed if not re.fullmatch(everywhere, name)]:
        yield RULES["imports"], f"it loads {', '.join(foreign)}, not in the FMU"
    missing = sorted(library.undefined)
    if missing and all(re.fullmatch(EVERYWHERE["linux"], name) for name in library.needs):
        shown = shortened(missing, _NAMES)
        yield RULES["undefined"], f"it names no library that has {shown} ({len(missing)} symbols)"
    found = [m for text in library.versions if (m := _VERSION.fullmatch(text))]
    for system, (oldest, rule) in _OLDEST.items():
        newest = max(((int(m[2]), int(m[3])) for m in found if m[1] == system), default=(0, 0))
        if newest > oldest:
            called = {"GLIBC": "glibc"}.get(system, system)
            yield rule, f"it needs {called} {newest[0]}.{newest[1]} or newer"
    for folder in library.run_paths:
        if not folder.startswith(_OWN_FOLDER):
            yield RULES["run-path"], f"it looks for libraries in {folder}"
