"""Two trajectories on one grid: how far apart they are, and where."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cosim.errors import UsageError
from cosim.model.values import number
from cosim.series.interpolation import resample as interpolated
from cosim.text.tables import MOST_LINES, html_table, text_table
from cosim.trajectory import Trajectory


@dataclass(frozen=True)
class Difference:
    """The largest difference of one variable, divided by its nominal value, and its time [s]."""

    name: str
    scaled: float
    time: float


@dataclass(frozen=True)
class Comparison:
    """Differences of two runs, variable by variable, the largest first.

    Attributes:
        first, second: What was compared.
        differences: One per common variable, falling.
        bound: Up to where the scaled difference is agreement.
        note: How other output times were met; empty where both runs have the same ones.

    Example:
        >>> import cosim
        >>> a, b = (cosim.simulate("crank_shaft", stop_time=1, solver=s) for s in ("cvodes", "erk"))
        >>> cosim.compare(a, b).agrees
        True
    """

    first: str
    second: str
    differences: tuple[Difference, ...]
    bound: float
    note: str = ""

    @property
    def worst(self) -> Difference:
        """The largest difference."""
        return self.differences[0]

    @property
    def agrees(self) -> bool:
        """Whether every variable stays within the bound."""
        return self.worst.scaled <= self.bound

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per variable, the largest difference first."""
        return [{"name": d.name, "difference": d.scaled, "at [s]": d.time} for d in self]

    def __iter__(self) -> Iterator[Difference]:
        return iter(self.differences)

    def __str__(self) -> str:
        worst = self.worst
        verdict = "agree" if self.agrees else "DIFFER"
        text = (
            f"{self.first} and {self.second} {verdict}: {worst.name} by {worst.scaled:.2e} of its "
            f"nominal value at {worst.time:g} s (bound {self.bound:g})"
        )
        return f"{text}; {self.note}" if self.note else text

    def __repr__(self) -> str:
        return f"{self}\n{text_table(self.rows(), most=MOST_LINES - 1)}"

    def _repr_html_(self) -> str:
        return html_table(self.rows(), str(self))


def compare(
    first: Trajectory,
    second: Trajectory,
    *,
    bound: float = 1e-6,
    without: Collection[str] = (),
    resample: bool = True,
) -> Comparison:
    """Compare the variables that two runs have in common.

    Where the runs have other output times, the second one is taken at those of the first one that
    lie within both, and `note` says how: computed again, or interpolated with an estimated error.

    Args:
        first, second: Two runs; nominal values are the first one's.
        bound: Largest scaled difference that counts as agreement (1).
        without: Names to leave out.
        resample: Whether runs with other output times are compared, and not refused.

    Raises:
        ParameterError: The bound is not a positive number.
        UsageError: The runs have no variable in common, one in another unit, or no time in common.

    Example:
        >>> import cosim
        >>> first = cosim.simulate("crank_shaft", stop_time=1)
        >>> second = cosim.simulate("crank_shaft", stop_time=1, solver="idas")
        >>> compare(first, second, bound=1e-5).agrees
        True
    """
    for run in (first, second):
        if not isinstance(run, Trajectory):
            raise UsageError.of_type("compare", run, "two results of simulate or simulate_fmu")
    number("compare", "bound", bound, positive=True)
    names = [name for name in first.names if name in second.names and name not in without]
    if not names:
        raise UsageError(f"{first.model} and {second.model} have no variable in common")
    labels = _label(first), _label(second)
    for name in names:
        units = first.column(name).unit, second.column(name).unit
        if units[0] != units[1]:
            raise UsageError(
                f"{name} is in {units[0]} in {labels[0]}, in {units[1]} in the other; of a file, "
                "say what it is in: read_csv(path, like=run), or units={...}"
            )
    note = ""
    if resample and len(first) and len(second) and not _same_times(first, second):
        first, second, note = _on_common_times(first.select(names), second.select(names))
    refuse_other_times(first, second)
    differences = []
    for name in names:
        with np.errstate(invalid="ignore"):  # infinity less infinity
            gap = np.abs(first[name] - second[name]) / first.column(name).nominal
        gap = np.where(np.isnan(gap), np.inf, gap)  # what is not a number agrees with nothing
        at = int(np.argmax(gap))
        differences.append(Difference(name, float(gap[at]), float(first.time[at])))
    differences.sort(key=lambda difference: -difference.scaled)
    return Comparison(*labels, tuple(differences), bound, note)


def _on_common_times(first: Trajectory, second: Trajectory) -> tuple[Trajectory, Trajectory, str]:
    """Return two runs at the times of the first one that both cover, and how that was done."""
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
        met = second.at(time)
    else:
        values, estimate = interpolated(second.time, second.values, time)
        met = replace(second, time=time, values=values)
        scaled = max(
            e / first.column(n).nominal for n, e in zip(second.names, estimate, strict=True)
        )
        how = f"interpolated, with an estimated error of {scaled:.1e}"
    note = f"compared at {len(time)} times of the first run, {time[0]:g} ... {time[-1]:g} s; "
    return part, met, note + f"the second one is {how}"


def _same_times(first: Trajectory, second: Trajectory) -> bool:
    if len(first) != len(second):
        return False
    slack = 1e-9 * max(1.0, float(np.abs(first.time).max()))
    return float(np.abs(first.time - second.time).max()) <= slack


def refuse_other_times(first: Trajectory, second: Trajectory) -> None:
    """Refuse two runs that cannot be subtracted row by row.

    Raises:
        UsageError: They have other output times, or none.
    """
    if not len(first):
        raise UsageError(f"{_label(first)} has no output times; there is nothing to compare")
    if len(first) != len(second):
        raise UsageError(
            f"other output times: {_label(first)} has {len(first)} output times, {_label(second)} "
            f"has {len(second)}; run both with one start_time, stop_time and output_interval"
        )
    apart = np.abs(first.time - second.time)
    if apart.max() > 1e-9 * max(1.0, float(np.abs(first.time).max())):
        i = int(np.argmax(apart))
        raise UsageError(
            f"{_label(first)} and {_label(second)} have other output times from the {i}th on "
            f"({first.time[i]:g} s and {second.time[i]:g} s); run both with one output_interval"
        )


def _label(run: Trajectory) -> str:
    solver = run.stats.get("solver")
    return f"{run.model} [{solver}]" if solver else run.model
