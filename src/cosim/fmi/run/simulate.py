"""FMU simulation: from a file, through a master, to a `Trajectory`."""

import os
from collections.abc import Mapping, Sequence
from contextlib import closing, nullcontext
from dataclasses import replace
from time import perf_counter
from typing import Any

from cosim.errors import UsageError
from cosim.fmi.run.description import Interface, by_name
from cosim.fmi.run.opened import Master, OpenedFmu, still_open
from cosim.fmi.run.request import TIME, WHY_NOT_TIME, FmuRequest, rounding
from cosim.model.request import choice
from cosim.series.samples import uncontrolled
from cosim.text import one_note
from cosim.trajectory import Trajectory

_MANY_ROWS = 400  # that show how large a state gets


def simulate_fmu(
    path: str | os.PathLike[str],
    *,
    interface: str | None = None,
    start_time: float | None = None,
    stop_time: float | None = None,
    output_interval: float | None = None,
    relative_tolerance: float | None = None,
    start_values: Mapping[str, float] | None = None,
    inputs: Any = None,
    outputs: Sequence[str] | None = None,
    master: str = Master.FMPY,
) -> Trajectory:
    """Simulate an FMU. Its binary runs in this process: only run FMUs you trust.

    Args:
        path: The FMU.
        interface: "ModelExchange" (the master integrates) or "CoSimulation" (the solver inside
            does); by default co-simulation if the FMU has it, as in fmpy.
        start_time, stop_time, output_interval: s; the FMU's default experiment when None. The
            last output is at `stop_time` in any case.
        relative_tolerance: Error per step; the FMU's default experiment when None.
        start_values: Start values, parameters and constant inputs by name, in the FMU's units;
            elements of arrays have the names `u[1]` or `A[1,2]`.
        inputs: What `read_inputs` returns; or by name a number, a formula of time ("2*sin(3*t)"),
            a function of time, samples at the output times (n,), or an `InputSeries`; in the FMU's
            units. Within a step of an FMU that integrates itself, inputs are constant, linear
            or cubic.
        outputs: Names to record; the FMU's outputs when None. That of an array stands for its
            elements.
        master: What drives the FMU. "fmpy" is a loop in Python over fmpy's objects with CVODE,
            which takes more than fmpy's 500 steps between two outputs if it has to
            (`stats["note"]` reports it). "c" is compiled code, 10 to 100 times as fast: one call
            for the whole run, `dop853` in model exchange, in co-simulation the same numbers as
            fmpy. It keeps a file open for the next runs and takes no `inputs`.

    Returns:
        Every recorded variable, with its unit.

    Raises:
        FmuError: The file is no FMU that can run here, or the run failed or stopped
            early. If the FMU itself ends the run, the run is complete: `stats["stop"]` says why.
        SecurityError: The archive would write outside its folder, or its XML is dangerous.
        UnknownName: A variable, the interface or the master does not exist.
        UsageError, ParameterError: A variable cannot be set or recorded, a number is wrong, or the
            master does not take an argument.
        MissingTool: The master "c" needs a compiler, and none works.

    Example:
        >>> import cosim
        >>> path = cosim.export_fmu(cosim.load("crank_shaft"), "crank.fmu")
        >>> run = simulate_fmu(path, start_values={"omega": 10.0}, stop_time=1)
        >>> round(run.final["omega"], 6)  # 10 rad/s2 for a second
        20.0
    """
    began = perf_counter()
    master = choice(Master, "master", master)
    compiled = master is Master.C
    if compiled and inputs is not None and inputs != {}:
        raise UsageError(
            f"{path}: master '{master}' takes no series of inputs; use '{Master.FMPY}'"
        )
    fmu = still_open(path, interface) if compiled else OpenedFmu(path, interface)
    with nullcontext() if compiled else closing(fmu):
        request = fmu.request(
            start_time=start_time,
            stop_time=stop_time,
            output_interval=output_interval,
            relative_tolerance=relative_tolerance,
            start_values=start_values,
            inputs=inputs,
            outputs=outputs,
        )
        run = fmu.run(request, master)
        small = _small_states(request, run)
        if small and len(run) < _MANY_ROWS:
            parts = -(-_MANY_ROWS // len(run))
            finer = replace(request, interval=request.interval / parts)
            small = _small_states(request, fmu.run(finer, master))
    gaps = request.inputs.gaps(request.start, request.stop) if request.inputs else ""
    note = one_note(
        run.stats.get("note"),
        gaps,
        small,
        rounding(request.recorded, run),
        _left_out(request) if outputs is None else "",
    )
    stats = {**run.stats, "wall_time": perf_counter() - began}
    return replace(run, stats=stats | {"note": note} if note else stats)


def _left_out(request: FmuRequest) -> str:
    """Return a note if the FMU has an output whose name is that of the time."""
    variable = by_name(request.description).get(TIME)
    is_output = variable is not None and variable.causality == "output"
    return f"its output 'time' is left out, {WHY_NOT_TIME}" if is_output else ""


def _small_states(request: FmuRequest, run: Trajectory) -> str:
    """Return which states are too small for the tolerance of a run in model exchange."""
    if request.interface is not Interface.MODEL_EXCHANGE or not len(run):
        return ""
    names = [column.name for column in run.columns if column.is_state]
    states = run.select(names)
    relative = request.relative_tolerance
    return uncontrolled(states.columns, states.values, relative, relative)
