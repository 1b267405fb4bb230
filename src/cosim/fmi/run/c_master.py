"""An FMU driven by compiled code: one call over all output times; see fmu/master."""

import ctypes
from collections.abc import Mapping, Sequence
from enum import IntEnum
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from cosim.arrays import Vector, frozen
from cosim.codegen.c_sources import master_source
from cosim.codegen.compiler import cached_library
from cosim.codegen.interruptible import interruptible
from cosim.codegen.runge_kutta.stage_sums import dop853_coefficients
from cosim.errors import FmuError
from cosim.fmi.run.initialization import enter_continuous_time, initialize
from cosim.memo import kept_per_thread

MASTER_TOLERANCE = 1e-5  # of model exchange where neither user nor FMU says one, as in fmpy

# Kinds of variables, in the order of the enumeration in fmu/master/recording.h
KINDS: dict[str, Any] = {
    "Float64": ctypes.c_double, "Float32": ctypes.c_float, "Int8": ctypes.c_int8,
    "UInt8": ctypes.c_uint8, "Int16": ctypes.c_int16, "UInt16": ctypes.c_uint16,
    "Int32": ctypes.c_int32, "UInt32": ctypes.c_uint32, "Int64": ctypes.c_int64,
    "UInt64": ctypes.c_uint64, "Boolean": ctypes.c_bool,
}  # fmt: skip
_GETTERS_2 = {"Real": "Float64", "Integer": "Int32", "Boolean": "Int32", "Enumeration": "Int32"}

# Fields of `Functions` in fmu/master/fmu.h: their names in FMI 2 and 3
_FUNCTIONS = {
    "set_time": ("SetTime", "SetTime"),
    "get_states": ("GetContinuousStates", "GetContinuousStates"),
    "set_states": ("SetContinuousStates", "SetContinuousStates"),
    "get_derivatives": ("GetDerivatives", "GetContinuousStateDerivatives"),
    "get_indicators": ("GetEventIndicators", "GetEventIndicators"),
    "enter_event_mode": ("EnterEventMode", "EnterEventMode"),
    "enter_continuous_time_mode": ("EnterContinuousTimeMode", "EnterContinuousTimeMode"),
    "new_discrete_states": ("NewDiscreteStates", None),
    "update_discrete_states": (None, "UpdateDiscreteStates"),
    "completed_step_2": ("CompletedIntegratorStep", None),
    "completed_step_3": (None, "CompletedIntegratorStep"),
    "do_step_2": ("DoStep", None),
    "do_step_3": (None, "DoStep"),
    "get_boolean_status": ("GetBooleanStatus", None),
    "get_real_status": ("GetRealStatus", None),
}
_LONG, _DOUBLE, _POINTER = ctypes.c_longlong, ctypes.c_double, ctypes.c_void_p


class _Functions(ctypes.Structure):
    _fields_ = (("version", _LONG), *((n, _POINTER) for n in ("instance", *_FUNCTIONS)))


class _Group(ctypes.Structure):
    _fields_ = (
        ("kind", _LONG),
        ("count", _LONG),
        ("references", _POINTER),
        ("get_2", _POINTER),
        ("get_3", _POINTER),
        ("function", ctypes.c_char_p),
        ("buffer", _POINTER),
    )


class _Recording(ctypes.Structure):
    _fields_ = (
        ("groups", _LONG),
        ("width", _LONG),
        ("group", ctypes.POINTER(_Group)),
        ("columns", _POINTER),
        ("rows", _POINTER),
    )


class _Run(ctypes.Structure):
    _fields_ = (
        ("functions", ctypes.POINTER(_Functions)),
        ("recording", ctypes.POINTER(_Recording)),
        ("times", _POINTER),
        ("points", _LONG),
        *((name, _DOUBLE) for name in ("start", "stop", "interval")),
        *((name, _LONG) for name in ("any_step", "states", "indicators")),
        *((name, _LONG) for name in ("needs_completed_step", "next_defined")),
        *((name, _DOUBLE) for name in ("next_event", "relative_tolerance")),
        ("nominals", _POINTER),
        *((name, _LONG) for name in ("how", "rows", "steps", "calls", "events", "status")),
        ("function", ctypes.c_char_p),
        ("time", _DOUBLE),
    )


