"""The same run on every road and in every formulation, and how far the results are apart."""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi_models
from casadi_models.dae import Dae
from cosim.errors import (
    CosimError,
    FmuError,
    InitialConditionError,
    SolverError,
    UsageError,
)
from cosim.fmi.export.package import export_fmu
from cosim.host.progress import doing
from cosim.host.temporary import temporary_folder
from cosim.model.catalogue import formulations, load
from cosim.model.values import number
from cosim.scene.roads import FMU_ROADS, Road, run_fmu, run_on_road, scene_dae
from cosim.scene.scene import Scene, Settings
from cosim.scene.variants import fitting_formulations
from cosim.text.tables import MOST_LINES, html_table, text_table
from cosim.trajectory import Trajectory
from cosim.verify.check import Check, Verdict
from cosim.verify.comparison import compare
from cosim.verify.reference import reference

BOUND = 1e-6  # of the nominal value
_FAILURES = (SolverError, FmuError, InitialConditionError)  # of one run, not of what was asked
_SETTING = "--relative-tolerance"


class Checks(Iterator[Check]):
    """Checks of runs, computed as they are asked for and kept.

    `for check in checks` and `next(checks)` compute one after the other; a second loop sees the
    same ones. Shown at a prompt or in a notebook, they are a table of all of them, for which those
    that are left are computed.
    """

    def __init__(self, checks: Iterator[Check]) -> None:
        self._left = checks
        self._done: list[Check] = []
        self._given = 0  # to next()

    def __iter__(self) -> Iterator[Check]:
        position = 0
        while self._reaches(position):
            yield self._done[position]
            position += 1

    def __next__(self) -> Check:
        if not self._reaches(self._given):
            raise StopIteration
        self._given += 1
        return self._done[self._given - 1]

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

    def _reaches(self, position: int) -> bool:
        while len(self._done) <= position:
            try:
                self._done.append(next(self._left))
            except StopIteration:
                return False
        return True


def crosscheck(
    models: str | Scene | Sequence[str | Scene] | None = None,
    *,
    stop_time: float | None = None,
    output_interval: float | None = None,
    relative_tolerance: float | None = None,
    bound: float = BOUND,
) -> Checks:
    """Run models on every road and compare, one check at a time.

    Every formulation runs through CVODES or IDAS; the FMU made from the same equations runs through
    fmpy, as model exchange and as co-simulation; formulations are compared with the first one. A
    run that fails is a check that failed, and the others go on.

    Args:
        models: `MODEL` (every formulation), `MODEL/FORMULATION`, or a scene: its own formulation
            first, then every other one that has the scene's outputs and takes its values. The
            whole catalogue when None.
        stop_time, output_interval: s; each model's or scene's own when None.
        relative_tolerance: Of every solver; the model's `reference_tolerance` when None. A scene's
            own solver and tolerances do not count.
        bound: Largest difference that counts as agreement, in nominal values.

    Returns:
        The checks, each computed when it is asked for; shown, they are a table of all of them.

    Raises:
        UnknownName: A model does not exist.
        UsageError, ParameterError: A number or a scene makes no sense.
        MissingTool: There is no C compiler.

    Example:
        >>> checks = crosscheck("crank_shaft/driven", stop_time=0.5)
        >>> [str(check.road) for check in checks], checks.agree
        (['fmu-me', 'fmu-cs'], True)
    """
    number("crosscheck", "bound", bound, positive=True)
    if isinstance(models, str | Scene):
        models = [models]
    if not isinstance(models, Collection | None):
        raise UsageError.of_type("crosscheck", models, "names of models, or scenes")
    for item in models or ():
        if isinstance(item, str) and ".py:" not in item:
            formulations(item)  # refuses an unknown name before the first run
    return Checks(_all_checks(models, stop_time, output_interval, relative_tolerance, bound))


def _all_checks(
    models: Collection[str | Scene] | None,
    stop_time: float | None,
    output_interval: float | None,
    relative_tolerance: float | None,
    bound: float,
) -> Iterator[Check]:
    first: tuple[Trajectory, Dae] | None = None
    for item in models or dict.fromkeys(e.partition("/")[0] for e in casadi_models.CATALOG):
        if not isinstance(item, str) or ".py:" not in item:  # forms of one file are compared
            first = None
        for scene in _members(item):
            own = scene.settings
            settings = Settings(
                start_time=own.start_time,
                stop_time=own.stop_time if stop_time is None else stop_time,
                output_interval=own.output_interval if output_interval is None else output_interval,
                relative_tolerance=scene.dae.experiment.reference_tolerance
                if relative_tolerance is None
                else relative_tolerance,
            )
            scene = replace(scene, settings=settings)
            try:
                with doing(str(Road.NATIVE)):
                    run = run_on_road(scene)
            except _FAILURES as error:
                yield Check(scene.dae.full_name, Road.NATIVE, "", None, failure=str(error))
                continue
            yield from _roads(scene, run, bound, relative_tolerance is not None)
            if first is None or first[1].name != scene.dae.name:
                first = run, scene.dae
            elif check := _formulation_check(first, run, scene.dae, bound):
                yield (
                    check
                    if check.comparison and check.comparison.agrees
                    else replace(check, note=_advice(settings.relative_tolerance or 0.0))
                )


