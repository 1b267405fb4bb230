"""Road two: an FMU through fmpy to a `Trajectory`."""

import os
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from threading import current_thread, main_thread
from time import perf_counter
from types import FrameType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.errors import FmuError, ParameterError, UnknownName, UsageError
from cosim.fmi.archive import unpacked
from cosim.fmi.run import inputs
from cosim.fmi.run.instance import (
    INTERFACES,
    by_name,
    choose_interface,
    count_derivatives,
    instantiated,
    is_number,
    may_be_set,
    read_description,
)
from cosim.host.progress import doing
from cosim.model.driving import followed
from cosim.model.inputs import InputSeries
from cosim.model.time_grid import time_grid
from cosim.model.values import listed, number
from cosim.trajectory import Column, Trajectory

__all__ = ["INTERFACES", "simulate_fmu", "unpacked"]

_CONTINUOUS = ("Real", "Float64")
MOST_POINTS = 10_000_000  # output times; fmpy keeps them as Python objects


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
) -> Trajectory:
    """Simulate an FMU with fmpy. Its binary runs in this process: only run FMUs you trust.

    Args:
        path: The FMU.
        interface: "ModelExchange" (fmpy's CVODE integrates) or "CoSimulation" (the solver inside
            does); what fmpy takes when None: co-simulation where the FMU has it.
        start_time, stop_time, output_interval: s; the FMU's default experiment when None. The
            last output is at `stop_time` in any case.
        relative_tolerance: Error per step; the FMU's default experiment when None.
        start: Start values, parameters and constant inputs by name, in the FMU's units.
        inputs: What `read_inputs` returns; or by name a number, a formula of time ("2*sin(3*t)"),
            a function of time, samples at the output times (n,), or an `InputSeries`; in the FMU's
            units. Inputs rest, or are linear, within a step of an FMU that integrates itself.
        outputs: Names to record; the FMU's outputs when None.

    Returns:
        Every recorded variable, with its unit.

    Raises:
        FmuError: The file is no FMU that can run here, or the run failed or ended early.
        SecurityError: The archive would write outside its folder, or its XML is dangerous.
        UnknownName: A variable or the interface does not exist.
        UsageError, ParameterError: A variable cannot be set or recorded, or a number is wrong.

    Example:
        >>> import cosim
        >>> path = cosim.export_fmu(cosim.load("crank_shaft"), "crank.fmu")
        >>> run = simulate_fmu(path, start={"omega": 10.0}, stop_time=1)
        >>> round(run.final["omega"], 6)  # 10 rad/s2 for a second
        20.0
    """
    began = perf_counter()
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
            table = _driven(instance, description, kind, series, span.start, values)
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
    numbers = numbers_of_run(variables, values)
    return Trajectory(description.modelName, time, columns, rows, stats, numbers=numbers)


def numbers_of_run(variables: Mapping[str, Any], given: Mapping[str, float]) -> dict[str, float]:
    """Return the parameters and inputs that an FMU is run with: what is given, else its own."""
    kinds = ("parameter", "input")
    found = {n: v.start for n, v in variables.items() if v.causality in kinds and is_number(v)}
    own = {name: float(start) for name, start in found.items() if _is_float(start)}
    return own | {name: value for name, value in given.items() if name in found}


def _is_float(text: Any) -> bool:
    try:
        float(text)
    except (TypeError, ValueError):  # there is none, it is an array, or true
        return False
    return True


@dataclass(frozen=True)
class Span:
    """When a run begins, ends and is recorded, s."""

    start: float
    stop: float
    interval: float

    @property
    def times(self) -> NDArray[np.float64]:
        """The output times, (n,)."""
        return time_grid(self.start, self.stop, self.interval)


