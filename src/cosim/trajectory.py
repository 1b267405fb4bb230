"""`Trajectory`: what every run on either road returns."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TextIO, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cosim.arrays import Vector, frozen
from cosim.errors import UnknownName, UsageError
from cosim.presenters import presenter
from cosim.series.column import Column, summary_rows
from cosim.series.csv_file import in_si, read_csv_samples, repr_17, write_csv
from cosim.series.frames import data_frame, data_set
from cosim.series.interpolation import resample, times_within
from cosim.series.npz_file import read_npz, write_npz
from cosim.text.tables import MOST_LINES, Table, html_table, text_table

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

    from casadi_models.dae import Drawing

SHOWN_PANELS = 6  # of the picture in a notebook

__all__ = ["Column", "Trajectory", "repr_17"]


@dataclass(frozen=True, eq=False)  # arrays have no single truth value
class Trajectory:
    """Values of variables over time, in SI units.

    `run["phi"]` is an array, `run[["phi", "delta"]]` a run with these variables only; `name in run`
    and `for name in run` speak of names, `len(run)` is the number of times, as in pandas.

    Attributes:
        model: `MODEL/FORMULATION`, or the name in an FMU.
        time: Output times, s, (n,).
        columns: The variables.
        values: One column per variable, (n, len(columns)).
        stats: What the run took: solver, steps, rhs_calls, wall_time [s], compiled, ...
        status: "complete", or where and why the run stopped early.
        drawing: What the model looks like, with the run's parameters; None where nobody knows.
        numbers: Parameters and constant inputs that it was run with, SI; None where nobody knows.
        again: Computes the run at other times within its span; None where nothing can.

    Raises:
        UsageError: The shapes do not fit, or a variable occurs twice.

    Example:
        >>> run = Trajectory("m", [0, 1, 2], (Column("x", "m"),), [[0], [1], [4]])
        >>> run["x"].max()
        np.float64(4.0)
        >>> run
        m: 3 times from 0 to 2 s, 1 variable, complete
        name  unit  start  end  min  max
        x     m     0      4    0    4
    """

    model: str
    time: Vector
    columns: tuple[Column, ...]
    values: Vector
    stats: Mapping[str, Any] = field(default_factory=dict)
    status: str = "complete"
    drawing: Drawing | None = field(default=None, repr=False)
    again: Callable[[Vector], Trajectory] | None = field(default=None, repr=False)
    numbers: Mapping[str, float] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        for name in ("time", "values"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        if self.time.ndim != 1 or self.values.shape != (len(self.time), len(self.columns)):
            raise UsageError(
                f"{self.model}: {len(self.columns)} variables, but time of shape {self.time.shape} "
                f"and values of shape {self.values.shape}; give (n,) and (n, {len(self.columns)})"
            )
        if len({"time", *[column.name for column in self.columns]}) <= len(self.columns):
            names = ("time", *self.names)
            twice = next(name for name in names if names.count(name) > 1)
            raise UsageError(f"{self.model}: '{twice}' is recorded twice; name it once")

    @cached_property
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

    @property
    def validity(self) -> tuple[float, tuple[str, ...]]:
        """From when on the run is not what it seems, s (infinite when never), and why."""
        reasons = tuple(str(text) for text in self.stats.get("invalid", ()))
        if not len(self):
            return inf, reasons
        said = re.match(r"from (\S+) s on ", reasons[0]) if reasons else None
        known = float(said[1]) if said else self.time[0] if reasons else inf
        start = float(self.stats.get("invalid_from", known))
        if self.complete:
            return start, reasons
        return min(start, float(self.time[-1])), (*reasons, self.status)

    def column(self, name: str) -> Column:
        """Return what is known of a variable.

        Raises:
            UnknownName: It was not recorded.
        """
        return self.columns[self._index(name)]

    @overload
    def __getitem__(self, name: str) -> Vector: ...

    @overload
    def __getitem__(self, name: list[str] | tuple[str, ...]) -> Trajectory: ...

    def __getitem__(self, name: str | list[str] | tuple[str, ...]) -> Vector | Trajectory:
        """Return the values of a variable (or of "time"), (n,); of a list of names, a run.

        Raises:
            UnknownName: It was not recorded.
        """
        if isinstance(name, list | tuple):
            return self.select(name)
        return self.time if name == "time" else self.values[:, self._index(name)]

    def __contains__(self, name: object) -> bool:
        return name == "time" or name in self.names

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def keys(self) -> tuple[str, ...]:
        """Names of the variables, so that `dict(run)` holds their values."""
        return self.names

    def __len__(self) -> int:
        return len(self.time)

    def select(self, names: str | Sequence[str]) -> Trajectory:
        """Return the same run with these variables only, in this order; one name is a list, too.

        Raises:
            UnknownName: One was not recorded.
            UsageError: One is named twice.
        """
        wanted = (names,) if isinstance(names, str) else tuple(names)
        own = self.names
        if wanted == own:
            return replace(self)
        places = {name: i for i, name in enumerate(own)}
        chosen = [places[name] if name in places else self._index(name) for name in wanted]
        columns = tuple(self.columns[i] for i in chosen)
        values = self.values[:, chosen]
        values.setflags(write=False)
        return replace(self, columns=columns, values=values)

    @property
    def final(self) -> dict[str, float]:
        """Every variable at the last time, by name."""
        return dict(zip(self.names, self.values[-1].tolist(), strict=True))

    def at(self, times: ArrayLike) -> Any:
        """Return the run at other times within its span.

        A run of `cosim.simulate` is computed again for them, by the interpolant of its solver; any
        other one is interpolated between its samples, by polynomials of degree 5.

        Args:
            times: s; one number, or an array (m,) that does not fall.

        Returns:
            Values by name for a number; a `Trajectory` for an array.

        Raises:
            ParameterError: A time is not a number, or not within the run.

        Example:
            >>> run = Trajectory("m", [0, 1, 2], (Column("x", "m"),), [[0], [1], [4]])
            >>> run.at(1.5)
            {'x': 2.25}
            >>> run.at([0.5, 1.5])["x"]
            array([0.25, 2.25])
        """
        wanted = times_within(self.model, self.time, times)
        if self.again is not None:
            found = self.again(np.atleast_1d(wanted)).select(self.names)
        else:
            values, _ = resample(self.time, self.values, np.atleast_1d(wanted))
            found = replace(self, time=np.atleast_1d(wanted), values=values)
        return found.final if wanted.ndim == 0 else found

    def computed_by(self, again: Callable[[Vector], Trajectory]) -> Trajectory:
        """Return the same run, which a function computes again at other times; see `at`."""
        other = object.__new__(type(self))  # of fields that have been checked
        vars(other).update(vars(self), again=again)
        return other

    def summary(self) -> Table:
        """Return start, end, smallest and largest value of every variable, in display units."""
        return Table(
            tuple(summary_rows(self.columns, self.time, self.values, when=True)),
            self._headline(),
            digits=6,
        )

    @classmethod
    def read_csv(
        cls,
        path: str | os.PathLike[str],
        *,
        units: Mapping[str, str] | None = None,
        like: Trajectory | None = None,
        model: str | None = None,
    ) -> Trajectory:
        """Read a run, a measurement or another tool's result from a CSV file.

        The first line names the columns, `time` among them or first. Units stand behind the names
        in brackets or in a second line; values become SI.

        Args:
            path: The file; columns separated by commas, semicolons or tabs.
            units: Units of columns, by name, where the file does not tell them.
            like: A run whose units, nominal values and meanings are taken for the same names.
            model: What it is called; the name of the file when None.

        Raises:
            UsageError: The file cannot be read, has no header or an unknown unit.
            ParameterError: A cell is no number, or the time falls.
        """
        place = Path(path)
        samples = read_csv_samples(place)
        known = {} if like is None else {column.name: column for column in like.columns}
        wanted = {name: column.unit for name, column in known.items()}
        pairs, values = in_si(place, samples, units or {}, wanted)
        columns = tuple(
            known.get(name, Column(name, unit, shown))
            for name, (unit, shown) in zip(samples.names, pairs, strict=True)
        )
        return cls(model or place.stem, samples.time, columns, values)

    def __repr__(self) -> str:
        rows = summary_rows(self.columns, self.time, self.values, when=False)
        table = text_table(rows, most=MOST_LINES - 1)
        return "\n".join(part for part in (self._headline(), table) if part)

    def _repr_html_(self) -> str:
        if not len(self) or not self.columns:
            return html_table((), self._headline())
        from cosim.plotting import embedded

        shown = self.select(self.names[:SHOWN_PANELS])
        rows = summary_rows(self.columns, self.time, self.values, when=True)
        left = len(rows) - MOST_LINES
        table = html_table(rows[:MOST_LINES], self._headline(), digits=6)
        more = f"<p>... and {left} more: run.summary()</p>" if left > 0 else ""
        return f"{embedded(shown.plot(), 'curves')}{table}{more}"

    def _ipython_key_completions_(self) -> list[str]:
        return ["time", *self.names]

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"again": None}  # a result travels without its model

    @property
    def structured(self) -> NDArray[Any]:
        """A structured array, `time` first, as FMPy's own helpers read it; shape (n,)."""
        table = np.empty(len(self), dtype=[(name, np.float64) for name in ("time", *self.names)])
        table["time"] = self.time
        for name, values in zip(self.names, self.values.T, strict=True):
            table[name] = values
        return table

    def to_csv(self, target: str | os.PathLike[str] | TextIO, *, units: str = "si") -> None:
        """Write `time` and every variable with 17 significant digits.

        Args:
            target: File name, replaced atomically, or an open text file.
            units: "si", or "book" for display units and a second line that names them.

        Raises:
            ExportError: The file cannot be written.
            UsageError: The target is neither.
            UnknownName: There is no such kind of units.
        """
        write_csv(target, self.columns, self.time, self.values, units)

    def to_npz(self, target: str | os.PathLike[str] | BinaryIO) -> None:
        """Write everything, bit for bit, as a file of numpy; see `from_npz`.

        Args:
            target: File name, replaced atomically, or an open binary file.

        Raises:
            ExportError: The file cannot be written.
        """
        facts: dict[str, Any] = {"model": self.model, "stats": dict(self.stats)}
        facts |= {"status": self.status}
        facts |= {"numbers": None if self.numbers is None else dict(self.numbers)}
        write_npz(target, self.columns, self.time, self.values, facts)

    @classmethod
    def from_npz(cls, source: str | os.PathLike[str] | BinaryIO) -> Trajectory:
        """Read what `to_npz` wrote.

        Raises:
            UsageError: It is no such file.
        """
        columns, time, values, facts = read_npz(source)
        try:
            return cls(time=time, columns=columns, values=values, **facts)
        except TypeError as error:
            raise UsageError(f"{source} holds no trajectory: {error}") from error

    def to_pandas(self) -> pd.DataFrame:
        """Return a `pandas.DataFrame` indexed by time; units in `attrs`."""
        attrs = {"model": self.model, "units": self.units, "status": self.status}
        return data_frame(self.columns, self.time, self.values, attrs)

    def to_xarray(self) -> xr.Dataset:
        """Return an `xarray.Dataset` over time; unit and meaning in each variable's `attrs`."""
        attrs = {"model": self.model, "status": self.status}
        return data_set(self.columns, self.time, self.values, attrs)

    def plot(self, names: str | Sequence[str] | None = None) -> Figure:
        """Draw variables over time in their display units, a panel each.

        The span in which the run is outside its model is shaded and named.

        Args:
            names: One, or several; all when None.

        Raises:
            UnknownName: A variable was not recorded.
        """
        from cosim.plotting import Panel, draw_panels  # matplotlib takes its time

        shown = self.select(names if names is not None else self.names)
        panels = [
            Panel(
                column.meaning or column.name,
                f"{column.name} [{column.shown_unit}]",
                column.shown(shown[column.name]),
                float(column.shown(np.array(column.nominal))),
            )
            for column in shown.columns
        ]
        start, reasons = self.validity
        suffix = "" if self.complete else f" ({self.status})"
        title = f"{self.model}{suffix}"
        return draw_panels(title, self.time, panels, invalid_from=start, reasons=reasons)

    def animate(self, target: str | os.PathLike[str] | None = None, **options: Any) -> Any:
        """Show the run in three dimensions; see `cosim.animate`."""
        return presenter("animate")(self, target, **options)

    def _index(self, name: str) -> int:
        try:
            return self.names.index(name)
        except ValueError:
            raise UnknownName.among(f"{self.model}: run", "variable", name, self.names) from None

    def _headline(self) -> str:
        times = "no time" if not len(self) else "1 time" if len(self) == 1 else f"{len(self)} times"
        span = f" from {self.time[0]:g} to {self.time[-1]:g} s" if len(self) else ""
        count = len(self.columns)
        stop = f", stopped where {self.stats['stop']}" if "stop" in self.stats else ""
        solver = f", {self.stats['solver']}" if "solver" in self.stats else ""
        variables = f"{count} variable{'s' * (count != 1)}"
        return f"{self.model}: {times}{span}, {variables}{solver}, {self.status}{stop}"
