"""Reductions: numbers of each run, and mean, variance and extremes over all runs."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cosim.arrays import Truths, Vector
from cosim.errors import UnknownName, UsageError
from cosim.series.curves import Curves
from cosim.trajectory import Trajectory

REDUCTIONS = ("final", "max", "min", "mean", "rms", "first")
WHOLE = ("trajectories", "statistics")
_REDUCTION = re.compile(r"\s*(\w+)\s*(?:\(\s*(.+?)\s*(?:,\s*([-+.\deE]+)\s*)?\))?\s*")


@dataclass(frozen=True)
class Reduction:
    """One number of each run.

    Attributes:
        kind: One of `REDUCTIONS`.
        variable: The output.
        level: For "first": the value that the output crosses.
    """

    kind: str
    variable: str
    level: float | None = None

    @property
    def name(self) -> str:
        """Name of the number, e.g. `phi_max`."""
        return "_".join([self.variable, self.kind, *([] if self.level is None else [self._digits])])

    @property
    def _digits(self) -> str:
        """The level; two of them never have the same digits."""
        assert self.level is not None
        short = f"{self.level:g}"
        return short if float(short) == self.level else repr(self.level)

    @property
    def meaning(self) -> str:
        """Meaning of the number, e.g. "max of phi"."""
        if self.kind == "first":
            return f"time when {self.variable} first crosses {self._digits}"
        words = {"final": "final value", "rms": "root mean square over time"}
        return f"{words.get(self.kind, self.kind)} of {self.variable}"

    def unit(self, of_variable: str) -> str:
        """Return the unit of the number of a variable with this unit."""
        return "s" if self.kind == "first" else of_variable

    @property
    def of_motion(self) -> bool:
        """Whether the number depends on what is between the output times."""
        return self.kind != "final"

    def of(self, known: Curves, curve: int) -> float:
        """Return the number of one curve of a run."""
        if self.kind == "first":
            return known.first(curve, self.level or 0.0)
        if self.kind == "final":
            return float(known.rows.values[-1, curve])
        if self.kind in ("max", "min"):
            found = known.extremes.high if self.kind == "max" else known.extremes.low
        else:
            found = known.mean() if self.kind == "mean" else known.rms()
        return float(found[curve])


Function = Callable[[Trajectory], Mapping[str, float]]  # of users: numbers of one run by name


@dataclass(frozen=True)
class Keep:
    """What a sweep stores of its runs.

    Attributes:
        trajectories: Whether it stores every output at every time.
        statistics: Whether it computes mean, variance and extremes over the runs.
        reductions: Numbers of each run.
        functions: Users' functions that return further numbers; as bytes for other processes.
    """

    trajectories: bool
    statistics: bool
    reductions: tuple[Reduction, ...]
    functions: tuple[Function | bytes, ...] = ()

    def words(self) -> list[str]:
        """Return all but the functions as `keep_from` reads it."""
        whole = [word for word in WHOLE if getattr(self, word)]
        calls = [
            f"{r.kind}({r.variable}{'' if r.level is None else f', {r.level!r}'})"
            for r in self.reductions
        ]
        return whole + calls


def keep_from(items: Iterable[str | Function], outputs: Sequence[str]) -> Keep:
    """Read "trajectories", "final" of all outputs, "max(phi)" of one, "first(phi, 1)", functions.

    Raises:
        UnknownName: A word is unknown, or names no output.
        UsageError: "first" has no level, or another word has one.
    """
    if isinstance(items, str):
        raise UsageError.of_type("sweep: keep", items, "a list, e.g. ['final', 'max(phi)']")
    whole, reductions, functions = set(), list[Reduction](), list[Function]()
    for word in items:
        if not isinstance(word, str):
            if not callable(word):
                raise UsageError.of_type("sweep: keep", word, "words or functions of a Trajectory")
            functions.append(word)
            continue
        match = _REDUCTION.fullmatch(word)
        kind, variable, level = match.groups() if match else (word, None, None)
        if kind in WHOLE and variable is None:
            whole.add(kind)
            continue
        if kind not in REDUCTIONS:
            raise UnknownName.among("sweep", "result to store", word, (*WHOLE, *REDUCTIONS))
        if (kind == "first") != (level is not None):
            raise UsageError(f"sweep: {word}: write e.g. first(phi, 0.5), and others as max(phi)")
        if variable is not None and variable not in outputs:
            raise UnknownName.among("sweep", "output", variable, outputs)
        try:
            number = None if level is None else float(level)
        except ValueError:
            raise UsageError(f"sweep: {word}: '{level}' is no number; write e.g. 0.5") from None
        for name in outputs if variable is None else (variable,):
            reductions.append(Reduction(kind, name, number))
    once = tuple(dict.fromkeys(reductions))
    return Keep("trajectories" in whole, "statistics" in whole, once, tuple(functions))


@dataclass(frozen=True, eq=False)
class Moments:
    """Sums over complete runs that can be merged: number, mean, squared deviations, extremes.

    Attributes:
        count: Number of complete runs that reach each time, (times, outputs).
        mean, squares, low, high: Mean, sum of squared deviations from it, extremes; 0 and infinite
            where there is no run; (times, outputs).
    """

    count: Vector
    mean: Vector
    squares: Vector
    low: Vector
    high: Vector


@dataclass(frozen=True, eq=False)
class Statistics:
    """Mean, variance and extremes of outputs over the complete runs of a sweep.

    Attributes:
        names: The outputs.
        moments: Of all of them.
    """

    names: tuple[str, ...]
    moments: Moments

    @property
    def count(self) -> int:
        """Number of complete runs."""
        return int(self.moments.count.max(initial=0))

    def mean(self, name: str) -> Vector:
        """Return the mean over the runs, (times,)."""
        return self._of(name, self.moments.mean)

    def variance(self, name: str) -> Vector:
        """Return the variance of the runs, its divisor one less than their number, (times,)."""
        return self._of(name, self.moments.squares / np.maximum(self.moments.count - 1, 1))

    def minimum(self, name: str) -> Vector:
        """Return the least value, (times,)."""
        return self._of(name, self.moments.low)

    def maximum(self, name: str) -> Vector:
        """Return the largest value, (times,)."""
        return self._of(name, self.moments.high)

    def _of(self, name: str, table: Vector) -> Vector:
        UnknownName.reject("statistics", "output", self.names, name)
        reached = np.where(self.moments.count > 0, table, np.nan)
        return reached[:, self.names.index(name)]


def moments_of(values: Vector, complete: Truths) -> Moments:
    """Return the moments of the complete runs among trajectories, (runs, times, outputs)."""
    chosen = values[complete]
    there = ~np.isnan(chosen)  # an event may have ended a run
    count = there.sum(axis=0).astype(float)
    mean = np.where(there, chosen, 0.0).sum(axis=0) / np.maximum(count, 1)
    squares = (np.where(there, chosen - mean, 0.0) ** 2).sum(axis=0)
    low = np.where(there, chosen, np.inf).min(axis=0, initial=np.inf)
    high = np.where(there, chosen, -np.inf).max(axis=0, initial=-np.inf)
    return Moments(count, mean, squares, low, high)


def merged(a: Moments, b: Moments) -> Moments:
    """Return the moments of the runs of both.

    References:
        Chan, Golub & LeVeque, The American Statistician 37, 1983,
        doi:10.1080/00031305.1983.10483115.
    """
    count, shift = a.count + b.count, b.mean - a.mean
    share = b.count / np.maximum(count, 1)
    mean = a.mean + shift * share
    squares = a.squares + b.squares + shift**2 * a.count * share
    return Moments(count, mean, squares, np.minimum(a.low, b.low), np.maximum(a.high, b.high))
