"""Input time series: linear between samples, held constant outside, with jumps; from CSV files."""

import csv
import io
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import isfinite
from pathlib import Path
from typing import Literal

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.files import read_text

_SAME_TIME = 1e-12  # of a time
_SHORT = 0.1  # of the middle length of the intervals between samples


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
        time, values = (np.array(a, dtype=float) for a in (self.time, self.values))
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
                time[k] = time[k - 1]

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
        slack = _SAME_TIME * max(abs(begin), abs(end))
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
        time, jumping = self.time.copy(), np.isin(self.time, self.jumps)
        after = np.clip(np.searchsorted(times, time), 0, len(times) - 1)
        for near in (times[after], times[np.maximum(after - 1, 0)]):
            same = jumping & (np.abs(near - time) <= _SAME_TIME * np.abs(near))
            time[same] = near[same]
        return replace(self, time=time)

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
    """

    laws: Mapping[str, Callable[[Vector], Vector]] = field(default_factory=dict)

    def _rows(self, times: Vector, side: Literal["left", "right"]) -> Vector:
        rows = super()._rows(times, side)
        for name, law in self.laws.items():
            rows[self.names.index(name)] = law(times)
        return rows


def read_inputs(path: str | os.PathLike[str], dae: Dae | None = None) -> InputSeries:
    r"""Read a time series of some of a model's inputs from a CSV file.

    The first line names the columns: `time`, then inputs. Numbers are in SI units, with a decimal
    point, and columns are separated by commas. A byte order mark and CRLF are tolerated. Two lines
    with the same time are a jump.

    Args:
        dae: The model whose inputs the columns are; for those of an FMU, None.

    Raises:
        UsageError: The file cannot be read, or has no header or too few samples.
        UnknownName: A column is no input of the model.
        ParameterError: A cell is missing, no finite number, out of bounds, or a time falls
            or stands three times; line and column are named.

    Example:
        >>> from pathlib import Path
        >>> _ = Path("torque.csv").write_text("time,steer_torque\n0,0\n1,2\n")
        >>> read_inputs("torque.csv").names
        ('steer_torque',)
    """
    rows = _table_rows(Path(path))
    names = _header(f"{path}, line 1", rows[0] if rows else [], dae)
    if len(rows) < 3:
        raise UsageError(
            f"{path}: {max(len(rows) - 1, 0)} sample(s); give two or more, "
            "or write a constant input as a number"
        )
    table = [
        _row_numbers(f"{path}, line {i}", row, names, dae) for i, row in enumerate(rows[1:], 2)
    ]
    samples = np.array(table)
    if (found := _disorder(samples[:, 0])) is not None:
        raise ParameterError(
            f"{path}, line {found[0] + 2}, column 'time': {found[1]}; sort the lines by time and "
            "give each time once, or twice for a jump"
        )
    return InputSeries(tuple(names[1:]), samples[:, 0], samples[:, 1:])


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


def _table_rows(path: Path) -> list[list[str]]:
    text = read_text(path, "the input series ")
    try:
        rows = list(csv.reader(io.StringIO(text), strict=True))
    except csv.Error as error:
        raise UsageError(f"{path} is not a CSV file: {error}") from error
    while rows and not any(cell.strip() for cell in rows[-1]):
        rows.pop()  # blank lines at the end
    return rows


def _header(where: str, cells: Sequence[str], dae: Dae | None) -> list[str]:
    names = [cell.strip() for cell in cells]
    if not names or names[0] != "time":
        found = f"'{names[0]}'" if names and names[0] else "nothing"
        for mark, word in ((";", "semicolons"), ("\t", "tabs")):
            if names and mark in cells[0]:
                found = f"columns separated by {word}"
        raise UsageError(f"{where}: the header begins with {found}; write 'time,INPUT,...'")
    known = [variable.name for variable in dae.inputs] if dae else []
    for i, name in enumerate(names[1:], start=2):
        if dae and name not in known:
            raise UnknownName.among(f"{where}, column {i}: {dae.full_name}", "input", name, known)
        if name in names[: i - 1]:
            raise UsageError(f"{where}, column {i}: '{name}' occurs twice; give each input once")
    if len(names) == 1:
        raise UsageError(f"{where}: there is no column beside 'time'; give an input's samples")
    return names


def _row_numbers(
    where: str, cells: Sequence[str], names: Sequence[str], dae: Dae | None
) -> list[float]:
    if len(cells) != len(names):
        raise ParameterError(
            f"{where}: {len(cells)} cells under {len(names)} column names; separate the columns "
            "by commas, write numbers with a decimal point, and leave no cell out"
        )
    numbers = [
        _cell_number(f"{where}, column '{name}'", cell)
        for name, cell in zip(names, cells, strict=True)
    ]
    for name, value in zip(names[1:], numbers[1:], strict=True) if dae else ():
        assert dae is not None
        variable = dae.variable(name)
        if not variable.minimum <= value <= variable.maximum:
            raise ParameterError(
                f"{where}, column '{name}': {value:g} {variable.unit} is out of its range "
                f"{variable.minimum:g} ... {variable.maximum:g} {variable.unit}"
            )
    return numbers


def _cell_number(where: str, cell: str) -> float:
    text = cell.strip()
    if not text:
        raise ParameterError(f"{where}: the cell is empty; give a number in every cell")
    try:
        value = float(text if "_" not in text else "none")  # Python's 1_000 is no CSV number
    except ValueError:
        hint = "with a decimal point" if "," in text else "in SI units, without its unit"
        raise ParameterError(f"{where}: '{text}' is not a number; write one {hint}") from None
    if not isfinite(value):
        raise ParameterError(f"{where}: {text} is not finite; give a finite number")
    return value
