"""`run`: execute a request as an FMU that is exported from its model, through fmpy."""

from contextlib import closing
from dataclasses import replace
from pathlib import Path

from cosim.codegen.fmu.solver import CO_SIMULATION_SOLVERS, FIXED_STEPS
from cosim.errors import UsageError
from cosim.fmi.export.options import FmuKeywords
from cosim.fmi.export.package import export_fmu
from cosim.fmi.run.description import Interface
from cosim.fmi.run.opened import OpenedFmu
from cosim.host.temporary import temporary_folder
from cosim.model.request import RunRequest
from cosim.model.solver import Goal, Solver
from cosim.text import one_note
from cosim.trajectory import Trajectory


def run(request: RunRequest, interface: str) -> Trajectory:
    """Export the model with the request's values, and simulate the FMU.

    Args:
        request: What to compute. Its solver becomes that of the FMU if FMUs for co-simulation have
            it; of another one, only the tolerance and the longest step count, and a note says so.
        interface: "ModelExchange" or "CoSimulation".

    Raises:
        UsageError: The request has a goal, a stop condition or output times of its own.
        CosimError: See `export_fmu` and `simulate_fmu`.
    """
    name, policy = request.dae.full_name, request.policy
    if isinstance(request.solver, Goal):
        raise UsageError(
            f"{name}: accuracy and budget are for native simulation; choose a relative tolerance "
            "for an FMU"
        )
    if policy.stop_when is not None or policy.record_events or request.times.own:
        raise UsageError(
            f"{name}: stop_when, record_events and output_times are for native simulation; leave "
            "them out, or use the backend native"
        )
    solver = request.solver
    solvers = (*CO_SIMULATION_SOLVERS, *FIXED_STEPS) if interface == Interface.CO_SIMULATION else ()
    options = FmuKeywords(max_step=request.max_step)
    note = ""
    if isinstance(solver, Solver) and solver.name in solvers:
        options |= {"solver": solver.name, "step_size": getattr(solver, "step_size", None)}
    elif isinstance(solver, Solver):
        note = f"{solver.name} is for native simulation: the FMU or its importer has another one"
    with temporary_folder() as folder:
        path = Path(folder) / "model.fmu"
        export_fmu(request.configured(), path, **options)
        found = run_file(request, path, interface)
    note = one_note(note, found.stats.get("note"))
    return replace(found, stats={**found.stats, "note": note}) if note else found


def run_file(request: RunRequest, path: Path, interface: str) -> Trajectory:
    """Simulate the FMU that was exported from the configured model of a request."""
    times, experiment = request.times, request.dae.experiment
    start, stop = times.span(request.dae)
    with closing(OpenedFmu(path, interface)) as fmu:
        fmu.path = request.dae.full_name  # what messages name; the file is a temporary one
        found = fmu.request(
            start_time=start,
            stop_time=stop,
            output_interval=times.interval or experiment.output_interval,
            relative_tolerance=request.relative_tolerance,
            inputs=request.inputs,
            outputs=request.outputs,
        )
        return fmu.run(replace(found, max_step=request.max_step))
