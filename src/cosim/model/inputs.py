"""Input time series: piecewise linear between samples, held constant outside; from CSV files."""

import csv
import io
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import isfinite
from pathlib import Path

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.files import read_text


@dataclass(frozen=True, eq=False)  # arrays have no single truth value
class InputSeries:
    """Samples of inputs over time, in SI units.

    Attributes:
        names: The inputs.
        time: Increasing sample times, s, (m,), m > 1.
        values: One column per input, (m, len(names)).

    Raises:
        ParameterError: The shapes do not fit, a name or a time occurs twice, a time is earlier
            than the one before it, or a number is not finite.

    Example:
        >>> InputSeries(("torque",), [0.0, 1.0], [[0.0], [2.0]]).at([0.5, 3.0])
        array([[1., 2.]])
    """

    names: tuple[str, ...]
    time: Vector
    values: Vector

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
        if (np.diff(time) <= 0).any():
            i = int(np.argmax(np.diff(time) <= 0)) + 1
            raise ParameterError(
                f"input series: time {i} ({time[i]:g} s) is not after the one before it"
            )
        for what, array in (("time", time), ("values", values)):
            array.setflags(write=False)
            object.__setattr__(self, what, array)

    def at(self, times: Vector) -> Vector:
        """Return the values at some times, (len(names), n)."""
        return np.array([np.interp(times, self.time, column) for column in self.values.T])

    def only(self, names: Collection[str]) -> "InputSeries | None":
        """Return the series of those inputs that are named; None when none of them is."""
        left = [i for i, name in enumerate(self.names) if name in names]
        kept = tuple(self.names[i] for i in left)
        return InputSeries(kept, self.time, self.values[:, left]) if left else None


@dataclass(frozen=True, eq=False)
class FollowedInputs(InputSeries):
    """Inputs of which some follow functions of time instead of their samples.

    Attributes:
        laws: Functions by name, times (n,) to values (n,).
    """

    laws: Mapping[str, Callable[[Vector], Vector]] = field(default_factory=dict)

    def at(self, times: Vector) -> Vector:
        """Return the values at some times, (len(names), n)."""
        rows = super().at(times)
        for name, law in self.laws.items():
            rows[self.names.index(name)] = law(times)
        return rows


def read_inputs(path: str | os.PathLike[str], dae: Dae | None = None) -> InputSeries:
    """Read a time series of some of a model's inputs from a CSV file.

    The first line names the columns: `time`, then inputs. Numbers are in SI units, with a decimal
    point, and columns are separated by commas. A byte order mark and CRLF are tolerated.

    Args:
        path: The file.
        dae: The model whose inputs the columns are; for those of an FMU, None.

    Raises:
        UsageError: The file cannot be read, or has no header or too few samples.
        UnknownName: A column is no input of the model.
        ParameterError: A cell is missing, no finite number, out of bounds, or a time does not
            increase; line and column are named.

    Example:
        >>> from pathlib import Path
        >>> _ = Path("torque.csv").write_text("time,steer_torque\\n0,0\\n1,2\\n")
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
    for line, (before, after) in enumerate(pairwise(table), start=3):
        if after[0] <= before[0]:
            raise ParameterError(
                f"{path}, line {line}, column 'time': {after[0]:g} s is not after {before[0]:g} s "
                "of the line before; sort the lines by time and give each time once"
            )
    samples = np.array(table)
    return InputSeries(tuple(names[1:]), samples[:, 0], samples[:, 1:])


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
