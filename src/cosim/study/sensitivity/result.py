"""What a sensitivity analysis finds: trajectories of derivatives, and which of them matter."""

import os
from dataclasses import dataclass
from typing import Any, TextIO

import numpy as np

from cosim.arrays import Vector
from cosim.errors import UnknownName
from cosim.trajectory import Column, Trajectory


@dataclass(frozen=True)
class Agreement:
    """How far a second method is from the derivatives, where it is farthest.

    Attributes:
        method: The second method.
        scaled: The difference, over the largest derivative of that pair plus the output's nominal
            value, all times the size of what is differentiated by (1).
        of, with_respect_to: Of which derivative.
        time: s.
        first, second: The derivative there, by both methods; SI.
        bound: Up to where it is agreement.
    """

    method: str
    scaled: float
    of: str
    with_respect_to: str
    time: float
    first: float
    second: float
    bound: float

    def __str__(self) -> str:
        return (
            f"{self.method}: {self.scaled:.1e} apart at most, in d {self.of} / d "
            f"{self.with_respect_to} at {self.time:g} s (bound {self.bound:g})"
        )


@dataclass(frozen=True, eq=False)  # arrays have no single truth value
class Sensitivity:
    """Derivatives of outputs along a run.

    Attributes:
        run: The outputs themselves.
        targets: What they are differentiated by: name, unit, meaning; the nominal value is the
            size by which a derivative is scaled.
        values: Derivatives in SI units, (times, outputs, targets).
        check: What a second method found; None where none was asked for.
    """

    run: Trajectory
    targets: tuple[Column, ...]
    values: Vector
    check: Agreement | None = None

    def __getitem__(self, pair: tuple[str, str]) -> Vector:
        """Return d(output)/d(target) over time by both names, SI, (n,).

        Raises:
            UnknownName: There is no such output or target.
        """
        of, by = pair
        places = []
        for kind, name, known in (
            ("output", of, self.run.names),
            ("parameter", by, [target.name for target in self.targets]),
        ):
            if name not in known:
                raise UnknownName.among(f"{self.run.model}: sensitivity", kind, name, known)
            places.append([*known].index(name))
        values: Vector = self.values[:, places[0], places[1]]
        return values

    @property
    def scaled(self) -> Vector:
        """Derivatives times the size of the target, in nominal values of the output."""
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
                f"{column.unit}/({target.unit})",
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
        """Return a row per pair, of each output what matters most first.

        `weight` is the largest scaled derivative: how many nominal values the output would move if
        the target changed by its whole size and nothing bent.
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
                        "unit": f"{column.unit}/({self.targets[j].unit})",
                    }
                )
        return rows

    def to_csv(self, target: str | os.PathLike[str] | TextIO) -> None:
        """Write `time` and every derivative with 17 digits; see `Trajectory.to_csv`."""
        self.trajectory.to_csv(target)

    def __str__(self) -> str:
        names = ", ".join(target.name for target in self.targets)
        checked = "not checked" if self.check is None else str(self.check)
        return f"{self.run.model}: {', '.join(self.run.names)} by {names}; {checked}"
