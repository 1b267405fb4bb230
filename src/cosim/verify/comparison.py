"""`compare`: differences of two trajectories, and the verdict of a check."""

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from cosim.arrays import Vector
from cosim.backend import Backend
from cosim.errors import UnknownName, UsageError
from cosim.model.solver import Tolerance
from cosim.model.values import number
from cosim.presenters import presenter
from cosim.series.samples import NOT_GIVEN
from cosim.text import MOST_LINES, html_table, one_note, text_table
from cosim.trajectory import Trajectory

_ONE_INSTANT = 1e-6  # distance of a row from an event at its time, of the span
_LARGEST_ERROR = 100.0  # that runs usually have, in tolerances of their steps


@dataclass(frozen=True)
class Difference:
    """The largest difference of one variable, divided by `size`, and its time [s].

    `size` is the nominal value, or the largest value of a small state without one, SI.
    """

    name: str
    scaled: float
    time: float
    size: float = 1.0


@dataclass(frozen=True)
class Comparison:
    """Differences of two runs, variable by variable, the largest first.

    Attributes:
        first, second: Names of the two runs.
        differences: One for each common variable, the largest first.
        residuals: Second run minus first, at the compared times, SI; NaN in gaps of a measurement.
        runs: Both runs at their own times.
        bound: Largest scaled difference that counts as agreement (1).
        note: How the runs were brought to the same output times; empty if they have the same.

    Example:
        >>> import cosim
        >>> a, b = (cosim.simulate("crank_shaft", stop_time=1, solver=s) for s in ("cvodes", "erk"))
        >>> cosim.compare(a, b).agrees
        True
    """

    first: str
    second: str
    differences: tuple[Difference, ...]
    residuals: Trajectory = field(repr=False, compare=False)
    runs: tuple[Trajectory, Trajectory] = field(repr=False, compare=False)
    bound: float
    note: str = ""

    @property
    def worst(self) -> Difference:
        """The largest difference."""
        return self.differences[0]

    @property
    def agrees(self) -> bool:
        """Whether the difference of every variable is within the bound."""
        return self.worst.scaled <= self.bound

    @property
    def event_times(self) -> tuple[Vector, Vector]:
        """Instants with events of both runs, s."""
        first, second = (np.unique([event.time for event in run.events]) for run in self.runs)
        return first, second

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per variable; `largest` and `rms` residual are in display units."""
        rows = []
        for one in self:
            column = self.residuals.column(one.name)
            own = column.shown(self.residuals[one.name], difference=True)
            own = np.abs(own[np.isfinite(own)])
            row = {"name": one.name, "difference": one.scaled, "at [s]": one.time}
            row |= {"largest": own.max(initial=0.0), "rms": np.sqrt(own @ own / max(1, len(own)))}
            rows.append(row | {"unit": column.shown_unit})
        return rows

    def plot(self, target: str | Path | None = None, names: Sequence[str] | None = None) -> Any:
        """Draw the first run as a line, the second as points, and the residuals below.

        Args:
            target: PNG, SVG or PDF file; no file if None.
            names: Names of variables; the six with the largest differences if None.

        Raises:
            UnknownName: A variable was not compared, or the file has another ending.
            ExportError: The file cannot be written.
        """
        return plot_comparisons([self], target, names)

    def __bool__(self) -> bool:
        return self.agrees

    def __iter__(self) -> Iterator[Difference]:
        return iter(self.differences)

    def __str__(self) -> str:
        worst = self.worst
        verdict = "agree" if self.agrees else "DIFFER"
        is_nominal = worst.size == self.runs[0].column(worst.name).nominal
        size = "nominal value" if is_nominal else f"largest value {worst.size:.1g}"
        text = (
            f"{self.first} and {self.second} {verdict}: {worst.name} by {worst.scaled:.2e} of its "
            f"{size} at {worst.time:g} s (bound {self.bound:g})"
        )
        return f"{text}; {self.note}" if self.note else text

    def __repr__(self) -> str:
        return f"{self}\n{text_table(self.rows(), most=MOST_LINES - 1)}"

    def _repr_html_(self) -> str:
        return html_table(self.rows(), str(self))


def plot_comparisons(
    compared: Sequence[Comparison],
    target: str | os.PathLike[str] | None,
    names: Sequence[str] | None = None,
) -> Any:
    """Draw comparisons side by side; see `Comparison.plot`."""
    shown = []
    for one in compared:
        chosen = names if names is not None else [each.name for each in one.differences[:6]]
        shown.append((one.residuals.select(chosen), *one.runs))
    figure = presenter("compare")(*shown)
    if target is not None:
        from cosim.plotting import save  # loads matplotlib

        save([figure], str(target))
    return figure


def compare(
    first: Trajectory,
    second: Trajectory,
    *,
    bound: float = 1e-6,
    without: Collection[str] = (),
    resample: bool = True,
    by_nominal: bool = False,
) -> Comparison:
    """Compare the variables that two runs have in common.

    If the runs have different output times, the second run is evaluated at the times of the first
    one that lie within both; but if only the second one was read from a file (a measurement), the
    first run is evaluated at its times. `note` says how: computed again, or interpolated with an
    estimated error. Gaps of a measurement (NaN) are left out. A row at the time of an event, up to
    a millionth of the span, may hold the values before or after it.

    Differences are divided by nominal values. A state without one that stays below 1 SI unit is
    compared with its own largest value, unless its error control cannot tell that from 0, or
    `by_nominal` is true.

    Args:
        first, second: Two runs; the nominal values are those of the first.
        bound: Largest scaled difference that counts as agreement (1).
        without: Names to leave out.
        resample: Whether runs with different output times are compared; else they are rejected.
        by_nominal: Whether all differences are divided by nominal values, as accuracies are given.

    Raises:
        ParameterError: The bound is not a positive number, or a run that is interpolated has no row
            between two events.
        UsageError: The runs have no variable in common, one in another unit, or no time in common;
            or a measurement has nothing but gaps there.

    Example:
        >>> import cosim
        >>> first = cosim.simulate("crank_shaft", stop_time=1)
        >>> second = cosim.simulate("crank_shaft", stop_time=1, solver="idas")
        >>> compare(first, second, bound=1e-5).agrees
        True
    """
    for run in (first, second):
        UsageError.reject("compare", run, Trajectory, "two results of simulate or simulate_fmu")
    bound = number("compare", "bound", bound, positive=True)
    if isinstance(without, str):  # whose letters may be names
        raise UsageError.of_type("compare: without", without, "a list of names")
    UnknownName.reject("compare", "variable", {*first.names, *second.names}, *map(str, without))
    names = [name for name in first.names if name in second.names and name not in without]
    if not names:
        raise UsageError(f"{first.model} and {second.model} have no variable in common")
    labels = _label(first), _label(second)
    for name in names:
        units = first.column(name).unit, second.column(name).unit
        if units[0] != units[1]:
            raise UsageError(
                f"{name} is in {units[0]} in {labels[0]}, but in {units[1]} in {labels[1]}; for a "
                "file, set its units: read_csv(path, like=run) or read_csv(path, units={...})"
            )
    note = ""
    first, second = runs = _up_to_the_stop(first.select(names), second.select(names), bound)
    if resample and len(first) and len(second) and apart(first, second) is not None:
        if "file" in second.stats and "file" not in first.stats:
            second, first, note = _on_common_times(second, first, "second", "first")
        else:
            first, second, note = _on_common_times(first, second)
    reject_other_times(first, second)
    with np.errstate(invalid="ignore"):  # infinity minus infinity
        values = _difference(first, second)
    gaps = np.zeros(values.shape, dtype=bool)
    for run in (first, second):
        gaps |= np.isnan(run.values) & ("file" in run.stats)
    if gaps.all(axis=0).any():
        name = names[int(np.argmax(gaps.all(axis=0)))]
        raise UsageError(f"{name} has no measured value there; leave it out: without=['{name}']")
    sizes, small = (_nominals(first),) * 2 if by_nominal else sizes_of(first, second)
    scaled = np.abs(values) / sizes
    scaled = np.where(gaps, 0.0, np.where(np.isnan(scaled), np.inf, scaled))  # NaN never agrees
    differences = []
    for name, own, size in zip(names, scaled.T, sizes.tolist(), strict=True):
        at = int(np.argmax(own))
        differences.append(Difference(name, float(own[at]), float(first.time[at]), size))
    differences.sort(key=lambda difference: -difference.scaled)
    left_out = f"gaps left out: {gaps.sum()}" if gaps.any() else ""
    unsure = _unsure(names, scaled, sizes, small, bound)
    note = one_note(note, left_out, unsure)
    title = f"{labels[1]} minus {labels[0]}"
    residuals = Trajectory(title, first.time, runs[0].columns, values)
    return Comparison(*labels, tuple(differences), residuals, runs, bound, note)


def _difference(first: Trajectory, second: Trajectory) -> Vector:
    """Return second minus first; rounding decides which side of an event a row at its time has."""
    values = second.values - first.values
    for run, other, sign in ((first, second, 1), (second, first, -1)):
        for event in (event for event in run.events if event.before):
            for row in rows_at(run, event.time):
                for side in (event.before, event.after):
                    left = sign * (other.values[row] - [side[name] for name in run.names])
                    values[row] = np.where(np.abs(left) < np.abs(values[row]), left, values[row])
    return values


def rows_at(run: Trajectory, time: float) -> list[int]:
    """Return the rows of a run that may hold either side of an event at a time, s."""
    reach = _ONE_INSTANT * (run.time[-1] - run.time[0])
    return np.flatnonzero(np.abs(run.time - time) <= reach).tolist()


def _nominals(run: Trajectory) -> Vector:
    return np.array([column.nominal for column in run.columns])


def sizes_of(first: Trajectory, second: Trajectory) -> tuple[Vector, Vector]:
    """Return what differences are divided by, and the largest values of small states.

    The first are nominal values, or how large small states become, unless that may be errors; the
    second include the latter, and are nominal values for all others.
    """
    sizes = _nominals(first)
    states = np.array([column.is_state for column in first.columns])
    own = states.copy()
    for run in (first, second):
        own &= _nominals(run) == NOT_GIVEN
    largest = np.maximum(*(np.nan_to_num(np.abs(r.values)).max(axis=0) for r in (first, second)))
    relative, zero = Tolerance(first.stats.get("relative_tolerance") or Tolerance.relative).pair
    small = np.where(own & (largest > zero), np.minimum(largest, sizes), sizes)
    # what the other states make of a state that is 0 by symmetry is no smaller than their errors
    zero = max(zero, _LARGEST_ERROR * relative * largest[states].max(initial=0.0))
    return np.where(largest > zero, small, sizes), small


def _unsure(
    names: Sequence[str], scaled: Vector, sizes: Vector, small: Vector, bound: float
) -> str:
    """Return which small state differs most for its own size; empty if none is above a bound."""
    most = np.where(small < sizes, scaled.max(axis=0) * sizes / small, 0.0)
    place = int(most.argmax())
    if most[place] <= bound:
        return ""
    return (
        f"{names[place]} differs by {most[place]:.1g} of its largest value {small[place]:.1g}, "
        "which the errors of larger states may reach: set its nominal value"
    )


def _on_common_times(
    first: Trajectory, second: Trajectory, one: str = "first", other: str = "second"
) -> tuple[Trajectory, Trajectory, str]:
    """Return both runs at the times of the first that both cover, and a note on the method."""
    begin = max(first.time[0], second.time[0])
    end = min(first.time[-1], second.time[-1])
    inside = np.flatnonzero((first.time >= begin) & (first.time <= end))
    if not inside.size:
        raise UsageError(
            f"{_label(first)} and {_label(second)} have no time in common: they run from "
            f"{first.time[0]:g} to {first.time[-1]:g} s and from {second.time[0]:g} to "
            f"{second.time[-1]:g} s"
        )
    time = first.time[inside]
    part = replace(first, time=time, values=first.values[inside])
    if second.again is not None:
        how = "computed again there"
        resampled = second.at(time)
    else:
        resampled, estimate = second.interpolated(time)
        scaled = max(
            e / first.column(n).nominal for n, e in zip(second.names, estimate, strict=True)
        )
        how = f"interpolated, with an estimated error of {scaled:.1e}"
    note = f"compared at {len(time)} times of the {one} run, {time[0]:g} ... {time[-1]:g} s; "
    return part, resampled, note + f"the {other} run is {how}"


def _up_to_the_stop(
    first: Trajectory, second: Trajectory, bound: float
) -> tuple[Trajectory, Trajectory]:
    """Leave out the last row if both runs were stopped, one just before an output time.

    The time at which a motion just reaches a condition is off by the root of the motion's error.
    """
    n, stopped = apart(first, second), "stop" in first.stats and "stop" in second.stats
    if not (n and stopped and max(len(first), len(second)) - n < 3):
        return first, second
    if abs(first.time[-1] - second.time[-1]) > np.sqrt(bound) * np.ptp(first.time):
        return first, second
    first, second = (replace(r, time=r.time[:n], values=r.values[:n]) for r in (first, second))
    return first, second


def apart(first: Trajectory, second: Trajectory) -> int | None:
    """Return the index from which on two runs have different output times; None if the same."""
    times = [run.time[: min(len(first), len(second))] for run in (first, second)]
    since = np.abs(first.time - first.time[:1]).max(initial=0.0)
    rounding = 4 * np.spacing(np.abs(times[0]))
    apart = np.abs(times[0] - times[1]) > np.maximum(1e-9 * since, rounding)
    if apart.any():
        return int(np.argmax(apart))
    return None if len(first) == len(second) else len(apart)


def reject_other_times(first: Trajectory, second: Trajectory) -> None:
    """Reject two runs with different output times.

    Raises:
        UsageError: They have different output times, or none.
    """
    if not len(first):
        raise UsageError(f"{_label(first)} has no output times; there is nothing to compare")
    if (i := apart(first, second)) is not None:
        raise UsageError(
            f"{_label(first)} and {_label(second)} have different output times from index {i} on "
            f"({len(first)} and {len(second)} in all); run both with the same start_time, "
            "stop_time and output_interval"
        )


def _label(run: Trajectory) -> str:
    solver = run.stats.get("solver")
    return f"{run.model} [{solver}]" if solver else run.model


class Verdict(StrEnum):
    """Result of a comparison."""

    OK = "ok"
    COARSE = "reference too coarse"  # the error of the reference may explain the difference
    DIFFERS = "DIFFERS"
    FAILED = "FAILED"  # one of the runs failed


@dataclass(frozen=True)
class Check:
    """One comparison of two runs, with the cost of the second.

    Attributes:
        model: `MODEL/FORMULATION` of the second run.
        backend: Backend of the second run, or how a coupled system was simulated.
        against: Name of the first run.
        comparison: The differences; None if a run failed.
        stats: Statistics of the second run: wall_time, s; rhs_calls.
        failure: Why the run failed; empty if it did not.
        left_out: Names that are not compared since they have different meanings, with the reason.
        doubt: Estimated error of the first run, divided as the differences are; 0 if it is unknown
            or does not matter.
        note: Steps that were taken to explain a difference, or the remedy to try.
    """

    model: str
    backend: Backend | str
    against: str
    comparison: Comparison | None
    stats: Mapping[str, Any] = field(default_factory=dict)
    failure: str = ""
    left_out: Mapping[str, str] = field(default_factory=dict)
    doubt: float = 0.0
    note: str = ""

    @property
    def verdict(self) -> Verdict:
        """Result of the comparison."""
        if self.comparison is None:
            return Verdict.FAILED
        if self.comparison.agrees:
            return Verdict.OK
        nearest = self.comparison.worst.scaled - self.doubt
        return Verdict.COARSE if nearest <= self.comparison.bound else Verdict.DIFFERS

    @property
    def wall_time(self) -> float | None:
        """Elapsed time of the second run without compilation, s; None if there is no run."""
        wall: float | None = self.stats.get("wall_time")
        return None if wall is None else wall - (self.stats.get("compile_time") or 0.0)

    @property
    def reason(self) -> str:
        """Why the run failed; else the note."""
        return self.failure or self.note

    def row(self) -> dict[str, Any]:
        """Return the check as a row of a table, for JSON too."""
        compared = self.comparison
        worst = None if compared is None else compared.worst
        none = np.empty(0), np.empty(0)
        ours, others = none if compared is None else compared.event_times
        same = len(ours) == len(others)
        return {
            "model": self.model,
            "backend": self.backend,
            "against": self.against,
            "variables": None if compared is None else len(compared.differences),
            "worst": worst and worst.name,
            "difference": worst and worst.scaled,
            "at": worst and worst.time,
            "events": (f"{len(ours)}" if same else f"{len(ours)}, {len(others)}")
            if len(ours) or len(others)
            else None,
            "event_shift": float(np.abs(ours - others).max()) if same and len(ours) else None,
            "bound": None if compared is None else compared.bound,
            "verdict": str(self.verdict),
            "wall_time": self.wall_time,
            "rhs_calls": self.stats.get("rhs_calls"),
            "left_out": " ".join(self.left_out) or None,
            "reason": self.reason or None,
        }
