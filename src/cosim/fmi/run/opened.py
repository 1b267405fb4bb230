"""An FMU for many runs: unpacked, read and instantiated once, reset before each run."""

import ctypes
import os
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import replace
from enum import StrEnum
from functools import partial
from math import isfinite
from pathlib import Path
from time import perf_counter
from typing import Any
from weakref import finalize

import numpy as np

from cosim.codegen.c_sources import master_source
from cosim.codegen.compiler import cached_library
from cosim.codegen.runge_kutta.stage_sums import dop853_coefficients
from cosim.errors import FmuError, MissingTool
from cosim.fmi.archive import unpacked
from cosim.fmi.run.arrays import with_elements
from cosim.fmi.run.c_structures import NOTE, Calls, Ending, Run, exchange_run, reject_failure
from cosim.fmi.run.description import Interface, asks_for_inputs, choose_interface, read_description
from cosim.fmi.run.deviations import Deviations
from cosim.fmi.run.instance import (
    enter_continuous_time,
    initialize,
    instantiated,
    invalidity,
    why_it_ended,
)
from cosim.fmi.run.kept_rows import new_rows
from cosim.fmi.run.python_master import Clock, run_in_python
from cosim.fmi.run.request import FmuRequest, MasterRun, lost_state
from cosim.fmi.trust import is_made_here
from cosim.host.signals import interruptible
from cosim.memo import cached_per_thread
from cosim.model.growth import MOST_TRIALS_OF_GROWTH, Growth
from cosim.model.troughs import MOST_TRIALS, Trough
from cosim.text import moment, one_note
from cosim.trajectory import Event, Trajectory


def _growth(run: Trajectory) -> str:
    """Return which state has grown so that its start is less than its rounding; empty if none."""
    for i, column in enumerate(run.columns):
        sizes = np.abs(run.values[:, i])
        most = sizes.max(initial=0.0)
        if column.is_state and np.finfo(float).eps * most > max(sizes[0], column.nominal):
            return (
                f"{column.name} grows to {most:.1g}; if the model does not, the steps "
                "inside the FMU are too long: compare with model exchange"
            )
    return ""


class Master(StrEnum):
    """What drives an FMU."""

    FMPY = "fmpy"  # a loop in Python over fmpy's objects
    C = "c"  # compiled code


