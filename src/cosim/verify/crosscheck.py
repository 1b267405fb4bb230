"""Crosscheck: the same run on every backend and in every formulation, with the differences."""

from collections.abc import Callable, Collection, Iterator, Sequence
from copy import copy
from dataclasses import replace
from itertools import tee
from pathlib import Path
from typing import Any

import casadi_models
from casadi_models.dae import Dae
from cosim.backend import FMU_BACKENDS, Backend
from cosim.coupling.settings import Method
from cosim.coupling.system import System
from cosim.errors import CosimError, FmuError, InitialConditionError, SolverError, UsageError
from cosim.fmi.export.package import export_fmu
from cosim.fmi.run.exported import run_file
from cosim.host.progress import doing
from cosim.host.temporary import temporary_folder
from cosim.integrate.run import run as execute
from cosim.model.catalogue import formulations, loaded
from cosim.model.request import Policy, RunRequest
from cosim.model.solver import LEAST_RELATIVE, Tolerance
from cosim.model.times import Times
from cosim.model.values import number
from cosim.scene.scene import Scene
from cosim.scene.variants import fitting_formulations
from cosim.text import MOST_LINES, html_table, text_table
from cosim.trajectory import Trajectory
from cosim.verify.comparison import Check, Verdict, compare
from cosim.verify.reference import reference

BOUND = 1e-6  # of the nominal value
_FAILURES = (SolverError, FmuError, InitialConditionError)  # errors of one run; the others continue
_COUPLED = (Method.ITERATED, Method.EXTRAPOLATED)  # methods with an estimate of their error
_OF_BOUND = 0.1  # accuracy of a co-simulation
Subject = str | Scene | System
_SETTING = "--relative-tolerance"


class Checks(Iterator[Check]):
    """Checks of runs, computed when they are read and then stored.

    `for check in checks` and `next(checks)` compute one check after the other; a second loop reads
    the stored ones. At a prompt or in a notebook they are shown as a table; the remaining checks
    are then computed.
    """

    def __init__(self, checks: Iterator[Check]) -> None:
        self._every, self._next = tee(checks)

    def __iter__(self) -> Iterator[Check]:
        return copy(self._every)

    def __next__(self) -> Check:
        return next(self._next)

    @property
    def agree(self) -> bool:
        """Whether every check found agreement; computes all of them."""
        return all(check.verdict == "ok" for check in self)

    def rows(self) -> list[dict[str, Any]]:
        """Return every check as plain values, for `pandas.DataFrame(checks.rows())`."""
        return [check.row() for check in self]

    def __repr__(self) -> str:
        return text_table(self.rows(), most=MOST_LINES) or "no check"

    def _repr_html_(self) -> str:
        return html_table(self.rows())


def crosscheck(
    models: Subject | Sequence[Subject] | None = None,
    *,
    stop_time: float | None = None,
    output_interval: float | None = None,
    relative_tolerance: float | None = None,
    bound: float = BOUND,
) -> Checks:
    """Run models on every backend and compare, one check at a time.

    Every formulation runs through CVODES or IDAS; the FMU made from the same equations runs through
    fmpy, as model exchange and as co-simulation; formulations are compared with the first one. A
    run that fails gives a failed check, and the others continue.

    Args:
        models: `MODEL` (every formulation), `MODEL/FORMULATION`, or a scene: its own formulation
            first, then every other one that has the scene's outputs and values; or a coupled
            system: all parts as one model, and co-simulation. The whole catalogue when None.
        stop_time, output_interval: s; each model's or scene's own when None.
        relative_tolerance: For every solver; the model's `reference_tolerance` when None. A scene's
            own solver and tolerances are not used.
        bound: Largest difference that counts as agreement, in nominal values.

    Returns:
        The checks, each computed when it is read; they are shown as a table.

    Raises:
        UnknownName: A model does not exist.
        UsageError, ParameterError: A number or a scene is invalid.
        MissingTool: There is no C compiler.

    Example:
        >>> checks = crosscheck("crank_shaft/driven", stop_time=0.5)
        >>> [str(check.backend) for check in checks], checks.agree
        (['fmu-me', 'fmu-cs'], True)
    """
    number("crosscheck", "bound", bound, positive=True)
    if isinstance(models, Subject):
        models = [models]
    UsageError.reject("crosscheck", models, Collection | None, "names of models, or scenes")
    for item in models or ():
        if isinstance(item, str) and ".py:" not in item:
            formulations(item)  # rejects an unknown name before the first run
    return Checks(_all_checks(models, stop_time, output_interval, relative_tolerance, bound))


