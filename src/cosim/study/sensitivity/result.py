"""`Sensitivity`: derivatives over time, their ranking, and the agreement of two methods."""

import os
from dataclasses import dataclass
from typing import Any, TextIO

import numpy as np

from casadi_models.units import quotient_name
from cosim.arrays import Vector
from cosim.errors import UnknownName
from cosim.text import one_note
from cosim.trajectory import Column, Trajectory


@dataclass(frozen=True)
class Agreement:
    """Largest difference between the derivatives of two methods.

    Attributes:
        method: The second method.
        scaled: The difference times the size of the parameter, divided by the sum of the largest
            derivative of that pair times the same size and the output's nominal value (1).
        output, with_respect_to: Output and parameter of the derivative that differs most.
        time: Time of the largest difference, s.
        first, second: The derivative there, by both methods; SI.
        bound: Largest scaled difference that counts as agreement.
        note: Outputs whose derivatives are too small for the bound, and times at which events leave
            one-sided derivatives only.
    """

    method: str
    scaled: float
    output: str
    with_respect_to: str
    time: float
    first: float
    second: float
    bound: float
    note: str = ""

    def __repr__(self) -> str:
        return one_note(
            f"{self.method}: the largest difference is {self.scaled:.1e}, in d {self.output} / d "
            f"{self.with_respect_to} at {self.time:g} s (bound {self.bound:g})",
            self.note,
        )


@dataclass(frozen=True, eq=False)  # arrays have no single truth value
class Sensitivity:
    """Derivatives of outputs along a run.

    Attributes:
        run: The outputs over time.
        targets: Parameters, initial values and inputs by which they are differentiated: name,
            unit, meaning; the nominal value is the size that scales a derivative.
        values: Derivatives in SI units, (times, outputs, targets).
        check: Agreement with a second method; None without a check.
    """

    run: Trajectory
    targets: tuple[Column, ...]
    values: Vector
    check: Agreement | None = None

    def __getitem__(self, pair: tuple[str, str]) -> Vector:
        """Return d(output)/d(target) over time, SI, (n,).

        Raises:
            UnknownName: There is no such output or target.
        """
        of, by = pair
        places = []
        for kind, name, known in (
            ("output", of, self.run.names),
            ("parameter", by, [target.name for target in self.targets]),
        ):
            UnknownName.reject(f"{self.run.model}: sensitivity", kind, known, name)
            places.append([*known].index(name))
        return self.values[:, places[0], places[1]]

    @property
    def scaled(self) -> Vector:
        """Derivatives times the size of their target, in nominal values of the output."""
        nominal = np.array([column.nominal for column in self.run.columns])
        sizes = np.array([target.nominal for target in self.targets])
        scaled: Vector = self.values * sizes / nominal[:, None]
        return scaled

    @property
    def trajectory(self) -> Trajectory:
        """The derivatives as a run of variables `d_OUTPUT_d_TARGET`."""
        columns = tuple(
            Column(
                f"d_{column.name}_d_{target.name}",
                quotient_name(column.unit, target.unit),
                nominal=column.nominal / target.nominal,
                meaning=f"derivative of {column.name} by {target.name}",
            )
            for column in self.run.columns
            for target in self.targets
        )
        values = self.values.reshape(len(self.run), len(columns))
        return Trajectory(
            self.run.model, self.run.time, columns, values, self.run.stats, self.run.status
        )

    def ranking(self) -> list[dict[str, Any]]:
        """Return a table with a row per pair; for each output, the largest weight first.

        `weight` is the largest scaled derivative: how far the output would move, in nominal values
        and to first order, if the target changed by its whole size.
        """
        rows = []
        scaled = np.abs(self.scaled)
        for i, column in enumerate(self.run.columns):
            order = np.argsort(-scaled[:, i, :].max(axis=0), kind="stable")
            for j in order:
                at = int(scaled[:, i, j].argmax())
                rows.append(
                    {
                        "output": column.name,
                        "by": self.targets[j].name,
                        "weight": float(scaled[at, i, j]),
                        "largest": float(self.values[at, i, j]),
                        "at": float(self.run.time[at]),
                        "at the end": float(self.values[-1, i, j]),
                        "unit": quotient_name(column.unit, self.targets[j].unit),
                    }
                )
        return rows

    def to_csv(self, target: str | os.PathLike[str] | TextIO) -> None:
        """Write `time` and every derivative; see `Trajectory.to_csv`."""
        self.trajectory.to_csv(target)

    def __repr__(self) -> str:
        names = ", ".join(target.name for target in self.targets)
        checked = "not checked" if self.check is None else str(self.check)
        return f"{self.run.model}: {', '.join(self.run.names)} by {names}; {checked}"
