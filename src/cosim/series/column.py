"""What is known of a recorded variable, and what its values amount to."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casadi_models.units import UNITS
from cosim.arrays import Vector


@dataclass(frozen=True)
class Column:
    """What is known of a recorded variable: name, SI unit, display unit, nominal, meaning.

    Example:
        >>> Column("phi", "rad", "deg").shown(np.array([np.pi]))
        array([180.])
    """

    name: str
    unit: str = "1"
    display_unit: str | None = None
    nominal: float = 1.0
    meaning: str = ""

    @property
    def shown_unit(self) -> str:
        """The unit in which people read it."""
        return self.display_unit or self.unit

    @property
    def facts(self) -> dict[str, str]:
        """Unit and meaning by the names of the climate and forecast conventions, for datasets."""
        return {"units": self.unit, "long_name": self.meaning}

    def shown(self, values: Vector) -> Vector:
        """Convert SI values of this variable to `shown_unit`."""
        if self.display_unit is None or self.unit not in UNITS:
            return values
        shown: Vector = values * UNITS[self.unit].factor / UNITS[self.display_unit].factor
        return shown


def summary_rows(
    columns: Sequence[Column], time: Vector, values: Vector, *, when: bool
) -> list[dict[str, Any]]:
    """Return start, end, smallest and largest value of each column in display units.

    Args:
        columns: What is known of each.
        time: s, (n,).
        values: SI, (n, len(columns)).
        when: Whether to say when the smallest and the largest one are.
    """
    if not len(time):
        return []
    rows = []
    for column, own in zip(columns, values.T, strict=True):
        shown = column.shown(own)
        known = shown if np.isfinite(shown).any() else np.zeros(len(shown))
        low, high = int(np.nanargmin(known)), int(np.nanargmax(known))
        row: dict[str, Any] = {"name": column.name, "unit": column.shown_unit}
        row |= {"start": float(shown[0]), "end": float(shown[-1])}
        row["min"] = float(shown[low])
        row |= {"min at [s]": float(time[low])} if when else {}
        row["max"] = float(shown[high])
        row |= {"max at [s]": float(time[high])} if when else {}
        rows.append(row)
    return rows
