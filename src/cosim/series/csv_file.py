"""CSV files of samples over time: written by this project, and read from any tool."""

import csv
import io
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np

from casadi_models.units import UNITS
from cosim.arrays import Vector
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.host.progress import doing
from cosim.series.samples import Column
from cosim.text import csv_cell

UNIT_KINDS = ("si", "book")  # of units in files
_NAMED = re.compile(r"\s*(.+?)\s*(?:[\[(]([^\])]*)[\])])?\s*")
_BLOCK = 1000  # rows, that are written at once
_TIMES = ("time", "t", "zeit", "temps")


@dataclass(frozen=True)
class CsvSamples:
    """Content of a CSV file.

    Attributes:
        names: Names of the columns, without time.
        units: Unit of each column as written; None if there is none.
        time: Sample times, s, (n,).
        values: Samples as written, (n, columns).
    """

    names: tuple[str, ...]
    units: tuple[str | None, ...]
    time: Vector
    values: Vector


def write_csv(
    target: str | os.PathLike[str] | TextIO,
    columns: Sequence[Column],
    time: Vector,
    values: Vector,
    units: str,
) -> None:
    """Write samples over time, SI, (n, len(columns)), with 17 digits; see `Trajectory.to_csv`."""
    if not isinstance(target, str | os.PathLike):
        if not hasattr(target, "write"):
            raise UsageError.of_type("to_csv", target, "a file name, or an open text file")
        _write_lines(target, columns, time, values, units)
        return
    from cosim.files import written_atomically  # only if a file is used

    with written_atomically(target) as file:
        text = io.TextIOWrapper(file, encoding="utf-8", newline="")
        _write_lines(text, columns, time, values, units)
        text.detach()


def _write_lines(
    stream: TextIO, columns: Sequence[Column], time: Vector, values: Vector, units: str
) -> None:
    if units not in UNIT_KINDS:
        raise UnknownName.among("to_csv", "kind of units", units, UNIT_KINDS)
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([csv_cell(name) for name in ("time", *(column.name for column in columns))])
    if units == "book":
        writer.writerow(("s", *(column.shown_unit for column in columns)))
        shown = [column.shown(own) for column, own in zip(columns, values.T, strict=True)]
        values = np.transpose(shown).reshape(values.shape)
    line = ",".join(["%.17g"] * (1 + len(columns))) + "\n"  # see `repr_17`
    written = 0
    with doing("writing", lambda: written / len(time)):
        for written in range(0, len(time), _BLOCK):
            rows = slice(written, written + _BLOCK)
            block = np.column_stack((time[rows], values[rows]))
            stream.write(line * len(block) % tuple(block.ravel().tolist()))


def repr_17(value: float) -> str:
    """Write a number with 17 significant digits, so that reading returns the same bits."""
    return f"{value:.17g}"


def read_csv_samples(path: Path) -> CsvSamples:
    """Read a CSV file with a header, times in its first column or in one that is called time.

    Columns are separated by commas, semicolons or tabs; units stand in brackets behind the names
    or in a second line; lines that begin with # are comments.

    Raises:
        UsageError: The file cannot be read, or has no header, time or sample.
        ParameterError: A cell is not a number, or time decreases; the line is named.
    """
    rows = _rows(path)
    header = [_NAMED.fullmatch(cell) for cell in rows[0][1]]
    if len(header) < 2 or any(_is_number(cell) for cell in rows[0][1]):
        raise UsageError(f"{path}, line {rows[0][0]}: no header; write 'time,NAME,...' there")
    if not all(header):
        raise UsageError(f"{path}, line {rows[0][0]}: a column has no name; give each one a name")
    names = [match[1] for match in header if match]
    units: list[str | None] = [match[2] for match in header if match]
    body = rows[1:]
    if body and not any(_is_number(cell) for cell in body[0][1]):
        units = [cell.strip() or None for cell in body[0][1]]
        body = body[1:]
    if not body:
        raise UsageError(f"{path}: there is no sample below the header; give one line or more")
    table = np.array([_numbers(path, line, row, names) for line, row in body])
    at = next((i for i, name in enumerate(names) if name.lower() in _TIMES), 0)
    time = table[:, at] * _time_factor(path, units[at])
    if (falling := np.flatnonzero(np.diff(time) < 0)).size:
        line = body[int(falling[0]) + 1][0]
        raise ParameterError(f"{path}, line {line}: time decreases; sort the lines by time")
    rest = [i for i in range(len(names)) if i != at]
    return CsvSamples(
        tuple(names[i] for i in rest), tuple(units[i] for i in rest), time, table[:, rest]
    )