def span_of(
    path: object,
    description: Any,
    start: float | None,
    stop: float | None,
    interval: float | None,
) -> Span:
    """Fill in the FMU's default experiment; fmpy itself has other ideas of the interval."""
    experiment = description.defaultExperiment

    def default(name: str, otherwise: float) -> float:
        value = getattr(experiment, name, None)
        return otherwise if value is None else float(value)

    start = number(str(path), "start_time", default("startTime", 0.0) if start is None else start)
    length = default("stopTime", default("startTime", 0.0) + 1) - default("startTime", 0.0)
    stop = number(str(path), "stop_time", start + length if stop is None else stop)
    if stop < start:
        raise ParameterError(
            f"{path}: stop_time = {stop:g} s lies before start_time = {start:g} s; "
            "give a later stop"
        )
    if interval is None:
        interval = default("stepSize", (stop - start) / 500) or 1.0
    interval = number(str(path), "output_interval", interval, positive=True)
    if (stop - start) / interval > MOST_POINTS:
        raise ParameterError(
            f"{path}: output_interval = {interval:g} s makes {(stop - start) / interval:.3g} "
            "output times; give a larger one"
        )
    return Span(start, stop, interval)


def tolerance_of(path: object, relative: float | None) -> float | None:
    if relative is None:
        return None
    if number(str(path), "relative_tolerance", relative, positive=True) > 0.1:
        raise ParameterError(f"{path}: relative_tolerance = {relative:g} is above 0.1")
    return float(relative)


def given_numbers(
    path: object, variables: Mapping[str, Any], start: Mapping[str, float]
) -> dict[str, float]:
    if not isinstance(start, Mapping):
        raise UsageError.of_type(f"{path}: start", start, "values by name, e.g. {'phi': 0.1}")
    settable = [v.name for v in variables.values() if may_be_set(v) and is_number(v)]
    for name in start:
        if name not in variables:
            raise UnknownName.among(str(path), "start value", name, settable)
        if variables[name].name not in settable:
            raise UsageError(f"{path}: {name} cannot be set; it is calculated, or not a number")
    return {variables[name].name: number(str(path), name, value) for name, value in start.items()}


def recorded(
    path: object, variables: Mapping[str, Any], outputs: Sequence[str] | None
) -> list[str]:
    if outputs is None:
        return [
            n
            for n, v in variables.items()
            if v.causality == "output" and is_number(v) and n == v.name
        ]
    wanted = listed(f"{path}: outputs", outputs)
    for name in wanted:
        if name not in variables:
            raise UnknownName.among(str(path), "output", name, variables)
        if not is_number(variables[name]):
            raise UsageError(f"{path}: {name} is not a single number and cannot be recorded")
    return list(dict.fromkeys(variables[name].name for name in wanted))


def _input_variables(description: Any) -> dict[str, Any]:
    return {n: v for n, v in by_name(description).items() if v.causality == "input"}


def refuse_series(
    path: object, description: Any, series: InputSeries | None, values: Mapping[str, float]
) -> None:
    """Refuse a series of what is no input, of no real number, or that has a constant value, too.

    Raises:
        UnknownName: There is no such input.
        UsageError: It cannot follow a series.
    """
    known = _input_variables(description)
    for name in series.names if series else ():
        if name not in known:
            raise UnknownName.among(str(path), "input", name, known)
        if known[name].type not in _CONTINUOUS or known[name].dimensions:
            raise UsageError(f"{path}: {name} is no real number; give it a constant value")
        if name in values:
            raise UsageError(f"{path}: {name} is given a value and a series; give one of them")


def _driven(
    instance: Any,
    description: Any,
    kind: str,
    series: InputSeries | None,
    start_time: float,
    values: dict[str, float],
) -> Any:
    """Put a series in charge of the inputs; add their start values; return fmpy's `input`."""
    if series is None:
        return None
    known = _input_variables(description)
    references = [known[name].valueReference for name in series.names]
    values |= inputs.inputs_at_start(series, start_time)
    if kind == "CoSimulation":
        inputs.drive_co_simulation(instance, series, references, description.coSimulation)
        return None
    constants = {
        name: values.get(name, float(variable.start or 0.0))
        for name, variable in known.items()
        if name not in series.names
    }
    return inputs.drive_model_exchange(instance, series, references, constants)


