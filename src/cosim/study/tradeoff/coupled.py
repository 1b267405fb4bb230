"""Trade-off of a coupled system: error and cost of co-simulation by method and macro step."""

from collections.abc import Callable, Sequence
from itertools import product
from math import log
from statistics import median
from time import perf_counter
from typing import Any

from cosim.coupling.settings import Method
from cosim.coupling.system import System
from cosim.errors import SolverError
from cosim.integrate.keywords import requested
from cosim.integrate.run import run as execute
from cosim.study.pareto import pareto_front
from cosim.study.tradeoff.configuration import STEPS
from cosim.study.tradeoff.measurement import LEFT_OUT
from cosim.text import Table
from cosim.trajectory import Trajectory
from cosim.verify.comparison import compare

_EXACT: dict[str, Any] = {"solver": "dop853", "relative_tolerance": 1e-12}  # of the one model
_TIGHT = 1e-9  # accuracy of the co-simulation that stands for it where parts are FMUs
_ASYMPTOTIC = 0.1  # error in nominal values; larger ones show no order
COUPLED = ("start_time", "stop_time", "output_interval", "start_values", "outputs")
_FACTS = ("error", "worst", "order", "macro_steps", "part_steps", "iterations", "ms", "pareto")


def coupled_tradeoff(
    system: System,
    steps: Sequence[float],
    repeats: int,
    deadline: float,
    progress: Callable[[str], None],
    **given: Any,
) -> Table:
    """Measure error and cost of co-simulation; see `tradeoff`, `measure`, and `System.simulate`."""
    start, stop, interval = system.times(*map(given.get, COUPLED[:3]))
    rows, truths = list[dict[str, Any]](), dict[float, Trajectory]()
    for method, step in product(Method, steps or [interval * factor for factor in STEPS]):
        apart = max(step, interval)
        ways = {**given, "start_time": start, "stop_time": stop, "output_interval": apart}
        row: dict[str, Any] = {"method": str(method), "step": step} | dict.fromkeys(_FACTS)
        if perf_counter() > deadline:
            rows.append(row | {"status": f"{LEFT_OUT}: the time limit was reached"})
            continue
        try:
            if apart not in truths and system.is_model:
                truths[apart] = execute(requested(system.dae, **ways, **_EXACT))
            elif apart not in truths:
                truths[apart] = system.simulate(accuracy=_TIGHT, **ways)
            runs = [
                system.simulate(macro_step=step, method=method, **ways) for _ in range(repeats + 1)
            ]
        except SolverError as error:
            rows.append(row | {"status": str(error)})
            progress(f"{method} at {step:g} s: {error}")
            continue
        stats, truth = runs[-1].stats, truths[apart]
        if abs(runs[-1].time[-1] - truth.time[-1]) > step:
            ends = f"{runs[-1].time[-1]:g} s, the reference at {truth.time[-1]:g} s"
            rows.append(row | {"status": f"it ends at {ends}"})
            continue
        shared = [name for name in runs[-1].names if name in truth.names]
        worst = compare(truth.select(shared), runs[-1], by_nominal=True).worst
        row |= {key: stats[key] for key in ("macro_steps", "iterations")}
        row |= {"error": worst.scaled, "worst": worst.name, "status": "complete"}
        row["part_steps"] = max(stats["part_steps"].values())
        row["ms"] = 1e3 * median(run.stats["wall_time"] for run in runs[1:] or runs)
        before = rows[-1] if rows and rows[-1]["method"] == row["method"] else row
        if before["error"] and 0 < worst.scaled < before["error"] < _ASYMPTOTIC:
            row["order"] = log(before["error"] / worst.scaled) / log(before["step"] / step)
        rows.append(row)
        progress(f"{method} at {step:g} s: error {worst.scaled:.1e}, {row['ms']:.3g} ms")
    for row in pareto_front(rows, lambda row: row["ms"], lambda row: row["error"]):
        row["pareto"] = "yes"
    return Table(tuple(rows), f"{system.name}: co-simulation by method and macro step [s]")
