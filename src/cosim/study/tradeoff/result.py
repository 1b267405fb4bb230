"""The outcome of a trade-off study: measurements, Pareto fronts, and where all of it comes from."""

import json
import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from math import log10
from typing import Any

import numpy as np

from cosim.codegen.compiler import find_compiler
from cosim.errors import MissingTool
from cosim.scene.roads import Road
from cosim.study.tradeoff.configuration import Family
from cosim.study.tradeoff.convergence import Order
from cosim.study.tradeoff.measurement import COSTS, Measurement
from cosim.study.tradeoff.stability import StabilityLimit
from cosim.text.tables import MOST_LINES, csv_text, html_table, text_table
from cosim.verify.reference import Reference


@dataclass(frozen=True)
class Proportionality:
    """How the error of an adaptive solver follows its tolerance: constant * tolerance ** slope."""

    model: str
    reduced: bool
    solver: str
    slope: float
    constant: float
    points: int

    def row(self) -> dict[str, Any]:
        """Return plain values, for tables."""
        return vars(self) | {"reduced": "yes" if self.reduced else "no"}


@dataclass(frozen=True)
class Tradeoff:
    """Errors and costs of many configurations of one scene.

    Attributes:
        scene: Its name.
        kept: The outputs whose errors count.
        invariants: What is constant in the reference.
        reference: What the errors are measured against, with its own error.
        measurements: One per configuration.
        orders: Observed order of each fixed-step solver.
        stability: The largest stable step of each, where the run ends in a steady motion.
        provenance: Versions, machine, hash of the model, method of the reference.
        impossible: What was not measured because it cannot be, each with the reason.
    """

    scene: str
    kept: tuple[str, ...]
    invariants: tuple[str, ...]
    reference: Reference
    measurements: tuple[Measurement, ...]
    orders: tuple[Order, ...]
    stability: tuple[StabilityLimit, ...]
    provenance: Mapping[str, str]
    impossible: tuple[tuple[str, str], ...] = ()

    @property
    def floor(self) -> float:
        """Estimated error of the reference in the kept outputs: smaller errors mean nothing."""
        return self.reference.error(self.kept)

    @property
    def competing(self) -> tuple[Measurement, ...]:
        """The measurements with every output time; longer steps deliver fewer of them."""
        every = len(self.reference.run)
        return tuple(m for m in self.measurements if m.points == every)

    def front(self, cost: str) -> tuple[Measurement, ...]:
        """Return the measurements that no other one beats in error and in cost, cheapest first.

        Args:
            cost: One of `COSTS`.
        """
        return pareto_front(self.competing, cost, self.floor)

    def proportionality(self) -> tuple[Proportionality, ...]:
        """Fit error against tolerance for each compiled adaptive solver."""
        return proportionality(self.measurements, self.floor)

    def missing(self) -> list[dict[str, str]]:
        """Return what has no result and why.

        Of a family, failures of one kind are one row, with the reason of the first.
        """
        groups: dict[tuple[Family, str], list[Measurement]] = {}
        for measurement in self.measurements:
            if measurement.error is None:
                kind = (measurement.configuration.family, measurement.outcome.kind)
                groups.setdefault(kind, []).append(measurement)
        rows = []
        for first, *others in groups.values():
            last = f" ... {others[-1].configuration.setting}" if others else ""
            rows.append(
                {"configuration": f"{first.configuration}{last}", "reason": str(first.outcome)}
            )
        keys = ("configuration", "reason")
        return [*rows, *(dict(zip(keys, pair, strict=True)) for pair in self.impossible)]

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per configuration; `front` names the costs for which none is better."""
        fronts = {cost: self.front(cost) for cost in COSTS}
        return [
            m.row() | {"front": " ".join(cost for cost in COSTS if m in fronts[cost])}
            for m in self.measurements
        ]

    def __repr__(self) -> str:
        return f"{self._title()}\n{text_table(self._best(), most=MOST_LINES - 1)}"

    def _repr_html_(self) -> str:
        from cosim.plotting import draw_costs, embedded  # matplotlib takes its time

        timed = any(m.solver_time for m in self.competing)
        cost, factor = ("solver_time", 1e3) if timed else ("rhs_calls", 1.0)
        points: dict[str, list[tuple[float, float]]] = {}
        for m in self.competing:
            if m.error is not None and (price := m.cost(cost)):
                point = factor * price, max(m.error, self.floor)
                points.setdefault(m.configuration.solver, []).append(point)
        label = "time of the solver [ms]" if timed else "right-hand sides evaluated"
        fronts = {name: _lower_left(pairs) for name, pairs in points.items()}
        figure = draw_costs(self.scene, (label, "largest global error [nominal values]"), fronts)
        table = html_table(self._best(), self._title())
        return f"{embedded(figure, 'error against cost')}{table}"

    def _title(self) -> str:
        return (
            f"Tradeoff of {self.scene}: {len(self.measurements)} configurations, reference error "
            f"{self.floor:.1e}; those that none beats:"
        )

    def _best(self) -> list[dict[str, Any]]:
        keys = ("model", "road", "solver", "tolerance", "step", "error", "solver_ms", "front")
        return [{key: row[key] for key in keys} for row in self.rows() if row["front"]]

    def to_csv(self) -> str:
        """Return the rows as CSV; lines that begin with # say where they come from."""
        origin = "".join(f"# {key}: {value}\n" for key, value in self.provenance.items())
        return origin + csv_text(self.rows())

    def to_json(self) -> str:
        """Return everything as JSON, the errors of every output included."""
        rows = [
            row | {"errors": m.errors}
            for row, m in zip(self.rows(), self.measurements, strict=True)
        ]
        facts = {
            "scene": self.scene,
            "provenance": dict(self.provenance),
            "kept": self.kept,
            "invariants": self.invariants,
            "floor": self.floor,
            "reference_errors": dict(self.reference.errors),
            "fronts": {cost: [str(m.configuration) for m in self.front(cost)] for cost in COSTS},
            "proportionality": [fit.row() for fit in self.proportionality()],
            "orders": [order.row() for order in self.orders],
            "stability": [limit.row() for limit in self.stability],
            "missing": self.missing(),
            "measurements": rows,
        }
        return json.dumps(facts, indent=1) + "\n"


