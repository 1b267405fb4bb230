"""An FMU that carries its own proof: a reference result, how near the FMU comes, a picture.

The reference is the run of road one, not of the FMU; `check_file` repeats the comparison anywhere.
"""

import csv
import io
import json
import os
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any
from warnings import warn
from xml.etree import ElementTree as ET

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.compiler import has_compiler
from cosim.errors import CosimError, FmuError, SolverError, UsageError
from cosim.files import refuse_unwritable, write_atomically
from cosim.fmi.aliases import flat_names
from cosim.fmi.archive import DESCRIPTION, entry_content, opened
from cosim.fmi.export.package import export_fmu, zipped
from cosim.fmi.export.solver_choice import ROSENBROCK, solver_for
from cosim.fmi.platforms import NATIVE
from cosim.fmi.run.isolated import simulate_apart
from cosim.fmi.run.simulate import simulate_fmu
from cosim.fmi.trust import is_made_here, remember
from cosim.host.temporary import temporary_folder
from cosim.integrate.simulate import simulate
from cosim.model.rank import watches_rank
from cosim.scene.roads import FMU_ROADS
from cosim.text.escaping import sentence
from cosim.trajectory import Column, Trajectory
from cosim.verify.check import Check, Verdict
from cosim.verify.comparison import compare
from cosim.verify.crosscheck import BOUND
from cosim.verify.related_files import MEASURED, REFERENCE, Sets, related_files

OWN = "reference"
MOST_ROWS = 201
CONSTANT_NOISE = (
    1e-10  # of what is constant, in nominal values: rounding, and what the tolerance leaves
)
FINER_OUTPUTS = 10  # times of a check within each of the reference: communication steps
LOOSER = 10.0  # tolerance of a run by the reference's own solver that tells how wrong it may be
AFFORDABLE = 5000  # operations of equations that a second method runs interpreted
_TRY = "try a tighter reference_tolerance of the model, a shorter span, or cosim export --accuracy"
PALETTE_SIZE = 16  # of the picture
_Way = tuple[str | None, bool | None]  # a solver, and whether compiled
_ACROSS: _Way = (None, None)  # positions where constraints lose rank


def export_with_proof(
    dae: Dae,
    target: str | os.PathLike[str],
    *,
    reference: bool = True,
    sets: Sets = MappingProxyType({}),
    **options: Any,
) -> Path:
    """Export an FMU with a reference result, the measured difference from it, and a picture.

    The FMU is written whatever becomes of its proof; a warning says what is missing, and why.

    Args:
        dae: The model.
        target: The file, replaced when everything has succeeded.
        reference: Whether there shall be a reference result.
        sets: A line of text and values, SI, by name: files of parameters inside the FMU, each with
            what of it the FMU lets be set.
        options: See `export_fmu`.

    Raises:
        CosimError: See `export_fmu`.

    Warns:
        UserWarning: There is no reference result, or the FMU is too far from it.
    """
    refuse_unwritable(target)
    with temporary_folder() as folder:
        plain = export_fmu(dae, Path(folder) / "model.fmu", **options)
        proof: dict[str, bytes] = {}
        if reference:
            local = plain  # what can be run here
            if tuple(options.get("platforms", (NATIVE,))) != (NATIVE,):
                here = options | {"platforms": (NATIVE,)}
                local = export_fmu(dae, Path(folder) / "local.fmu", **here)
            proof = _proof(dae, local, str(target))
        with zipfile.ZipFile(plain) as fmu:
            files = {name: fmu.read(name) for name in fmu.namelist()}
    if "model.png" in files or "terminalsAndIcons/icon.png" in files:
        proof.pop("model.png", None)  # the mechanism is a better icon than a result
    files |= proof
    files |= related_files(files, sets)
    content = zipped(files)
    remember(content)
    return write_atomically(target, content)


