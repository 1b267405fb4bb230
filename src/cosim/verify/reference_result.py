"""Reference result inside an FMU: a native run, and the FMU's difference from it at export.

`check_file` repeats the comparison.
"""

import csv
import io
import json
import os
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any, Unpack
from warnings import warn
from xml.etree import ElementTree as ET

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.backend import FMU_BACKENDS
from cosim.codegen.compiler import has_compiler
from cosim.codegen.fmu.solver import ROSENBROCK, solver_for
from cosim.errors import CosimError, FmuError, SolverError, UsageError
from cosim.files import reject_unwritable, write_atomically
from cosim.fmi.archive import DESCRIPTION, entry_content, flat_names, opened
from cosim.fmi.export.options import FmuKeywords
from cosim.fmi.export.package import export_fmu, zipped
from cosim.fmi.platforms import NATIVE
from cosim.fmi.run.isolated import run_apart
from cosim.fmi.run.simulate import simulate_fmu
from cosim.fmi.trust import is_made_here, remember
from cosim.host.temporary import temporary_folder
from cosim.integrate.keywords import requested
from cosim.integrate.run import run as execute
from cosim.model.request import DriftControl
from cosim.model.times import checked_grid
from cosim.model.values import number
from cosim.text import sentence
from cosim.trajectory import Column, Event, Trajectory
from cosim.verify.comparison import Check, Verdict, compare, rows_at, sizes_of
from cosim.verify.crosscheck import BOUND

OWN = "reference"
REFERENCE = "documentation/reference.csv"
MEASURED = "documentation/reference.json"
MOST_ROWS = 201
CONSTANT_NOISE = 1e-10  # range of a constant result, in its size: rounding and tolerance
LOOSER = 10.0  # factor on the tolerance where the same solver estimates its own error
AFFORDABLE = 5000  # most operations of equations that a second method integrates interpreted
_TRY = "try a tighter reference_tolerance of the model, a shorter span, or a tighter tolerance"
_Method = tuple[str | None, bool | None]  # a solver, and whether it is compiled
_PROJECTED: _Method = (None, None)  # passes singular configurations


def export_with_reference(
    dae: Dae,
    target: str | os.PathLike[str],
    *,
    reference: bool = True,
    **options: Unpack[FmuKeywords],
) -> Path:
    """Export an FMU with a reference result and the measured difference from it.

    The FMU is written even if there is no reference result; a warning then says why.

    Args:
        dae: The model.
        target: The file, replaced when everything has succeeded.
        reference: Whether the FMU gets a reference result.
        options: See `export_fmu`.

    Raises:
        CosimError: See `export_fmu`.

    Warns:
        UserWarning: There is no reference result, or the FMU is too far from it.
    """
    reject_unwritable(target)
    with temporary_folder() as folder:
        plain = export_fmu(dae, Path(folder) / "model.fmu", **options)
        added: dict[str, bytes] = {}
        if reference:
            local = plain  # an FMU that runs on this machine
            if tuple(options.get("platforms", (NATIVE,))) != (NATIVE,):
                here: FmuKeywords = {**options, "platforms": (NATIVE,)}
                local = export_fmu(dae, Path(folder) / "local.fmu", **here)
            added = _reference_files(dae, local, str(target))
        with zipfile.ZipFile(plain) as fmu:
            files = {name: fmu.read(name) for name in fmu.namelist()}
    content = zipped(files | added)
    remember(content)
    return write_atomically(target, content)


def _reference_files(dae: Dae, local: Path, target: str) -> dict[str, bytes]:
    """Return result and measured differences; the reason where there is no result."""
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
            coarse = f"{check.verdict}: " if check.verdict is Verdict.COARSE else ""
            problem = f"{coarse}{check.comparison}; {_TRY}"
            if check.failure:
                problem = f"{check.failure}; the FMU is written without this comparison"
            warn(f"{target}: {check.backend}: {problem}", stacklevel=3)
    text = io.StringIO(newline="")
    _under_its_names(run, local).to_csv(text)
    worst = {c.backend: c.comparison.worst for c in checks if c.comparison}
    facts = {
        "model": run.model,
        "solver": run.stats["solver"],
        "relative_tolerance": tolerance,
        "estimated error in nominal values": float(f"{doubt:.1e}"),
        "estimated by": by,
        "bound": BOUND,
        "unit": {column.name: column.unit for column in run.columns},
        "nominal": {column.name: column.nominal for column in run.columns},
        "states": [column.name for column in run.columns if column.is_state],
        "events": [  # both sides where a row is, which may hold either
            asdict(e if rows_at(run, e.time) else Event(e.time, e.name, {}, {})) for e in run.events
        ],
        "largest difference in nominal values": {
            backend: {"variable": w.name, "difference": w.scaled, "time": w.time}
            for backend, w in worst.items()
        },
        "failed": {c.backend: c.failure for c in checks if c.failure},
    }
    return {
        REFERENCE: text.getvalue().encode(),
        MEASURED: (json.dumps(facts, indent=1) + "\n").encode(),
    }