def _lower_left(points: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the points of which none is both cheaper and more accurate."""
    front: list[tuple[float, float]] = []
    for price, error in sorted(points):
        if not front or error < front[-1][1]:
            front.append((price, error))
    return front


def pareto_front(
    measurements: Iterable[Measurement], cost: str, floor: float
) -> tuple[Measurement, ...]:
    """Return what no other measurement beats, cheapest first; errors below the floor are equal."""
    known = [(m.cost(cost), max(m.error, floor), m) for m in measurements if m.error is not None]
    priced = [(price, error, m) for price, error, m in known if price is not None]
    front: list[Measurement] = []
    best = float("inf")
    for _, error, measurement in sorted(priced, key=lambda item: item[:2]):
        if error < best:
            front.append(measurement)
            best = error
    return tuple(front)


def proportionality(
    measurements: Sequence[Measurement], floor: float
) -> tuple[Proportionality, ...]:
    """Fit log error = log constant + slope log tolerance, above the floor and below 0.1."""
    families: dict[Family, list[tuple[float, float]]] = {}
    for measurement in measurements:
        configuration, error = measurement.configuration, measurement.error
        adaptive = configuration.road is Road.NATIVE and configuration.tolerance is not None
        if adaptive and error is not None and 10 * floor < error < 0.1:
            point = (log10(configuration.tolerance or 1.0), log10(error))
            families.setdefault(configuration.family, []).append(point)
    fits = []
    for (model, reduced, _, solver, control), points in families.items():
        if len(points) >= 3:
            tolerances, errors = np.array(points).T
            slope, intercept = np.polyfit(tolerances, errors, 1)
            fits.append(
                Proportionality(
                    model,
                    reduced,
                    f"{solver} {control or ''}".rstrip(),
                    float(slope),
                    10 ** float(intercept),
                    len(points),
                )
            )
    return tuple(fits)


def provenance(reference: Reference) -> dict[str, str]:
    """Return versions, machine, hash of the model, and method of the reference."""
    try:
        compiler = " ".join(find_compiler())
    except MissingTool:
        compiler = "none"
    return {
        **{name: version(name) for name in ("cosim-rigid", "casadi", "fmpy", "numpy")},
        "python": platform.python_version(),
        "platform": platform.platform(),
        "processor": f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores",
        "compiler": compiler,
        "model hash": reference.key,
        "reference": reference.method,
        "reference checked by": reference.check,
        "reference error": f"{reference.error():.1e} of the nominal value",
    }
