"""Export of a model as an FMU file: options, content, archive."""

import hashlib
import io
import os
import re
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import TypedDict, Unpack

from casadi_models.dae import Dae
from cosim.codegen.c_sources import cache_folder, license_texts, runtime_sources, solver_sources
from cosim.codegen.compiler import reject_unlinked
from cosim.codegen.runge_kutta.stage_sums import dop853_coefficients
from cosim.drawing.diagram import diagram, icon
from cosim.drawing.pose import start_pose
from cosim.errors import ExportError, ParameterError, UnknownName, UsageError
from cosim.files import reject_unwritable, write_atomically
from cosim.fmi.check.check import check_fmu
from cosim.fmi.export.build import binaries
from cosim.fmi.export.c_files import equations_c, model_header, variable_table
from cosim.fmi.export.co_simulation import FIXED_STEPS, solver_for, uses_dop853
from cosim.fmi.export.dependencies import structural_dependencies, tunable_parameters, without_modes
from cosim.fmi.export.dialect import DIALECTS
from cosim.fmi.export.documentation import documentation_page
from cosim.fmi.export.equations import embedded_sources, equations_code, has_rank
from cosim.fmi.export.events import fmu_events
from cosim.fmi.export.model_description import Identity, build_description, model_description
from cosim.fmi.export.variables import fmu_variables, structured, with_margins
from cosim.fmi.platforms import NATIVE, targets
from cosim.fmi.trust import remember
from cosim.memo import cached_per_thread
from cosim.model.reduction import checked_outputs
from cosim.model.values import A_DAE, listed, number

_C_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,99}")
# C11 keywords, then names that Windows keeps for devices
_RESERVED = (
    "auto break case char const continue default do double else enum extern float for goto if "
    "inline int long register restrict return short signed sizeof static struct switch typedef "
    "union unsigned void volatile while main "
    "con prn aux nul com1 com2 com3 com4 com5 com6 com7 com8 com9 "
    "lpt1 lpt2 lpt3 lpt4 lpt5 lpt6 lpt7 lpt8 lpt9"
)


def model_identifier(name: str) -> str:
    """Return the identifier of `MODEL/FORMULATION`: the slash becomes an underscore.

    Raises:
        ExportError: The result is no C name of at most 100 characters, or is a reserved word.
    """
    identifier = name.replace("/", "_", 1)
    if not _C_NAME.fullmatch(identifier):
        raise ExportError(
            f"'{name}' cannot name an FMU: use at most 100 ASCII letters, digits and _, "
            "beginning with a letter or _"
        )
    if identifier.lower() in _RESERVED.split():
        raise ExportError(f"'{name}' cannot name an FMU: it is a reserved word; choose another")
    return identifier


DIAGRAM = "documentation/diagram.png"
ICONS = {2: "model.png", 3: "terminalsAndIcons/icon.png"}


@cached_per_thread(8)
def pictures(dae: Dae, fmi: int) -> Mapping[str, bytes]:
    """Return diagram and icon, at the start values, by their paths; none without shapes."""
    pose = start_pose(dae)
    return {} if pose is None else {DIAGRAM: diagram(pose), ICONS[fmi]: icon(pose)}


TOLERANCE = 1e-9  # recommended to importers, whose solvers take it as the error per step
ABOUT = {"author": "author", "license": "license", "date": "generationDateAndTime"}
_OF_EVENTS = ("modes.c", "crossing.c", "time_events.c", "events.c")  # empty without events
_DOP853 = ("dop853.h", "interpolant.h", "ode.h")
_EVENTS = ("crossings.h",)
_EPOCH = (1980, 1, 1, 0, 0, 0)  # of every file in the archive: same input, same bytes


class NameStyle(StrEnum):
    """How an FMU names the components of vectors: `fx_A` or `A.f[1]`."""

    FLAT = "flat"
    STRUCTURED = "structured"


class FmuKeywords(TypedDict, total=False):
    """The keywords of `export_fmu`, which documents them."""

    fmi: int
    identifier: str | None
    outputs: Sequence[str] | None
    platforms: Sequence[str]
    tolerance: float
    solver: str | None
    step_size: float | None
    max_step: float | None
    tunable: Sequence[str] | None
    adjoint: bool
    derivatives: bool
    about: Mapping[str, str] | None
    valid: bool
    names: str


@dataclass(frozen=True)
class FmuOptions:
    """Export options that hold for any model, checked when they are created; see `export_fmu`."""

    fmi: int = 2
    identifier: str | None = None
    outputs: Sequence[str] | None = None
    platforms: Sequence[str] = (NATIVE,)
    tolerance: float = TOLERANCE
    solver: str | None = None
    step_size: float | None = None
    max_step: float | None = None
    tunable: Sequence[str] | None = None
    adjoint: bool = False
    derivatives: bool = True
    about: Mapping[str, str] | None = None
    valid: bool = False
    names: str = NameStyle.FLAT

    def __post_init__(self) -> None:
        """Check every option that does not depend on the model."""
        if type(self.fmi) is not int or self.fmi not in DIALECTS:
            raise UnknownName.among("cosim", "FMI version", str(self.fmi), map(str, DIALECTS))
        if isinstance(self.platforms, str):
            raise UsageError.of_type("export_fmu", self.platforms, "a list of platforms")
        if not 1e-13 <= number("export", "tolerance", self.tolerance) <= 0.1:
            raise ParameterError(
                f"export: tolerance = {self.tolerance:g} is not within 1e-13 ... 0.1"
            )
        for name in ("step_size", "max_step"):
            value, fixed = getattr(self, name), self.solver in FIXED_STEPS
            if value is None:
                continue
            number("export", name, value, positive=True)
            if fixed != (name == "step_size"):
                other = "the adaptive ones" if fixed else " and ".join(FIXED_STEPS)
                raise UsageError(f"export: {name} is for other solvers: {other}; name one")
        for key in self.about or {}:
            if key not in ABOUT:
                raise UnknownName.among("export", "fact about an FMU", key, ABOUT)
        if self.adjoint and not self.derivatives:
            raise UsageError("export: adjoint needs derivatives; leave one of the options out")
        if self.adjoint and self.fmi == 2:
            raise UsageError("export: FMI 2.0 has no adjoint derivatives; use --fmi 3")
        if self.names not in tuple(NameStyle):
            raise UnknownName.among("export", "kind of names", self.names, NameStyle)

    def identifier_of(self, dae: Dae) -> str:
        """Return the C identifier of a model's FMU."""
        return model_identifier(self.identifier or dae.full_name)