def _formulation_check(
    first: tuple[Trajectory, Dae], run: Trajectory, dae: Dae, bound: float
) -> Check | None:
    """Compare a formulation with the first one, in what both mean by the same name."""
    other, other_dae = first
    own = other_dae.own_meanings | dae.own_meanings
    common = [name for name in other.names if name in run.names]
    left_out = {name: own[name] for name in common if name in own}
    if len(left_out) == len(common):
        return None
    difference = compare(other, run, bound=bound, without=left_out)
    return Check(
        run.model, Road.NATIVE, other.model, difference, dict(run.stats), left_out=left_out
    )


def _members(item: str | Scene) -> Iterator[Scene]:
    """Yield a scene for each formulation that is asked for."""
    if isinstance(item, str):
        names = (item,) if "/" in item or ".py:" in item else formulations(item)
        yield from (Scene(name, load(name)) for name in names)
        return
    if not isinstance(item, Scene):
        raise UsageError.of_type("crosscheck", item, "names of models, or scenes")
    yield from fitting_formulations(item)


def _roads(scene: Scene, run: Trajectory, bound: float, given: bool) -> Iterator[Check]:
    """Compare the FMU's runs with a run through CasADi's integrators."""
    dae = scene_dae(scene)
    with temporary_folder() as folder:
        with doing(f"{dae.full_name}, export"):
            path = export_fmu(dae, Path(folder) / "model.fmu")
        for road in FMU_ROADS:
            yield _road(scene, dae, path, run, road, bound, given)


def _road(
    scene: Scene, dae: Dae, path: Path, run: Trajectory, road: Road, bound: float, given: bool
) -> Check:
    """Compare an FMU's run, with a better reference and at tighter tolerances where it differs."""
    solver = run.stats["solver"]

    def again(scene: Scene) -> Trajectory:
        with doing(f"{dae.full_name}, {road}"):
            return run_fmu(scene, dae, path, road)

    try:
        other = again(scene)
    except _FAILURES as error:
        return Check(dae.full_name, road, solver, None, failure=str(error))
    difference = compare(run, other, bound=bound, resample=False)
    first = Check(dae.full_name, road, solver, difference, dict(other.stats))
    if difference.agrees:
        return first
    return _judged(scene, run.names, first, other, None if given else again)


def _judged(
    scene: Scene,
    names: Sequence[str],
    check: Check,
    other: Trajectory,
    again: Callable[[Scene], Trajectory] | None,
) -> Check:
    """Compare with a reference that states its own error what differs from a plain run.

    Args:
        scene: What ran.
        names: The variables that are compared.
        check: What the plain comparison gave.
        other: The run that differs.
        again: Runs the scene with other settings; None where its tolerance was asked for.
    """
    assert check.comparison is not None
    bound = check.comparison.bound
    settings = scene.settings
    tolerance = settings.relative_tolerance or 0.0
    try:
        with doing(f"{scene.dae.full_name}, reference"):
            best = reference(scene)
        truth, doubt = best.run.select(names), best.error(names)
    except CosimError as error:
        advice = f"try {_SETTING} {tolerance / 10:g}; no reference: {error}"
        return replace(check, note=advice)
    found = check
    for tighter in (1.0, 0.1, 0.01):
        now = tighter * tolerance
        try:
            if tighter < 1:
                if again is None:
                    break
                other = again(replace(scene, settings=replace(settings, relative_tolerance=now)))
            difference = compare(truth, other, bound=bound, resample=False)
        except _FAILURES:
            break
        note = f"at relative tolerance {now:g}" if tighter < 1 else ""
        found = Check(
            check.model,
            check.road,
            best.method,
            difference,
            dict(other.stats),
            left_out=check.left_out,
            doubt=doubt,
            note=note,
        )
        if found.verdict is not Verdict.DIFFERS:
            break
    if found.verdict is Verdict.DIFFERS:
        found = replace(found, note=_advice(tolerance))
    elif found.verdict is Verdict.COARSE:
        told = f"the reference may be wrong by {doubt:.1e}: ask for a larger bound or a shorter run"
        found = replace(found, note=told)
    return found


def _advice(tolerance: float) -> str:
    return (
        f"try {_SETTING} {tolerance / 10:g} or a shorter run; if neither helps, the motion is too "
        "sensitive, or one of the two is wrong"
    )
