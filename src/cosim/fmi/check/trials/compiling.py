"""The sources of an FMU compile and link as the file says."""

import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree as ET

from cosim.codegen.compiler import find_compiler
from cosim.errors import MissingTool
from cosim.fmi.check.finding import WRONG, Finding, Rule
from cosim.fmi.check.parsed import BUILD
from cosim.fmi.check.trials.bench import Bench, Skipped
from cosim.fmi.export.build import fmi_headers

UNCOMPILABLE = Rule(
    "sources",
    WRONG,
    "cannot build it for their own platform: targets in real time, other processors",
    "add what is missing; fmpy compile shows the same",
)
_TIMEOUT = 60.0  # s, of one file
_SYSTEM = ("m", "dl", "pthread", "rt")  # libraries that come with a C compiler
_MESSAGE = re.compile(r".*\b(?:error|undefined reference)\b.*", re.IGNORECASE)


@dataclass
class _Build:
    """What is to be compiled into one library."""

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
    if not build.files:
        raise Skipped("it lists no sources")
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
        if told := _fails([*call, "-c", name, "-o", str(objects[-1])], folder):
            yield UNCOMPILABLE.at(f"sources/{name}", f"it does not compile: {told}")
            return
    whole = ["-Wl,--no-undefined"] if sys.platform == "linux" else []
    link = [*compiler, "-shared", *map(str, objects), *whole, "-o", str(Path("all.so").absolute())]
    libraries = [f"-l{name}" for name in {*build.libraries, "m"}]
    if told := _fails([*link, *libraries], folder):
        yield UNCOMPILABLE.at("sources", f"they do not make a library: {told}")


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
            if e.get("optional") != "true"
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
    said = done.stderr.decode(errors="replace").splitlines() or ["no reason given"]
    return next((line for line in said if _MESSAGE.fullmatch(line)), said[0]).strip()
