"""The same run on every road and in every formulation, and how far the results are apart."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import casadi_models
from casadi_models.dae import Dae
from cosim.errors import FmuError, InitialConditionError, SolverError, UsageError
from cosim.fmi.export.package import export_fmu
from cosim.model.catalogue import formulations, load
from cosim.model.values import number
from cosim.scene.roads import FMU_ROADS, Road, run_fmu, run_scene, scene_dae
from cosim.scene.scene import Scene, Settings
from cosim.scene.variants import fitting_formulations
from cosim.tables import MOST_LINES, html_table, text_table
from cosim.temporary import temporary_folder
from cosim.trajectory import Trajectory
from cosim.verify.comparison import Comparison, compare

BOUND = 1e-6  # of the nominal value
_FAILURES = (SolverError, FmuError, InitialConditionError)  # of one run, not of what was asked


@dataclass(frozen=True)
class Check:
    """One comparison of two runs, and what the second one took.

    Attributes:
        model: `MODEL/FORMULATION` of the second run.
        road: How it was computed.
        against: What it is compared with.
        comparison: The differences; None where the run failed.
        stats: Of the second run: wall_time [s], rhs_calls.
        failure: Why the run failed.
        left_out: Names that are not compared, and why: they mean something else.
    """

    model: str
    road: Road
    against: str
    comparison: Comparison | None
    stats: dict[str, Any] = field(default_factory=dict)
    failure: str = ""
    left_out: Mapping[str, str] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        """ "ok", "DIFFERS" or "FAILED"."""
        if self.comparison is None:
            return "FAILED"
        return "ok" if self.comparison.agrees else "DIFFERS"

    def row(self) -> dict[str, Any]:
        """Return the check as plain values, for tables and JSON."""
        compared = self.comparison
        worst = compared and compared.worst
        return {
            "model": self.model,
            "road": self.road,
            "against": self.against,
            "variables": compared and len(compared.differences),
            "worst": worst and worst.name,
            "difference": worst and worst.scaled,
            "at": worst and worst.time,
            "bound": compared and compared.bound,
            "verdict": self.verdict,
            "wall_time": self.stats.get("wall_time"),
            "rhs_calls": self.stats.get("rhs_calls"),
            "left_out": " ".join(self.left_out) or None,
        }


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
    """
    number("crosscheck", "bound", bound, positive=True)
    if isinstance(models, str | Scene):
        models = [models]
    if not isinstance(models, Collection | None):
        raise UsageError.of_type("crosscheck", models, "names of models, or scenes")
    for item in models or ():
        if isinstance(item, str) and ".py:" not in item:
            formulations(item)  # refuses an unknown name before the first run
    return Checks(_checks(models, stop_time, output_interval, relative_tolerance, bound))


def _checks(
    models: Collection[str | Scene] | None,
    stop_time: float | None,
    output_interval: float | None,
    relative_tolerance: float | None,
    bound: float,
) -> Iterator[Check]:
    for item in models or dict.fromkeys(e.partition("/")[0] for e in casadi_models.CATALOG):
        first: tuple[Trajectory, Dae] | None = None
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
                run = run_scene(scene)
            except _FAILURES as error:
                yield Check(scene.dae.full_name, Road.NATIVE, "", None, failure=str(error))
                continue
            yield from _roads(scene, run, bound)
            if first is None:
                first = run, scene.dae
            elif check := _against(first, run, scene.dae, bound):
                yield check


def _against(
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


def _roads(scene: Scene, run: Trajectory, bound: float) -> Iterator[Check]:
    """Compare the FMU's runs with a run through CasADi's integrators."""
    dae = scene_dae(scene)
    with temporary_folder() as folder:
        path = export_fmu(dae, Path(folder) / "model.fmu")
        solver = run.stats["solver"]
        for road in FMU_ROADS:
            try:
                again = run_fmu(scene, dae, path, road)
            except _FAILURES as error:
                yield Check(dae.full_name, road, solver, None, failure=str(error))
                continue
            difference = compare(run, again, bound=bound, resample=False)
            yield Check(dae.full_name, road, solver, difference, dict(again.stats))
