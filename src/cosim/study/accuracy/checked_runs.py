"""Runs of a front's configurations, and what two of them by different solvers say of each other."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from cosim.study.tradeoff.measurement import Measurement
from cosim.trajectory import Trajectory
from cosim.verify.comparison import Difference, compare

CHECK = 100.0  # by which the run that checks another is to be more accurate
Solve = Callable[..., Trajectory]  # of `solver` and `relative_tolerance`


@dataclass(frozen=True)
class Done:
    """A run, and what the front says of its configuration."""

    measured: Measurement
    run: Trajectory

    @property
    def solver(self) -> str:
        """Name of the solver."""
        return self.measured.configuration.solver

    @property
    def promised(self) -> float:
        """Error by the front, in nominal values."""
        return promised_error(self.measured)

    def __str__(self) -> str:
        return label(self.measured)


@dataclass(frozen=True)
class Pair:
    """Two runs by different solvers; the second one checks the first."""

    first: Done
    second: Done

    @property
    def worst(self) -> Difference:
        """Where they are farthest apart."""
        return compare(self.first.run, self.second.run).worst

    @property
    def better(self) -> Done:
        """The one that is promised to be more accurate: the second, unless the first is at best."""
        return min(self.second, self.first, key=lambda done: done.promised)

    @property
    def facts(self) -> dict[str, object]:
        """What `stats` tell of the first one's error."""
        worst = self.worst
        return {
            "configuration": str(self.first),
            "promised_error": self.first.promised,
            "checked_by": str(self.second),
            "error_estimate": worst.scaled,
            "error_estimate_of": worst.name,
        }


def run_of(measured: Measurement, solve: Solve) -> Done:
    """Run a configuration."""
    configuration = measured.configuration
    run = solve(solver=configuration.solver, relative_tolerance=configuration.tolerance)
    return Done(measured, run)


def label(measured: Measurement) -> str:
    """Return solver and tolerance in words."""
    configuration = measured.configuration
    return f"{configuration.solver} at {configuration.tolerance:g}"


def labelled(run: Trajectory, facts: dict[str, object]) -> Trajectory:
    """Return a run with more `stats`."""
    return replace(run, stats={**run.stats, **facts})


def promising(cheapest_first: Sequence[Measurement], error: float) -> Measurement | None:
    """Return the cheapest configuration with such an error, else the most accurate one."""
    good = (m for m in cheapest_first if promised_error(m) <= error)
    return next(good, cheapest_first[-1] if cheapest_first else None)


def promised_error(measured: Measurement) -> float:
    """Return the error of a configuration on a front, in nominal values."""
    assert measured.error is not None  # the front has none without
    return measured.error
