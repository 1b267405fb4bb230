"""An FMU driven by fmpy: inputs put in its way, Ctrl-C and errors brought out of it."""

import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from threading import current_thread, main_thread
from types import FrameType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.errors import FmuError
from cosim.fmi.run import inputs
from cosim.fmi.run.request import Span, input_variables
from cosim.host.progress import doing
from cosim.model.inputs import InputSeries


def inputs_driven(
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
    known = input_variables(description)
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
    return inputs.drive_model_exchange(instance, series, references, constants, start_time)


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
    """Return what `fmpy.simulate_fmu` does; every failure says why."""
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
