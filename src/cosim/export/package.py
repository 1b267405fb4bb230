"""`export_fmu`: generate, compile, zip; the file appears whole or not at all."""

import hashlib
import io
import os
import tempfile
import uuid
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

from casadi_models.dae import Dae
from cosim.compile import compile_library, find_compiler
from cosim.errors import ExportError, UnknownName
from cosim.export import description2, description3
from cosim.export.documentation import documentation_page
from cosim.export.identifier import model_identifier
from cosim.export.platforms import Platform, native_platform
from cosim.export.sources import equations, model_header, variable_table
from cosim.export.structure import Identity
from cosim.export.variables import dependencies, fmu_variables
from cosim.files import write_atomically
from cosim.resources import cache_folder, runtime_sources

TOLERANCE = 1e-9  # recommended to importers, whose solvers take it as the error per step
VERSIONS = {2: description2, 3: description3}
_EPOCH = (1980, 1, 1, 0, 0, 0)  # of every file in the archive: same input, same bytes


def export_fmu(
    dae: Dae,
    target: str | os.PathLike[str],
    *,
    fmi: int = 2,
    identifier: str | None = None,
    outputs: Sequence[str] | None = None,
    tolerance: float = TOLERANCE,
) -> Path:
    """Write a DAE as an FMU for model exchange and co-simulation.

    Args:
        dae: The model.
        target: The file, replaced when everything has succeeded.
        fmi: Version of FMI: 2 (FMI 2.0) or 3 (FMI 3.0).
        identifier: Model name in the FMU; `MODEL_FORMULATION` when None.
        outputs: What importers record; everything observable when None.
        tolerance: Relative tolerance that the FMU recommends.

    Returns:
        Path of the FMU.

    Raises:
        ExportError: The name is no C name, or the file cannot be written.
        UnknownName: The model has no such output, or FMI no such version.
        MissingTool: There is no C compiler.
    """
    if fmi not in VERSIONS:
        raise UnknownName.among("cosim", "FMI version", str(fmi), map(str, VERSIONS))
    path = Path(target)
    name = model_identifier(identifier or dae.full_name)
    if outputs is not None:
        dae = _observing(dae, outputs)
    if not path.parent.is_dir() or path.is_dir():
        write_atomically(path, b"")  # refuses, before anything has been computed
    files = source_files(dae, name, tolerance, fmi)
    platform = native_platform()
    binary = compiled_binary(files, name, platform)
    inside = f"binaries/{platform.folder(fmi)}/{name}{platform.suffix}"
    return write_atomically(path, _archive(files | {inside: binary}))


def source_files(dae: Dae, name: str, tolerance: float, fmi: int) -> dict[str, bytes]:
    """Return the content of the FMU by path, without binaries."""
    variables = fmu_variables(dae)
    runtime = {e.name: e.read_bytes() for e in runtime_sources() if _belongs(e.name, fmi)}
    code = {
        "model.c": variable_table(variables).encode(),
        "equations.c": equations(dae).encode(),
    }
    compiled = tuple(sorted(file for file in (*runtime, *code) if file.endswith(".c")))
    draft = Identity(name, "", f"cosim-rigid {version('cosim-rigid')}", compiled, tolerance)
    depends = dependencies(dae)
    describe = VERSIONS[fmi].model_description
    unsigned = describe(dae, draft, variables, depends)
    digest = hashlib.sha256()
    for part in (unsigned, *code.values(), *runtime.values()):
        digest.update(part)
    guid = f"{{{uuid.UUID(bytes=digest.digest()[:16])}}}"
    code["model.h"] = model_header(dae, name, guid, tolerance).encode()
    if fmi == 3:
        code["buildDescription.xml"] = description3.build_description(draft)
    return {
        "modelDescription.xml": describe(dae, replace(draft, guid=guid), variables, depends),
        "documentation/index.html": documentation_page(dae, variables).encode(),
        **{f"sources/{file}": content for file, content in {**runtime, **code}.items()},
    }


def _belongs(file: str, fmi: int) -> bool:
    """Tell whether a file of the runtime is for this version of FMI, or for every."""
    return not file.startswith("fmi") or file.startswith(f"fmi{fmi}")


def compiled_binary(files: dict[str, bytes], name: str, platform: Platform) -> bytes:
    """Return the content of the shared library, compiled unless the cache has it.

    Raises:
        MissingTool: There is no compiler, or it fails.
    """
    sources = {Path(p).name: c for p, c in files.items() if p.startswith("sources/")}
    command = platform.command or find_compiler()
    digest = hashlib.sha256(repr((command, platform)).encode())
    for file in sorted(sources):
        digest.update(file.encode() + sources[file])
    cached = cache_folder() / f"{digest.hexdigest()[:32]}{platform.suffix}"
    if cached.exists():
        return cached.read_bytes()
    cached.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="build-", dir=cached.parent) as build:
        for file, content in sources.items():
            (Path(build) / file).write_bytes(content)
        library = compile_library(
            sorted(Path(build).glob("*.c")),
            Path(build) / f"{name}{platform.suffix}",
            include=[fmi_headers()],
            options=[f"-ffile-prefix-map={build}=.", *platform.options],
            command=command,
        )
        content = library.read_bytes()
        library.replace(cached)
    return content


def fmi_headers() -> Path:
    """Return the folder of the FMI headers, which come with FMPy."""
    found = find_spec("fmpy")
    if found is None or not found.submodule_search_locations:
        raise ExportError("the FMI headers come with fmpy, which is missing; pip install fmpy")
    return Path(found.submodule_search_locations[0]) / "c-code"


def _observing(dae: Dae, outputs: Sequence[str]) -> Dae:
    names = [v.name for v in (*dae.states, *dae.algebraics, *dae.output_variables)]
    for name in outputs:
        if name not in names:
            raise UnknownName.among(dae.full_name, "output", name, names)
    return replace(dae, observed=tuple(outputs))


def _archive(files: dict[str, bytes]) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in sorted(files.items()):
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.external_attr = 0o644 << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, data)
    return content.getvalue()
