"""Errors against tolerances and steps: slope and constant, observed order, largest stable step.

Prints the tables of docs/tradeoff.md for the default formulation of every system. The error is the
largest global error of all outputs, in nominal values. Tolerances run from 1e-2 to 1e-12; steps are
halved four times. Nothing is timed.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import log10
from typing import Any

import numpy as np

import cosim
from cosim.backend import Backend
from cosim.study.tradeoff.configuration import Family, Selection
from cosim.study.tradeoff.measurement import Measurement
from cosim.study.tradeoff.study import tradeoff

FOOT_POUND = 1.3558179483314004  # N.m
CASES = (
    ("crank_shaft", {}),
    ("bar_on_frame", {}),
    ("bar_on_frame", {"b": 2000 * FOOT_POUND}),
    ("bicycle", {}),
    ("disk_two_bars", {}),
    ("double_pendulum", {}),
)


@dataclass(frozen=True)
class Proportionality:
    """Fit of an adaptive solver's error: constant * tolerance ** slope."""

    model: str
    reduced: bool
    solver: str
    slope: float
    constant: float
    points: int

    def row(self) -> dict[str, Any]:
        """Return plain values, for tables."""
        return vars(self) | {"reduced": "yes" if self.reduced else "no"}


def proportionality(
    measurements: Sequence[Measurement], reference_error: float
) -> tuple[Proportionality, ...]:
    """Fit log error = log constant + slope log tolerance.

    Errors count from ten times the reference's error up to 0.1.
    """
    families: dict[Family, list[tuple[float, float]]] = {}
    for measurement in measurements:
        configuration, error = measurement.configuration, measurement.error
        adaptive = configuration.backend is Backend.NATIVE and configuration.tolerance is not None
        if adaptive and error is not None and 10 * reference_error < error < 0.1:
            point = (log10(configuration.tolerance or 1.0), log10(error))
            families.setdefault(configuration.family, []).append(point)
    fits = []
    for (model, reduced, _, solver, control), points in families.items():
        if len(points) >= 3:
            tolerances, errors = np.array(points).T
            slope, intercept = np.polyfit(tolerances, errors, 1)
            name = f"{solver} {control or ''}".rstrip()
            constant = 10 ** float(intercept)
            fits.append(Proportionality(model, reduced, name, float(slope), constant, len(points)))
    return tuple(fits)


def table(rows: Iterable[Mapping[str, Any]]) -> None:
    """Print rows as a table in Markdown."""
    for number, row in enumerate(rows):
        if number == 0:
            print(f"\n| {' | '.join(row)} |\n|{'---|' * len(row)}")
        print("|", " | ".join(_cell(value) for value in row.values()), "|", flush=True)


def _cell(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str("" if value is None else value)


def main() -> None:
    """Measure every case and print the three tables."""
    slopes, orders, limits = [], [], []
    for model, values in CASES:
        label = {"model": f"{model}, stiff" if values else model}
        study = tradeoff(
            cosim.requested(model, start_values=values),
            selection=Selection(backends=("native",)),
            every_formulation=False,
            repeats=0,
        )
        slopes += [
            fit.row() | label for fit in proportionality(study.measurements, study.reference_error)
        ]
        orders += [order.row() | label for order in study.orders]
        limits += [limit.row() | label for limit in study.stability]
    for rows in (slopes, orders, limits):
        table({key: value for key, value in row.items() if key != "reduced"} for row in rows)


if __name__ == "__main__":
    main()
