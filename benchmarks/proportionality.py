"""Errors against tolerances and steps: slope and constant, observed order, largest stable step.

Prints the tables of docs/tradeoff.md for the default formulation of every system. The error is the
largest global error of all outputs, in nominal values. Tolerances run from 1e-2 to 1e-12; steps are
halved four times. Nothing is timed.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import cosim
from cosim.study.tradeoff.configuration import Selection
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
        slopes += [fit.row() | label for fit in study.proportionality()]
        orders += [order.row() | label for order in study.orders]
        limits += [limit.row() | label for limit in study.stability]
    for rows in (slopes, orders, limits):
        table({key: value for key, value in row.items() if key != "reduced"} for row in rows)


if __name__ == "__main__":
    main()
