"""An FMU driven by compiled code: one call over all output times; see fmu/master."""

import ctypes
from math import isfinite
from typing import Any

import numpy as np

from cosim.codegen.c_sources import master_source
from cosim.codegen.compiler import cached_library
from cosim.codegen.runge_kutta.stage_sums import dop853_coefficients
from cosim.fmi.run.c_structures import Ending, Recorded, Run, functions_of, reject_failure
from cosim.fmi.run.instance import Interface, enter_continuous_time, initialize
from cosim.fmi.run.request import DEFAULT_TOLERANCE, FmuRequest, MasterRun
from cosim.host.signals import interruptible
from cosim.memo import cached_per_thread


class CompiledMaster:
    """Drives an FMU: model exchange by `dop853`, co-simulation step by step.

    Raises:
        MissingTool: There is no compiler.
    """

    def __init__(self, instance: Any, description: Any, interface: Interface) -> None:
        self._instance, self._description = instance, description
        self._exchange = exchange = interface is Interface.MODEL_EXCHANGE
        self._library = _library(
            description.numberOfContinuousStates if exchange else 0,
            description.numberOfEventIndicators if exchange else 0,
            exchange,
        )
        self._functions = functions_of(instance, description)
        self._recordings: dict[tuple[int, ...], Recorded] = {}

    def run(self, request: FmuRequest) -> MasterRun:
        """Initialize the FMU and run it.

        Raises:
            FmuError: A call failed, or the FMU stopped without ending the run.
        """
        instance, description, exchange = self._instance, self._description, self._exchange
        initialize(instance, description, request.values, **request.experiment)
        points = request.points
        rows = np.empty((len(points), len(request.recorded)))
        key = tuple(map(id, request.recorded))  # which live as long as their description
        if key not in self._recordings:
            self._recordings = {key: Recorded(instance, description, request.recorded)}
        recording = self._recordings[key].structure
        recording.rows = rows.ctypes.data
        run = Run(
            functions=ctypes.pointer(self._functions),
            recording=ctypes.pointer(recording),
            times=points.ctypes.data,
            points=len(points),
            start=request.start,
            stop=points[-1] if exchange else request.stop,
            interval=request.interval,
            any_step=exchange or description.coSimulation.canHandleVariableCommunicationStepSize,
        )
        nominals = _prepare_exchange(run, instance, request) if exchange else None
        with interruptible(self._library) as interrupts:
            self._library.run_fmu(ctypes.byref(run))
        del nominals
        reject_failure(run, interrupts, request.stop)
        instance.terminate()
        rows.setflags(write=False)
        stats = {"steps": run.steps, "events": run.events}
        if run.how == Ending.ENDED_BY_FMU:
            points, rows = np.append(points[: run.rows - 1], run.time), rows[: run.rows]
            stats["stop_time"] = run.time
        if exchange:
            stats["rhs_calls"] = run.calls
        return MasterRun(points, rows, stats)


def _prepare_exchange(run: Run, instance: Any, request: FmuRequest) -> Any:
    """Fill in what model exchange needs; return the nominal values, which `run` points to."""
    description = request.description
    next_event = enter_continuous_time(instance, description)
    run.states = n = description.numberOfContinuousStates
    run.indicators = description.numberOfEventIndicators
    run.needs_completed_step = description.modelExchange.needsCompletedIntegratorStep
    run.next_defined = isfinite(next_event)
    run.next_event = next_event if isfinite(next_event) else 0.0
    tolerance = request.tolerance
    run.relative_tolerance = DEFAULT_TOLERANCE if tolerance is None else tolerance
    nominals = (ctypes.c_double * (n + 1))(*([1.0] * (n + 1)))
    if n:
        instance.getNominalsOfContinuousStates(nominals, n)
    run.nominals = ctypes.addressof(nominals)
    return nominals


@cached_per_thread(8)
def _library(states: int, indicators: int, exchange: bool) -> ctypes.CDLL:
    text = master_source("co_simulation.h")
    if exchange:
        sizes = f"#define NX {max(states, 1)}\n#define NZ {max(indicators, 1)}\n"
        coefficients = dop853_coefficients().replace('#include "dop853.h"\n', "")
        text = sizes + master_source("model_exchange.h") + coefficients
    library = ctypes.CDLL(str(cached_library(f"master {text}", lambda: text)))
    library.run_fmu.argtypes = [ctypes.POINTER(Run)]
    library.run_fmu.restype = None
    return library
