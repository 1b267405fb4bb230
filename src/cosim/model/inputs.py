"""Input time series: linear between samples, held constant outside, with jumps; from CSV files."""

import os
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import ArrayLike

from casadi_models.dae import Dae
from cosim.arrays import Vector, reals
from cosim.errors import ParameterError, UnknownName, UsageError, naming_arguments_of
from cosim.memo import digest_of
from cosim.series.csv_file import Words, read_samples
from cosim.series.samples import Column

SAME_TIME = 1e-12  # relative distance of times that differ by rounding only
_SHORT = 0.1  # of the middle length of the intervals between samples


@naming_arguments_of
@dataclass(frozen=True, eq=False)  # arrays have no single truth value
class InputSeries:
    """Samples of inputs over time, in SI units.

    A time that stands twice is a jump: its first sample ends what comes before, its second one
    begins what comes after, as in the input files of FMPy.

    Attributes:
        names: The inputs.
        time: Sample times that do not fall, s, (m,), m > 1.
        values: One column per input, (m, len(names)).
        spans: First and last sample time, s, of inputs whose samples cover a part only.

    Raises:
        ParameterError: The shapes do not fit, a name occurs twice, a time three times, a time is
            earlier than the one before it, or a number is not finite.

    Example:
        >>> InputSeries(("torque",), [0.0, 1.0], [[0.0], [2.0]]).at([0.5, 3.0])
        array([[1., 2.]])
        >>> step = InputSeries(("torque",), [0, 1, 1, 2], [[0], [0], [5], [5]])
        >>> step.at([0.9, 1.0]), step.before([1.0])
        (array([[0., 5.]]), array([[0.]]))
    """

    names: tuple[str, ...]
    time: Vector
    values: Vector
    spans: Mapping[str, tuple[float, float]] = field(default_factory=dict, kw_only=True)

    def __post_init__(self) -> None:
        time, values = map(reals, (self.time, self.values))
        if time.ndim != 1 or len(time) < 2 or values.shape != (len(time), len(self.names)):
            raise ParameterError(
                f"input series: time has shape {time.shape}, values have {values.shape}, for "
                f"{len(self.names)} inputs; give shapes (m,) and (m, {len(self.names)}), m > 1"
            )
        if not self.names or len(set(self.names)) < len(self.names):
            raise ParameterError("input series: name every input, each of them once")
        if not (np.isfinite(time).all() and np.isfinite(values).all()):
            raise ParameterError("input series: a number is not finite; give finite numbers")
        if (found := _disorder(time)) is not None:
            raise ParameterError(
                f"input series: time {found[0]}: {found[1]}; give times that increase, one twice "
                "for a jump"
            )
        self._join_at_jumps(time)
        for what, array in (("time", time), ("values", values)):
            array.setflags(write=False)
            object.__setattr__(self, what, array)

    @staticmethod
    def _join_at_jumps(time: Vector) -> None:
        """Make two times that differ by rounding equal."""
        gaps = np.diff(time, prepend=-np.inf, append=np.inf)
        for k in np.flatnonzero(gaps <= 4 * np.spacing(np.abs(np.append(time, 0)))).tolist():
            if gaps[k - 1] > 0 and gaps[k + 1] > 0:  # no time stands three times
                time[k], gaps[k] = time[k - 1], 0

    @cached_property
    def digest(self) -> str:
        """Hash of the samples."""
        names = repr((self.names, dict(self.spans))).encode()
        return digest_of((names, self.time.tobytes(), self.values.tobytes()))

    @cached_property
    def breaks(self) -> Vector:
        """Times at which solvers start afresh, s: jumps, and both ends of short intervals.

        Elsewhere no step is longer than the shortest interval between samples.
        """
        gaps = np.diff(self.time)
        usual = np.median(gaps[gaps > 0]) if gaps.any() else np.inf
        short = np.flatnonzero(gaps < _SHORT * usual)
        return np.unique(self.time[np.concatenate((short, short + 1))])

    @cached_property
    def jumps(self) -> Vector:
        """The times that stand twice, s."""
        found: Vector = self.time[1:][np.diff(self.time) == 0]
        return found

    def at(self, times: Vector) -> Vector:
        """Return the values at some times, (len(names), n); at a jump those that come after it."""
        return self._rows(times, "right")

    def before(self, times: Vector) -> Vector:
        """Return the values just before some times, (len(names), n)."""
        return self._rows(times, "left")

    def _rows(self, times: Vector, side: Literal["left", "right"]) -> Vector:
        rows = np.array([np.interp(times, self.time, column) for column in self.values.T])
        if side == "left" and self.jumps.size:
            here = np.isin(times, self.jumps)
            rows[:, here] = self.values[np.searchsorted(self.time, np.asarray(times)[here])].T
        return rows

    def gaps(self, begin: float, end: float) -> str:
        """Describe which inputs have no samples in a part of a run; an empty text if none."""
        slack = SAME_TIME * max(abs(begin), abs(end))
        found = list[str]()
        for name in self.names:
            first, last = self.spans.get(name, (self.time[0], self.time[-1]))
            if first > begin + slack or last < end - slack:
                found.append(f"{name} has samples from {first:g} to {last:g} s")
        return f"{', '.join(found)}, and is constant before and after them" if found else ""

    def slopes(self, time: float) -> Vector:
        """Return the time derivatives just after a time, (len(names),)."""
        k = int(np.searchsorted(self.time, time, side="right"))
        if not 0 < k < len(self.time):
            return np.zeros(len(self.names))
        found: Vector = (self.values[k] - self.values[k - 1]) / (self.time[k] - self.time[k - 1])
        return found

    def around(self, time: float) -> "InputSeries":
        """Return the part between two breaks in which a time lies; outside, it rests.

        Args:
            time: s; at a break, the part after it is meant.
        """
        return self._parts[int(np.searchsorted(self.breaks, time, side="right"))]

    @cached_property
    def _parts(self) -> "tuple[InputSeries, ...]":
        if not self.breaks.size:
            return (self,)
        begins = [0, *np.searchsorted(self.time, self.breaks, "right") - 1]
        ends = [*np.searchsorted(self.time, self.breaks, "left") + 1, len(self.time)]
        found = list[InputSeries]()
        for begin, end in zip(begins, ends, strict=True):
            time, values = self.time[begin:end], self.values[begin:end]
            if len(time) == 1:  # a break at the first or the last sample
                time, values = np.array([time[0], time[0] + 1]), np.repeat(values, 2, axis=0)
            found.append(replace(self, time=time, values=values))
        return tuple(found)

    def with_jumps_at(self, times: Vector) -> "InputSeries":
        """Return the series with each jump that misses one of some times by rounding moved there.

        Args:
            times: Where steps end, s, increasing, (n,).
        """
        if not self.jumps.size:
            return self
        jumping = np.isin(self.time, self.jumps)
        return replace(self, time=np.where(jumping, moved_to(times, self.time), self.time))

    def held(self) -> "InputSeries":
        """Return the series whose inputs keep the values of a sample until the next one."""
        changes = (np.diff(self.values, axis=0) != 0).any(axis=1) & (np.diff(self.time) > 0)
        after = np.flatnonzero(changes) + 1
        values = self.values.copy()
        jumps = np.isin(after, np.flatnonzero(np.diff(self.time) == 0))  # which have two rows
        values[after[jumps]] = self.values[after[jumps] - 1]
        after = after[~jumps]
        return replace(
            self,
            time=np.insert(self.time, after, self.time[after]),
            values=np.insert(values, after, self.values[after - 1], axis=0),
        )

    def with_rates(self, rates: Mapping[str, str]) -> "InputSeries":
        """Return the series with the time derivatives of some inputs, which jump at the samples.

        Args:
            rates: Their names by the names of inputs of the series.
        """
        if not rates:
            return self
        chosen = [self.names.index(name) for name in rates]
        time = np.concatenate(([self.time[0] - 1], self.time, [self.time[-1] + 1]))
        values = self.values[[0, *range(len(self.time)), -1]]
        begins = np.flatnonzero(np.diff(time))
        slopes: Vector = np.diff(values[:, chosen], axis=0)[begins] / np.diff(time)[begins, None]
        rows = np.column_stack((begins, begins + 1)).ravel()
        return replace(
            self,
            names=(*self.names, *rates.values()),
            time=time[rows],
            values=np.column_stack((values[rows], np.repeat(slopes, 2, axis=0))),
        )

    def only(self, names: Collection[str]) -> "InputSeries | None":
        """Return the series of those inputs that are named; None when none of them is."""
        left = [i for i, name in enumerate(self.names) if name in names]
        kept = tuple(self.names[i] for i in left)
        values = self.values[:, left]
        return InputSeries(kept, self.time, values, spans=self.spans) if left else None


