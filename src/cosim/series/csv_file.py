"""CSV files of samples over time: written by this project, and read from any tool."""

import csv
import io
import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TextIO

import numpy as np

from casadi_models.units import UNITS, Unit, converted, parse_unit
from cosim.arrays import Vector
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.host.progress import doing
from cosim.series.samples import Column
from cosim.text import csv_cell

UNIT_KINDS = ("si", "book")  # of units in files
_NAMED = re.compile(r"\s*(.+?)\s*(?:\[([^\[\]]*)\]?|\(([^()]*)\)?)?\s*")
_WITHOUT_UNIT = re.compile(r"der\(.*\)|\S+\[[\d\s,;]+\]")  # a derivative, an element
_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")  # a number with a decimal comma
_SEPARATOR = re.compile(r'"?sep=(.)"?', re.IGNORECASE)  # a first line for Excel
_BLOCK = 1000  # rows, that are written at once
Words = Callable[[str, str], float | None]  # from the name of a column and a cell
_TIME = re.compile("t|(?i:time|zeit|temps)")  # T is a torque or a temperature


def write_csv(
    target: str | os.PathLike[str] | TextIO,
    columns: Sequence[Column],
    time: Vector,
    values: Vector,
    units: str,
) -> None:
    """Write samples over time, SI, (n, len(columns)); see `Trajectory.to_csv`."""
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
    UnknownName.reject("to_csv", "kind of units", UNIT_KINDS, units)
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([csv_cell(name) for name in ("time", *(column.name for column in columns))])
    if units == "book":
        writer.writerow(("s", *(column.shown_unit for column in columns)))
        shown = [column.shown(own) for column, own in zip(columns, values.T, strict=True)]
        values = np.transpose(shown).reshape(values.shape)
    written = 0
    with doing("writing", lambda: written / len(time)):
        for written in range(0, len(time), _BLOCK):
            rows = slice(written, written + _BLOCK)
            block = np.column_stack((time[rows], values[rows]))
            lines = (",".join(map(shortest, row)) for row in block.tolist())
            stream.write("".join(f"{line}\n" for line in lines))


def shortest(value: float) -> str:
    """Write a number with the fewest digits from which reading returns the same bits."""
    return repr(value).removesuffix(".0")


def read_samples(
    path: Path,
    headers: Mapping[str, str] | None,
    time: str | None,
    units: Mapping[str, str],
    known: Mapping[str, Column],
    words: Words | None = None,
) -> tuple[Vector, tuple[Column, ...], Vector, list[int]]:
    """Read a CSV file with a header; see `Trajectory.read_csv` for its form and the errors.

    Args:
        path: The file.
        headers: Header of a column by name of the variable; all columns if None.
        time: Header of the times; that of a column called time, or the first one, if None.
        units: Units by name of columns without a unit in the file.
        known: Variables by name whose units and meanings apply to columns of that name.
        words: See `numbers_of`.

    Returns:
        Times, s, (n,); variables; their values, SI, (n, variables), NaN in gaps; the numbers of
        the lines.
    """
    cells, names, written, body = _parts(path, named=headers is not None)
    at = _place_of_time(path, cells, names, time)
    chosen = [(name, i) for i, name in enumerate(names) if i != at]
    if headers is not None:
        chosen = [(name, _place(path, cells, names, text)) for name, text in headers.items()]
    places = [at, *(i for _, i in chosen)]
    place_of = {"time": at, **dict(chosen)}
    for key, unit in units.items():
        UnknownName.reject(f"{path}: units", "column", place_of, key)
        other = written[place_of[key]]
        if other is not None and other != unit and parse_unit(other) is not None:
            raise UsageError(f"{path}: {key} is in '{other}' by its header; units= says '{unit}'")
    table = np.array([numbers_of(path, line, row, names, places, words) for line, row in body])
    _, in_file, target = _column(path, "time", units.get("time", written[at]), Column("time", "s"))
    times = converted(table[:, 0], in_file, target)
    lines = [line for line, _ in body]
    for wrong, problem in (
        (np.isnan(times), "the time is missing; fill it in"),
        (np.isinf(times), "the time is infinite; correct it"),
        (np.diff(times, prepend=times[0]) < 0, "time decreases; sort the lines by time"),
    ):
        if wrong.any():
            raise ParameterError(f"{path}, line {lines[int(np.argmax(wrong))]}: {problem}")
    found = [_column(path, n, units.get(n, written[i]), known.get(n)) for n, i in chosen]
    values = table[:, 1:]
    for own, (_, in_file, target) in zip(values.T, found, strict=True):
        own[:] = converted(own, in_file, target)
    return times, tuple(column for column, *_ in found), values, lines


