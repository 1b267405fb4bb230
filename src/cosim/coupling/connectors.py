"""`Connector`: a name of a whole system for inputs and parameters of its parts, or an output."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from casadi_models.units import Unit
from cosim.trajectory import Trajectory


class End(NamedTuple):
    """A variable of a part behind a connector: (part, name), and a linear transformation."""

    variable: tuple[str, str]
    factor: float
    offset: float

    @property
    def is_same(self) -> bool:
        """Whether the variable has the value of the connector, which may then be a word."""
        return (self.factor, self.offset) == (1.0, 0.0)


def transformed(number: float, factor: float, offset: float) -> float:
    """Return factor * number + offset; an integer that stays the same is not rounded."""
    return number if (factor, offset) == (1.0, 0.0) else factor * number + offset


@dataclass(frozen=True)
class Connector:
    """A connector of a whole system.

    Attributes:
        name: Of the connector.
        unit: Of its value; None if it has none.
        units: What its file says that the unit means, by name.
        is_input: Whether its value sets variables of parts: variable = factor value + offset.
            Otherwise it shows one: value = factor variable + offset.
        ends: The variables; one for an output.
        is_text: Whether it is a text, which no run records.
    """

    name: str
    unit: str | None
    is_input: bool
    ends: tuple[End, ...]
    units: Mapping[str, Unit] = field(default_factory=dict)
    is_text: bool = False

    @property
    def shows(self) -> bool:
        """Whether it is an output of a part, and can be recorded."""
        return not self.is_input and len(self.ends) == 1 and not self.is_text

    def __str__(self) -> str:
        ends = ", ".join(".".join(end.variable) for end in self.ends) or "nothing"
        return f"{self.name} -> {ends}" if self.is_input else f"{ends} -> {self.name}"


def with_outputs(
    run: Trajectory, connectors: Mapping[str, Connector], outputs: Sequence[str] | None
) -> Trajectory:
    """Return a run with the outputs of the whole system.

    Args:
        run: With the variables behind them.
        connectors: Of the system, by name.
        outputs: Names to retain; all when None.
    """
    shown = [c for c in connectors.values() if c.shows and c.name not in run]
    if outputs is not None:
        shown = [connector for connector in shown if connector.name in outputs]
    if not shown:
        return run
    columns, values = list(run.columns), [run.values]
    for connector in shown:
        (end,) = connector.ends
        source = run.column(".".join(end.variable))
        column = replace(source, name=connector.name, unit=connector.unit or source.unit)
        if column.unit != source.unit or end.factor != 1:
            nominal = abs(end.factor) * source.nominal or source.nominal
            column = replace(
                column, display_unit=None, display_factor=None, display_offset=0.0, nominal=nominal
            )
        columns.append(column)
        values.append((end.factor * run[source.name] + end.offset)[:, np.newaxis])
    whole = replace(run, columns=tuple(columns), values=np.hstack(values))
    if outputs is None:
        return whole
    return whole.select([name for name in whole.names if name in outputs])