class OpenedFmu:
    """An unpacked FMU that can run many times; its binary runs in this process.

    Its files are removed when nothing uses it any more.

    Attributes:
        path: What messages call it.
        description: Of fmpy, with the elements of arrays.
        interface: The one that runs.
        is_own: Whether it was exported here, so that its reset is complete.
    """

    def __init__(self, path: str | os.PathLike[str], interface: str | None = None) -> None:
        self.path = path
        with ExitStack() as opening:
            self._folder = opening.enter_context(unpacked(path, to_run=True))
            self.description = with_elements(read_description(self._folder, path))
            self.interface = choose_interface(self._folder, self.description, interface, path)
            self._open = opening.pop_all()  # which stays open, as nothing has failed
        finalize(self, self._open.close)
        self.is_own = is_made_here(path)  # else each run gets a new instance
        self.callback: dict[str, Any] = {}  # of FMI 3; see `instantiated`
        self._live = self._open.enter_context(ExitStack())  # freed before the files are removed
        self._instance: tuple[Any, Callable[[Exception], FmuError]] | None = None
        self._calls: Calls | None = None
        self._is_spoilt = False  # whether nothing of the library may be called any more

    def contains(self, name: str) -> bool:
        """Tell whether there is a file of this name in it."""
        return (self._folder / name).is_file()

    def request(self, **keywords: Any) -> FmuRequest:
        """Return a request from keywords of `simulate_fmu`, checked."""
        return FmuRequest.of(self.description, self.interface, self.path, **keywords)

    def run(self, request: FmuRequest, master: Master = Master.FMPY) -> Trajectory:
        """Run it once more, from its initial state.

        Where a deviation grows unseen in model exchange, or a state loses its digits, it runs again
        with a smaller absolute tolerance.
        """
        found, lost = self._run(request, master)
        trials = MOST_TRIALS if isinstance(lost, Trough) else MOST_TRIALS_OF_GROWTH
        relative = request.relative_tolerance
        closer = request.closer
        text = _growth(found) if self.interface is Interface.CO_SIMULATION else ""
        while lost and trials:
            trials -= 1
            last, closer = lost, lost.closer(relative, relative, closer)
            if master is Master.C:
                closer = closer._replace(until=request.stop)
            self._drop()  # the reset of a file of another tool may be incomplete
            with suppress(FmuError):
                found, lost = self._run(replace(request, closer=closer), master)
            text = last.note(closer, relative, lost is None)
            if lost is last or (isinstance(lost, Growth) and lost.time < closer.until):
                break
        if not text:
            return found
        note = one_note(found.stats.get("note"), text)
        return replace(found, stats={**found.stats, "note": note})

    def _run(
        self, request: FmuRequest, master: Master
    ) -> tuple[Trajectory, Growth | Trough | None]:
        began = perf_counter()
        instance: Any
        driven = request.inputs is not None and self.interface is Interface.CO_SIMULATION
        if driven and asks_for_inputs(self.description):
            self._drop()
            self.callback = {
                "requiredIntermediateVariables": request.input_references,
                "intermediateUpdate": lambda _, time, asks, *__: asks and instance.answer(time),
            }
        instance, explained = self.ready()
        ready = perf_counter()
        try:
            found = self._driven(instance, request, master)
            lost = lost_state(instance, self.description)()
            instance.terminate()  # after which some FMUs have no values
            _reject_not_finite(found, request, lost)
        except BaseException as error:
            self._drop()  # its state is unknown
            if isinstance(error, Exception) and not isinstance(error, MissingTool):
                raise explained(error) from error
            raise
        done = perf_counter()
        if (end := found.stats.get("stop_time")) is not None:
            found.stats["stop"] = f"{why_it_ended(instance.logged.texts)} from {end:.12g} s on"
        if note := one_note(found.stats.get("note"), *instance.logged.passed):
            found.stats["note"] = note
        stats = {
            **found.stats,
            **invalidity(instance.logged.violations),
            "solver": f"{master} {self.interface}",
            "solve_time": done - ready,
            "wall_time": done - began,
        }
        run = Trajectory(
            self.description.modelName,
            found.times,
            request.columns,
            found.rows,
            stats,
            numbers=request.numbers,
            events=tuple(Event(time, name, {}, {}) for time, name in instance.logged.events),
        )
        return run, found.growth

    def close(self) -> None:
        """Free the instance and remove the unpacked files."""
        self._drop()
        self._open.close()

    def _driven(self, instance: Any, request: FmuRequest, master: Master) -> MasterRun:
        if master is Master.FMPY:
            return run_in_python(instance, request)
        if self._calls is None:
            self._calls = Calls(instance, self.description)
        return _run_compiled(instance, request, self._calls)

    def instance(self, stack: ExitStack) -> tuple[Any, Callable[[Exception], FmuError]]:
        """Return a new instance that a stack frees, and a function that explains its errors."""
        facts = self._folder, self.description, self.interface, self.path
        return stack.enter_context(instantiated(*facts, **self.callback))

    def ready(self) -> tuple[Any, Callable[[Exception], FmuError]]:
        """Return an instance, fresh or reset, and a function that adds its log to an error.

        What it has logged before is forgotten. After a fatal error it is of another copy of the
        library, as nothing of that one may be called.
        """
        if not self.is_own or (self._instance and self._instance[0].fatal.value):
            self._drop()
        if self._is_spoilt:
            self._folder = self._open.enter_context(unpacked(self.path, to_run=True))
            self._is_spoilt = False
        if self._instance is None:
            self._instance = self.instance(self._live)
        else:
            instance, explained = self._instance
            try:
                instance.reset()
            except Exception as error:
                self._drop()
                raise explained(error) from error
        instance, explained = self._instance
        instance.logged.clear()
        return instance, explained

    def _drop(self) -> None:
        self._is_spoilt |= bool(self._instance and self._instance[0].fatal.value)
        self._live.close()
        self._instance = self._calls = None


