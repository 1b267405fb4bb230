"""Two trajectories on one grid: how far apart they are, and where."""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from cosim.errors import UsageError
from cosim.model.values import number
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
    """

    first: str
    second: str
    differences: tuple[Difference, ...]
    bound: float

    @property
    def worst(self) -> Difference:
        """The largest difference."""
        return self.differences[0]

    @property
    def agrees(self) -> bool:
        """Whether every variable stays within the bound."""
        return self.worst.scaled <= self.bound

    def __str__(self) -> str:
        worst = self.worst
        verdict = "agree" if self.agrees else "DIFFER"
        return (
            f"{self.first} and {self.second} {verdict}: {worst.name} by {worst.scaled:.2e} of its "
            f"nominal value at {worst.time:g} s (bound {self.bound:g})"
        )


def compare(
    first: Trajectory,
    second: Trajectory,
    *,
    bound: float = 1e-6,
    without: Collection[str] = (),
) -> Comparison:
    """Compare the variables that two runs have in common, at the times of both.

    Args:
        first, second: Two runs on the same output times; nominal values are the first one's.
        bound: Largest scaled difference that counts as agreement (1).
        without: Names to leave out.

    Raises:
        ParameterError: The bound is not a positive number.
        UsageError: The runs have no variable in common, one in another unit, no output times or
            other ones.
    """
    for run in (first, second):
        if not isinstance(run, Trajectory):
            raise UsageError.of_type("compare", run, "two results of simulate or simulate_fmu")
    number("compare", "bound", bound, positive=True)
    names = [name for name in first.names if name in second.names and name not in without]
    if not names:
        raise UsageError(f"{first.model} and {second.model} have no variable in common")
    _refuse_other_times(first, second)
    for name in names:
        units = first.column(name).unit, second.column(name).unit
        if units[0] != units[1]:
            raise UsageError(
                f"{name} is in {units[0]} in {_label(first)}, in {units[1]} in the other"
            )
    differences = []
    for name in names:
        with np.errstate(invalid="ignore"):  # infinity less infinity
            gap = np.abs(first[name] - second[name]) / first.column(name).nominal
        gap = np.where(np.isnan(gap), np.inf, gap)  # what is not a number agrees with nothing
        at = int(np.argmax(gap))
        differences.append(Difference(name, float(gap[at]), float(first.time[at])))
    differences.sort(key=lambda difference: -difference.scaled)
    return Comparison(_label(first), _label(second), tuple(differences), bound)


def _refuse_other_times(first: Trajectory, second: Trajectory) -> None:
    if not len(first):
        raise UsageError(f"{_label(first)} has no output times; there is nothing to compare")
    if len(first) != len(second):
        raise UsageError(
            f"{_label(first)} has {len(first)} output times, {_label(second)} has {len(second)}; "
            "run both with one start_time, stop_time and output_interval"
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
