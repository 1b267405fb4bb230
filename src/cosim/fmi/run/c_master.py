"""An FMU driven by compiled code: one call over all output times; see fmu/master."""

import ctypes
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cosim.arrays import Vector, frozen
from cosim.codegen.c_sources import master_source
from cosim.codegen.compiler import cached_library
from cosim.codegen.interruptible import interruptible
from cosim.codegen.runge_kutta.stage_sums import dop853_coefficients
from cosim.fmi.run.compiled_run import Recorded, Recording, Run, functions_of, refuse_failure
from cosim.fmi.run.initialization import enter_continuous_time, initialize
from cosim.memo import kept_per_thread

MASTER_TOLERANCE = 1e-5  # of model exchange where neither user nor FMU says one, as in fmpy


class DrivenRun(NamedTuple):
    """A run: its times, s, (n,), a row for each of them, and what it took."""

    time: Vector
    rows: Vector
    stats: dict[str, Any]


class CompiledMaster:
    """Drives an FMU: model exchange by `dop853`, co-simulation step by step.

    Args:
        instance: Of fmpy, instantiated or reset before each run.
        description: Of the FMU, of version 2 or 3.
        kind: "ModelExchange" or "CoSimulation".

    Raises:
        MissingTool: There is no compiler.
    """

    def __init__(self, instance: Any, description: Any, kind: str) -> None:
        self._instance, self._description = instance, description
        self._exchange = exchange = kind == "ModelExchange"
        self._any_step = exchange or description.coSimulation.canHandleVariableCommunicationStepSize
        self._library = _library(
            description.numberOfContinuousStates if exchange else 0,
            description.numberOfEventIndicators if exchange else 0,
            exchange,
        )
        self._functions = functions_of(instance, description)
        self._recordings: dict[tuple[int, ...], Recorded] = {}

    def run(
        self,
        span: tuple[float, float, float],
        tolerance: float | None,
        values: Mapping[str, float],
        variables: Sequence[Any],
    ) -> DrivenRun:
        """Initialize the FMU and run it.

        Args:
            span: Begin, end and output interval, s.
            tolerance: Error per step; the FMU's own, or fmpy's, when None.
            values: Start values by name.
            variables: What to record.

        Raises:
            FmuError: A call failed, or the run ended early.
        """
        start, stop, _ = span
        instance, description, exchange = self._instance, self._description, self._exchange
        if tolerance is None:
            own = getattr(description.defaultExperiment, "tolerance", None)
            tolerance = None if own is None else float(own)
        experiment: dict[str, float | None] = {"startTime": start, "stopTime": stop}
        if not exchange:
            experiment["tolerance"] = tolerance
        initialize(instance, description, values, **experiment)
        times = communication_points(*span, any_step=self._any_step)
        rows = np.empty((len(times), len(variables)))
        recording = self._recording(variables)
        recording.rows = rows.ctypes.data
        run = Run(
            functions=ctypes.pointer(self._functions),
            recording=ctypes.pointer(recording),
            times=times.ctypes.data,
            points=len(times),
            start=start,
            stop=times[-1] if exchange else stop,
            interval=span[2],
            any_step=self._any_step,
        )
        held = _prepare_exchange(run, instance, description, tolerance) if exchange else None
        with interruptible(self._library) as interrupts:
            self._library.run_fmu(ctypes.byref(run))
        del held
        refuse_failure(run, interrupts, stop)
        instance.terminate()
        rows.setflags(write=False)
        stats = {"steps": run.steps, "events": run.events}
        if exchange:
            stats["rhs_calls"] = run.calls
        return DrivenRun(times, rows, stats)

    def _recording(self, variables: Sequence[Any]) -> Recording:
        wanted = tuple(map(id, variables))  # which live as long as their description
        if wanted not in self._recordings:
            self._recordings = {wanted: Recorded(self._instance, self._description, variables)}
        return self._recordings[wanted].structure


@lru_cache(8)
def communication_points(start: float, stop: float, interval: float, *, any_step: bool) -> Vector:
    """Return the times at which fmpy records, s, (n,), bit for bit."""
    times: Vector = start + interval * np.arange(int((stop - start) / interval) + 3, dtype=float)
    near = np.abs(times - stop) <= 1e-9 * np.maximum(np.abs(times), abs(stop))
    last = int(np.argmax((times > stop) | near))
    times = times[: last + 1]
    if times[-1] > stop and not near[last]:
        times = np.append(times[:-1], [stop] if any_step else [])
    return frozen(times)


def _prepare_exchange(run: Run, instance: Any, description: Any, tolerance: float | None) -> Any:
    """Fill in what model exchange needs; return what has to live as long as the run."""
    first = enter_continuous_time(instance, description)
    run.states = n = description.numberOfContinuousStates
    run.indicators = description.numberOfEventIndicators
    run.needs_completed_step = description.modelExchange.needsCompletedIntegratorStep
    run.next_defined = first.next_event is not None
    run.next_event = first.next_event or 0.0
    run.relative_tolerance = MASTER_TOLERANCE if tolerance is None else tolerance
    nominals = (ctypes.c_double * (n + 1))(*([1.0] * (n + 1)))
    if n:
        instance.getNominalsOfContinuousStates(nominals, n)
    run.nominals = ctypes.addressof(nominals)
    return nominals


def co_simulation_library() -> Path:
    """Compile what drives co-simulation, or take it from the cache: `run_fmu`, `run_steps`.

    Raises:
        MissingTool: There is no compiler.
    """
    text = master_source("co_simulation.h")
    for function, interface in (("run_fmu", "co_simulation"), ("run_steps", "summed_steps")):
        text += f"SHARED void {function}(Run *run) {{\n    answer(run, {interface});\n}}\n"
    return cached_library(f"master {text}", lambda: text)


def _model_exchange_library(states: int, indicators: int) -> Path:
    """Compile what drives model exchange, one per size."""
    sizes = f"#define NX {max(states, 1)}\n#define NZ {max(indicators, 1)}\n"
    coefficients = dop853_coefficients().replace('#include "dop853.h"\n', "")
    text = f"{sizes}{master_source('model_exchange.h')}{coefficients}"
    text += "SHARED void run_fmu(Run *run) {\n    answer(run, model_exchange);\n}\n"
    return cached_library(f"master {text}", lambda: text)


@kept_per_thread(8)
def _library(states: int, indicators: int, exchange: bool) -> ctypes.CDLL:
    place = _model_exchange_library(states, indicators) if exchange else co_simulation_library()
    library = ctypes.CDLL(str(place))
    library.run_fmu.argtypes = [ctypes.POINTER(Run)]
    library.run_fmu.restype = None
    return library
