"""Values of many variants of one model: checked like single values, rejected row by row."""

from collections.abc import Mapping
from dataclasses import dataclass
from warnings import catch_warnings

import numpy as np
from numpy.typing import ArrayLike

from casadi_models.dae import Dae, Start
from cosim.arrays import Integers, Vector, reals
from cosim.errors import CosimError, ParameterError, UsageError
from cosim.model.start_outputs import reject_twice, solved_starts
from cosim.model.values import assign, inertias, unphysical, usual_numbers


@dataclass(frozen=True)
class ManyValues:
    """Values of every run for each state (initial guesses included), parameter and input.

    Attributes:
        given: What the user gave, by name, (runs,).
        x, p, u: (runs, number of them).
        refused: Why, by run, where a value cannot be.
    """

    given: Mapping[str, Vector]
    x: Vector
    p: Vector
    u: Vector
    refused: Mapping[int, str]

    def __len__(self) -> int:
        return len(self.x)

    def select(self, runs: Integers) -> "ManyValues":
        """Return the values of some runs, given by their positions, none of which is refused."""
        given = {name: column[runs] for name, column in self.given.items()}
        return ManyValues(given, self.x[runs], self.p[runs], self.u[runs], {})


def as_arrays(owner: str, values: Mapping[str, ArrayLike] | None) -> dict[str, Vector]:
    """Return arrays of equal length; a single number applies to all runs.

    Raises:
        ParameterError: Something is no column of numbers, or the lengths differ.
        UsageError: These are no values by name.
    """
    UsageError.reject(owner, values, Mapping | None, "arrays by name, e.g. {'phi': [0.1, 0.2]}")
    columns: dict[str, Vector] = {}
    for name, value in (values or {}).items():
        try:
            columns[name] = reals(value)
        except (TypeError, ValueError, OverflowError) as error:
            raise ParameterError(f"{owner}: {name}: {error}; give numbers in SI units") from error
        if columns[name].ndim > 1:
            raise ParameterError(
                f"{owner}: {name} has the shape {columns[name].shape}; give one number per run"
            )
    lengths = {name: len(column) for name, column in columns.items() if column.ndim}
    runs = max(lengths.values(), default=1)
    for name, length in lengths.items():
        if length != runs:
            raise ParameterError(
                f"{owner}: {name} has {length} values where others have {runs}; "
                "give one per run, or one for all"
            )
    return {
        name: np.ascontiguousarray(np.broadcast_to(column, runs))
        for name, column in columns.items()
    }


def assign_many(dae: Dae, overrides: Mapping[str, ArrayLike] | None = None) -> ManyValues:
    """Replace the model's start values, parameters and inputs by arrays of values.

    A value that is impossible refuses its run alone, in the words of `assign`.

    Raises:
        UnknownName: A name is no state, parameter or input of the model.
        ParameterError: The arrays differ in length or hold no numbers.
        InitialConditionError: A start value is given that follows from others.
        UsageError: This is no model, or these are no values by name.
    """
    assign(dae)  # rejects what is no model
    usual, places = usual_numbers(dae)
    given = as_arrays(dae.full_name, overrides)
    runs = len(next(iter(given.values()))) if given else 1
    table, bad = np.tile(usual, (runs, 1)), np.zeros(runs, dtype=bool)
    through = {way.variable.name for way in dae.start_outputs}
    reject_twice(dae, given)
    for name, column in given.items():
        calculated = name in places and places[name][1].start_kind is Start.CALCULATED
        if name not in places or (calculated and name not in through):
            assign(dae, {name: 0.0})  # says what is wrong
        row, variable = places[name]
        bad |= ~((column >= variable.minimum) & (column <= variable.maximum))
        bad |= ~np.isfinite(column)
        if row is not None:
            table[:, row] = column
    ends = np.cumsum([len(dae.states), len(dae.parameters)])
    x, p, u = map(np.ascontiguousarray, np.split(table, ends, axis=1))
    x, solved = solved_starts(dae, given, x, p)
    bad |= ~solved
    if runs and dae.inertias and any(v.name in given for v in dae.parameters):
        bad |= unphysical(inertias(dae, p))
    refused = {int(i): _reason(dae, given, int(i)) for i in np.flatnonzero(bad)}
    return ManyValues(given, x, p, u, refused)


def _reason(dae: Dae, given: Mapping[str, Vector], run: int) -> str:
    try:
        with catch_warnings(action="ignore"):
            assign(dae, {name: float(column[run]) for name, column in given.items()})
    except CosimError as error:
        return str(error)
    return "its values are impossible"