def _moving(
    start: float, stop: float, interrupts: Sequence[int]
) -> tuple[Callable[[float, Any], bool], Callable[[], float]]:
    """Return what stops fmpy after Ctrl-C, or where time stands still; and how far it is.

    Where an FMU discards a step, fmpy repeats it for ever.
    """
    last = start

    def done() -> float:
        return (last - start) / (stop - start) if stop > start else 0.0

    def moves(time: float, _recorder: Any) -> bool:
        nonlocal last
        last, before = time, last
        return time > before and not interrupts

    return moves, done


def simulated(explained: Callable[[Exception], FmuError], start: float, **arguments: Any) -> Any:
    from fmpy import simulate_fmu as run

    with _noticed_interrupts() as interrupts, _noticed_errors() as errors:
        moving, done = _moving(start, arguments["stop_time"], interrupts)
        try:
            with doing("running the FMU", done):
                result = run(start_time=start, step_finished=moving, **arguments)
        except Exception as error:
            if interrupts:
                raise KeyboardInterrupt from error
            cause = errors[0] if errors else error
            raise explained(cause) from cause
        if interrupts:
            raise KeyboardInterrupt
        if errors:
            raise explained(errors[0]) from errors[0]
    return result


@contextmanager
def _noticed_errors() -> Iterator[list[Exception]]:
    """Collect the exceptions within callbacks of fmpy's solver, which ctypes prints and forgets."""
    seen: list[Exception] = []
    usual = sys.unraisablehook

    def notice(unraisable: "sys.UnraisableHookArgs") -> None:
        if isinstance(unraisable.exc_value, Exception):
            seen.append(unraisable.exc_value)

    sys.unraisablehook = notice
    try:
        yield seen
    finally:
        sys.unraisablehook = usual


@contextmanager
def _noticed_interrupts() -> Iterator[list[int]]:
    """Collect Ctrl-C for `_moving`: ctypes swallows what is raised within fmpy's callbacks.

    The second one does what it usually does.
    """
    seen: list[int] = []
    usual = signal.getsignal(signal.SIGINT)
    if current_thread() is not main_thread() or not callable(usual):
        yield seen
        return

    def notice(number: int, frame: FrameType | None) -> None:
        seen.append(number)
        if len(seen) > 1:
            usual(number, frame)

    signal.signal(signal.SIGINT, notice)
    try:
        yield seen
    finally:
        signal.signal(signal.SIGINT, usual)


def rows_of(
    explained: Callable[[Exception], FmuError], result: Any, names: Sequence[str], span: Span
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the values at the output times, and these; an early end is an error.

    fmpy records events too; of several rows at one time the last one is kept.
    """
    every = np.array(result["time"], dtype=float)
    slack = 1e-9 * max(1.0, abs(span.start), abs(span.stop))
    steps = (every - span.start) / span.interval
    regular = np.abs(steps - np.round(steps)) * span.interval <= slack
    regular |= np.abs(every - span.stop) <= slack
    last = np.append(np.diff(every) > 0, True)
    time = every[regular & last]
    if every[-1] < span.stop - slack:
        raise explained(
            FmuError(f"the run ended at {every[-1]:g} s, before the stop time {span.stop:g} s")
        )
    rows = np.empty((len(time), len(names)))
    for i, name in enumerate(names):
        rows[:, i] = result[name][regular & last]
        finite = np.isfinite(rows[:, i])
        if not finite.all():
            at = time[int(np.argmin(finite))]
            raise explained(FmuError(f"{name} is not finite at {at:g} s"))
    return rows, time


def column_of(variable: Any) -> Column:
    declared = variable.declaredType
    return Column(
        variable.name,
        variable.unit or (declared.unit if declared else None) or "1",
        variable.displayUnit,
        float(variable.nominal or 1.0),
        variable.description or "",
    )
