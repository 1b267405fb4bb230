"""Extreme cases on bare tools: `casadi.integrator` with its defaults, and fmpy on exported FMUs.

    python benchmarks/extremes.py [MODEL...]

Prints the number of cases of each outcome for each tool. Consistent initial values come from cosim,
because a bare tool does not compute them; the rest of a run is the tool's own.
"""

import sys
import tempfile
from collections import Counter
from functools import cache
from pathlib import Path

import casadi as ca
import fmpy
import numpy as np

from casadi_models.extreme_cases import Case
from cosim.errors import SolverError, UsageError
from cosim.fmi.export.package import export_fmu
from cosim.integrate.integrator import start_vectors
from cosim.integrate.outputs import all_columns
from cosim.model.catalogue import load
from cosim.study.extremes.campaign import RUNNER, explore, select_cases
from cosim.study.extremes.oracles import OUTCOMES
from cosim.trajectory import Trajectory

PLUGINS = {"cvodes_adams": "cvodes", "ode8": "rk", "rk4": "rk"}
FOLDER = tempfile.TemporaryDirectory(prefix="cosim-extremes-")


def run_casadi(case: Case) -> Trajectory:
    """Run CasADi's integrator with its default options and the tolerance of the case."""
    dae = load(case.model)
    start = start_vectors(dae, case.values)
    grid = np.linspace(0, case.stop_time, case.points + 1)
    solver = case.solver or ("idas" if dae.algebraics else "cvodes")
    options = {"reltol": case.relative_tolerance, "abstol": 0.01 * case.relative_tolerance}
    if solver == "cvodes_adams":
        options["linear_multistep_method"] = "adams"
    if solver in ("rk4", "ode8"):
        options = {}
    problem = {"t": dae.t, "x": dae.x, "z": dae.z, "u": dae.u, "p": dae.p}
    problem |= {"ode": dae.ode, "alg": dae.alg}
    try:
        run = ca.integrator("run", PLUGINS.get(solver, solver), problem, 0.0, list(grid), options)
        found = run(x0=start["x0"], z0=start["z0"], p=start["p"], u=start["u"])
    except RuntimeError as error:
        raise SolverError(str(error).splitlines()[-1]) from error
    outputs = ca.Function("y", [dae.t, dae.x, dae.z, dae.u, dae.p], [dae.outputs])
    states, unknowns = found["xf"], found["zf"]
    rows = outputs(ca.DM(grid).T, states, unknowns, start["u"], start["p"])
    table = np.vstack((np.array(states), np.array(unknowns), np.array(rows))).T
    return Trajectory(dae.full_name, grid, all_columns(dae), table)


def run_fmpy(case: Case) -> Trajectory:
    """Run fmpy's model exchange with its CVODE and the tolerance of the case."""
    dae = load(case.model)
    if case.solver not in (None, "cvodes", "idas"):
        raise UsageError("fmpy has CVODE and Euler only")
    try:
        result = fmpy.simulate_fmu(
            _fmu(case.model),
            fmi_type="ModelExchange",
            stop_time=case.stop_time,
            output_interval=case.stop_time / case.points,
            relative_tolerance=case.relative_tolerance,
            start_values=dict(case.values),
            output=[column.name for column in all_columns(dae)],
        )
    except Exception as error:
        raise SolverError(str(error)) from error
    columns = all_columns(dae)
    table = np.column_stack([result[column.name] for column in columns])
    if len(table) != case.points + 1:
        raise SolverError(f"fmpy returned {len(table)} of {case.points + 1} rows")
    return Trajectory(dae.full_name, result["time"], columns, table)


@cache
def _fmu(model: str) -> str:
    target = Path(FOLDER.name) / f"{model.replace('/', '_')}.fmu"
    return str(export_fmu(load(model), target))


def main(models: list[str]) -> None:
    cases = [case for case in select_cases(models) if case.solver != "dop853"]  # only cosim has it
    print("tool".ljust(10), *(outcome.rjust(11) for outcome in OUTCOMES))
    runners = {"cosim": RUNNER, "casadi": "extremes:run_casadi", "fmpy": "extremes:run_fmpy"}
    for tool, runner in runners.items():
        counts = Counter(f.outcome for f in explore(cases, timeout=60, runner=runner))
        print(tool.ljust(10), *(str(counts[outcome]).rjust(11) for outcome in OUTCOMES), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
