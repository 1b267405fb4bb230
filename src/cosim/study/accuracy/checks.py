"""Runs of a front's configurations, and what two of them by different solvers say of each other."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cosim.study.tradeoff.measurement import Measurement
from cosim.trajectory import Trajectory
from cosim.verify.comparison import Difference, compare

SolveAt = Callable[..., Trajectory]  # of `solver` and `relative_tolerance`


@dataclass(frozen=True)
class ErrorCheck:
    """What is known of a run's error.

    Attributes:
        configuration: What ran.
        promised_error: By the front, in nominal values.
        checked_by: Another method.
        error_estimate: How far the two are apart, in nominal values.
        error_estimate_of: The variable that is farthest apart.
    """

    configuration: str
    promised_error: float
    checked_by: str
    error_estimate: float
    error_estimate_of: str

    @classmethod
    def of(cls, run: Trajectory) -> "ErrorCheck":
        """Return what the `stats` of a run tell."""
        return cls(**{name: run.stats[name] for name in cls.__dataclass_fields__})

    @classmethod
    def exact(cls, run: Trajectory) -> "ErrorCheck":
        """Return what is known of a run without states, which no solver touches."""
        scaled = np.spacing(np.abs(run.values).max(axis=0)) / [c.nominal for c in run.columns]
        worst = int(np.argmax(scaled))
        error = float(scaled[worst])
        return cls("no integration", error, "double precision", error, run.names[worst])


@dataclass(frozen=True)
class Done:
    """A run, and what the front says of its configuration."""

    measured: Measurement
    run: Trajectory

    @classmethod
    def of(cls, measured: Measurement, solve: SolveAt) -> "Done":
        """Run a configuration."""
        way = measured.configuration
        return cls(measured, solve(solver=way.solver, relative_tolerance=way.tolerance))

    @property
    def solver(self) -> str:
        """Name of the solver."""
        return self.measured.configuration.solver

    @property
    def promised(self) -> float:
        """Error by the front, in nominal values."""
        return self.measured.known_error

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
    def check(self) -> ErrorCheck:
        """What they tell of the first one's error."""
        worst, first = self.worst, self.first
        return ErrorCheck(str(first), first.promised, str(self.second), worst.scaled, worst.name)


def label(measured: Measurement) -> str:
    """Return solver and tolerance in words."""
    configuration = measured.configuration
    return f"{configuration.solver} at {configuration.tolerance:g}"


def with_check(run: Trajectory, goal: Mapping[str, Any], check: ErrorCheck) -> Trajectory:
    """Return a run whose `stats` tell what was asked for, and what is known of its error."""
    return replace(run, stats={**run.stats, **goal, **vars(check)})