_Line = tuple[int, list[str]]  # its number, and its cells


def _parts(
    path: Path, *, named: bool
) -> tuple[list[str], list[str], list[str | None], list[_Line]]:
    """Divide a CSV file into its header and the samples below.

    Args:
        path: The file.
        named: Whether columns are named by their headers; else each must have a name.

    Returns:
        The header; the names in it; the units, which may have a line of their own; the samples.
    """
    head, *body = rows_of(path)
    place, cells = f"{path}, line {head[0]}", [cell.strip() for cell in head[1]]
    if len(cells) < 2 or any(_is_number(cell) for cell in cells):
        raise UsageError(f"{place}: no header; write 'time,NAME,...' there")
    header = [_named(cell) for cell in cells]
    names, units = [name for name, _ in header], [unit for _, unit in header]
    if not named and not all(names):
        raise UsageError(f"{place}: a column has no name; give each one a name")
    if body and _are_units(body[0][1]):
        line, own = body.pop(0)
        numbers_of(path, line, ["" for _ in own], names, [])  # rejects another number of cells
        units = [cell.strip() or unit for cell, unit in zip(own, units, strict=True)]
    if not body:
        raise UsageError(f"{path}: there is no sample below the header; give one line or more")
    return cells, names, units, body


def _are_units(cells: Sequence[str]) -> bool:
    """Tell whether the line below a header holds units: texts, and 1, which is a unit."""
    texts = [cell for cell in cells if cell.strip() != "1"]
    return any(map(str.strip, texts)) and not any(map(_is_number, texts))


def _named(cell: str) -> tuple[str, str | None]:
    """Return the name in the header of a column, and the unit in brackets behind it."""
    match = _NAMED.fullmatch(cell)
    if match is None or _WITHOUT_UNIT.fullmatch(cell):
        return cell, None
    return match[1], match[2] if match[3] is None else match[3]


def _place_of_time(path: Path, cells: Sequence[str], names: Sequence[str], time: str | None) -> int:
    """Return the place of the times; a header `time` is also found as `Time` or `t`."""
    found = next((i for i, name in enumerate(names) if _TIME.fullmatch(name)), None)
    if time is None:
        return found or 0
    if time == "time" and time not in names and found is not None:
        return found
    return _place(path, cells, names, time)


def _place(path: Path, cells: Sequence[str], names: Sequence[str], text: str) -> int:
    """Return the place of the column whose header, or the name in it, is a text."""
    found = [i for i, cell in enumerate(cells) if text.strip() in (cell, names[i])]
    if not found:
        raise UnknownName.among(str(path), "column", text, filter(None, cells))
    if len(found) > 1:
        raise UsageError(f"{path}: {len(found)} columns are called '{text}'; rename them")
    return found[0]