def _proof(dae: Dae, local: Path, target: str) -> dict[str, bytes]:
    """Return the files that prove an FMU; without a reference, one that says why there is none."""
    tolerance = dae.experiment.reference_tolerance
    try:
        run, doubt, by = _reference_run(dae, tolerance)
    except CosimError as error:
        warn(f"{target}: no reference: {error}", stacklevel=3)
        missing = {"model": dae.full_name, "no reference": str(error)}
        return {MEASURED: (json.dumps(missing, indent=1) + "\n").encode()}
    checks = [*_result_checks(local, run, tolerance, BOUND, simulate_fmu, doubt)]
    for check in checks:
        if check.verdict is not Verdict.OK:
            said = f"{check.verdict}: {check.comparison}; {_TRY}"
            if check.failure:
                said = f"{check.failure}; the FMU is written without this part of its proof"
            warn(f"{target}: {check.road}: {said}", stacklevel=3)
    text = io.StringIO(newline="")
    _under_its_names(run, local).to_csv(text)
    worst = {c.road: c.comparison.worst for c in checks if c.comparison}
    facts = {
        "model": run.model,
        "solver": run.stats["solver"],
        "relative_tolerance": tolerance,
        "estimated error in nominal values": float(f"{doubt:.1e}"),
        "estimated by": by,
        "bound": BOUND,
        "unit": {column.name: column.unit for column in run.columns},
        "nominal": {column.name: column.nominal for column in run.columns},
        "largest difference in nominal values": {
            road: {"variable": w.name, "difference": w.scaled, "time": w.time}
            for road, w in worst.items()
        },
        "failed": {c.road: c.failure for c in checks if c.failure},
    }
    return {
        REFERENCE: text.getvalue().encode(),
        MEASURED: (json.dumps(facts, indent=1) + "\n").encode(),
        "model.png": _picture(run),
    }


def check_file(path: str | os.PathLike[str], timeout: float | None = None) -> Iterator[Check]:
    """Run an FMU through fmpy on every interface and compare with the reference inside it.

    Its binary runs in a process of its own; a run that fails is a check that failed.

    Args:
        path: The FMU.
        timeout: Wall time of one run, s.

    Raises:
        FmuError: The file is no FMU, or carries no reference.
    """
    try:
        with opened(path) as fmu:
            facts = json.loads(entry_content(fmu, MEASURED))
            if "no reference" in facts:
                why = sentence(str(facts["no reference"]))
                raise FmuError(f"{path} carries no reference result: {why}")
            table = entry_content(fmu, REFERENCE).decode()
            description = ET.fromstring(entry_content(fmu, DESCRIPTION))
            against = _whose(path, description)
            run = _from_csv(table, facts, flat_names(description))
            tolerance, bound = float(facts["relative_tolerance"]), float(facts["bound"])
            doubt = float(facts.get("estimated error in nominal values", 0.0))
    except (KeyError, ValueError, TypeError, IndexError, RecursionError, csv.Error) as error:
        raise FmuError(
            f"{path} carries no reference result; export it with cosim export"
        ) from error
    apart = partial(simulate_apart, timeout=timeout)
    for check in _result_checks(path, run, tolerance, bound, apart, doubt):
        yield replace(check, against=against)


def _whose(path: str | os.PathLike[str], description: ET.Element) -> str:
    """Return what to call the reference inside an FMU: its maker's own, but for ours."""
    if is_made_here(path):
        return OWN
    tool = sentence(description.get("generationTool") or "an unnamed tool")[:60]
    return f"{OWN} by {tool}"


def _reference_run(dae: Dae, tolerance: float) -> tuple[Trajectory, float, str]:
    """Return a run of road one, its estimated error, and what tells it.

    A second method tells how far it may be wrong; of a large model, or where no other one comes
    through, a run of the same solver with a tenfold tolerance. Of a stiff or a sensitive model
    another solver may be the first that comes through.

    Raises:
        CosimError: None does; the first one's reason.
    """
    implicit = dae.algebraics or solver_for(dae, None) == ROSENBROCK  # as the FMU's own
    ways: list[_Way] = [("rosenbrock" if implicit else "erk", False)]
    ways += [("dop853", True)] * has_compiler() + [("rosenbrock", False)]
    ways += [("idas" if dae.algebraics else "cvodes", False)]
    ways += [_ACROSS] * (has_compiler() and watches_rank(dae))
    ways = [*dict.fromkeys(ways)]
    first: CosimError | None = None
    for i, (solver, compiled) in enumerate(ways):
        try:
            run = _plain(dae, solver, compiled, tolerance)
        except (SolverError, UsageError) as error:
            first = first or error
            continue
        estimate = _doubt(dae, run, ways[i], ways[i + 1 :], tolerance)
        if estimate is None:
            continue
        doubt, by = estimate
        quiet = without_noise(run.values, [column.nominal for column in run.columns])
        return replace(run, values=quiet), doubt, by
    raise first or SolverError(f"{dae.full_name}: no second run confirms the first one")