class _Ending(IntEnum):
    """How a run ended, as in fmu/master/run.h."""

    DONE, CALL_FAILED, ENDED_BY_FMU, STUCK, EARLY_RETURN, STEP_VANISHED, INTERRUPTED = range(7)


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
        self._functions = _functions(instance, description)
        self._recordings: dict[tuple[int, ...], _Recorded] = {}

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
        run = _Run(
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
        _refuse(run, interrupts, stop)
        instance.terminate()
        rows.setflags(write=False)
        stats = {"steps": run.steps, "events": run.events}
        if exchange:
            stats["rhs_calls"] = run.calls
        return DrivenRun(times, rows, stats)

    def _recording(self, variables: Sequence[Any]) -> _Recording:
        wanted = tuple(map(id, variables))  # which live as long as their description
        if wanted not in self._recordings:
            self._recordings = {wanted: _Recorded(self._instance, self._description, variables)}
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


def _prepare_exchange(run: _Run, instance: Any, description: Any, tolerance: float | None) -> Any:
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


class _Recorded:
    """What is recorded, as C takes it, but for the rows; keeps its arrays alive."""

    def __init__(self, instance: Any, description: Any, variables: Sequence[Any]) -> None:
        second = description.fmiVersion.startswith("2")
        found: dict[str, list[int]] = {}
        for place, variable in enumerate(variables):
            getter = variable.type
            if getter == "Enumeration":
                getter = "Integer" if second else "Int64"
            found.setdefault(getter, []).append(place)
        self._held: list[Any] = []
        groups = [
            self._group(instance, getter, [variables[i].valueReference for i in places], second)
            for getter, places in found.items()
        ]
        self._groups = (_Group * len(groups))(*groups)
        self._columns = np.concatenate([[], *found.values()]).astype(np.int64)
        self.structure = _Recording(
            len(groups), len(variables), self._groups, self._columns.ctypes.data
        )

    def _group(self, instance: Any, getter: str, references: list[int], second: bool) -> _Group:
        kind = _GETTERS_2[getter] if second else getter
        name = f"fmi{2 if second else 3}Get{getter}"
        wanted = (ctypes.c_uint32 * len(references))(*references)
        buffer = (KINDS[kind] * len(references))()
        self._held += [wanted, buffer]
        address = _address(instance, name)
        return _Group(
            list(KINDS).index(kind),
            len(references),
            ctypes.addressof(wanted),
            address if second else None,
            None if second else address,
            name.encode(),
            ctypes.addressof(buffer),
        )


def _functions(instance: Any, description: Any) -> _Functions:
    version = 2 if description.fmiVersion.startswith("2") else 3
    found = {
        field: _address(instance, f"fmi{version}{name}")
        for field, names in _FUNCTIONS.items()
        if (name := names[version - 2]) is not None
    }
    return _Functions(version=version, instance=instance.component, **found)


def _address(instance: Any, name: str) -> int | None:
    """Return where a function of an FMU's library is; None where it has none of this name."""
    function = getattr(instance.dll, name, None)
    return None if function is None else ctypes.cast(function, _POINTER).value


@kept_per_thread(8)
def _library(states: int, indicators: int, exchange: bool) -> ctypes.CDLL:
    """Compile the master, or take it from the cache; of model exchange, one per size."""
    if exchange:
        sizes = f"#define NX {max(states, 1)}\n#define NZ {max(indicators, 1)}\n"
        headers = master_source("model_exchange.h")
        coefficients = dop853_coefficients().replace('#include "dop853.h"\n', "")
        text, interface = f"{sizes}{headers}{coefficients}", "model_exchange"
    else:
        text, interface = master_source("co_simulation.h"), "co_simulation"
    text += f"SHARED void run_fmu(Run *run) {{\n    answer(run, {interface});\n}}\n"
    library = ctypes.CDLL(str(cached_library(f"master {text}", lambda: text)))
    library.run_fmu.argtypes = [ctypes.POINTER(_Run)]
    library.run_fmu.restype = None
    return library


def _refuse(run: _Run, interrupts: Sequence[int], stop: float) -> None:
    """Raise what a run ended with, in fmpy's words where it has some."""
    from fmpy.fmi1 import FMICallException

    ending = _Ending(run.how)
    if interrupts or ending is _Ending.INTERRUPTED:
        raise KeyboardInterrupt
    if ending is _Ending.CALL_FAILED:
        name = run.function.decode()
        if run.status < 0:
            raise FmuError(f"{name} returned {run.status}, which is no status of the FMI")
        raise FMICallException(function=name, status=run.status)
    if ending is _Ending.EARLY_RETURN:
        raise FmuError("FMU returned early from doStep() but Early Return is not allowed.")
    if ending is _Ending.STEP_VANISHED:
        raise FmuError(f"dop853: step size too small, or too many steps, at t = {run.time:g} s")
    if ending is not _Ending.DONE or run.rows < run.points:
        raise FmuError(f"the run ended at {run.time:g} s, before the stop time {stop:g} s")