def check_file(path: str | os.PathLike[str], timeout: float | None = None) -> Iterator[Check]:
    """Run an FMU through fmpy with each interface and compare with the reference inside it.

    The binary runs in a separate process; a run that fails, or takes longer than the timeout, s,
    becomes a check that failed.

    Raises:
        FmuError: The file is no FMU, or carries no reference result.
    """
    try:
        with opened(path) as fmu:
            facts = json.loads(entry_content(fmu, MEASURED))
            if "no reference" in facts:
                why = sentence(str(facts["no reference"]))
                raise FmuError(f"{path} carries no reference result: {why}")
            table = entry_content(fmu, REFERENCE).decode()
            description = ET.fromstring(entry_content(fmu, DESCRIPTION))
            tool = sentence(description.get("generationTool") or "an unnamed tool")[:60]
            against = OWN if is_made_here(path) else f"{OWN} by {tool}"
            run = _from_csv(table, facts, flat_names(description))
            tolerance, bound = (_positive(facts, key) for key in ("relative_tolerance", "bound"))
            doubt = float(facts.get("estimated error in nominal values", 0.0))
    except (LookupError, ValueError, TypeError, RecursionError, csv.Error, UsageError) as error:
        raise FmuError(
            f"{path} carries no reference result; export it with cosim export"
        ) from error
    apart = partial(run_apart, timeout=timeout)
    for check in _result_checks(path, run, tolerance, bound, apart, doubt):
        yield replace(check, against=against)


def _reference_run(dae: Dae, tolerance: float) -> tuple[Trajectory, float, str]:
    """Return a native run, its estimated error, and the method that estimates the error.

    The solvers are tried in order until one succeeds. A second solver estimates the error; for
    large models, or where no other solver succeeds, the same solver at ten times the tolerance.
    """
    implicit = dae.algebraics or solver_for(dae, None) == ROSENBROCK  # as inside the FMU
    methods: list[_Method] = [("rosenbrock" if implicit else "erk", False)]
    methods += [("dop853", True)] * has_compiler() + [("rosenbrock", False)]
    methods += [("idas" if dae.algebraics else "cvodes", False)]
    methods += [_PROJECTED] * (has_compiler() and dae.has_conditioned_multipliers)
    methods = [*dict.fromkeys(methods)]
    first: CosimError | None = None
    for i, (solver, compiled) in enumerate(methods):
        try:
            run = _plain(dae, solver, compiled, tolerance)
        except (SolverError, UsageError) as error:
            first = first or error
            continue
        estimate = _estimated_error(dae, run, methods[i], methods[i + 1 :], tolerance)
        if estimate is None:
            continue
        doubt, by = estimate
        quiet = without_noise(run.values, sizes_of(run, run)[0])
        return replace(run, values=quiet), doubt, by
    raise first or SolverError(f"{dae.full_name}: no second run confirms the first one")


def _estimated_error(
    dae: Dae, run: Trajectory, own: _Method, others: Sequence[_Method], tolerance: float
) -> tuple[float, str] | None:
    """Return the error of a run in nominal values and its estimator; None if no run succeeds."""
    if not run.names:
        return 0.0, ""
    second = [m for m in others if m[1] is False] if dae.operations() <= AFFORDABLE else []
    for name, compiled in [*second, own]:
        looser = LOOSER if name == own[0] else 1.0
        with suppress(SolverError, UsageError):
            again = _plain(dae, name, compiled, looser * tolerance)
            by = f"{again.stats['solver']} at {looser * tolerance:g}"
            return compare(run, again).worst.scaled, by
    return None


def _plain(dae: Dae, solver: str | None, compiled: bool | None, tolerance: float) -> Trajectory:
    span, interval = dae.experiment.stop_time, dae.experiment.output_interval
    request = requested(
        dae,
        output_interval=max(interval, span / (MOST_ROWS - 1)),
        relative_tolerance=tolerance,
        solver=solver,
        outputs=dae.observed,
        compiled=compiled,
        drift_control=DriftControl.PROJECTION if solver is None else None,
    )
    return execute(request)


def without_noise(values: Vector, sizes: Sequence[float] | Vector) -> Vector:
    """Return results, (n, variables), whose constants and zeros are exact.

    Importers compare a result with a band around the reference. Its width is a part of the
    reference's range, which for a constant would be rounding noise.
    """
    quiet = values.copy()
    for column, size in zip(quiet.T, sizes, strict=True):
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
    for backend in FMU_BACKENDS:
        try:
            again = simulate_file(
                path,
                interface=backend.interface,
                stop_time=float(run.time[-1]),
                output_interval=float(run.time[1] - run.time[0]),
                relative_tolerance=tolerance,
            )
        except FmuError as error:
            yield Check(run.model, backend, OWN, None, failure=str(error))
            continue
        difference = compare(run, again, bound=bound)
        yield Check(run.model, backend, OWN, difference, dict(again.stats), doubt=doubt)


def _under_its_names(run: Trajectory, path: Path) -> Trajectory:
    """Return a result under the names of an FMU's variables, which may be structured."""
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
    units, states = facts["unit"], facts.get("states", ())
    columns = tuple(
        Column(n, units[n], nominal=_positive(facts["nominal"], n), is_state=n in states)
        for n in head[1:]
    )
    stats = {name: facts[name] for name in ("solver", "relative_tolerance")}
    time, values = checked_grid(numbers[:, 0]), numbers[:, 1:]
    events = tuple(_event(head[1:], **event) for event in facts.get("events", ()))
    return Trajectory(facts["model"], time, columns, values, stats, events=events)


def _event(
    names: Sequence[str], time: float, name: str, before: dict[str, float], after: dict[str, float]
) -> Event:
    known = names if before else ()
    sides = ({key: float(side[key]) for key in known} for side in (before, after))
    return Event(float(time), name, *sides)


def _positive(facts: Mapping[str, Any], key: str) -> float:
    return number(MEASURED, key, float(facts[key]), positive=True)
