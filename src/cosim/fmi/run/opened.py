"""An FMU for many runs: unpacked, read and instantiated once, reset before each run."""

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from time import perf_counter
from typing import Any

from cosim.arrays import Vector
from cosim.errors import FmuError
from cosim.fmi.archive import unpacked
from cosim.fmi.run.instance import (
    by_name,
    choose_interface,
    instantiated,
    read_description,
)
from cosim.fmi.run.simulate import (
    column_of,
    given_numbers,
    numbers_of_run,
    recorded,
    rows_of,
    simulated,
    span_of,
    tolerance_of,
)
from cosim.model.time_grid import time_grid
from cosim.trajectory import Column, Trajectory


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
        self._live = ExitStack()
        self._instance: tuple[Any, Callable[[Exception], FmuError]] | None = None

    def columns(self, outputs: Sequence[str] | None) -> tuple[Column, ...]:
        """Return what a run records."""
        names = recorded(self.path, self.variables, outputs)
        return tuple(column_of(self.variables[name]) for name in names)

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
    ) -> Trajectory:
        """Run it once more, from its initial state; arguments and errors as of `simulate_fmu`."""
        began = perf_counter()
        span = span_of(self.path, self.description, start_time, stop_time, output_interval)
        values = self.settable(start)
        names = recorded(self.path, self.variables, outputs)
        tolerance = tolerance_of(self.path, relative_tolerance)
        instance, explained = self._ready()
        try:
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
            rows, time = rows_of(explained, result, names, span)
        except BaseException:
            self._drop()  # nobody knows its state
            raise
        columns = tuple(column_of(self.variables[name]) for name in names)
        took = perf_counter() - began
        stats = {"solver": f"fmpy {self.kind}", "solve_time": took, "wall_time": took}
        numbers = numbers_of_run(self.variables, values)
        return Trajectory(self.description.modelName, time, columns, rows, stats, numbers=numbers)

    def close(self) -> None:
        """Free the instance and remove what was unpacked."""
        self._drop()
        self._open.close()

    def _ready(self) -> tuple[Any, Callable[[Exception], FmuError]]:
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
        self._instance = None
