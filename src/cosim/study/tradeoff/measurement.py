"""From single runs to measurements: error, counts, and median and spread of the times."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np

from cosim.errors import CosimError, SolverError
from cosim.study.tradeoff.configuration import Configuration
from cosim.study.tradeoff.record import Event, Outcome
from cosim.trajectory import Trajectory
from cosim.verify.comparison import compare
from cosim.verify.reference import Reference

COSTS = ("rhs_calls", "solver_time")


@dataclass(frozen=True)
class Timing:
    """Times of repeated runs, s."""

    median: float
    fastest: float
    slowest: float
    repeats: int


@dataclass(frozen=True)
class Measurement:
    """A configuration with its error and its cost.

    Attributes:
        configuration: What ran.
        outcome: How its first run ended.
        error: Largest global error of the kept outputs, in nominal values.
        worst: The output that has it.
        errors: Of each kept output.
        drift: Largest change of what the reference keeps constant, in nominal values.
        drifting: What changes most.
        rhs_calls, jacobian_calls, steps: Counts; None where the road does not tell.
        solver_time, total_time: Of the integration alone, and with everything around it.
        first_time: s; of the first run, with whatever had to be compiled.
    """

    configuration: Configuration
    outcome: Outcome
    error: float | None = None
    worst: str | None = None
    errors: Mapping[str, float] | None = None
    drift: float | None = None
    drifting: str | None = None
    rhs_calls: int | None = None
    jacobian_calls: int | None = None
    steps: int | None = None
    points: int = 0
    solver_time: Timing | None = None
    total_time: Timing | None = None
    first_time: float | None = None

    @property
    def known_error(self) -> float:
        """The error; infinite where there is no result."""
        return float("inf") if self.error is None else self.error

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
            "road": configuration.road,
            "solver": configuration.solver,
            "drift_control": configuration.drift_control,
            "tolerance": configuration.tolerance,
            "step": configuration.step,
            "error": self.error,
            "worst": self.worst,
            "drift": self.drift,
            "drifting": self.drifting,
            "rhs_calls": self.rhs_calls,
            "jacobian_calls": self.jacobian_calls,
            "steps": self.steps,
            "points": self.points,
            **_in_ms("solver", self.solver_time),
            **_in_ms("total", self.total_time),
            "repeats": self.total_time.repeats if self.total_time else 0,
            "first_ms": None if self.first_time is None else 1e3 * self.first_time,
            "status": str(self.outcome),
        }


def gather(events: Iterable[Event]) -> tuple[Measurement, ...]:
    """Put the runs of each configuration together, in the order of their first run."""
    groups: dict[Configuration, list[Event]] = {}
    for event in events:
        groups.setdefault(event.configuration, []).append(event)
    return tuple(_measurement(group) for group in groups.values())


def observed_event(
    configuration: Configuration,
    run: Trajectory,
    reference: Reference,
    kept: Sequence[str],
    invariants: Sequence[str],
) -> Event:
    """Compare a run with the reference at the output times that both have."""
    truth = at_times(reference.run, run)
    differences = compare(truth.select(kept), run).differences
    drift = {
        name: float(np.ptp(run[name])) / truth.column(name).nominal
        for name in invariants
        if name in run.names
    }
    stats = run.stats
    return Event(
        configuration,
        errors={d.name: d.scaled for d in differences},
        drift=drift,
        rhs_calls=stats.get("rhs_calls"),
        jacobian_calls=stats.get("jacobian_calls"),
        steps=stats.get("steps"),
        points=len(run),
        solver_time=stats.get("solve_time"),
        total_time=stats["wall_time"],
    )


def failed_event(configuration: Configuration, error: CosimError) -> Event:
    """Keep the reason why a configuration has no result, and the time that the solver took."""
    partial = error.partial if isinstance(error, SolverError) else None
    time = partial.stats.get("solve_time") if partial is not None else None
    return Event(configuration, Outcome(type(error).__name__, str(error)), solver_time=time)


def invariants(reference: Reference) -> tuple[str, ...]:
    """Return what the reference keeps constant though it is computed from what moves.

    Energy and momenta of conservative systems, residuals of constraints: their change needs no
    reference to be called an error.
    """
    run = reference.run
    found = []
    for column in run.columns:
        values = run[column.name]
        change = float(np.ptp(values)) / column.nominal
        if 0 < change <= 10 * max(reference.errors[column.name], 1e-13):
            found.append(column.name)
    return tuple(found)


def at_times(reference: Trajectory, run: Trajectory) -> Trajectory:
    """Return the reference at those of its times that a run with longer intervals has."""
    if len(reference) == len(run):
        return reference
    rows = np.searchsorted(reference.time, run.time - 1e-9 * max(1.0, reference.time[-1]))
    rows = np.minimum(rows, len(reference) - 1)
    return Trajectory(
        reference.model, reference.time[rows], reference.columns, reference.values[rows]
    )


def _measurement(events: Sequence[Event]) -> Measurement:
    first, repeats = events[0], events[1:] or events
    if not first.errors:
        return Measurement(first.configuration, first.outcome)
    worst = max(first.errors, key=first.errors.__getitem__)
    drifting = max(first.drift, key=first.drift.__getitem__, default=None)
    return Measurement(
        first.configuration,
        first.outcome,
        error=first.errors[worst],
        worst=worst,
        errors=first.errors,
        drift=None if drifting is None else first.drift[drifting],
        drifting=drifting,
        rhs_calls=first.rhs_calls,
        jacobian_calls=first.jacobian_calls,
        steps=first.steps,
        points=first.points,
        solver_time=_timing([event.solver_time for event in repeats]),
        total_time=_timing([event.total_time for event in repeats]),
        first_time=first.total_time,
    )


def _timing(times: Iterable[float | None]) -> Timing | None:
    known = [time for time in times if time is not None]
    return Timing(median(known), min(known), max(known), len(known)) if known else None


def _in_ms(what: str, timing: Timing | None) -> dict[str, float | None]:
    if timing is None:
        return {f"{what}_ms": None, f"{what}_ms_low": None, f"{what}_ms_high": None}
    return {
        f"{what}_ms": 1e3 * timing.median,
        f"{what}_ms_low": 1e3 * timing.fastest,
        f"{what}_ms_high": 1e3 * timing.slowest,
    }
