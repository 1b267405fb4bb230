"""`export_fmu`: generate, compile, zip; the file appears whole or not at all."""

import hashlib
import io
import os
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType

from casadi_models.dae import Dae
from cosim.codegen.c_sources import cache_folder, license_texts, runtime_sources, solver_sources
from cosim.codegen.compiler import refuse_unlinked
from cosim.codegen.runge_kutta.stage_sums import dop853_coefficients
from cosim.errors import ExportError, ParameterError, UnknownName, UsageError
from cosim.files import refuse_unwritable, write_atomically
from cosim.fmi.check.check import check_fmu
from cosim.fmi.export.build import binaries
from cosim.fmi.export.dependencies import structural_dependencies
from cosim.fmi.export.description.build_description import build_description
from cosim.fmi.export.description.fmi2_xml import FMI2
from cosim.fmi.export.description.fmi3_xml import FMI3
from cosim.fmi.export.description.model_description import Identity, model_description
from cosim.fmi.export.description.structured_names import structured
from cosim.fmi.export.documents.documentation import documentation_page
from cosim.fmi.export.documents.pictures import DIAGRAM, pictures
from cosim.fmi.export.identifier import model_identifier
from cosim.fmi.export.margins import with_margins
from cosim.fmi.export.solver_choice import solver_for, uses_dop853
from cosim.fmi.export.sources.c_files import equations_c, model_header, variable_table
from cosim.fmi.export.sources.equations import embedded_sources
from cosim.fmi.export.sources.rank import has_rank
from cosim.fmi.export.tunable import tunable_parameters
from cosim.fmi.export.variables import fmu_variables
from cosim.fmi.platforms import NATIVE, targets
from cosim.fmi.trust import remember
from cosim.model.values import A_DAE, listed, number

TOLERANCE = 1e-9  # recommended to importers, whose solvers take it as the error per step
VERSIONS = {2: FMI2, 3: FMI3}
ABOUT = {"author": "author", "license": "license", "date": "generationDateAndTime"}
NAMES = FLAT, STRUCTURED = ("flat", "structured")
_DOP853 = ("dop853.h", "interpolant.h", "ode.h")
_EPOCH = (1980, 1, 1, 0, 0, 0)  # of every file in the archive: same input, same bytes


def export_fmu(
    dae: Dae,
    target: str | os.PathLike[str],
    *,
    fmi: int = 2,
    identifier: str | None = None,
    outputs: Sequence[str] | None = None,
    platforms: Sequence[str] = (NATIVE,),
    tolerance: float = TOLERANCE,
    solver: str | None = None,
    tunable: Sequence[str] | None = None,
    adjoint: bool = False,
    about: Mapping[str, str] | None = None,
    valid: bool = False,
    names: str = FLAT,
) -> Path:
    """Write a DAE as an FMU for model exchange and co-simulation.

    Args:
        dae: The model.
        target: The file, replaced when everything has succeeded.
        fmi: Version of FMI: 2 (FMI 2.0) or 3 (FMI 3.0).
        identifier: Model name in the FMU; `MODEL_FORMULATION` when None.
        outputs: What importers record; everything observable when None.
        platforms: What it runs on: "native" (this machine), "linux64", "win64", "darwin64",
            "aarch64-linux" (FMI 3.0) or "all".
        tolerance: Relative tolerance that the FMU recommends.
        solver: Of co-simulation: "dop853" (explicit, order 8; the default), "rosenbrock" (the
            default of models that are stiff at their start) or "erk" (explicit, order 5, ODEs).
        tunable: Parameters that may change during a run, or `["all"]`; when None, all but inertias
            and those that start values follow from.
        adjoint: Whether the FMU says that it has adjoint derivatives (FMI 3.0). CasADi up to
            3.8.2 gets wrong Jacobians from them: it writes all directions over the first.
        about: What the description says besides: "author", "license", "date" (ISO 8601). Without a
            date, the same model gives the same bytes at any time.
        valid: Whether there is a Boolean output `valid`, true while every limit of the model
            holds; the margins of the limits are then event indicators.
        names: "flat" (`fx_A`) or "structured" (`A.f[1]`); the tools here know both.

    Returns:
        Path of the FMU.

    Raises:
        ExportError: The name is no C name, or the file cannot be written.
        UnknownName: The model has no such output, or FMI no such version, platform or solver.
        UsageError: The solver cannot solve for algebraic unknowns; a parameter cannot be tunable;
            FMI 2.0 has no adjoint derivatives; the model has no limits that `valid` could tell of,
            or calls a library whose C code is not at hand;
            or an argument is of a type that is of no use.
        ParameterError: The tolerance is not within 1e-13 ... 0.1.
        MissingTool: There is no C compiler, or it fails.

    Example:
        >>> import cosim
        >>> export_fmu(cosim.load("crank_shaft"), "crank.fmu", fmi=3).name
        'crank.fmu'
    """
    if not isinstance(dae, Dae):
        raise UsageError.of_type("export_fmu", dae, A_DAE)
    if not isinstance(target, str | os.PathLike):
        raise UsageError.of_type("export_fmu", target, "a file name")
    if type(fmi) is not int or fmi not in VERSIONS:
        raise UnknownName.among("cosim", "FMI version", str(fmi), map(str, VERSIONS))
    path = Path(target)
    refuse_unwritable(path)  # before anything has been computed
    name = model_identifier(identifier or dae.full_name)
    if isinstance(platforms, str):
        raise UsageError.of_type("export_fmu", platforms, "a list of platforms")
    chosen = targets(platforms, fmi)
    if not 1e-13 <= number("export", "tolerance", tolerance) <= 0.1:
        raise ParameterError(f"export: tolerance = {tolerance:g} is not within 1e-13 ... 0.1")
    if outputs is not None:
        dae = _observing(dae, listed(f"{dae.full_name}: outputs", outputs))
    for key in about or {}:
        if key not in ABOUT:
            raise UnknownName.among("export", "fact about an FMU", key, ABOUT)
    if tunable:
        tunable = listed(f"{dae.full_name}: tunable", tunable)
    if adjoint and fmi == 2:
        raise UsageError("export: FMI 2.0 has no adjoint derivatives; use --fmi 3")
    if names not in NAMES:
        raise UnknownName.among("export", "kind of names", names, NAMES)
    files = source_files(
        dae,
        name,
        tolerance,
        fmi,
        solver,
        tunable=tunable,
        adjoint=adjoint,
        about=about or {},
        valid=valid,
        names=names,
    )
    sources = {Path(p).name: c for p, c in files.items() if p.startswith("sources/")}
    content = zipped(files | binaries(sources, name, chosen))
    if problems := check_fmu(io.BytesIO(content)):
        raise ExportError(
            f"{path} is not written, as it would not be sound: {'; '.join(problems)}; "
            f"remove what {cache_folder()} holds and try again"
        )
    remember(content)
    return write_atomically(path, content)