def _reject_not_finite(run: MasterRun, request: FmuRequest, lost: str) -> None:
    finite = np.isfinite(run.rows)
    if not finite.all():
        row = int(np.argmin(finite.all(axis=1)))
        name = request.recorded[int(np.argmin(finite[row]))].name
        raise FmuError(f"{name} is not finite at {moment(run.times[row], 6)} s")
    if lost:
        raise FmuError(f"its state {lost} is not finite at the end of the run")


def still_open(path: str | os.PathLike[str], interface: str | None) -> OpenedFmu:
    """Return an FMU that stays open for the next runs in this thread.

    A file that was not exported here gets a new instance for every run, as its reset may be
    incomplete.
    """
    try:
        facts = Path(path).stat()
    except (OSError, TypeError, ValueError):
        return OpenedFmu(path, interface)  # which raises the reason
    changed = facts.st_dev, facts.st_ino, facts.st_size, facts.st_mtime_ns, facts.st_ctime_ns
    return _opened(str(path), interface, changed)


@cached_per_thread(4)
def _opened(path: str, interface: str | None, _changed: tuple[int, ...]) -> OpenedFmu:
    return OpenedFmu(path, interface)


def _note(run: Run, seen: Deviations, time: float, states: Any, before_event: bool) -> None:
    """Note the states that compiled code reaches; before an event, look back."""
    if before_event:
        seen.pass_event(run.steps - seen.steps)
    else:
        seen.note(time, states[: run.states])


def _run_compiled(instance: Any, request: FmuRequest, calls: Calls) -> MasterRun:
    """Initialize an FMU and run it by compiled code; it is not terminated yet.

    Model exchange is integrated by `dop853`, co-simulation is stepped.

    Raises:
        FmuError: A call failed, or the FMU stopped without ending the run.
        MissingTool: There is no compiler.
    """
    description, points = request.description, request.points
    exchange = request.interface is Interface.MODEL_EXCHANGE
    sizes = description.numberOfContinuousStates, description.numberOfEventIndicators
    library = _library(*sizes) if exchange else _library()
    initialize(instance, description, request.values, **request.experiment)
    rows = new_rows(request)
    recording = calls.recording(request.recorded, rows)
    facts: dict[str, Any] = {
        "recording": ctypes.pointer(recording),
        "times": points.ctypes.data,
        "points": len(points),
        "start": request.start,
        "interval": request.interval,
    }
    deviations: Deviations | None = None
    if exchange:
        next_event = enter_continuous_time(instance)
        facts |= {"stop": points[-1], "any_step": True, "next_defined": isfinite(next_event)}
        facts |= {"next_event": next_event, "relative_tolerance": request.relative_tolerance}
        shares = request.closer.shares if request.closer else 1.0
        run, _nominals = exchange_run(instance, description, calls, shares, **facts)
        deviations = Deviations(instance, request, Clock(instance, request), every=False)
        run.note = NOTE(partial(_note, run, deviations))
    else:
        any_step = description.coSimulation.canHandleVariableCommunicationStepSize
        facts |= {"stop": request.stop, "any_step": any_step}
        run = Run(functions=ctypes.pointer(calls.functions), **facts)
    with interruptible(library) as interrupts:
        library.run_fmu(ctypes.byref(run))
    reject_failure(run, interrupts, request.stop)
    if deviations:
        deviations.judge(run.steps - deviations.steps)
    rows.setflags(write=False)
    stats = {"steps": run.steps, "events": run.events}
    if run.how == Ending.ENDED_BY_FMU:
        points, rows = np.append(points[: run.rows - 1], run.time), rows[: run.rows]
        stats["stop_time"] = run.time
    if exchange:
        stats["rhs_calls"] = run.calls
    return MasterRun(points, rows, stats, deviations.found if deviations else None)


@cached_per_thread(8)
def _library(*sizes: int) -> ctypes.CDLL:
    text = master_source("co_simulation.h")
    if sizes:
        states, indicators = (max(size, 1) for size in sizes)
        text = f"#define NX {states}\n#define NZ {indicators}\n{master_source('model_exchange.h')}"
        text += dop853_coefficients().replace('#include "dop853.h"\n', "")
    return ctypes.CDLL(str(cached_library(f"master {text}", lambda: text)))
