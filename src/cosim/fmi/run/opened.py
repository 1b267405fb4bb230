"""An FMU for many runs: unpacked, read and instantiated once, reset before each run."""

import os
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from threading import local
from time import perf_counter
from typing import Any
from weakref import finalize

import numpy as np

from cosim.arrays import Vector
from cosim.errors import FmuError, MissingTool
from cosim.fmi.archive import unpacked
from cosim.fmi.run.c_master import CompiledMaster
from cosim.fmi.run.fmpy_master import rows_of, simulated
from cosim.fmi.run.instance import (
    by_name,
    choose_interface,
    instantiated,
    read_description,
)
from cosim.fmi.run.patient import patiently
from cosim.fmi.run.request import (
    Span,
    column_of,
    given_numbers,
    numbers_of_run,
    own_numbers,
    recorded,
    span_of,
    tolerance_of,
)
from cosim.fmi.trust import is_made_here
from cosim.model.time_grid import time_grid
from cosim.model.values import listed
from cosim.trajectory import Column, Trajectory

FMPY, C = MASTERS = ("fmpy", "c")
_MOST_OPEN = 4  # files that a thread keeps open
Explained = Callable[[Exception], FmuError]


class OpenedFmu:
    """An FMU that runs again and again; its binary runs in this process.

    Args:
        path: The file.
        interface: See `simulate_fmu`.

    Raises:
        FmuError, SecurityError, UnknownName: See `simulate_fmu`.
    """

    def __init__(self, path: str | os.PathLike[str], interface: str | None = None) -> None:
        self.path = path
        self._open = ExitStack()
        try:
            self._folder = self._open.enter_context(unpacked(path))
            self.description = read_description(self._folder, path)
            self.kind = choose_interface(self._folder, self.description, interface, path)
        except BaseException:
            self._open.close()
            raise
        self.variables = by_name(self.description)
        self._own_numbers = own_numbers(self.variables)
        self._columns: dict[tuple[str, ...] | None, tuple[Column, ...]] = {}
        self.reset_is_enough = True  # before another run; a new instance is made where it is not
        self._live = ExitStack()
        self._instance: tuple[Any, Explained] | None = None
        self._master: CompiledMaster | None = None

    def columns(self, outputs: Sequence[str] | None) -> tuple[Column, ...]:
        """Return what a run records."""
        asked = outputs if outputs is None else listed(f"{self.path}: outputs", outputs)
        if asked not in self._columns:
            names = recorded(self.path, self.variables, asked)
            self._columns[asked] = tuple(column_of(self.variables[name]) for name in names)
        return self._columns[asked]

    def settable(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return start values, or refuse them; see `simulate_fmu`."""
        return given_numbers(self.path, self.variables, values)

    def times(
        self, start_time: float | None, stop_time: float | None, output_interval: float | None
    ) -> Vector:
        """Return the output times of a run, s; see `simulate_fmu`."""
        span = span_of(self.path, self.description, start_time, stop_time, output_interval)
        return time_grid(span.start, span.stop, span.interval)

    def simulate(
        self,
        start: Mapping[str, float],
        *,
        start_time: float | None = None,
        stop_time: float | None = None,
        output_interval: float | None = None,
        relative_tolerance: float | None = None,
        outputs: Sequence[str] | None = None,
        master: str = FMPY,
    ) -> Trajectory:
        """Run it once more, from its initial state; arguments and errors as of `simulate_fmu`."""
        span = span_of(self.path, self.description, start_time, stop_time, output_interval)
        values = self.settable(start)
        tolerance = tolerance_of(self.path, relative_tolerance)
        once = partial(self._run, values, span, tolerance, outputs, master)
        return patiently(once) if master == FMPY else once()

    def _run(
        self,
        values: dict[str, float],
        span: Span,
        tolerance: float | None,
        outputs: Sequence[str] | None,
        master: str,
    ) -> Trajectory:
        began = perf_counter()
        columns = self.columns(outputs)
        names = [column.name for column in columns]
        instance, explained = self._ready()
        ready, stats = perf_counter(), dict[str, Any]()
        try:
            if master == FMPY:
                rows, time = self._through_fmpy(instance, explained, span, tolerance, values, names)
            else:
                wanted = [self.variables[name] for name in names]
                rows, time, stats = self._in_c(instance, explained, span, tolerance, values, wanted)
        except BaseException:
            self._drop()  # nobody knows its state
            raise
        stats["solver"] = f"{master} {self.kind}"
        stats["solve_time"] = perf_counter() - (began if master == FMPY else ready)
        stats["wall_time"] = perf_counter() - began
        numbers = numbers_of_run(self.variables, self._own_numbers, values)
        return Trajectory(self.description.modelName, time, columns, rows, stats, numbers=numbers)

    def _through_fmpy(
        self,
        instance: Any,
        explained: Explained,
        span: Span,
        tolerance: float | None,
        values: dict[str, float],
        names: Sequence[str],
    ) -> tuple[Vector, Vector]:
        result = simulated(
            explained,
            span.start,
            filename=str(self._folder),
            model_description=self.description,
            fmu_instance=instance,
            fmi_type=self.kind,
            validate=False,
            stop_time=span.stop,
            output_interval=span.interval,
            relative_tolerance=tolerance,
            start_values=values,
            output=names,
        )
        return rows_of(explained, result, names, span)

    def _in_c(
        self,
        instance: Any,
        explained: Explained,
        span: Span,
        tolerance: float | None,
        values: dict[str, float],
        wanted: Sequence[Any],
    ) -> tuple[Vector, Vector, dict[str, Any]]:
        try:
            if self._master is None:
                self._master = CompiledMaster(instance, self.description, self.kind)
            numbers = span.start, span.stop, span.interval
            found = self._master.run(numbers, tolerance, values, wanted)
        except MissingTool:
            raise
        except Exception as error:
            raise explained(error) from error
        finite = np.isfinite(found.rows)
        if not finite.all():
            row = int(np.argmin(finite.all(axis=1)))
            name = wanted[int(np.argmin(finite[row]))].name
            raise explained(FmuError(f"{name} is not finite at {found.time[row]:g} s"))
        return found.rows, found.time, found.stats

    def close(self) -> None:
        """Free the instance and remove what was unpacked."""
        self._drop()
        self._open.close()

    def _ready(self) -> tuple[Any, Explained]:
        if not self.reset_is_enough:
            self._drop()
        if self._instance is None:
            made = instantiated(self._folder, self.description, self.kind, self.path)
            self._instance = self._live.enter_context(made)
        else:
            instance, explained = self._instance
            try:
                instance.reset()
            except Exception as error:
                self._drop()
                raise explained(error) from error
        return self._instance

    def _drop(self) -> None:
        self._live.close()
        self._instance = self._master = None


class _Open(local):
    """What a thread keeps open, the latest last."""

    def __init__(self) -> None:
        self.files = OrderedDict[tuple[object, ...], OpenedFmu]()


_open = _Open()


def kept_open(path: str | os.PathLike[str], interface: str | None) -> OpenedFmu:
    """Return an FMU that this thread has opened, and keep it for its next runs.

    A file that was not made here gets a new instance for every run: only of ours is it known that a
    reset leaves nothing behind.

    Raises:
        FmuError, SecurityError, UnknownName: See `simulate_fmu`.
    """
    try:
        facts = Path(path).stat()
    except (OSError, TypeError, ValueError):
        return OpenedFmu(path, interface)  # which says what is wrong
    changed = facts.st_dev, facts.st_ino, facts.st_size, facts.st_mtime_ns, facts.st_ctime_ns
    key = (str(path), interface, *changed)
    found = _open.files.pop(key, None)
    if found is None:
        found = OpenedFmu(path, interface)
        found.reset_is_enough = is_made_here(path)
        finalize(found, ExitStack.close, found._open)
    _open.files[key] = found
    while len(_open.files) > _MOST_OPEN:
        _, oldest = _open.files.popitem(last=False)
        oldest.close()
    return found
