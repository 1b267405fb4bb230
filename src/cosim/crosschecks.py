"""The same run on every road and in every formulation, and how far the results are apart."""

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi_models
from casadi_models.dae import Dae
from cosim.comparison import Comparison, compare
from cosim.export import export_fmu
from cosim.fmpy_run import INTERFACES, simulate_fmu
from cosim.integrate import simulate
from cosim.loading import formulations, load
from cosim.trajectory import Trajectory

BOUND = 1e-6  # of the nominal value
TOLERANCE = 1e-10

# The book leaves the pitch rate out of the contact point's velocity (docs/bicycle.md).
DIFFERENT_BY_DESIGN = {"bicycle/book": frozenset({"xP", "yP"})}


@dataclass(frozen=True)
class Check:
    """One comparison of two runs, and what the second one took.

    Attributes:
        model: `MODEL/FORMULATION` of the second run.
        road: How it was computed.
        against: What it is compared with.
        comparison: The differences.
        stats: Of the second run: wall_time [s], rhs_calls.
    """

    model: str
    road: str
    against: str
    comparison: Comparison
    stats: dict[str, Any]

    def row(self) -> dict[str, Any]:
        """Return the check as plain values, for tables and JSON."""
        worst = self.comparison.worst
        return {
            "model": self.model,
            "road": self.road,
            "against": self.against,
            "variables": len(self.comparison.differences),
            "worst": worst.name,
            "difference": worst.scaled,
            "at": worst.time,
            "bound": self.comparison.bound,
            "verdict": "ok" if self.comparison.agrees else "DIFFERS",
            "wall_time": self.stats.get("wall_time"),
            "rhs_calls": self.stats.get("rhs_calls"),
        }


def crosscheck(
    models: Sequence[str] | None = None,
    *,
    stop_time: float | None = None,
    output_interval: float | None = None,
    relative_tolerance: float = TOLERANCE,
    bound: float = BOUND,
) -> Iterator[Check]:
    """Run models on every road and compare, one check at a time.

    Every formulation runs through CVODES or IDAS; the FMU made from the same equations runs through
    fmpy, as model exchange and as co-simulation; formulations are compared with the first one.

    Args:
        models: `MODEL` (every formulation) or `MODEL/FORMULATION`; the whole catalogue when None.
        stop_time, output_interval: s; each model's own when None.
        relative_tolerance: Of every solver.
        bound: Largest difference that counts as agreement, in nominal values.

    Raises:
        CosimError: A model does not exist, or a run failed.
    """
    names = models or dict.fromkeys(e.partition("/")[0] for e in casadi_models.CATALOG)
    for name in names:
        members = formulations(name) if "/" not in name and ".py:" not in name else (name,)
        first: Trajectory | None = None
        for member in members:
            dae = load(member)
            run = simulate(
                dae,
                stop_time=stop_time,
                output_interval=output_interval,
                relative_tolerance=relative_tolerance,
            )
            road = run.stats["solver"]
            yield from _roads(dae, run, output_interval, relative_tolerance, bound)
            if first is None:
                first = run
            else:
                without = DIFFERENT_BY_DESIGN.get(member, frozenset())
                difference = compare(first, run, bound=bound, without=without)
                yield Check(member, road, first.model, difference, dict(run.stats))


def _roads(
    dae: Dae, run: Trajectory, interval: float | None, tolerance: float, bound: float
) -> Iterator[Check]:
    """Compare the FMU's runs with a run through CasADi's integrators."""
    with tempfile.TemporaryDirectory(prefix="cosim-") as folder:
        path = export_fmu(dae, Path(folder) / "model.fmu")
        for interface in INTERFACES:
            again = simulate_fmu(
                path,
                interface=interface,
                stop_time=float(run.time[-1]),
                output_interval=interval or dae.experiment.output_interval,
                relative_tolerance=tolerance,
            )
            solver = run.stats["solver"]
            difference = compare(run, again, bound=bound)
            yield Check(dae.full_name, f"fmpy {interface}", solver, difference, dict(again.stats))