def source_files(
    dae: Dae,
    name: str,
    tolerance: float,
    fmi: int,
    solver: str | None = None,
    *,
    tunable: Sequence[str] | None = None,
    adjoint: bool = False,
    about: Mapping[str, str] = MappingProxyType({}),
    valid: bool = False,
    names: str = FLAT,
) -> dict[str, bytes]:
    """Return the content of the FMU by path, without binaries; see `export_fmu`."""
    solver = solver_for(dae, solver)
    dae = with_margins(dae) if valid else dae
    variables = fmu_variables(dae, tunable_parameters(dae, tunable), valid=valid)
    if names == STRUCTURED:
        variables = structured(variables)
    others = (f"fmi{5 - fmi}", f"integration_{'step' if uses_dop853(dae, solver) else 'dop853'}")
    runtime = {e.name: e.read_bytes() for e in runtime_sources() if not e.name.startswith(others)}
    embedded = embedded_sources(dae)
    code = {
        "model.c": variable_table(dae, variables).encode(),
        "equations.c": equations_c(dae, name, fmi, solver).encode(),
        **{file: text.encode() for file, text in embedded.items()},
    }
    refuse_unlinked(code["equations.c"].decode(), embedded)
    if uses_dop853(dae, solver):
        code |= {e.name: e.read_bytes() for e in solver_sources() if e.name in _DOP853}
        code["dop853_coefficients.h"] = dop853_coefficients().encode()
    compiled = tuple(sorted(file for file in (*runtime, *code) if file.endswith(".c")))
    tool = f"cosim-rigid {version('cosim-rigid')}"
    told = {ABOUT[key]: text for key, text in about.items()}
    indicators = len(dae.limits) if valid else 0
    watched = has_rank(dae)
    draft = Identity(name, "", tool, compiled, tolerance, adjoint, told, indicators, watched)
    depends = structural_dependencies(dae)
    unsigned = model_description(dae, draft, variables, depends, VERSIONS[fmi])
    digest = hashlib.sha256()
    for part in (unsigned, *code.values(), *runtime.values()):
        digest.update(part)
    signed = replace(draft, guid=f"{{{uuid.UUID(bytes=digest.digest()[:16])}}}")
    code["model.h"] = model_header(dae, signed, fmi, solver, valid=valid).encode()
    code["buildDescription.xml"] = build_description(signed)
    drawn = pictures(dae, fmi)
    page = documentation_page(
        dae, variables, solver, tolerance, DIAGRAM if DIAGRAM in drawn else None
    )
    return {
        **drawn,
        "modelDescription.xml": model_description(dae, signed, variables, depends, VERSIONS[fmi]),
        **{f"documentation/licenses/{e.name}": e.read_bytes() for e in license_texts()},
        "documentation/index.html": page.encode(),
        **{f"sources/{file}": content for file, content in {**runtime, **code}.items()},
    }


def _observing(dae: Dae, outputs: Sequence[str]) -> Dae:
    names = [v.name for v in (*dae.states, *dae.algebraics, *dae.output_variables)]
    for name in outputs:
        if name not in names:
            raise UnknownName.among(dae.full_name, "output", name, names)
    return replace(dae, observed=tuple(outputs))


def zipped(files: dict[str, bytes]) -> bytes:
    """Return an archive with these files, the same bytes for the same content."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in sorted(files.items()):
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.external_attr = 0o644 << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, data, compresslevel=9)
    return content.getvalue()
