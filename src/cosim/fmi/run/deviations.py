"""`Deviations`: the motion of an FMU between events, searched for growth that no step follows."""

from collections.abc import Callable, Iterable, Sequence
from ctypes import c_double
from typing import Any, NamedTuple

import numpy as np

from cosim.arrays import Vector
from cosim.fmi.run.request import FmuRequest, nominals_of, state_names
from cosim.model.growth import Growth, growth_from_start, smallest_of, unfollowed_growth
from cosim.model.state_path import StatePath
from cosim.model.troughs import Trough, deepest_trough

_MOST_ROWS = 20_000  # of which every second one is dropped
_PLACES = 36  # of a run, between events, at which its equations are looked at
_STEP = float(np.cbrt(np.finfo(float).eps))  # of a central difference, in sizes of its state


class _Place(NamedTuple):
    """Where the equations were looked at: time, s, states, their rates, and the slopes of these."""

    time: float
    states: Vector
    rates: Vector
    slopes: Vector


class Deviations:
    """The states of an FMU for model exchange, in which deviations may grow that no step follows.

    Args:
        instance: fmpy's, in continuous-time mode.
        request: What to compute.
        clock: Sets time and inputs.
        every: Whether to look back before every event; else, before those that are many times
            closer than places, only at random, so that no period of events hides a mode.

    Attributes:
        names: Of the states.
        rows: Times, s, and states, in their order, since the last event.
        steps: Number of the solver's steps that have been looked at.
        found: A state that grows from few digits, or the smallest deviation that grows unseen, or
            that stays suppressed in a run that follows it; None if there is none.
    """

    def __init__(self, instance: Any, request: FmuRequest, clock: Any, every: bool) -> None:
        self._instance, self._clock = instance, clock
        self.names = state_names(request.description)
        self._tolerances = request.relative_tolerance, request.relative_tolerance
        self._closer = request.closer
        own = self._closer.shares if self._closer else 1.0
        self._shares = np.ones(len(self.names)) * (own if np.ndim(own) else 1.0)
        self._distance = (request.stop - request.start) / _PLACES
        self.found: Growth | Trough | None = None
        self.rows: list[tuple[float, Vector]] = []
        self._places: list[_Place] = []
        self._grown: list[Growth | None] = []  # in parts without an event
        self._every: list[tuple[float, Vector]] = []  # rows of the run
        self.steps = 0
        self._random = None if every else np.random.default_rng(0)
        self._next_look = -np.inf

    def note(self, time: float, states: Sequence[float] | None = None) -> None:
        """Note the present states, which the FMU tells where they are not given."""
        if self.names:
            known = self._block(self._instance.getContinuousStates) if states is None else states
            self.rows.append((time, np.array(known)))
        if len(self.rows) > _MOST_ROWS:
            del self.rows[1:-1:2]

    def pass_event(self, steps: int) -> None:
        """Look back over the motion since the last event, before the next one.

        Args:
            steps: Number of the solver's steps since then.
        """
        if self._random and self.rows:
            time = self.rows[-1][0]
            if time < self._next_look:
                self._keep(self.rows)
                self.rows, self.steps = [], self.steps + steps
                return
            self._next_look = time + 2 * self._random.random() * self._distance
        path = self._piece(steps)
        if path is not None:
            self._remember(path)
            self._rates(path.time[-1], path.states[:, -1])

    def judge(self, steps: int) -> None:
        """Look back over the whole motion at its end; see `pass_event`."""
        path = last = self._piece(steps)
        if self._places:
            if last is not None:
                self._remember(last)
            path = self._linearized()
        if path is not None and not isinstance(self.found, Trough):
            whole = unfollowed_growth(path, self.steps, *self._tolerances, self._closer)
            self.found = smallest_of(filter(None, (whole, *self._grown)))
        if last is not None:
            self._rates(last.time[-1], last.states[:, -1])

    def _piece(self, steps: int) -> StatePath | None:
        """Return the motion since the last event, of which troughs are judged."""
        rows, self.rows = self.rows, []
        self.steps += steps
        if len(rows) < 2:
            return None
        path = self._path(
            rows,
            lambda times, x: np.array([*map(self._rates, times, x.T)]).T,
            lambda times, x: np.array([*map(self._slopes, times, x.T)]),
        )
        if not isinstance(self.found, Trough):
            self.found = deepest_trough(path, self._tolerances, self._shares)
        is_new = self._closer is None or path.time[0] >= self._closer.until
        if is_new and path.time[-1] - path.time[0] >= self._distance:
            self._grown.append(growth_from_start(path, *self._tolerances))
        return path

    def _remember(self, path: StatePath) -> None:
        """Look at the equations of a piece, which the next event may change."""
        self._keep(zip(path.time.tolist(), path.states.T, strict=True))
        times = np.arange(path.time[0], path.time[-1], self._distance)
        states = np.array([np.interp(times, path.time, row) for row in path.states])
        facts = times, states.T, path.rates(times, states).T, path.slopes(times, states)
        self._places += map(_Place, *facts)

    def _keep(self, rows: Iterable[tuple[float, Vector]]) -> None:
        self._every += rows
        if len(self._every) > _MOST_ROWS:
            del self._every[1:-1:2]

    def _linearized(self) -> StatePath:
        """Return the motion over all events, with linear equations at the places remembered."""
        begins = np.array([place.time for place in self._places])

        def at(times: Vector) -> list[_Place]:
            return [self._places[i] for i in begins.searchsorted(times, "right") - 1]

        def rates(times: Vector, states: Vector) -> Vector:
            pairs = zip(at(times), states.T, strict=True)
            return np.array([p.rates + p.slopes @ (x - p.states) for p, x in pairs]).T

        return self._path(
            self._every, rates, lambda times, _: np.array([p.slopes for p in at(times)])
        )

    def _path(
        self,
        rows: Sequence[tuple[float, Vector]],
        rates: Callable[[Vector, Vector], Vector],
        slopes: Callable[[Vector, Vector], Vector],
    ) -> StatePath:
        times, states = zip(*rows, strict=True)
        sizes = nominals_of(self._instance, len(self.names))
        every = np.ones(len(sizes), dtype=bool)
        columns = np.array(states).T
        return StatePath(self.names, np.array(times), columns, sizes, rates, slopes, every)

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