def _all_checks(
    models: Collection[Subject] | None,
    stop_time: float | None,
    output_interval: float | None,
    relative_tolerance: float | None,
    bound: float,
) -> Iterator[Check]:
    first: tuple[Trajectory, Dae] | None = None
    names = (entry.partition("/")[0] for entry in casadi_models.CATALOG)
    for item in dict.fromkeys(names) if models is None else models:
        if not isinstance(item, str) or ".py:" not in item:  # forms of one file are compared
            first = None
        for request in _members(item):
            experiment = request.dae.experiment
            tolerance = experiment.reference_tolerance
            if relative_tolerance is not None:
                tolerance = relative_tolerance
            request = _plain(request, stop_time, output_interval, tolerance)
            try:
                with doing(str(Backend.NATIVE)):
                    run = execute(request)
            except _FAILURES as error:
                yield Check(request.dae.full_name, Backend.NATIVE, "", None, failure=str(error))
                continue
            yield from _backends(request, run, bound, relative_tolerance is not None)
            if isinstance(item, System):
                yield from _couplings(item, request, run, bound)
            if first is None or first[1].name != request.dae.name:
                first = run, request.dae
            elif check := _formulation_check(first, run, request.dae, bound):
                yield check if check.comparison else replace(check, note=_advice(tolerance))


def _plain(
    request: RunRequest, stop_time: float | None, interval: float | None, tolerance: float
) -> RunRequest:
    """Return a request for the default solver at a tolerance, reduced to its outputs."""
    times = request.times
    stop = times.stop if stop_time is None else stop_time
    return replace(
        request,
        times=Times(times.start, stop, times.interval if interval is None else interval),
        solver=Tolerance(tolerance),
        policy=Policy(),
    ).reduced()


def _formulation_check(
    first: tuple[Trajectory, Dae], run: Trajectory, dae: Dae, bound: float
) -> Check | None:
    """Compare a formulation with the first one in the variables with the same meaning."""
    other, other_dae = first
    own = other_dae.own_meanings | dae.own_meanings
    common = [name for name in other.names if name in run.names]
    left_out = {name: own[name] for name in common if name in own}
    if len(left_out) == len(common):
        return None
    difference = compare(other, run, bound=bound, without=left_out)
    return Check(
        run.model, Backend.NATIVE, other.model, difference, dict(run.stats), left_out=left_out
    )


def _members(item: Subject) -> Iterator[RunRequest]:
    """Yield a request for each formulation of an item."""
    if isinstance(item, str):
        names = (item,) if "/" in item or ".py:" in item else formulations(item)
        yield from (RunRequest(loaded(name)) for name in names)
        return
    if isinstance(item, System):
        yield RunRequest(item.dae)
        return
    UsageError.reject("crosscheck", item, Scene, "names of models, scenes or systems")
    yield from fitting_formulations(item.request)


def _couplings(
    system: System, request: RunRequest, run: Trajectory, bound: float
) -> Iterator[Check]:
    """Compare the co-simulation of a system by each method with the run of all parts as one."""
    start, stop = request.times.span(request.dae)
    for method in _COUPLED:
        backend = f"co-simulation, {method}"
        try:
            with doing(f"{system.name}, {backend}"):
                other = system.simulate(
                    start_time=start,
                    stop_time=stop,
                    output_interval=request.times.interval,
                    accuracy=_OF_BOUND * bound,
                    method=method,
                )
            difference = compare(run, other, bound=bound, resample=False)
        except (*_FAILURES, UsageError) as error:
            yield Check(system.name, backend, run.stats["solver"], None, failure=str(error))
            continue
        yield Check(system.name, backend, run.stats["solver"], difference, dict(other.stats))


