"""`run`: execute a request as an FMU that is exported from its model, through fmpy."""

from contextlib import closing
from dataclasses import replace
from pathlib import Path

from cosim.errors import UsageError
from cosim.fmi.export.package import export_fmu
from cosim.fmi.run.opened import OpenedFmu
from cosim.host.temporary import temporary_folder
from cosim.model.request import RunRequest
from cosim.model.solver import Goal
from cosim.trajectory import Trajectory


def run(request: RunRequest, interface: str) -> Trajectory:
    """Export the model with the request's values, and simulate the FMU.

    Args:
        request: What to compute. Of its solver only the tolerance and the longest step count: the
            FMU, or the importer, has a solver of its own.
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
    with temporary_folder() as folder:
        path = Path(folder) / "model.fmu"
        export_fmu(request.configured(), path, max_step=request.max_step)
        return run_file(request, path, interface)


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
