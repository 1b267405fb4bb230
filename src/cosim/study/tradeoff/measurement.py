"""Measured error and cost of configurations: of single runs and of repeated ones."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from statistics import median
from typing import Any

import numpy as np

from cosim.errors import CosimError, SolverError
from cosim.study.tradeoff.configuration import Configuration
from cosim.trajectory import Trajectory
from cosim.verify.comparison import compare
from cosim.verify.reference import Reference

COMPLETE, LEFT_OUT = "complete", "left out"


@dataclass(frozen=True)
class Outcome:
    """How a run ended.

    Attributes:
        kind: "complete", "left out", or the type of the error.
        reason: Why there is no result.
    """

    kind: str = COMPLETE
    reason: str = ""

    def __str__(self) -> str:
        return f"{self.kind}: {self.reason}" if self.reason else self.kind


COSTS = ("rhs_calls", "solver_time")
_SETTINGS = ("backend", "solver", "drift_control", "tolerance", "step")
_RESULTS = (
    *("error", "worst", "drift", "drifting"),
    *("rhs_calls", "jacobian_calls", "steps", "points"),
)


@dataclass(frozen=True)
class Timing:
    """Times of repeated runs, s."""

    median: float
    fastest: float
    slowest: float
    repeats: int

    @classmethod
    def of(cls, times: Iterable[float | None]) -> "Timing | None":
        """Return the timing of the known times; None if there are none."""
        known = [time for time in times if time is not None]
        return cls(median(known), min(known), max(known), len(known)) if known else None


@dataclass(frozen=True)
class Measurement:
    """Error and cost of a configuration, of one run or of several.

    Attributes:
        configuration: The configuration that was run.
        outcome: How the first run ended.
        errors: Largest global error by name, in nominal values.
        drifts: Largest change of each invariant of the reference, in nominal values, by name.
        rhs_calls, jacobian_calls, steps: Counts; None if the backend does not report them.
        points: Number of output times that were compared.
        solver_time, total_time: Times of the integration alone, and of the whole run.
        first_time: Time of the first run, compilation included, s.
    """

    configuration: Configuration
    outcome: Outcome = Outcome()
    errors: Mapping[str, float] = field(default_factory=dict)
    drifts: Mapping[str, float] = field(default_factory=dict)
    rhs_calls: int | None = None
    jacobian_calls: int | None = None
    steps: int | None = None
    points: int = 0
    solver_time: Timing | None = None
    total_time: Timing | None = None
    first_time: float | None = None

    @property
    def worst(self) -> str | None:
        """The output with the largest error; None if there is no result."""
        return max(self.errors, key=self.errors.__getitem__, default=None)

    @property
    def error(self) -> float | None:
        """Largest global error of the outputs, in nominal values; None if there is no result."""
        return None if self.worst is None else self.errors[self.worst]

    @property
    def run_time(self) -> float:
        """Median time of the integration without compilation, s; 0 if it is not known."""
        return self.solver_time.median if self.solver_time else 0.0

    @property
    def drifting(self) -> str | None:
        """The invariant of the reference that changes most; None if there is none."""
        return max(self.drifts, key=self.drifts.__getitem__, default=None)

    @property
    def drift(self) -> float | None:
        """Largest change of an invariant of the reference, in nominal values."""
        return None if self.drifting is None else self.drifts[self.drifting]

    def cost(self, kind: str) -> float | None:
        """Return the cost of one of `COSTS`: calls, or the median time in s."""
        if kind == "rhs_calls":
            return self.rhs_calls
        return self.solver_time.median if self.solver_time else None

    def row(self) -> dict[str, Any]:
        """Return plain values, for tables and files; times in ms."""
        configuration = self.configuration
        return {
            "model": configuration.model,
            "reduced": "yes" if configuration.reduced else "no",
            **{name: getattr(configuration, name) for name in _SETTINGS},
            **{name: getattr(self, name) for name in _RESULTS},
            **_in_ms("solver", self.solver_time),
            **_in_ms("total", self.total_time),
            "repeats": self.total_time.repeats if self.total_time else 0,
            "first_ms": None if self.first_time is None else 1e3 * self.first_time,
            "status": str(self.outcome),
        }


def measurement_of(
    configuration: Configuration,
    run: Trajectory,
    reference: Reference,
    outputs: Sequence[str],
    invariants: Sequence[str],
) -> Measurement:
    """Compare a run with the reference at the output times that both have."""
    truth, own = at_common_times(reference.run, run)
    differences = compare(truth.select(outputs), own, by_nominal=True).differences
    drifts = {
        name: float(np.ptp(run[name])) / truth.column(name).nominal
        for name in invariants
        if name in run.names
    }
    stats = run.stats
    return Measurement(
        configuration,
        errors={d.name: d.scaled for d in differences},
        drifts=drifts,
        rhs_calls=stats.get("rhs_calls"),
        jacobian_calls=stats.get("jacobian_calls"),
        steps=stats.get("steps"),
        points=len(own),
        solver_time=Timing.of([stats.get("solve_time")]),
        total_time=Timing.of([stats["wall_time"]]),
        first_time=stats["wall_time"],
    )


def failed(configuration: Configuration, error: CosimError) -> Measurement:
    """Return the measurement of a failed run: the reason, and the time of the solver."""
    partial = error.partial if isinstance(error, SolverError) else None
    time = partial.stats.get("solve_time") if partial is not None else None
    outcome = Outcome(type(error).__name__, str(error))
    return Measurement(configuration, outcome, solver_time=Timing.of([time]))


def invariants(reference: Reference) -> tuple[str, ...]:
    """Return the invariants of a motion: outputs that are computed but constant in the reference.

    Examples are energy and momenta of conservative systems, and residuals of constraints. Their
    change is an error, even without a reference.
    """
    run = reference.run
    found = []
    for column in run.columns:
        values = run[column.name]
        change = float(np.ptp(values)) / column.nominal
        if 0 < change <= 10 * max(reference.errors[column.name], 1e-13):
            found.append(column.name)
    return tuple(found)


def at_common_times(reference: Trajectory, run: Trajectory) -> list[Trajectory]:
    """Return the rows of the reference and of a run at the output times that both have."""
    if len(reference) == len(run):
        return [reference, run]
    near = 1e-9 * np.abs(reference.time - reference.time[0]).max(initial=0.0)
    rows = np.searchsorted(reference.time[:-1], run.time - near)
    both = np.abs(reference.time[rows] - run.time) <= near
    chosen = ((reference, rows[both]), (run, both))
    return [Trajectory(one.model, one.time[i], one.columns, one.values[i]) for one, i in chosen]


def combined(runs: Sequence[Measurement]) -> Measurement:
    """Return the measurement of a configuration from its runs; the first one is not timed."""
    first, repeats = runs[0], runs[1:] or runs
    if not first.errors:
        return Measurement(first.configuration, first.outcome)
    return replace(
        first,
        solver_time=Timing.of(run.solver_time.median for run in repeats if run.solver_time),
        total_time=Timing.of(run.total_time.median for run in repeats if run.total_time),
    )


def _in_ms(what: str, timing: Timing | None) -> dict[str, float | None]:
    names = (f"{what}_ms", f"{what}_ms_low", f"{what}_ms_high")
    if timing is None:
        return dict.fromkeys(names)
    times = (timing.median, timing.fastest, timing.slowest)
    return {name: 1e3 * time for name, time in zip(names, times, strict=True)}