def export_fmu(dae: Dae, target: str | os.PathLike[str], **keywords: Unpack[FmuKeywords]) -> Path:
    """Write a DAE as an FMU for model exchange and co-simulation.

    Args:
        dae: The model.
        target: The file, replaced when everything has succeeded.
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
    if not isinstance(dae, Dae):
        raise UsageError.of_type("export_fmu", dae, A_DAE)
    if not isinstance(target, str | os.PathLike):
        raise UsageError.of_type("export_fmu", target, "a file name")
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
    name, fmi = options.identifier_of(dae), options.fmi
    if options.outputs is not None:
        names = checked_outputs(dae, options.outputs)
        dae = replace(dae.watching(names), observed=names)
    tunable = options.tunable and listed(f"{dae.full_name}: tunable", options.tunable)
    solver = solver_for(dae, options.solver)
    fixed = options.step_size or dae.experiment.output_interval
    step_size = fixed if solver in FIXED_STEPS else None
    dae = with_margins(dae) if options.valid else dae
    embedded = embedded_sources(dae)
    tunable = tunable_parameters(dae, tunable)
    system = fmu_events(dae)
    modes = len(system.relations) if system else 0
    dae = system.dae if system else dae
    variables = fmu_variables(dae, tunable, valid=options.valid, modes=modes)
    if options.names == NameStyle.STRUCTURED:
        variables = structured(variables)
    other_solver = "step" if uses_dop853(dae, solver) else "dop853"
    empty = (*(() if system else _OF_EVENTS), *(() if has_rank(dae) else ("rank.c",)))
    empty += () if system and system.time_bounds.relations else ("time_search.c",)
    unused = (f"fmi{5 - fmi}", f"integration_{other_solver}", *empty)
    runtime = {e.name: e.read_bytes() for e in runtime_sources() if not e.name.startswith(unused)}
    generated = equations_code(dae, name, fmi, solver, system, derivatives=options.derivatives)
    code = {
        "model.c": variable_table(dae, variables, system).encode(),
        "equations.c": equations_c(generated, name).encode(),
        **{file: text.encode() for file, text in embedded.items()},
    }
    reject_unlinked(code["equations.c"].decode(), embedded)
    shared = (*(_EVENTS if system else ()), *(_DOP853 if uses_dop853(dae, solver) else ()))
    code |= {e.name: e.read_bytes() for e in solver_sources() if e.name in shared}
    if uses_dop853(dae, solver):
        code["dop853_coefficients.h"] = dop853_coefficients().encode()
    unsigned = Identity(
        name,
        guid="",
        tool=f"cosim-rigid {version('cosim-rigid')}",
        sources=tuple(sorted(file for file in (*runtime, *code) if file.endswith(".c"))),
        tolerance=options.tolerance,
        adjoint=options.adjoint,
        derivatives=options.derivatives,
        step_size=step_size,
        about={ABOUT[key]: text for key, text in (options.about or {}).items()},
        indicators=(len(dae.limits) if options.valid else 0)
        + (system.of_time.count(False) if system else 0),
        watches_steps=has_rank(dae) or bool(system and any(system.of_input)),
        event_mode=modes > 0,
    )
    depends = structural_dependencies(dae)
    describe = partial(
        model_description,
        dae,
        variables=variables,
        depends=without_modes(depends, system) if system else depends,
        dialect=DIALECTS[fmi],
    )
    digest = hashlib.sha256()
    settings = repr((step_size, options.max_step)).encode()
    for part in (describe(identity=unsigned), *code.values(), *runtime.values(), settings):
        digest.update(part)
    identity = replace(unsigned, guid=f"{{{uuid.UUID(bytes=digest.digest()[:16])}}}")
    code["model.h"] = model_header(
        dae,
        identity,
        fmi,
        solver,
        valid=options.valid,
        max_step=options.max_step,
        system=system,
    ).encode()
    code["buildDescription.xml"] = build_description(identity)
    drawn = pictures(dae, fmi)
    page = documentation_page(dae, variables, solver, options.tolerance, pictured=bool(drawn))
    return {
        **drawn,
        "modelDescription.xml": describe(identity=identity),
        **{f"documentation/licenses/{e.name}": e.read_bytes() for e in license_texts()},
        "documentation/index.html": page.encode(),
        **{f"sources/{file}": content for file, content in {**runtime, **code}.items()},
    }


def zipped(files: dict[str, bytes]) -> bytes:
    """Return a ZIP archive of files; the same files always give the same bytes."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in sorted(files.items()):
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.external_attr = 0o644 << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, data, compresslevel=9)
    return content.getvalue()