def _column(
    path: Path, name: str, unit: str | None, known: Column | None
) -> tuple[Column, Unit, Unit]:
    """Return a variable, its unit in the file, and its own unit."""
    target = known.unit if known else None
    if unit is None or unit == target:
        own = UNITS[target or "1"]
        return known or Column(name), own, own
    source = parse_unit(unit, UNITS[target] if target else None)
    if source is None:
        raise UsageError(
            f"{path}: {name} is in '{unit}', which is unknown; give units={{'{name}': ...}}, "
            f"one of {', '.join(UNITS)}"
        )
    target = target or si_name(unit, source)
    if not source.measures_like(UNITS[target]):
        raise UsageError(f"{path}: {name} is in '{unit}', which does not convert to '{target}'")
    shown, own = unit if unit != target and parse_unit(unit) else None, UNITS[target]
    if known and known.is_difference:
        source, own = source.difference(), own.difference()
    return known or Column(name, target, shown), source, own


def si_name(name: str, unit: Unit) -> str:
    """Return the name of the SI unit that a unit converts to."""
    if name in UNITS and unit.is_si:
        return name
    fitting = (n for n, u in UNITS.items() if u.is_si and u.measures_like(unit))
    return next(fitting, None) or ".".join(f"{b}{n if n != 1 else ''}" for b, n in unit.base)


def rows_of(path: Path) -> list[tuple[int, list[str]]]:
    """Return the cells of a CSV file with the numbers of their lines, without comments.

    Without a line such as `sep=;` the header tells what separates the cells.
    """
    from cosim.files import read_text  # only if a file is used

    lines = [*enumerate(read_text(path).splitlines(), 1)]
    lines = [(i, line) for i, line in lines if line.strip() and not line.startswith("#")]
    declared = _SEPARATOR.fullmatch(lines[0][1].rstrip(" ")) if lines else None
    lines = lines[1:] if declared else lines
    if not lines:
        raise UsageError(f"{path} is empty; give a CSV file with a header")
    head = lines[0][1]
    mark = declared[1] if declared else next((m for m in (";", "\t", ",") if m in head), ",")
    rows = [(i, _cells(f"{path}, line {i}", line, mark)) for i, line in lines]
    return _with_decimal_points([row for row in rows if any(map(str.strip, row[1]))])


def _cells(place: str, line: str, mark: str) -> list[str]:
    try:
        return next(csv.reader(io.StringIO(line), delimiter=mark))
    except csv.Error as error:
        most = csv.field_size_limit()
        raise UsageError(
            f"{place} has a cell of more than {most} characters; write numbers"
        ) from error


def _with_decimal_points(rows: list[tuple[int, list[str]]]) -> list[tuple[int, list[str]]]:
    """Return the cells with decimal points instead of decimal commas.

    A file that has decimal points, too, stays as it is: its commas may part thousands.
    """
    numbers = [cell.strip() for _, cells in rows[1:] for cell in cells]
    with_commas = any(map(_COMMA.fullmatch, numbers))
    if not with_commas or any("." in cell and _is_number(cell) for cell in numbers):
        return rows
    return [
        (i, [c.replace(",", ".") if _COMMA.fullmatch(c.strip()) else c for c in cells])
        for i, cells in rows
    ]


def numbers_of(
    path: Path,
    line: int,
    cells: Sequence[str],
    names: Sequence[str],
    places: Sequence[int],
    words: Words | None = None,
) -> list[float]:
    """Return the numbers of a line at some places; NaN for an empty cell.

    Args:
        words: Returns the number that a cell stands for which is none itself; None for no number.
    """
    if len(cells) != len(names):
        raise ParameterError(
            f"{path}, line {line}: {len(cells)} cells under {len(names)} names; give each "
            "its own, and write numbers with a decimal point"
        )
    chosen = [cells[i].strip() or "nan" for i in places]
    found = list[float]()
    for name, cell in zip([names[i] for i in places], chosen, strict=True):
        value = float(cell) if _is_number(cell) else words and words(name, cell)
        if value is None:
            hint = "; write one with a decimal point" if "," in cell else ""
            raise ParameterError(
                f"{path}, line {line}, column '{name}': '{cell}' is not a number{hint}"
            )
        found.append(value)
    return found


def _is_number(cell: str) -> bool:
    try:
        float(cell if "_" not in cell else "none")  # Python's 1_000 is not a number in CSV
    except ValueError:
        return False
    return True