def _doubt(
    dae: Dae, run: Trajectory, own: _Way, others: Sequence[_Way], tolerance: float
) -> tuple[float, str] | None:
    """Return the estimated error of a run in nominal values and what tells it, if anything does."""
    if not run.names:
        return 0.0, ""
    second = [way for way in others if way[1] is False] if dae.operations() <= AFFORDABLE else []
    for name, compiled in [*second, own]:
        looser = LOOSER if name == own[0] else 1.0
        with suppress(SolverError, UsageError):
            again = _plain(dae, name, compiled, looser * tolerance)
            by = f"{again.stats['solver']} at {looser * tolerance:g}"
            return compare(run, again).worst.scaled, by
    return None


def _plain(dae: Dae, solver: str | None, compiled: bool | None, tolerance: float) -> Trajectory:
    span, interval = dae.experiment.stop_time, dae.experiment.output_interval
    return simulate(
        dae,
        output_interval=max(interval, span / (MOST_ROWS - 1)),
        relative_tolerance=tolerance,
        solver=solver,
        outputs=dae.observed,
        compiled=compiled,
    )


def without_noise(values: Vector, nominal: Sequence[float]) -> Vector:
    """Return results with constants and zeros written as such.

    Importers compare a result with a band around the reference as wide as a part of its range,
    which noise does not fill.

    Args:
        values: A column per variable, (n, number of variables).
        nominal: Their sizes.
    """
    quiet = values.copy()
    for column, size in zip(quiet.T, nominal, strict=True):
        if np.ptp(column) <= CONSTANT_NOISE * size:
            column[:] = 0.0 if abs(column[0]) <= CONSTANT_NOISE * size else column[0]
    return quiet


def _result_checks(
    path: str | os.PathLike[str],
    run: Trajectory,
    tolerance: float,
    bound: float,
    simulate_file: Callable[..., Trajectory],
    doubt: float,
) -> Iterator[Check]:
    for road in FMU_ROADS:
        try:
            again = simulate_file(
                path,
                interface=road.interface,
                stop_time=float(run.time[-1]),
                output_interval=float(run.time[1] - run.time[0]) / FINER_OUTPUTS,
                relative_tolerance=tolerance,
            )
        except FmuError as error:
            yield Check(run.model, road, OWN, None, failure=str(error))
            continue
        rows = np.union1d(np.arange(0, len(again), FINER_OUTPUTS), [len(again) - 1])
        again = replace(again, time=again.time[rows], values=again.values[rows])
        difference = compare(run, again, bound=bound)
        yield Check(run.model, road, OWN, difference, dict(again.stats), doubt=doubt)


def _under_its_names(run: Trajectory, path: Path) -> Trajectory:
    """Return a result with the names of an FMU's variables, which may be structured."""
    with opened(path) as fmu:
        names = flat_names(ET.fromstring(entry_content(fmu, DESCRIPTION)))
    own = {flat: name for name, flat in names.items()}
    return replace(
        run, columns=tuple(replace(c, name=own.get(c.name, c.name)) for c in run.columns)
    )


def _from_csv(table: str, facts: dict[str, Any], flat: Mapping[str, str]) -> Trajectory:
    head, *rows = csv.reader(io.StringIO(table))
    head = [flat.get(name, name) for name in head]
    numbers = np.array(rows, dtype=float)
    columns = tuple(
        Column(name, facts["unit"][name], nominal=facts["nominal"][name]) for name in head[1:]
    )
    stats = {"solver": facts["solver"]}
    return Trajectory(facts["model"], numbers[:, 0].copy(), columns, numbers[:, 1:].copy(), stats)


def _picture(run: Trajectory) -> bytes:
    """Draw the first variables of the run: what an importer shows for the model."""
    from PIL import Image

    from cosim.plotting import picture

    small = io.BytesIO()
    with Image.open(io.BytesIO(picture(run.plot(run.names[:3]), "png", dpi=50))) as drawn:
        drawn.convert("RGB").quantize(PALETTE_SIZE).save(small, "png", optimize=True)
    return small.getvalue()