def in_si(
    path: Path, samples: CsvSamples, units: Mapping[str, str], targets: Mapping[str, str]
) -> tuple[list[tuple[str, str | None]], Vector]:
    """Return SI unit and display unit of each column, and the values in SI units.

    Args:
        path, samples: The file, for messages, and its content.
        units: Units by name of columns without a unit in the file.
        targets: SI units that the columns should have, by name, where known.

    Raises:
        UsageError: A unit is unknown, or does not convert to the expected one.
    """
    pairs: list[tuple[str, str | None]] = []
    values = samples.values.copy()
    for i, (name, written) in enumerate(zip(samples.names, samples.units, strict=True)):
        unit, target = units.get(name, written), targets.get(name)
        if unit is None or unit == target:
            pairs.append((target or "1", None))
            continue
        if unit not in UNITS:
            raise UsageError(
                f"{path}: {name} is in '{unit}', which is unknown; give units={{'{name}': ...}}, "
                f"one of {', '.join(UNITS)}"
            )
        target = target or si_name(unit)
        if not UNITS[unit].measures_like(UNITS[target]):
            raise UsageError(f"{path}: {name} is in '{unit}', which does not convert to '{target}'")
        values[:, i] *= UNITS[unit].factor / UNITS[target].factor
        pairs.append((target, unit if unit != target else None))
    return pairs, values


def si_name(unit: str) -> str:
    """Return the SI unit that a unit converts to; the unit itself if there is none."""
    if UNITS[unit].factor == 1:
        return unit
    fitting = (n for n, u in UNITS.items() if u.factor == 1 and u.measures_like(UNITS[unit]))
    return next(fitting, unit)


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    from cosim.files import read_text  # only if a file is used

    lines = [*enumerate(read_text(path).splitlines(), 1)]
    lines = [(i, line) for i, line in lines if line.strip() and not line.startswith("#")]
    if not lines:
        raise UsageError(f"{path} is empty; give a CSV file with a header")
    head = lines[0][1]
    mark = next((mark for mark in (";", "\t", ",") if mark in head), ",")
    return [(i, next(csv.reader(io.StringIO(line), delimiter=mark))) for i, line in lines]


def _numbers(path: Path, line: int, cells: Sequence[str], names: Sequence[str]) -> list[float]:
    if len(cells) != len(names):
        raise ParameterError(
            f"{path}, line {line}: {len(cells)} cells under {len(names)} names; give each its own"
        )
    for name, cell in zip(names, cells, strict=True):
        if not _is_number(cell):
            raise ParameterError(f"{path}, line {line}, column '{name}': '{cell}' is not a number")
    return [float(cell) for cell in cells]


def _is_number(cell: str) -> bool:
    try:
        float(cell if "_" not in cell else "none")  # Python's 1_000 is not a number in CSV
    except ValueError:
        return False
    return True


def _time_factor(path: Path, unit: str | None) -> float:
    if unit is None:
        return 1.0
    if unit not in UNITS or not UNITS[unit].measures_like(UNITS["s"]):
        raise UsageError(f"{path}: time is in '{unit}'; give it in s or ms")
    return UNITS[unit].factor
