"""`Unknowns`: the values that a fit varies, with their bounds and initial values."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

import numpy as np

from cosim.arrays import Vector
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.model.values import listed, number
from cosim.study.fit.subject import Subject
from cosim.study.sweep.samples import design
from cosim.trajectory import Column

DECADES = 100.0  # ratio of positive bounds from which the middle is the geometric mean


@dataclass(frozen=True, eq=False)
class Unknowns:
    """The values that a fit varies.

    Attributes:
        columns: Their names, units and meanings.
        places: Name in the model, and position of the record that the value is for; None for all.
        initial: Initial values, (n,).
        low, high: Bounds, (n,).
    """

    columns: tuple[Column, ...]
    places: tuple[tuple[str, int | None], ...]
    initial: Vector
    low: Vector
    high: Vector

    @classmethod
    def of(
        cls,
        subject: Subject,
        given: Any,
        fixed: Mapping[str, float],
        each: Collection[str],
        records: int,
    ) -> "Unknowns":
        """Return the unknowns that a user names, those in `each` once a record; see `fit`."""
        if isinstance(given, str) or not isinstance(given, Mapping | Sequence):
            raise UsageError.of_type("fit: parameters", given, "names, or bounds by name")
        if not given:
            raise UsageError(
                "fit: nothing is unknown; name what to fit: parameters=..., or --free A,B"
            )
        asked = dict(given) if isinstance(given, Mapping) else dict.fromkeys(given)
        if each or not isinstance(each, tuple | list):
            UnknownName.reject("fit: each", "unknown", asked, *listed("fit: each", each))
        columns, places, rows = list[Column](), list[tuple[str, int | None]](), []
        for name, what in asked.items():
            if name in fixed:
                raise UsageError(f"fit: {name} is in parameters and in start_values; give it once")
            known = subject.known(name)
            row = _row(name, what, known.start, (known.minimum, known.maximum))
            for record in range(records) if name in each and records > 1 else (None,):
                label = name if record is None else f"{name} (record {record + 1})"
                columns.append(replace(known.column, name=label))
                places.append((name, record))
                rows.append(row)
        initial, low, high = np.array(rows).T
        return cls(tuple(columns), tuple(places), initial, low, high)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns."""
        return tuple(column.name for column in self.columns)

    def of_record(self, record: int) -> dict[str, int]:
        """Return the positions of the unknowns of one record, by name in the model."""
        return {name: i for i, (name, own) in enumerate(self.places) if own in (None, record)}

    @property
    def sizes(self) -> Vector:
        """Magnitudes of the unknowns by which the fit scales them, (n,)."""
        nominal = np.array([column.nominal for column in self.columns])
        return np.where(self.initial == 0, nominal, np.abs(self.initial))

    def of_scaled(self, x: Vector) -> Vector:
        """Return values from scaled ones, SI, (n,); rounding leads none beyond a bound."""
        return np.clip(x * self.sizes, self.low, self.high)

    def starts(self, count: int, seed: int) -> Vector:
        """Return the initial values, and further ones of a Latin hypercube, (count, n).

        Raises:
            ParameterError: Some bounds are not finite.
        """
        if count == 1:
            return self.initial[None]
        spans = zip(self.names, self.low, self.high, strict=True)
        ranges = {name: (float(low), float(high)) for name, low, high in spans}
        for name, span in ranges.items():
            if not np.all(np.isfinite(span)):
                raise ParameterError(
                    f"fit: several starts need bounds of {name}; give {name} = (low, high)"
                )
        table = design("lhs", count - 1, ranges, seed=seed).columns
        return np.vstack((self.initial, np.column_stack([table[name] for name in self.names])))


def _row(
    name: str, what: Any, start: float, bounds: tuple[float, float]
) -> tuple[float, float, float]:
    """Return initial value and bounds of an unknown."""
    if what is None:
        if np.isnan(start):
            raise ParameterError(f"fit: {name} has no initial value of its own; give one")
        return start, *bounds
    if isinstance(what, Real | str) or (isinstance(what, np.ndarray) and what.ndim == 0):
        start = number("fit", name, what)
        if not bounds[0] <= start <= bounds[1]:
            raise ParameterError(
                f"fit: {name} = {start:g} is outside its bounds {bounds[0]:g} ... {bounds[1]:g}"
            )
        return start, *bounds
    UsageError.reject(f"fit: {name}", what, Sequence | np.ndarray, "numbers")
    parts = [number("fit", name, part) for part in what]
    if len(parts) not in (2, 3) or not all(np.diff(parts) > 0):
        raise ParameterError(
            f"fit: {name} = {tuple(what)}: give (low, high) or (low, initial value, high), each "
            "above the one before"
        )
    low, high = max(parts[0], bounds[0]), min(parts[-1], bounds[1])
    if not low < high:
        raise ParameterError(
            f"fit: {name} = {tuple(what)} is outside its bounds {bounds[0]:g} ... {bounds[1]:g}"
        )
    if len(parts) == 3:
        start = parts[1]
    elif not low < start < high:
        wide = low > 0 and high > DECADES * low
        start = float(np.sqrt(low * high)) if wide else (low + high) / 2
    return float(np.clip(start, low, high)), low, high
