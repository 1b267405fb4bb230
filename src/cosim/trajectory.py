"""`Trajectory`: the result of a run on any backend."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from itertools import groupby
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TextIO, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cosim.arrays import Vector, frozen
from cosim.errors import UnknownName, UsageError, naming_arguments_of
from cosim.host.optional_packages import optional_module
from cosim.presenters import presenter
from cosim.series.csv_file import read_samples, shortest, write_csv
from cosim.series.curves import DEFAULT_RELATIVE_TOLERANCE, Curves, Rows, curves, of_rows
from cosim.series.mat_file import write_mat
from cosim.series.samples import Column, resample, summary_table, summary_text, times_within
from cosim.text import MOST_LINES, Table, Violation, counted, html_table, violations_in

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

    from casadi_models.dae import Drawing

SHOWN_PANELS = 6  # of the picture in a notebook

__all__ = ["Column", "Trajectory", "shortest"]


@dataclass(frozen=True)
class Event:
    """Something that happened at an instant of a run.

    Attributes:
        time: s.
        name: Name of the event, or the operation of the equations that switched.
        before, after: States and recorded variables just before and after it, SI; empty in runs
            of FMUs.
    """

    time: float
    name: str
    before: Mapping[str, float]
    after: Mapping[str, float]


@naming_arguments_of
@dataclass(frozen=True, eq=False)  # arrays have no single truth value
class Trajectory:
    """Values of variables over time, in SI units.

    `run["phi"]` is an array, `run[["phi", "delta"]]` a run with these variables only. `name in run`
    and `for name in run` refer to names; `len(run)` is the number of times, as in pandas.

    Attributes:
        model: `MODEL/FORMULATION`, or the name in an FMU.
        time: Output times, s, (n,).
        columns: The variables.
        values: One column per variable, (n, len(columns)).
        stats: Mapping of facts: solver, steps, wall_time [s], ...; of a native run also attributes.
        status: "complete", or where and why the run stopped early.
        drawing: What the model looks like, with the run's parameters; None if not known.
        numbers: Parameters and constant inputs of the run, SI; None if not known.
        again: Computes the run at other times within its span; None if it cannot be computed again.
        events: What happened at instants, in order.
        changes: Returns times, s, (m,), between which it may change in a part of a step; or None.

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
        min and max of the rows
    """

    model: str
    time: Vector
    columns: tuple[Column, ...]
    values: Vector
    stats: Any = field(default_factory=dict)
    status: str = "complete"
    drawing: Drawing | None = field(default=None, repr=False)
    again: Callable[[Vector], Trajectory] | None = field(default=None, repr=False)
    numbers: Mapping[str, float] | None = field(default=None, repr=False)
    events: tuple[Event, ...] = field(default=(), repr=False)
    changes: Callable[[], Vector] | None = field(default=None, repr=False)

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
        """Time from which the run is invalid, s (infinite if it is valid), and what is wrong."""
        found = self.stats.get("invalid", ())
        reasons = tuple(getattr(text, "what", text) for text in found)
        if not len(self):
            return inf, reasons
        times = (getattr(text, "time", float(self.time[0])) for text in found)
        start = float(self.stats.get("invalid_from", min(times, default=inf)))
        if self.complete:
            return start, reasons
        return min(start, float(self.time[-1])), (*reasons, self.status)

    def column(self, name: str) -> Column:
        """Return the metadata of a variable.

        Raises:
            UnknownName: The variable was not recorded.
        """
        return self.columns[self._index(name)]

    @overload
    def __getitem__(self, name: str) -> Vector: ...

    @overload
    def __getitem__(self, name: list[str] | tuple[str, ...]) -> Trajectory: ...

    def __getitem__(self, name: str | list[str] | tuple[str, ...]) -> Vector | Trajectory:
        """Return the values of a variable (or of "time"), (n,); of a list of names, a run.

        Raises:
            UnknownName: The variable was not recorded.
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
        """Return the same run with these variables only, in this order; a single name is accepted.

        Raises:
            UnknownName: A variable was not recorded.
            UsageError: A variable is named twice.
        """
        requested = (names,) if isinstance(names, str) else tuple(names)
        if requested == self.names:
            return replace(self)
        places = {name: i for i, name in enumerate(self.names)}
        chosen = [places[name] if name in places else self._index(name) for name in requested]
        columns = tuple(self.columns[i] for i in chosen)
        values = self.values[:, chosen]
        values.setflags(write=False)
        return replace(self, columns=columns, values=values)

    def with_events(self) -> Trajectory:
        """Return the run with rows just before and just after each event, at the same time."""
        hidden = [e for e in self.events if np.count_nonzero(self.time == e.time) < 2]
        known = [e for e in hidden if all(name in e.before for name in self.names)]
        times, rows = list[float](), list[list[float]]()
        for time, here in groupby(known, lambda event: event.time):
            events = list(here)
            sides = [before for before, _ in groupby(event.before for event in events)]
            if time not in self.time:  # a row there has what is after it
                sides.append(events[-1].after)
            times += [time] * len(sides)
            rows += [[side[name] for name in self.names] for side in sides]
        if not times:
            return self
        every = np.append(times, self.time)
        order = np.argsort(every, kind="stable")
        return replace(self, time=every[order], values=np.vstack((rows, self.values))[order])

    @property
    def final(self) -> dict[str, float]:
        """Every variable at the last time, by name."""
        return dict(zip(self.names, self.values[-1].tolist(), strict=True))

    def at(self, times: ArrayLike) -> Any:
        """Return the run at other times within its span.

        A run of `cosim.simulate` is computed again at these times by its solver. Any other run is
        interpolated between its samples by polynomials of degree 5, never across an event.

        Args:
            times: One time, or an array (m,) in increasing order, s.

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
        requested = times_within(self.model, self.time, times)
        if self.again is not None:
            distinct, places = np.unique(requested, return_inverse=True)
            found = self.again(distinct).select(self.names)
            if len(distinct) < requested.size:
                found = replace(found, time=requested, values=found.values[places])
        else:
            found, _ = self.interpolated(np.atleast_1d(requested))
        begin, end = requested.min(initial=inf), requested.max(initial=-inf)
        events = tuple(event for event in found.events if begin <= event.time <= end)
        return found.final if requested.ndim == 0 else replace(found, events=events)

    def interpolated(self, times: Vector) -> tuple[Trajectory, Vector]:
        """Return the run between its rows at times (m,), s, and an error estimate by column, SI."""
        own = self.with_events()  # with rows at events whose values are known
        found = resample(own.time, own.values, times, np.array([e.time for e in self.events]))
        return replace(self, time=times, values=found[0]), found[1]

    @cached_property
    def curves(self) -> Curves:
        """What is known of the variables between the output times.

        A run that can be computed again is computed at further times until polynomials fit it to
        its tolerance; `curves.extremes`, `mean()`, `rms()` and `first(i, level)` are then numbers
        of its motion. Of other runs they are numbers of the rows.
        """
        known, again = self._rows(), self.again
        if again is None or len(self) < 2 or not self.columns:
            return known
        found = curves(
            lambda times, _: again(times).select(self.names).values[None],
            [known.rows],
            [int(self.stats.get("steps") or 0)],
            float(self.stats.get("relative_tolerance") or DEFAULT_RELATIVE_TOLERANCE),
            np.array([column.nominal for column in self.columns]),
            [event.time for event in self.events],
            None if self.changes is None else [self.changes()],
        )
        return found[0]

    def summary(self) -> Table:
        """Return start, end, smallest and largest value of every variable, in display units.

        They are those of `curves`: of the motion, or of the rows, which the headline then says.
        """
        return summary_table(self.columns, self.curves, self._headline())

    @classmethod
    def read_csv(
        cls,
        path: str | os.PathLike[str],
        *,
        columns: Mapping[str, str] | None = None,
        time: str | None = None,
        units: Mapping[str, str] | None = None,
        like: Trajectory | None = None,
        model: str | None = None,
        time_offset: float = 0.0,
    ) -> Trajectory:
        """Read a run, a measurement or another tool's result from a CSV file.

        The first line names the columns. Time is the column `time`, or else the first one; its
        steps may differ. Units are in brackets after the names or in a second line; values are
        converted to SI. Empty cells and `nan` are gaps: they are NaN in the result, `compare`
        leaves them out, and `stats["gaps"]` counts them.

        Args:
            path: The file; columns separated by commas, semicolons or tabs. Decimal commas are read
                where the columns are not separated by commas.
            columns: Header of a column, with or without its unit, by name of the variable, e.g.
                `{"phi": "roll [deg]"}`; other columns are not read. All columns if None.
            time: Header of the column with the times, e.g. `"t [ms]"`.
            units: Units by name of columns without a unit in the file.
            like: A run whose units, nominal values and meanings apply to the same names.
            model: Name of the model; the name of the file if None.
            time_offset: Time that is added to the times of the file, s.

        Raises:
            UsageError: The file cannot be read, has no header or an unknown unit.
            UnknownName: There is no column with a requested header.
            ParameterError: A cell is not a number, or time is missing or decreases.
        """
        UsageError.reject(
            "read_csv: columns", columns, Mapping | None, "headers by name of a variable"
        )
        place = Path(path)
        known = {} if like is None else {column.name: column for column in like.columns}
        times, own, values, _ = read_samples(place, columns, time, units or {}, known)
        stats = {"file": place.name, "gaps": int(np.isnan(values).sum())}
        return cls(model or place.stem, times + time_offset, own, values, stats)

    def __repr__(self) -> str:
        return summary_text(self.columns, self._rows(), self._headline())

    def _repr_html_(self) -> str:
        if not len(self) or not self.columns:
            return html_table((), self._headline())
        from cosim.plotting import embedded

        shown = self.select(self.names[:SHOWN_PANELS])
        summary = summary_table(self.columns, self._rows(), self._headline())
        left = len(summary.rows) - MOST_LINES
        table = html_table(summary.rows[:MOST_LINES], summary.caption, digits=6)
        more = f"<p>... and {left} more: run.summary()</p>" if left > 0 else ""
        return f"{embedded(shown.plot(), 'curves')}{table}{more}"

    def _ipython_key_completions_(self) -> list[str]:
        return ["time", *self.names]

    def __getstate__(self) -> dict[str, Any]:
        # a pickled result does not contain its model
        return {n: v for n, v in self.__dict__.items() if n not in ("curves", "again", "changes")}

    @property
    def structured(self) -> NDArray[Any]:
        """A structured array, `time` first, as FMPy's own helpers read it; shape (n,)."""
        table = np.empty(len(self), dtype=[(name, np.float64) for name in ("time", *self.names)])
        table["time"] = self.time
        for name, values in zip(self.names, self.values.T, strict=True):
            table[name] = values
        return table

    def to_csv(self, target: str | os.PathLike[str] | TextIO, *, units: str = "si") -> None:
        """Write `time` and every variable, with the fewest digits that read back to the same bits.

        Args:
            target: File name, replaced atomically, or an open text file.
            units: "si", or "book" for display units and a second line that names them.

        Raises:
            ExportError: The file cannot be written.
            UsageError: The target is neither a file name nor an open text file.
            UnknownName: There is no such kind of units.
        """
        write_csv(target, self.columns, self.time, self.values, units)

    def to_mat(self, target: str | os.PathLike[str]) -> None:
        """Write a MATLAB file (version 5): `time`, each variable as a column, the struct `units`.

        What MATLAB does not allow in a name becomes `_`; the struct `names` holds the names here.

        Raises:
            MissingTool: scipy is not installed.
            ExportError: The file cannot be written.
        """
        write_mat(target, self.columns, self.time, self.values)

    def to_npz(self, target: str | os.PathLike[str] | BinaryIO) -> None:
        """Write everything, bit for bit, as an NPZ file of numpy; see `from_npz`.

        Args:
            target: File name, replaced atomically, or an open binary file.

        Raises:
            ExportError: The file cannot be written.
        """
        facts = {
            "model": self.model,
            "stats": dict(self.stats),
            "status": self.status,
            "numbers": None if self.numbers is None else dict(self.numbers),
            "columns": [asdict(column) for column in self.columns],
            "events": [asdict(event) for event in self.events],
            "violations": violations_in(self.stats.get("invalid", ())),
        }
        content = io.BytesIO()
        text = json.dumps(facts, default=np.generic.item)
        np.savez(content, time=self.time, values=self.values, facts=text)
        if isinstance(target, str | os.PathLike):
            from cosim.files import write_atomically  # only if a file is written

            write_atomically(target, content.getvalue())
        else:
            target.write(content.getvalue())

    @classmethod
    def from_npz(cls, source: str | os.PathLike[str] | BinaryIO) -> Trajectory:
        """Read a file that `to_npz` wrote.

        Raises:
            UsageError: The file is not of that kind.
        """
        try:
            with np.load(source, allow_pickle=False) as stored:
                facts = json.loads(str(stored["facts"]))
                columns = tuple(Column(**column) for column in facts.pop("columns"))
                facts["events"] = tuple(Event(**event) for event in facts["events"])
                for i, when, what, text in facts.pop("violations", ()):
                    facts["stats"]["invalid"][i] = Violation(when, what, text)
                return cls(time=stored["time"], columns=columns, values=stored["values"], **facts)
        except Exception as error:
            raise UsageError(f"{source} contains no trajectory: {error}") from error

    def to_pandas(self) -> pd.DataFrame:
        """Return a `pandas.DataFrame` of SI values indexed by time; units in `attrs`.

        Raises:
            MissingTool: pandas is not installed.
        """
        pandas = optional_module("pandas", "data")
        frame: pd.DataFrame = pandas.DataFrame(self.values, columns=self.names, index=self.time)
        frame.index.name = "time"
        frame.attrs = {"model": self.model, "units": self.units, "status": self.status}
        return frame

    def to_xarray(self) -> xr.Dataset:
        """Return an `xarray.Dataset` over time; unit and meaning in each variable's `attrs`.

        Raises:
            MissingTool: xarray is not installed.
        """
        variables = {
            column.name: ("time", values, column.facts)
            for column, values in zip(self.columns, self.values.T, strict=True)
        }
        coordinates = {"time": ("time", self.time, {"units": "s"})}
        attrs = {"model": self.model, "status": self.status}
        found: xr.Dataset = optional_module("xarray", "data").Dataset(variables, coordinates, attrs)
        return found

    def plot(self, names: str | Sequence[str] | None = None) -> Figure:
        """Draw variables over time in their display units, a panel each.

        The span in which the run is outside its validity range is shaded and explained.

        Args:
            names: One variable or several; all if None.

        Raises:
            UnknownName: A variable was not recorded.
        """
        shown = self.select(names if names is not None else self.names)
        figure: Figure = presenter("plot")(shown)
        return figure

    def animate(self, target: str | os.PathLike[str] | None = None, **options: Any) -> Any:
        """Show the run in three dimensions; see `cosim.animate`."""
        return presenter("animate")(self, target, **options)

    def _index(self, name: str) -> int:
        UnknownName.reject(f"{self.model}: run", "variable", self.names, name)
        return self.names.index(name)

    def _rows(self) -> Curves:
        own = self.with_events()
        return of_rows(Rows(own.time, own.values))

    def _headline(self) -> str:
        times = counted(len(self), "time")
        span = f" from {self.time[0]:g} to {self.time[-1]:g} s" if len(self) else ""
        stop = f", stopped where {self.stats['stop']}" if "stop" in self.stats else ""
        solver = f", {self.stats['solver']}" if "solver" in self.stats else ""
        variables = counted(len(self.columns), "variable")
        return f"{self.model}: {times}{span}, {variables}{solver}, {self.status}{stop}"
