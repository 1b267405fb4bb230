"""What is kept of every run: trajectories, numbers by name, and statistics over all runs."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from cosim.arrays import Vector
from cosim.errors import UnknownName, UsageError

REDUCTIONS = ("final", "max", "min", "mean", "rms", "first")
WHOLE = ("trajectories", "statistics")
_REDUCTION = re.compile(r"\s*(\w+)\s*(?:\(\s*([\w.\[\]]+)\s*(?:,\s*([-+.\deE]+)\s*)?\))?\s*")


@dataclass(frozen=True)
class Reduction:
    """One number of each run.

    Attributes:
        kind: One of `KINDS`.
        variable: Of which output.
        level: Of "first": the value that the output crosses.
    """

    kind: str
    variable: str
    level: float | None = None

    @property
    def name(self) -> str:
        """What the number is called."""
        at = "" if self.level is None else f"_{self.level:g}"
        return f"{self.variable}_{self.kind}{at}"

    @property
    def meaning(self) -> str:
        """What the number is, in words."""
        if self.kind == "first":
            return f"time when {self.variable} first crosses {self.level:g}"
        words = {"final": "final value", "rms": "root of the mean square over time"}
        return f"{words.get(self.kind, self.kind)} of {self.variable}"

    def of(self, time: Vector, values: Vector) -> Vector:
        """Return the number of each run, (runs,), from its values at times, (runs, times)."""
        if self.kind == "final":
            return values[:, -1]
        if self.kind in ("mean", "rms"):
            powers = values if self.kind == "mean" else values * values
            if len(time) > 1:
                mean = np.trapezoid(powers, time, axis=1) / (time[-1] - time[0])
            else:
                mean = powers[:, 0]
            result: Vector = mean if self.kind == "mean" else np.sqrt(mean)
            return result
        if self.kind == "first":
            return _first(time, values - (self.level or 0.0))
        extreme: Vector = getattr(np, self.kind)(values, axis=1)
        return extreme


def _first(time: Vector, heights: Vector) -> Vector:
    """Return when each row first passes zero, between its points by a straight line."""
    before, after = heights[:, :-1], heights[:, 1:]
    with np.errstate(invalid="ignore"):
        passes = (before == 0) | (before * after < 0)
    passes = np.concatenate((passes, heights[:, -1:] == 0), axis=1)
    at = passes.argmax(axis=1)
    rows = np.arange(len(heights))
    nearest = np.minimum(at + 1, heights.shape[1] - 1)
    left, right = heights[rows, at], heights[rows, nearest]
    with np.errstate(invalid="ignore", divide="ignore"):
        part = np.where(left == 0, 0.0, left / (left - right))
    found = time[at] + part * (time[nearest] - time[at])
    return np.where(passes.any(axis=1), found, np.nan)


@dataclass(frozen=True)
class Keep:
    """What is kept of the runs of a sweep."""

    trajectories: bool
    statistics: bool
    reductions: tuple[Reduction, ...]

    def words(self) -> list[str]:
        """Return what is kept as `keep_from` reads it."""
        whole = [word for word in WHOLE if getattr(self, word)]
        calls = [
            f"{r.kind}({r.variable}{'' if r.level is None else f', {r.level!r}'})"
            for r in self.reductions
        ]
        return whole + calls


def keep_from(words: Iterable[str], outputs: Sequence[str]) -> Keep:
    """Read words: "trajectories", "final" of all outputs, "max(phi)" of one, "first(phi, 1)".

    Raises:
        UnknownName: Something is nothing that can be kept, or no output.
        UsageError: "first" has no level, or something else has one.
    """
    if isinstance(words, str):
        raise UsageError.of_type("sweep: keep", words, "a list, e.g. ['final', 'max(phi)']")
    whole, reductions = set(), list[Reduction]()
    for word in words:
        match = _REDUCTION.fullmatch(word)
        kind, variable, level = match.groups() if match else (word, None, None)
        if kind in WHOLE and variable is None:
            whole.add(kind)
            continue
        if kind not in REDUCTIONS:
            raise UnknownName.among("sweep", "thing to keep", word, (*WHOLE, *REDUCTIONS))
        if (kind == "first") != (level is not None):
            raise UsageError(f"sweep: {word}: write e.g. first(phi, 0.5), and others as max(phi)")
        if variable is not None and variable not in outputs:
            raise UnknownName.among("sweep", "output", variable, outputs)
        number = None if level is None else float(level)
        for name in outputs if variable is None else (variable,):
            reductions.append(Reduction(kind, name, number))
    once = tuple(dict.fromkeys(reductions))
    return Keep("trajectories" in whole, "statistics" in whole, once)