@dataclass(frozen=True, eq=False)
class FollowedInputs(InputSeries):
    """Input series in which functions of time replace the samples of some inputs.

    Attributes:
        laws: Functions by name, times (n,) to values (n,).
        span: Times, s, at which they are called instead of earlier and later ones.
    """

    laws: Mapping[str, Callable[[Vector], Vector]] = field(default_factory=dict)
    span: tuple[float, float] = (-inf, inf)

    @cached_property
    def _parts(self) -> tuple[InputSeries, ...]:
        near = self._rounding(self.breaks)
        begins, ends = [-inf, *(self.breaks + near)], [*(self.breaks - near), inf]
        return tuple(
            replace(cast(FollowedInputs, part), span=(float(begin), float(end)))
            for part, begin, end in zip(super()._parts, begins, ends, strict=True)
        )

    def _rounding(self, times: Vector) -> Vector:
        """Return by how much laws may jump beside some times by rounding, s."""
        largest = np.maximum(np.abs(times), abs(self.time[0]))  # on the way
        return np.asarray(8 * np.spacing(largest))

    def _rows(self, times: Vector, side: Literal["left", "right"]) -> Vector:
        rows = super()._rows(times, side)
        near = self._rounding(times)
        beside = times + (near if side == "right" else -near)
        at = np.clip(np.where(np.isin(times, self.jumps), beside, times), *self.span)
        for name, law in self.laws.items():
            rows[self.names.index(name)] = law(at)
        return rows


