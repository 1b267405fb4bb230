"""`Deviations`: the motion of an FMU between events, searched for growth that no step follows."""

from ctypes import c_double
from typing import Any

import numpy as np

from cosim.arrays import Vector
from cosim.fmi.run.arrays import elements_of
from cosim.fmi.run.request import FmuRequest, nominals_of
from cosim.model.growth import Growth, StatePath, stays_suppressed, suppressed_growth
from cosim.model.troughs import Trough, deepest_trough

_MOST_ROWS = 20_000  # of which every second one is dropped
_STEP = float(np.cbrt(np.finfo(float).eps))  # of a central difference, in sizes of its state


class Deviations:
    """The states of an FMU for model exchange since its last event.

    Args:
        instance: fmpy's, in continuous-time mode.
        request: What to compute.
        clock: Sets time and inputs.

    Attributes:
        names: Of the states.
        rows: Times, s, and states, in their order.
        found: A state that grows from few digits, or the smallest deviation that grows unseen, or
            that stays suppressed in a run that follows it; None if there is none.
    """

    def __init__(self, instance: Any, request: FmuRequest, clock: Any) -> None:
        self._instance, self._clock = instance, clock
        self.names = _state_names(request.description)
        self._tolerance = request.relative_tolerance
        self._follows = request.closer is not None
        own = request.closer.shares if request.closer else 1.0
        self._shares = np.ones(len(self.names)) * (own if np.ndim(own) else 1.0)
        self.found: Growth | Trough | None = None
        self.rows: list[tuple[float, Vector]] = []

    def note(self, time: float) -> None:
        """Note the present states."""
        if self.names:
            self.rows.append((time, self._block(self._instance.getContinuousStates)))
        if len(self.rows) > _MOST_ROWS:
            del self.rows[1:-1:2]

    def judge(self, steps: int) -> None:
        """Look back over the motion since the last event, and begin anew.

        Args:
            steps: Number of the solver's steps.
        """
        rows, self.rows = self.rows, []
        if len(rows) < 2:
            return
        times, states = zip(*rows, strict=True)
        path = StatePath(
            self.names,
            np.array(times),
            np.array(states).T,
            nominals_of(self._instance, len(self.names)),
            lambda times, states: np.array([*map(self._rates, times, states.T)]).T,
            lambda times, states: np.array([*map(self._slopes, times, states.T)]),
        )
        tolerances = self._tolerance, self._tolerance
        trough = deepest_trough(path, tolerances, self._shares)
        if trough and not isinstance(self.found, Trough):
            self.found = trough
        found = None if trough else suppressed_growth(path, steps, *tolerances)
        if self._follows and found and not stays_suppressed(path, steps, *tolerances):
            found = None
        self._rates(*rows[-1])
        if isinstance(self.found, Trough):
            return
        if found and (self.found is None or found.size < self.found.size):
            self.found = found

    def _block(self, getter: Any) -> Vector:
        values = (c_double * len(self.names))()
        getter(values, len(values))
        return np.array(values)

    def _rates(self, time: float, states: Vector) -> Vector:
        """Return dx/dt, which is not a number where the FMU has none or does not go back."""
        from fmpy.fmi1 import FMICallException

        try:
            self._clock.set(time)
            self._instance.setContinuousStates((c_double * len(states))(*states), len(states))
            return self._block(self._instance.getContinuousStateDerivatives)
        except FMICallException:
            return np.full(len(states), np.nan)

    def _slopes(self, time: float, states: Vector) -> Vector:
        sizes = np.maximum(np.abs(states), nominals_of(self._instance, len(states)))
        shifts = np.diag(_STEP * sizes)
        columns = [
            (self._rates(time, states + shift) - self._rates(time, states - shift))
            / (2 * shift.sum())
            for shift in shifts
        ]
        return np.array(columns).T


def _state_names(description: Any) -> list[str]:
    """Return the names of the states; an array stands for its elements."""
    states = [item.variable.derivative for item in description.derivatives]
    every = description.modelVariables
    numbers = [elements_of(state, every) if state.dimensions else [state] for state in states]
    return [number.name for some in numbers for number in some]
