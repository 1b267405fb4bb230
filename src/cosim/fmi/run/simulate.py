"""Road two: an FMU through a master, fmpy unless another one is asked for, to a `Trajectory`."""

import os
from collections.abc import Mapping, Sequence
from functools import partial
from time import perf_counter
from typing import Any

from cosim.errors import UnknownName, UsageError
from cosim.fmi.archive import unpacked
from cosim.fmi.run.fmpy_master import inputs_driven, rows_of, simulated
from cosim.fmi.run.instance import (
    INTERFACES,
    by_name,
    choose_interface,
    count_derivatives,
    instantiated,
    read_description,
)
from cosim.fmi.run.opened import FMPY, MASTERS, kept_open
from cosim.fmi.run.patient import patiently
from cosim.fmi.run.request import (
    column_of,
    given_numbers,
    numbers_of_run,
    own_numbers,
    recorded,
    refuse_series,
    span_of,
    tolerance_of,
)
from cosim.model.driving import followed
from cosim.trajectory import Trajectory

__all__ = ["INTERFACES", "simulate_fmu", "unpacked"]


def simulate_fmu(
    path: str | os.PathLike[str],
    *,
    interface: str | None = None,
    start_time: float | None = None,
    stop_time: float | None = None,
    output_interval: float | None = None,
    relative_tolerance: float | None = None,
    start: Mapping[str, float] | None = None,
    inputs: Any = None,
    outputs: Sequence[str] | None = None,
    master: str = FMPY,
) -> Trajectory:
    """Simulate an FMU. Its binary runs in this process: only run FMUs you trust.

    Args:
        path: The FMU.
        interface: "ModelExchange" (the master integrates) or "CoSimulation" (the solver inside
            does); what fmpy takes when None: co-simulation where the FMU has it.
        start_time, stop_time, output_interval: s; the FMU's default experiment when None. The
            last output is at `stop_time` in any case.
        relative_tolerance: Error per step; the FMU's default experiment when None.
        start: Start values, parameters and constant inputs by name, in the FMU's units.
        inputs: What `read_inputs` returns; or by name a number, a formula of time ("2*sin(3*t)"),
            a function of time, samples at the output times (n,), or an `InputSeries`; in the FMU's
            units. Inputs rest, or are linear, within a step of an FMU that integrates itself.
        outputs: Names to record; the FMU's outputs when None.
        master: Who drives it. "fmpy" integrates with CVODE, with more than its 500 steps between
            two outputs where needed (`stats["note"]` says so). "c" is compiled code, a tenth to a
            hundredth of the time: one call for the whole run, `dop853` in model exchange, in
            co-simulation the very numbers of fmpy. It keeps a file of FMI 2 or 3 open for the
            next runs, and takes no `inputs`.

    Returns:
        Every recorded variable, with its unit.

    Raises:
        FmuError: The file is no FMU that can run here, or the run failed or ended early.
        SecurityError: The archive would write outside its folder, or its XML is dangerous.
        UnknownName: A variable, the interface or the master does not exist.
        UsageError, ParameterError: A variable cannot be set or recorded, a number is wrong, or the
            master does not take what is given.
        MissingTool: The master "c" is asked for, and no compiler works.

    Example:
        >>> import cosim
        >>> path = cosim.export_fmu(cosim.load("crank_shaft"), "crank.fmu")
        >>> run = simulate_fmu(path, start={"omega": 10.0}, stop_time=1)
        >>> round(run.final["omega"], 6)  # 10 rad/s2 for a second
        20.0
    """
    if master not in MASTERS:
        raise UnknownName.among("cosim", "master", str(master), MASTERS)
    if master != FMPY:
        if inputs is not None and inputs != {}:
            raise UsageError(f"{path}: master {master!r} takes no series of inputs; use {FMPY!r}")
        return kept_open(path, interface).simulate(
            {} if start is None else start,
            start_time=start_time,
            stop_time=stop_time,
            output_interval=output_interval,
            relative_tolerance=relative_tolerance,
            outputs=outputs,
            master=master,
        )
    settings = (start_time, stop_time, output_interval, relative_tolerance)
    once = partial(_through_fmpy, path, interface, settings, start, inputs, outputs)
    return patiently(once)


def _through_fmpy(
    path: str | os.PathLike[str],
    interface: str | None,
    settings: tuple[float | None, ...],
    start: Mapping[str, float] | None,
    inputs: Any,
    outputs: Sequence[str] | None,
) -> Trajectory:
    """Run an FMU as `simulate_fmu` does, in fmpy; `settings` are its numbers."""
    began = perf_counter()
    start_time, stop_time, output_interval, relative_tolerance = settings
    with unpacked(path) as folder:
        description = read_description(folder, path)
        kind = choose_interface(folder, description, interface, path)
        span = span_of(path, description, start_time, stop_time, output_interval)
        tolerance = tolerance_of(path, relative_tolerance)
        variables = by_name(description)
        values = given_numbers(path, variables, {} if start is None else start)
        names = recorded(path, variables, outputs)
        series = followed(str(path), inputs, span.times)
        refuse_series(path, description, series, values)
        with instantiated(folder, description, kind, path) as (instance, explained):
            calls = count_derivatives(instance) if kind == "ModelExchange" else None
            table = inputs_driven(instance, description, kind, series, span.start, values)
            ready = perf_counter()
            result = simulated(
                explained,
                span.start,
                filename=str(folder),
                model_description=description,
                fmu_instance=instance,
                fmi_type=kind,
                validate=False,
                stop_time=span.stop,
                output_interval=span.interval,
                relative_tolerance=tolerance,
                start_values=values,
                input=table,
                output=names,
            )
            done = perf_counter()
            stats: dict[str, Any] = {"solver": f"fmpy {kind}", "solve_time": done - ready}
            rows, time = rows_of(explained, result, names, span)
    stats |= {"wall_time": perf_counter() - began}
    if calls is not None:
        stats["rhs_calls"] = calls[0]
    columns = tuple(column_of(variables[name]) for name in names)
    numbers = numbers_of_run(variables, own_numbers(variables), values)
    return Trajectory(description.modelName, time, columns, rows, stats, numbers=numbers)