def rounding_of(times: ArrayLike, start: float) -> Any:
    """Return by how much times of a run from a start may miss those of samples, s."""
    times = np.asarray(times)
    return SAME_TIME * (times - start) + 4 * np.spacing(np.abs(times))


def moved_to(grid: Vector, times: Vector) -> Vector:
    """Return times, of which those that miss a time of a grid by rounding are moved there.

    Args:
        grid: s, increasing, (n,), n > 0; the first one is the start, from which they are counted.
        times: s, (m,).
    """
    moved = times.copy()
    after = np.clip(np.searchsorted(grid, times), 0, len(grid) - 1)
    for near in (grid[after], grid[np.maximum(after - 1, 0)]):
        same = np.abs(near - times) <= rounding_of(near, float(grid[0]))
        moved[same] = near[same]
    return moved


def read_inputs(
    path: str | os.PathLike[str], dae: Dae | None = None, words: Words | None = None
) -> InputSeries:
    r"""Read a time series of some of a model's inputs from a CSV file.

    The first line names the columns: `time`, and inputs, with their units in brackets or in a
    second line, or in SI units; see `Trajectory.read_csv`. Two lines with the same time are a jump.

    Args:
        dae: The model whose inputs the columns are; for those of an FMU, whose units count, None.
        words: Returns the number that another cell, such as true, says for an input; None for none.

    Raises:
        UsageError: The file cannot be read, has no header, too few samples or an unknown unit.
        UnknownName: There is no column `time`, or a column is no input of the model.
        ParameterError: A cell is missing, no finite number, out of bounds, or a time falls
            or stands three times; line and column are named.

    Example:
        >>> from pathlib import Path
        >>> _ = Path("torque.csv").write_text("time,steer_torque\n0,0\n1,2\n")
        >>> read_inputs("torque.csv").names
        ('steer_torque',)
    """
    known = {v.name: Column(v.name, v.unit) for v in dae.inputs} if dae else {}
    times, columns, values, lines = read_samples(Path(path), None, "time", {}, known, words)
    names = tuple(column.name for column in columns)
    for column in columns:
        if dae and column.name not in known:
            raise UnknownName.among(f"{path}: {dae.full_name}", "input", column.name, known)
        if names.count(column.name) > 1:
            raise UsageError(f"{path}: '{column.name}' occurs twice; give each input once")
        if not dae and (column.unit, column.display_unit) != ("1", None):
            raise UsageError(f"{path}: {column.name} has the unit of the FMU; leave the unit out")
    if len(times) < 2:
        raise UsageError(
            f"{path}: one sample; give two or more, or write a constant input as a number"
        )
    for name, samples in zip(("time", *names), (times, *values.T), strict=True):
        variable = dae.variable(name) if dae and name in known else None
        low, high = (variable.minimum, variable.maximum) if variable else (-inf, inf)
        wrong = ~(np.isfinite(samples) & (samples >= low) & (samples <= high))
        if wrong.any():
            i = int(np.argmax(wrong))
            raise ParameterError(
                f"{path}, line {lines[i]}, column '{name}': {samples[i]:g} is missing, not finite "
                f"or out of the range {low:g} ... {high:g}; give a number in every cell"
            )
    if (found := _disorder(times)) is not None:
        raise ParameterError(
            f"{path}, line {lines[found[0]]}, column 'time': {found[1]}; sort the lines by time "
            "and give each time once, or twice for a jump"
        )
    return InputSeries(names, times, values)


def _disorder(times: Vector) -> tuple[int, str] | None:
    """Return the position of the first time that is out of order, and the problem."""
    falls, thrice = np.zeros((2, len(times)), dtype=bool)
    falls[1:] = times[1:] < times[:-1]
    thrice[2:] = times[2:] == times[:-2]
    if not (falls | thrice).any():
        return None
    i = int(np.argmax(falls | thrice))
    after = f"comes after {times[i - 1]:g} s" if falls[i] else "stands there for the third time"
    return i, f"{times[i]:g} s {after}"
