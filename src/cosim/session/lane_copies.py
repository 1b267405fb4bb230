"""`LaneCopies`: copies of an explicit model in SIMD lanes and threads."""

from collections.abc import Mapping
from math import inf
from typing import Any

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Integers, Vector
from cosim.codegen.runge_kutta.lane_library import lane_library, processor_lanes
from cosim.errors import InitialConditionError, ParameterError, UnknownName, UsageError
from cosim.fmi.export.dependencies import tunable_parameters
from cosim.integrate.ensemble.lanes import (
    batch_outcome,
    lane_starts,
    nominal_sizes,
    processors,
    run_lanes,
    why_no_start,
)
from cosim.integrate.keywords import requested
from cosim.model.many_values import ManyValues, assign_many
from cosim.model.solver import Tolerance
from cosim.session.clock import is_beyond
from cosim.session.values import not_settable
from cosim.trajectory import Event


class LaneCopies:
    """Copies in SIMD lanes; see `Engine`.

    Each step begins with the state and the step size that the last one has ended with.

    Args:
        dae: An explicit model without events.
        count: Number of copies.
        tolerance: Tolerance and largest step of the solver.
        stop: End beyond which steps are rejected, s; none when None.

    Raises:
        MissingTool: There is no compiler, or it fails.
    """

    def __init__(self, dae: Dae, count: int, tolerance: Tolerance, stop: float | None) -> None:
        self.name = dae.full_name
        self.inputs = tuple(v.name for v in dae.inputs)
        self.outputs = dae.observed
        self.states = tuple(v.name for v in dae.states)
        self.reasons: dict[int, str] = {}
        self.invalid: dict[int, str] = {}
        self.owner = dae.digest
        self._dae = dae
        self._tolerance = tolerance
        self._stop = inf if stop is None else stop
        self._recorded = tuple(dict.fromkeys((*self.states, *self.outputs)))
        self._lanes = processor_lanes()
        self._library = lane_library(dae, self._recorded, self._lanes)
        self._parameters = tuple(v.name for v in dae.parameters)
        self._tunable = tunable_parameters(dae, None)
        sizes = {"x": dae.states, "nominal": dae.states, "u": dae.inputs, "p": dae.parameters}
        self._rows: dict[str, Vector] = {
            name: np.empty((count, len(found))) for name, found in sizes.items()
        }
        self._rows["step"] = np.zeros(count)
        self._known: Vector | None = None  # values of `_recorded` now, (copies, names)

    def begin(self, values: Mapping[str, Any], time: float, rows: Integers) -> None:
        """Begin copies again; see `Engine.begin`."""
        found = self._assigned(values, rows)
        x, u, p = (np.ascontiguousarray(column) for column in (found.x, found.u, found.p))
        good = lane_starts(self._library, self._dae, time, x, u, p)
        if not good.all():
            first = int(np.argmin(good))
            why = why_no_start(self._dae, time, found, first)
            raise InitialConditionError(f"copy {rows[first]}: {why}")
        for name, column in (("x", x), ("u", u), ("p", p), ("step", 0.0)):
            self._rows[name][rows] = column
        self._rows["nominal"][rows] = nominal_sizes(self._dae, x, self._tolerance)
        for number in rows.tolist():
            self.reasons.pop(number, None)
            self.invalid.pop(number, None)
        self._known = None

    def _assigned(self, values: Mapping[str, Any], rows: Integers) -> ManyValues:
        """Return values of some copies; a number or a text with a unit holds for all of them."""
        texts = {name: value for name, value in values.items() if isinstance(value, str)}
        numbers = requested(self._dae, start_values=texts).values if texts else {}
        columns = {**{name: v for name, v in values.items() if name not in texts}, **numbers}
        count = len(rows)
        every = {name: np.broadcast_to(v, count) for name, v in columns.items()}
        found = assign_many(self._dae, every)
        for first, why in sorted(found.refused.items())[:1]:
            raise ParameterError(f"copy {rows[first]}: {why}")
        if len(found) == count:
            return found
        x, p, u = (np.repeat(row, count, axis=0) for row in (found.x, found.p, found.u))
        return ManyValues({}, x, p, u, found.refused)

    def advance(self, time: float, target: float) -> dict[int, tuple[Event, ...]]:
        """Integrate; see `Engine.advance`."""
        if is_beyond(time, target, self._stop):
            raise UsageError(
                f"{self.name}: the step ends at {target:.17g}, beyond the stop time "
                f"{self._stop:.17g}; give a later one to open"
            )
        self._run(np.array([time, target]))
        return {}

    def _run(self, grid: Vector) -> None:
        """Integrate the running copies over two times, or compute their values at one."""
        rows, count = self._rows, len(self._rows["x"])
        going = np.setdiff1d(np.arange(count), [*self.reasons])
        steps = rows["step"][going]
        values, ended, _ = run_lanes(
            self._library,
            self._lanes,
            len(self._recorded),
            [rows[name][going] for name in ("x", "nominal", "u", "p")],
            grid,
            (*self._tolerance.pair, self._tolerance.max_step or np.inf),
            threads=processors(),
            stop_outside=False,
            steps=steps,
        )
        known = np.full((count, len(self._recorded)), np.nan)
        known[going] = values[:, -1]
        rows["step"][going] = steps
        rows["x"][going] = values[:, -1, : len(self.states)]
        for number, report in zip(going.tolist(), ended, strict=True):
            if report["code"] or report["left"] < np.inf:
                _, reason, outside = batch_outcome(self._dae, report, grid)
                if reason:
                    self.reasons[number] = reason
                if outside:
                    self.invalid.setdefault(number, outside)
        self._known = known

    def set(self, values: Mapping[str, Any]) -> None:
        """Set inputs and tunable parameters; see `Engine.set`."""
        settable = (*self.inputs, *self._tunable)
        for name in values:
            if name in settable:
                continue
            if name not in (*self._recorded, *self._parameters):
                raise UnknownName.among(self.name, "input", name, settable)
            raise not_settable(self.name, name, self.inputs)
        found = self._assigned(values, np.arange(len(self._rows["x"])))
        for kind, names, table in (("u", self.inputs, found.u), ("p", self._parameters, found.p)):
            for column, name in enumerate(names):
                if name in values:
                    self._rows[kind][:, column] = table[:, column]
        self._known = None

    def get(self, names: tuple[str, ...], time: float) -> Vector:
        """Return values; see `Engine.get`."""
        table = np.empty((len(names), len(self._rows["x"])))
        for row, name in enumerate(names):
            if name in self.inputs:
                table[row] = self._rows["u"][:, self.inputs.index(name)]
            elif name in self._parameters:
                table[row] = self._rows["p"][:, self._parameters.index(name)]
            elif name in self._recorded:
                if self._known is None:
                    self._run(np.array([time]))
                assert self._known is not None
                table[row] = self._known[:, self._recorded.index(name)]
            else:
                known = (*self._recorded, *self.inputs, *self._parameters)
                raise UnknownName.among(self.name, "variable", name, known)
        return table

    def save(self) -> dict[str, Vector]:
        """Return the state as arrays; see `Engine.save`."""
        return dict(self._rows)

    def fits(self, arrays: Mapping[str, Vector]) -> bool:
        """Tell whether arrays may be a saved state; see `Engine.fits`."""
        shapes = ({n: (a.shape, a.dtype) for n, a in rows.items()} for rows in (arrays, self._rows))
        return next(shapes) == next(shapes)

    def restore(self, arrays: Mapping[str, Vector]) -> dict[int, str]:
        """Set a saved state; see `Engine.restore`."""
        self._rows = {name: np.array(column) for name, column in arrays.items()}
        self._known = None
        return {}
