"""`Ensemble`: the results of many runs of one model."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cosim.arrays import Integers, Truths, Vector
from cosim.errors import UnknownName, naming_arguments_of
from cosim.host.optional_packages import optional_module
from cosim.model.values import position
from cosim.series.curves import DEFAULT_RELATIVE_TOLERANCE, Curves, Rows, curves, of_rows
from cosim.text import MOST_LINES, Table, counted, one_note, sentence, short_reason, text_table
from cosim.trajectory import Column, Trajectory

if TYPE_CHECKING:
    import xarray as xr

    from casadi_models.dae import Drawing


_NUMBERS = 4_000_000  # that runs computed together at further times have


class RunState(StrEnum):
    """How a run ended."""

    COMPLETE = "complete"
    FAILED = "failed"  # the solver failed
    STOPPED = "stopped"  # a validity condition was violated, with on_invalid="stop"
    REFUSED = "refused"  # its values, or initial values that follow from them, are not possible
    INTERRUPTED = "interrupted"  # by Ctrl-C
    LOST = "lost"  # its process ended before it returned the run


class Row(NamedTuple):
    """A run as a row of an ensemble.

    Attributes:
        values: At the output times that all runs share, SI, (n, columns).
        steps, rhs_calls: Numbers of its steps and of calls of the equations.
        invalid: The first violation of a validity condition; None if there is none.
        note: What it differs in from the request; None if in nothing.
        run: It, or what makes it, if it has events; else None.
    """

    values: Vector
    steps: int
    rhs_calls: int
    invalid: str | None
    note: str | None
    run: Trajectory | Callable[[], Trajectory] | None

    @classmethod
    def of(cls, run: Trajectory, time: Vector) -> Row:
        """Return a run, which may have ended early, as a row over output times, s."""
        stats, with_events = run.stats, bool(run.events) or "stop" in run.stats
        return cls(
            run.values[: shared_rows(run, time)],
            stats.get("steps", 0),
            stats.get("rhs_calls", 0),
            stats["invalid"][0] if "invalid" in stats else None,
            stats.get("note"),
            run if with_events else None,
        )


class LazyRuns(Mapping[int, Trajectory]):
    """Trajectories by position, some of which are made when they are needed.

    Args:
        runs: Trajectories, or what makes them.
    """

    def __init__(self, runs: dict[int, Trajectory | Callable[[], Trajectory]]) -> None:
        self._runs = runs

    def __getitem__(self, position: int) -> Trajectory:
        run = self._runs[position]
        if not isinstance(run, Trajectory):
            self._runs[position] = run = run()
        return run

    def __reduce__(self) -> tuple[type[LazyRuns], tuple[dict[int, Trajectory]]]:
        return LazyRuns, (dict(self),)

    def __contains__(self, position: object) -> bool:
        return position in self._runs

    def __iter__(self) -> Iterator[int]:
        return iter(self._runs)

    def __len__(self) -> int:
        return len(self._runs)


@naming_arguments_of
@dataclass(frozen=True, eq=False, repr=False)  # arrays have no single truth value
class Ensemble:
    """Values of variables over time for many runs of one model, in SI units.

    Attributes:
        model: `MODEL/FORMULATION`, or the name in an FMU.
        time: Output times, s, (times,).
        columns: The variables.
        values: Values, (runs, times, columns); NaN after the last valid output time of a run.
        start_values: The values that were varied, by name, (runs,) each.
        states: How each run ended.
        reasons: Why a run is not complete, by position of the run.
        invalid: Violated validity conditions, by position of the run.
        reached: Number of valid output times of each run, (runs,).
        steps, rhs_calls: Numbers of steps and of calls of the equations of each run, (runs,).
        error: Sum of the estimated errors of each run's steps, relative to the states' size, in
            the solver's norm, (runs,); NaN if the solver estimates no error.
        stats: Statistics of all runs: solver, relative_tolerance, solve_time [s], wall_time [s],
            ...
        drawing: The drawing of the model; None if unknown.
        numbers: Parameters and constant inputs that were not varied, SI; None if unknown.
        units: Units of the varied values, by name.
        notes: What a run differs in from the request, or may have missed, by position of the run.
        with_events: Runs with events, by position, with these and the row of one that ended them.
        again: Computes runs without events, given by their positions, at other times: values,
            (positions, times, columns); None if they cannot be computed again.
        changes: Returns between which times variables of a run without events, given by its
            position, may change within a part of a step, s; None if nothing tells it.

    Example:
        >>> import cosim
        >>> many = cosim.simulate_many(cosim.load("crank_shaft"), {"omega": [40, 50]}, stop_time=1)
        >>> many.status, many["phi"].shape
        ('2 complete', (2, 101))
    """

    model: str
    time: Vector
    columns: tuple[Column, ...]
    values: Vector
    start_values: Mapping[str, Vector]
    states: tuple[RunState, ...]
    reasons: Mapping[int, str]
    invalid: Mapping[int, str]
    reached: Integers
    steps: Integers
    rhs_calls: Integers
    error: Vector
    stats: Mapping[str, Any] = field(default_factory=dict)
    drawing: Drawing | None = field(default=None, repr=False)
    numbers: Mapping[str, float] | None = field(default=None, repr=False)
    units: Mapping[str, str] = field(default_factory=dict)
    notes: Mapping[int, str] = field(default_factory=dict)
    with_events: Mapping[int, Trajectory] = field(default_factory=dict, repr=False)
    again: Callable[[Vector, Integers], Vector] | None = field(default=None, repr=False)
    changes: Callable[[int], Vector] | None = field(default=None, repr=False)

    def __len__(self) -> int:
        return len(self.states)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the variables, without time."""
        return tuple(column.name for column in self.columns)

    @property
    def status(self) -> str:
        """Number of runs in each final state, as text."""
        counts = {state: self.states.count(state) for state in RunState if state in self.states}
        return ", ".join(f"{count} {state}" for state, count in counts.items())

    @property
    def complete(self) -> Truths:
        """Whether each run reached its stop time, (runs,)."""
        return np.array([state is RunState.COMPLETE for state in self.states], dtype=bool)

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C ended the runs."""
        return RunState.INTERRUPTED in self.states

    def __contains__(self, name: object) -> bool:
        return name == "time" or name in self.names

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __getitem__(self, name: str) -> Vector:
        """Return the values of a variable, (runs, times), or "time", (times,).

        Raises:
            UnknownName: The variable was not recorded.
        """
        if name == "time":
            return self.time
        UnknownName.reject(f"{self.model}: ensemble", "variable", self.names, name)
        return self.values[:, :, self.names.index(name)]

    def with_runs(self, runs: Integers, others: Ensemble) -> Ensemble:
        """Return an ensemble in which the runs at some positions are those of another one."""
        places = runs.tolist()

        def rows(own: Any, new: Any) -> Any:
            own = own.copy()
            own[runs] = new
            return own

        def facts(own: Mapping[int, Any], new: Mapping[int, Any]) -> dict[int, Any]:
            left = {i: fact for i, fact in own.items() if i not in places}
            return left | {places[i]: fact for i, fact in new.items()}

        states = dict(enumerate(self.states)) | dict(zip(places, others.states, strict=True))
        return replace(
            self,
            values=rows(self.values, others.values),
            states=tuple(states.values()),
            reasons=facts(self.reasons, others.reasons),
            invalid=facts(self.invalid, others.invalid),
            reached=rows(self.reached, others.reached),
            steps=rows(self.steps, others.steps),
            rhs_calls=rows(self.rhs_calls, others.rhs_calls),
            error=rows(self.error, others.error),
            notes=facts(self.notes, others.notes),
            with_events=facts(self.with_events, others.with_events),
        )

    def run(self, i: int) -> Trajectory:
        """Return one run up to its last valid output time, or to the event that ended it."""
        i = position(self.model, "run", i, len(self.states))
        if i in self.with_events:
            return self.with_events[i]
        n = int(self.reached[i])
        stats = {"solver": self.stats.get("solver"), "steps": int(self.steps[i])}
        stats |= {"rhs_calls": int(self.rhs_calls[i])}
        if i in self.invalid:
            stats["invalid"] = [self.invalid[i]]
        if i in self.notes:
            stats["note"] = self.notes[i]
        status = "complete" if self.states[i] is RunState.COMPLETE else self.reasons[i]
        numbers = drawing = None
        if self.numbers is not None:
            given = {name: float(column[i]) for name, column in self.start_values.items()}
            numbers = {name: given.get(name, value) for name, value in self.numbers.items()}
            drawing = self.drawing and self.drawing.with_numbers(numbers)
        table = self.values[i, :n]
        return Trajectory(
            self.model, self.time[:n], self.columns, table, stats, status, drawing, None, numbers
        )

    def rows(self, i: int) -> Curves:
        """Return what the output times tell of a run."""
        i = position(self.model, "run", i, len(self.states))
        run = self.with_events.get(i)
        return of_rows(
            Rows(self.time, self.values[i]) if run is None else Rows(run.time, run.values)
        )

    def curves(self) -> Iterator[tuple[int, Curves]]:
        """Yield each complete run and what is known of its variables between the output times.

        Runs that can be computed again are known at every time; see `Trajectory.curves`.
        """
        complete = np.flatnonzero(self.complete)
        events = [i for i in complete.tolist() if i in self.with_events]
        yield from ((i, self.with_events[i].curves) for i in events)
        plain = np.array([i for i in complete if i not in self.with_events], dtype=np.int64)
        again = self.again
        if again is None or len(self.time) < 2:
            yield from ((i, self.rows(i)) for i in plain.tolist())
            return
        nodes = 4 * max(len(self.time), 4 * int(self.steps.max(initial=0)))
        size = max(1, _NUMBERS // (nodes * len(self.columns) + 1))
        changes = {i: self.changes(i) if self.changes else np.empty(0) for i in plain.tolist()}
        calm = np.array([i for i, own in changes.items() if not len(own)], dtype=np.int64)
        groups = [calm[first : first + size] for first in range(0, len(calm), size)]
        alone = np.setdiff1d(plain, calm)[:, None]  # the times of a group are those of all its runs
        for some in [*groups, *alone]:
            found = curves(
                partial(lambda some, times, runs: again(times, some[runs]), some),
                [Rows(self.time, self.values[i]) for i in some],
                [int(self.steps[i]) for i in some],
                float(self.stats.get("relative_tolerance") or DEFAULT_RELATIVE_TOLERANCE),
                np.array([column.nominal for column in self.columns]),
                changes=[changes[i] for i in some.tolist()],
            )
            yield from zip(some.tolist(), found, strict=True)

    def reason(self, i: int) -> str:
        """Return from when on a run is invalid, and why it is not complete; "" if neither."""
        i = position(self.model, "run", i, len(self.states))
        invalid, stopped = self.invalid.get(i, ""), self.reasons.get(i, "")
        first = "" if invalid and invalid in stopped else short_reason(invalid)
        return one_note(first, short_reason(stopped))

    def summary(self) -> Table:
        """Return the smallest and largest value of each quantity, of the rows of all runs."""
        rows = varied_rows(self.start_values, self.units)
        for column, own in zip(self.columns, np.moveaxis(self.values, 2, 0), strict=True):
            rows.append(range_row(column.name, column.shown_unit, column.shown(own)))
        span = f" from {self.time[0]:g} to {self.time[-1]:g} s" if len(self.time) else ""
        facts = [counted(len(self), "run"), counted(len(self.time), "time") + span, self.status]
        return Table(tuple(rows), f"{self.model}: {', '.join(filter(None, facts))}")

    def __repr__(self) -> str:
        table = self.summary()
        lines = [table.caption, text_table(table.rows, most=MOST_LINES - 2)]
        reasons = {i: self.reason(i) for i in range(len(self)) if self.reason(i)}
        return "\n".join([*lines, *first_of("reason", reasons), *first_of("note", self.notes)])

    def _repr_html_(self) -> str:
        return self.summary()._repr_html_()

    def to_xarray(self) -> xr.Dataset:
        """Return an `xarray.Dataset` over run and time; varied values are coordinates of run."""
        xarray = optional_module("xarray", "data")
        variables: dict[str, Any] = {
            column.name: (("run", "time"), self.values[:, :, i], column.facts)
            for i, column in enumerate(self.columns)
        }
        variables["status"] = ("run", np.array([str(state) for state in self.states]))
        variables["reason"] = ("run", np.array([self.reason(i) for i in range(len(self))]))
        given = {
            f"{name}_start" if name in variables else name: (
                "run",
                values,
                unit_fact(self.units, name),
            )
            for name, values in self.start_values.items()
        }
        coordinates = {"time": ("time", self.time, {"units": "s"}), **given}
        dataset: xr.Dataset = xarray.Dataset(variables, coordinates, {"model": self.model})
        return dataset


def varied_rows(varied: Mapping[str, Vector], units: Mapping[str, str]) -> list[dict[str, Any]]:
    """Return the range of each varied quantity, in these units, as rows of a table."""
    return [
        range_row(f"{name} (varied)", units.get(name, ""), values)
        for name, values in varied.items()
    ]


def unit_fact(units: Mapping[str, str], name: str) -> dict[str, str]:
    """Return the unit of a quantity as the attribute of an array, if it has one."""
    return {"units": units[name]} if units.get(name) else {}


def first_of(what: str, texts: Mapping[int, str]) -> list[str]:
    """Return a line that counts texts by run and holds the first one; none without texts."""
    if not texts:
        return []
    run, text = next(iter(texts.items()))
    return [f"{len(texts)} with a {what}, the first one: run {run}: {sentence(text)}"]


def range_row(name: str, unit: str, values: Vector) -> dict[str, Any]:
    """Return the smallest and largest finite value as a row of a table."""
    finite = values[np.isfinite(values)]
    low, high = (finite.min(), finite.max()) if finite.size else (np.nan, np.nan)
    return {"name": name, "unit": unit, "min": float(low), "max": float(high)}


def shared_rows(run: Trajectory, time: Vector) -> int:
    """Return how many rows of a run are at the output times of all; that of a stop may not be."""
    n = len(run)
    return n - bool(n and not np.isclose(run.time[-1], time[n - 1], rtol=1e-9, atol=0))
