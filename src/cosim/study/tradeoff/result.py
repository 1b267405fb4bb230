"""Result of a trade-off study: measurements, Pareto fronts and provenance."""

import os
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

from cosim.codegen.compiler import find_compiler
from cosim.errors import MissingTool
from cosim.presenters import presenter
from cosim.study.pareto import pareto_front
from cosim.study.tradeoff.configuration import Family
from cosim.study.tradeoff.fixed_steps import Order, StabilityLimit
from cosim.study.tradeoff.measurement import COSTS, Measurement
from cosim.text import MOST_LINES, csv_text, html_table, json_text, text_table
from cosim.verify.reference import Reference


@dataclass(frozen=True)
class Tradeoff:
    """Errors and costs of many configurations of one scene.

    Attributes:
        scene: Name of the scene.
        outputs: Names of the outputs whose errors are measured.
        invariants: Names of the outputs that are constant in the reference.
        reference: The run that the errors are measured against, with its own error.
        measurements: One per configuration.
        orders: Observed order of each fixed-step solver.
        stability: Largest stable step of each fixed-step solver, for a run that becomes steady.
        provenance: Versions, machine, hash of the model, method of the reference.
        impossible: Configurations that cannot be run, each with the reason.
    """

    scene: str
    outputs: tuple[str, ...]
    invariants: tuple[str, ...]
    reference: Reference
    measurements: tuple[Measurement, ...]
    orders: tuple[Order, ...]
    stability: tuple[StabilityLimit, ...]
    provenance: Mapping[str, str]
    impossible: tuple[tuple[str, str], ...] = ()

    @property
    def reference_error(self) -> float:
        """Estimated error of the reference in the outputs; smaller errors are not significant."""
        return self.reference.error(self.outputs)

    def shown_error(self, measurement: Measurement) -> float:
        """Return the error of a measurement, at least that of the reference."""
        return max(measurement.error or 0.0, self.reference_error)

    @property
    def competing(self) -> tuple[Measurement, ...]:
        """The measurements at every output time; runs with longer steps have fewer of them."""
        every = len(self.reference.run)
        return tuple(m for m in self.measurements if m.points == every)

    def pareto_front(self, cost: str) -> tuple[Measurement, ...]:
        """Return the measurements that no other one beats in error and cost, cheapest first."""
        negligible = self.reference_error
        return pareto_front(self.competing, lambda m: m.cost(cost), lambda m: m.error, negligible)

    def missing(self) -> list[dict[str, str]]:
        """Return the configurations without a result, with the reason.

        Failures of one kind in one family share a row, with the reason of the first failure.
        """
        groups: dict[tuple[Family, str], list[Measurement]] = {}
        for measurement in self.measurements:
            if measurement.error is None:
                kind = (measurement.configuration.family, measurement.outcome.kind)
                groups.setdefault(kind, []).append(measurement)
        pairs = []
        for first, *others in groups.values():
            last = f" ... {others[-1].configuration.setting}" if others else ""
            pairs.append((f"{first.configuration}{last}", str(first.outcome)))
        return [{"configuration": c, "reason": why} for c, why in (*pairs, *self.impossible)]

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per configuration; `pareto` names the costs of its Pareto fronts."""
        fronts = {cost: self.pareto_front(cost) for cost in COSTS}
        return [
            m.row() | {"pareto": " ".join(cost for cost in COSTS if m in fronts[cost])}
            for m in self.measurements
        ]

    def __repr__(self) -> str:
        return f"{self._title()}\n{text_table(self._best(), most=MOST_LINES - 1)}"

    def _repr_html_(self) -> str:
        from cosim.plotting import embedded  # slow: imports matplotlib

        figure = presenter("tradeoff")(self)
        table = html_table(self._best(), self._title())
        return f"{embedded(figure, 'error against cost')}{table}"

    def _title(self) -> str:
        return (
            f"Tradeoff of {self.scene}: {len(self.measurements)} configurations, reference error "
            f"{self.reference_error:.1e}; Pareto front:"
        )

    def _best(self) -> list[dict[str, Any]]:
        keys = ("model", "backend", "solver", "tolerance", "step", "error", "solver_ms", "pareto")
        return [{key: row[key] for key in keys} for row in self.rows() if row["pareto"]]

    def to_csv(self) -> str:
        """Return the rows as CSV; lines that begin with # hold the provenance."""
        origin = "".join(f"# {key}: {value}\n" for key, value in self.provenance.items())
        return origin + csv_text(self.rows())

    def to_json(self) -> str:
        """Return the whole study as JSON, with the error of every output."""
        rows = [
            row | {"errors": m.errors or None}
            for row, m in zip(self.rows(), self.measurements, strict=True)
        ]
        facts = {
            "scene": self.scene,
            "provenance": dict(self.provenance),
            "outputs": self.outputs,
            "invariants": self.invariants,
            "reference_error": self.reference_error,
            "reference_errors": dict(self.reference.errors),
            "pareto_fronts": {
                cost: [str(m.configuration) for m in self.pareto_front(cost)] for cost in COSTS
            },
            "orders": [order.row() for order in self.orders],
            "stability": [limit.row() for limit in self.stability],
            "missing": self.missing(),
            "measurements": rows,
        }
        return json_text(facts, indent=1) + "\n"


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
