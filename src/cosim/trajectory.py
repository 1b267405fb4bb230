"""`Trajectory`: what every run on either road returns."""

from __future__ import annotations

import csv
import io
import json
import os
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TextIO

import numpy as np
from numpy.typing import NDArray

from casadi_models.units import UNITS
from cosim.arrays import Vector
from cosim.errors import MissingTool, UnknownName, UsageError

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

MOST_PANELS = 24


@dataclass(frozen=True)
class Column:
    """What is known of a recorded variable: name, SI unit, display unit, nominal, meaning."""

    name: str
    unit: str = "1"
    display_unit: str | None = None
    nominal: float = 1.0
    meaning: str = ""

    @property
    def shown_unit(self) -> str:
        """The unit in which people read it."""
        return self.display_unit or self.unit

    def shown(self, values: Vector) -> Vector:
        """Convert SI values of this variable to `shown_unit`."""
        if self.display_unit is None or self.unit not in UNITS:
            return values
        shown: Vector = values * UNITS[self.unit].factor / UNITS[self.display_unit].factor
        return shown


@dataclass(frozen=True, eq=False)  # arrays have no single truth value
class Trajectory:
    """Values of variables over time, in SI units.

    Attributes:
        model: `MODEL/FORMULATION`, or the name in an FMU.
        time: Output times, s, (n,).
        columns: The variables.
        values: One column per variable, (n, len(columns)).
        stats: What the run took: solver, steps, rhs_calls, wall_time [s], compiled, ...
        status: "complete", or where and why the run stopped early.

    Raises:
        UsageError: The shapes do not fit, or a variable occurs twice.
    """

    model: str
    time: Vector
    columns: tuple[Column, ...]
    values: Vector
    stats: Mapping[str, Any] = field(default_factory=dict)
    status: str = "complete"

    def __post_init__(self) -> None:
        for name in ("time", "values"):
            array = np.array(getattr(self, name), dtype=float)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if self.time.ndim != 1 or self.values.shape != (len(self.time), len(self.columns)):
            raise UsageError(
                f"{self.model}: {len(self.columns)} variables, but time of shape {self.time.shape} "
                f"and values of shape {self.values.shape}; give (n,) and (n, {len(self.columns)})"
            )
        names = ("time", *self.names)
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise UsageError(f"{self.model}: '{twice}' is recorded twice; name it once")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the variables, without time."""
        return tuple(column.name for column in self.columns)

    @property
    def units(self) -> dict[str, str]:
        """SI unit by name, time included."""
        return {"time": "s"} | {column.name: column.unit for column in self.columns}

    @property
    def complete(self) -> bool:
        """Whether the run reached its stop time."""
        return self.status == "complete"

    def column(self, name: str) -> Column:
        """Return what is known of a variable.

        Raises:
            UnknownName: It was not recorded.
        """
        return self.columns[self._index(name)]

    def __getitem__(self, name: str) -> Vector:
        """Return the values of a variable (or of "time"), (n,).

        Raises:
            UnknownName: It was not recorded.
        """
        return self.time if name == "time" else self.values[:, self._index(name)]

    def __len__(self) -> int:
        return len(self.time)

    def select(self, names: Sequence[str]) -> Trajectory:
        """Return the same run with these variables only, in this order.

        Raises:
            UnknownName: One was not recorded.
            UsageError: One is named twice.
        """
        chosen = [self._index(name) for name in names]
        columns = tuple(self.columns[i] for i in chosen)
        return replace(self, columns=columns, values=self.values[:, chosen])

    @property
    def structured(self) -> NDArray[Any]:
        """A structured array, `time` first, as FMPy's own helpers read it; shape (n,)."""
        table = np.empty(len(self), dtype=[(name, np.float64) for name in ("time", *self.names)])
        table["time"] = self.time
        for name, values in zip(self.names, self.values.T, strict=True):
            table[name] = values
        return table

    def to_csv(self, target: str | os.PathLike[str] | TextIO) -> None:
        """Write `time` and every variable with 17 significant digits.

        Args:
            target: File name, replaced atomically, or an open text file.

        Raises:
            ExportError: The file cannot be written.
            UsageError: The target is neither.
        """
        if not isinstance(target, str | os.PathLike):
            if not hasattr(target, "write"):
                raise UsageError.of_type("to_csv", target, "a file name, or an open text file")
            self._write_csv(target)
            return
        from cosim.files import write_atomically  # only where a file is wanted

        text = io.StringIO(newline="")
        self._write_csv(text)
        write_atomically(target, text.getvalue().encode())

    def to_npz(self, target: str | os.PathLike[str] | BinaryIO) -> None:
        """Write everything, bit for bit, as a file of numpy; see `from_npz`.

        Args:
            target: File name, replaced atomically, or an open binary file.

        Raises:
            ExportError: The file cannot be written.
        """
        facts = {
            "model": self.model,
            "columns": [asdict(column) for column in self.columns],
            "stats": dict(self.stats),
            "status": self.status,
        }
        content = io.BytesIO()
        np.savez(content, time=self.time, values=self.values, facts=json.dumps(facts))
        if not isinstance(target, str | os.PathLike):
            target.write(content.getvalue())
            return
        from cosim.files import write_atomically  # only where a file is wanted

        write_atomically(target, content.getvalue())

    @classmethod
    def from_npz(cls, source: str | os.PathLike[str] | BinaryIO) -> Trajectory:
        """Read what `to_npz` wrote.

        Raises:
            UsageError: It is no such file.
        """
        try:
            if isinstance(source, str | os.PathLike):
                with Path(source).open("rb") as file:  # numpy leaves a damaged one open
                    return cls.from_npz(file)
            with np.load(source, allow_pickle=False) as stored:
                facts = json.loads(str(stored["facts"]))
                columns = tuple(Column(**column) for column in facts.pop("columns"))
                return cls(time=stored["time"], columns=columns, values=stored["values"], **facts)
        except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
            raise UsageError(f"{source} holds no trajectory: {error}") from error

    def to_pandas(self) -> pd.DataFrame:
        """Return a `pandas.DataFrame` indexed by time; units in `attrs`."""
        pandas = optional_package("pandas")
        frame = pandas.DataFrame(self.values, columns=self.names, index=self.time)
        frame.index.name = "time"
        frame.attrs = {"model": self.model, "units": self.units, "status": self.status}
        return frame

    def to_xarray(self) -> xr.Dataset:
        """Return an `xarray.Dataset` over time; unit and meaning in each variable's `attrs`."""
        xarray = optional_package("xarray")
        variables = {
            column.name: (
                "time",
                self.values[:, i],
                {"units": column.unit, "long_name": column.meaning},
            )
            for i, column in enumerate(self.columns)
        }
        time = ("time", self.time, {"units": "s"})
        attrs = {"model": self.model, "status": self.status}
        dataset: xr.Dataset = xarray.Dataset(variables, {"time": time}, attrs)
        return dataset

    def plot(self, names: Sequence[str] | None = None) -> Figure:
        """Draw variables over time in their display units, a panel each.

        Args:
            names: Which variables; the first 24 when None.

        Raises:
            UnknownName: A variable was not recorded.
        """
        from cosim.plotting import Panel, draw_panels  # matplotlib takes its time

        shown = self.select(names if names is not None else self.names[:MOST_PANELS])
        panels = [
            Panel(
                column.meaning or column.name,
                f"{column.name} [{column.shown_unit}]",
                column.shown(shown[column.name]),
                float(column.shown(np.array(column.nominal))),
            )
            for column in shown.columns
        ]
        suffix = "" if self.complete else f" ({self.status})"
        return draw_panels(f"{self.model}{suffix}", self.time, panels)

    def _index(self, name: str) -> int:
        try:
            return self.names.index(name)
        except ValueError:
            raise UnknownName.among(f"{self.model}: run", "variable", name, self.names) from None

    def _write_csv(self, stream: TextIO) -> None:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(("time", *self.names))
        table = np.column_stack((self.time, self.values))
        writer.writerows([repr_17(value) for value in row] for row in table.tolist())


def repr_17(value: float) -> str:
    """Write a number with 17 significant digits, so that reading returns the same bits."""
    return f"{value:.17g}"


def optional_package(package: str) -> Any:
    """Return a package of the extra `data`.

    Raises:
        MissingTool: It is not installed.
    """
    from importlib import import_module

    try:
        return import_module(package)
    except ImportError as error:
        raise MissingTool(
            f"{package} is not installed; bring it with: pip install 'cosim-rigid[data]'"
        ) from error