def _backends(
    request: RunRequest, run: Trajectory, bound: float, fixed_tolerance: bool
) -> Iterator[Check]:
    """Compare runs of the FMU with a native run."""
    dae = request.configured()
    with temporary_folder() as folder:
        with doing(f"{dae.full_name}, export"):
            path = export_fmu(dae, Path(folder) / "model.fmu")
        for backend in FMU_BACKENDS:
            yield _backend(request, path, run, backend, bound, fixed_tolerance)


def _backend(
    request: RunRequest,
    path: Path,
    run: Trajectory,
    backend: Backend,
    bound: float,
    fixed_tolerance: bool,
) -> Check:
    """Compare an FMU's run; if it differs, use a better reference and tighter tolerances."""
    solver, name = run.stats["solver"], request.dae.full_name

    def again(request: RunRequest) -> Trajectory:
        assert backend.interface is not None
        with doing(f"{name}, {backend}"):
            return run_file(request, path, backend.interface)

    try:
        other = again(request)
        difference = compare(run, other, bound=bound, resample=False)
    except (*_FAILURES, UsageError) as error:  # also of runs that stop at different times
        return Check(name, backend, solver, None, failure=str(error))
    first = Check(name, backend, solver, difference, dict(other.stats))
    if difference.agrees:
        return first
    return _against_reference(request, run.names, first, other, None if fixed_tolerance else again)


def _against_reference(
    request: RunRequest,
    names: Sequence[str],
    check: Check,
    other: Trajectory,
    again: Callable[[RunRequest], Trajectory] | None,
) -> Check:
    """Compare the names of a run that differs, `other`, with a reference whose error is known.

    `check` has compared it with a plain run. `again` is None if the user has chosen the tolerance.
    """
    assert check.comparison is not None
    bound = check.comparison.bound
    tolerance = request.relative_tolerance or 0.0
    try:
        with doing(f"{request.dae.full_name}, reference"):
            best = reference(request)
        truth = best.run.select(names)
    except CosimError as error:
        return replace(check, note=f"{_advice(tolerance)}; no reference: {error}")
    found = check
    tighter = (tolerance * share for share in (0.1, 0.01) if again)
    for now in (tolerance, *(one for one in tighter if one >= LEAST_RELATIVE)):
        try:
            if again and now < tolerance:
                other = again(replace(request, solver=Tolerance(now)))
            difference = compare(truth, other, bound=bound, resample=False)
        except (*_FAILURES, UsageError):
            break
        nominal = {column.name: column.nominal for column in truth.columns}
        doubt = max(best.errors[d.name] * nominal[d.name] / d.size for d in difference)
        stats, note = dict(other.stats), f"at relative tolerance {now:g}" if now < tolerance else ""
        found = replace(check, against=best.method, comparison=difference, doubt=doubt)
        found = replace(found, stats=stats, note=note)
        if found.verdict is not Verdict.DIFFERS:
            break
    if found.verdict is Verdict.DIFFERS:
        found = replace(found, note=_advice(tolerance))
    elif found.verdict is Verdict.COARSE:
        off = f"the reference may be wrong by {found.doubt:.1e}"
        note = f"{off}: use a larger bound or a shorter run"
        found = replace(found, note=note)
    return found


def _advice(tolerance: float) -> str:
    tighter = f"{_SETTING} {tolerance / 10:g} or " if tolerance / 10 >= LEAST_RELATIVE else ""
    return (
        f"try {tighter}a shorter run; if that does not help, the motion is too sensitive, or one "
        "of the two is wrong"
    )
