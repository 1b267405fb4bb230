"""Export of a model as an FMU file."""

import hashlib
import io
import os
import uuid
import zipfile
from importlib.util import find_spec
from pathlib import Path
from typing import Unpack

from casadi_models.dae import Dae
from cosim.codegen.c_sources import cache_folder, license_texts
from cosim.codegen.compiler import reject_unlinked, renamed_externals
from cosim.codegen.runge_kutta.stage_sums import dop853_coefficients
from cosim.errors import ExportError, UsageError
from cosim.files import reject_unwritable, write_atomically
from cosim.fmi.check.check import check_fmu
from cosim.fmi.export.build import binaries
from cosim.fmi.export.c_files import equations_c, model_header, variable_table, whole_unit
from cosim.fmi.export.documentation import documentation_page, pictures
from cosim.fmi.export.model_description import build_description, model_description, to_bytes
from cosim.fmi.export.options import FmuKeywords, FmuOptions
from cosim.fmi.export.plan import Plan, planned
from cosim.fmi.platforms import targets
from cosim.fmi.trust import remember
from cosim.model.catalogue import model_of

_EPOCH = (1980, 1, 1, 0, 0, 0)  # of every file in the archive: same input, same bytes


def export_fmu(
    dae: Dae | str, target: str | os.PathLike[str], **keywords: Unpack[FmuKeywords]
) -> Path:
    """Write a DAE as an FMU for model exchange and co-simulation.

    Args:
        dae: The model, or its name.
        target: The file, replaced when everything has succeeded.

    Keyword Args:
        fmi: Version of FMI: 2 (FMI 2.0, the default) or 3 (FMI 3.0).
        identifier: Model name in the FMU; `MODEL_FORMULATION` by default.
        outputs: Names of the variables that importers record; all observable ones by default.
        platforms: Where the FMU runs: "native" (this machine, the default), "linux64", "win64",
            "darwin64", "aarch64-linux" (FMI 3.0) or "all".
        tolerance: Relative tolerance that the FMU recommends; 1e-9 by default.
        solver: Solver for co-simulation: "dop853" (explicit, order 8; the default), "rosenbrock"
            (the default for models that are stiff at their start values), "erk" (explicit,
            order 5, for ODEs), or with fixed steps "rk4" or "ode8".
        step_size: Longest step of "rk4" and "ode8", s; equal steps divide each communication step.
            The output interval of the model by default.
        max_step: Longest step of the other solvers, s; a 50th of the model's span by default.
        tunable: Names of the parameters that may change during a run, or `["all"]`; by default all
            but inertias and those that start values are calculated from.
        adjoint: Whether the FMU declares adjoint derivatives (FMI 3.0). CasADi up to 3.8.2
            computes wrong Jacobians from them: it writes all directions over the first.
        derivatives: Whether the FMU has directional derivatives and output derivatives, which are
            about half of its code.
        about: Further facts in the description: "author", "license", "date" (ISO 8601). Without a
            date, the same model always gives the same bytes.
        valid: Whether there is a Boolean output `valid`, true while every validity condition of
            the model holds; the margins of the conditions are then event indicators.
        names: "flat" (`fx_A`, the default) or "structured" (`A.f[1]`); `cosim` reads both.

    Returns:
        Path of the FMU.

    Raises:
        ExportError: The name is no C name, or the file cannot be written.
        UnknownName: The model has no such output, or there is no such FMI version, platform,
            solver or kind of names.
        UsageError: The solver cannot solve for algebraic unknowns; a parameter cannot be tunable;
            FMI 2.0 has no adjoint derivatives; the model has no validity conditions for `valid`;
            the model calls a library whose C code is missing; or an argument has a wrong type.
        ParameterError: The tolerance is not within 1e-13 ... 0.1.
        MissingTool: There is no C compiler, or it fails.

    Example:
        >>> import cosim
        >>> export_fmu(cosim.load("crank_shaft"), "crank.fmu", fmi=3).name
        'crank.fmu'
    """
    dae = model_of("export_fmu", dae)
    UsageError.reject("export_fmu", target, str | os.PathLike, "a file name")
    options = FmuOptions(**keywords)
    path = Path(target)
    reject_unwritable(path)  # before anything is computed
    platforms = targets(options.platforms, options.fmi)
    files = source_files(dae, options)
    sources = {Path(p).name: c for p, c in files.items() if p.startswith("sources/")}
    content = zipped(files | binaries(sources, options.identifier_of(dae), platforms))
    if problems := check_fmu(io.BytesIO(content), libraries=find_spec("lief") is not None):
        raise ExportError(
            f"{path} is not written, as it would not be sound: {'; '.join(problems)}; "
            f"remove the cache in {cache_folder()} and try again"
        )
    remember(content)
    return write_atomically(path, content)


def source_files(dae: Dae, options: FmuOptions) -> dict[str, bytes]:
    """Return the content of an FMU by path, without binaries."""
    return files_of(planned(dae, options))


def files_of(plan: Plan) -> dict[str, bytes]:
    """Return the content of a planned FMU by path, without binaries."""
    sources = ["fmu.c", *plan.embedded]
    description = model_description(plan, sources)
    written = to_bytes(description)  # before texts go into code: rejects what cannot be written
    code = _model_code(plan)
    settings = repr((plan.step_size, plan.options.max_step)).encode()
    guid = _guid_of(written, *code.values(), *plan.runtime.values(), settings)
    description.set(plan.dialect.token, guid)
    code["model.h"] = model_header(plan, guid, code["equations.c"].decode()).encode()
    code["buildDescription.xml"] = build_description(plan, sources)
    drawn = pictures(plan.dae, plan.options.fmi)
    return {
        **drawn,
        "modelDescription.xml": to_bytes(description),
        **{f"documentation/licenses/{e.name}": e.read_bytes() for e in license_texts()},
        "documentation/index.html": documentation_page(plan, pictured=bool(drawn)).encode(),
        **{f"sources/{name}": content for name, content in {**plan.runtime, **code}.items()},
    }


def _model_code(plan: Plan) -> dict[str, bytes]:
    """Return the C files of the model and of its solver, by name."""
    equations = equations_c(plan)
    reject_unlinked(equations, plan.embedded)
    equations, embedded = renamed_externals(equations, plan.embedded)
    own = {"fmu.c": whole_unit(plan), "tables.h": variable_table(plan), "equations.c": equations}
    own |= embedded
    code = {name: text.encode() for name, text in own.items()} | plan.headers
    if plan.dop853:
        code["dop853_coefficients.h"] = dop853_coefficients().encode()
    return code


def _guid_of(*parts: bytes) -> str:
    """Return an identifier of contents; the same contents have the same one."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return f"{{{uuid.UUID(bytes=digest.digest()[:16])}}}"


def zipped(files: dict[str, bytes]) -> bytes:
    """Return a ZIP archive of files; the same files always give the same bytes."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in sorted(files.items()):
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.external_attr = 0o644 << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, data)
    return content.getvalue()
