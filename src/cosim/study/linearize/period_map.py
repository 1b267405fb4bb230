"""`period_map`: the linear map of states and inputs over a period, with samples in it."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from casadi_models.dae import Dae, Start
from cosim.arrays import Truths, Vector
from cosim.memo import cached_per_thread
from cosim.model.reduction import pattern
from cosim.model.values import Values, numbers_of
from cosim.study.linearize.local import influence, local_system
from cosim.study.linearize.period import of_samples
from cosim.study.linearize.spectrum import reachable
from cosim.study.sensitivity.sensitivity import sensitivity

TOLERANCE = 1e-11  # of the integration over a period
ACCURACY = 1e-9  # of the map, relative to its entries


class Mapped(NamedTuple):
    """A state after a step, and its derivatives by the states and the inputs before it."""

    x: Vector
    by_x: Vector
    by_u: Vector

    def then(self, later: "Mapped") -> "Mapped":
        """Return this step followed by another one from its end."""
        return Mapped(later.x, later.by_x @ self.by_x, later.by_x @ self.by_u + later.by_u)


@dataclass(frozen=True, eq=False)
class PeriodMap:
    """The map of a model over one period.

    Attributes:
        dae: The model.
        values: Values of inputs and parameters.
        begin: Start of the period, s.
        period: Its length, s.
        samples_first: Whether the samples at the start belong to it, not those at its end.
        point: Description of the state, for errors.
    """

    dae: Dae
    values: Values
    begin: float
    period: float
    samples_first: bool
    point: str

    def __call__(self, x: Vector) -> Mapped:
        """Return the map of a state at the start of the period."""
        n, m = len(x), len(self.values.u)
        step, time = Mapped(x, np.eye(n), np.zeros((n, m))), self.begin
        end = self.begin + self.period
        for sample, events in self._events():
            if sample > time:
                step = step.then(self._flow(step.x, time, sample))
            step, time = step.then(self._jump(step.x, sample, events)), sample
        return step.then(self._flow(step.x, time, end)) if end > time else step

    @property
    def influence(self) -> Truths:
        """Whether the change of a state in a period depends on a state."""
        found = influence(self.dae)
        for event in self.dae.events:
            if event.sampled:
                found[list(event.states)] |= pattern(event.values, self.dae.x)
                for state in event.states:  # it forgets its value
                    found[state, state] = True
        return reachable(found)

    def _events(self) -> list[tuple[float, frozenset[int]]]:
        """Return the sample times of the period, in order, with the events of each."""
        times, end = dict[float, set[int]](), self.begin + self.period
        for i, event in enumerate(self.dae.events):
            if not event.sampled:
                continue
            samples = of_samples(self.dae, i, self.values)
            for time in samples.within(self.begin, end, at_begin=self.samples_first):
                same = (t for t in times if abs(t - time) <= samples.near(t, time))
                times.setdefault(next(same, time), set()).add(i)
        return [(time, frozenset(times[time])) for time in sorted(times)]

    def _jump(self, x: Vector, time: float, events: frozenset[int]) -> Mapped:
        """Return the assignments of samples at one time."""
        after = _after_samples(self.dae, events)
        found = local_system(after, (), time, x, self.values, f"{self.point}, at a sample")
        n = len(x)
        return Mapped(found.rates, found.jacobian[:n, :n], found.jacobian[:n, n:])

    def _flow(self, x: Vector, begin: float, end: float) -> Mapped:
        """Return the motion between two samples."""
        dae = _without_samples(self.dae)
        states = [v.name for v in dae.states]
        found = sensitivity(
            dae,
            outputs=states,
            with_respect_to=[*states, *(v.name for v in dae.inputs)],
            start_values={**numbers_of(dae, self.values), **dict(zip(states, x, strict=True))},
            relative_tolerance=TOLERANCE,
            check=False,
            start_time=begin,
            stop_time=end,
            output_interval=end - begin,
        )
        slopes, n = found.values[-1], len(x)
        return Mapped(found.run.values[-1], slopes[:, :n], slopes[:, n:])


@cached_per_thread(8)
def _without_samples(dae: Dae) -> Dae:
    """Return the model between its samples, started from any state."""
    free = [
        replace(v, start=0.0, start_kind=Start.EXACT, minimum=-np.inf, maximum=np.inf)
        for v in dae.states
    ]
    return replace(
        dae,
        events=(),
        states=tuple(free),
        x_start=(0.0,) * len(free),
        start_rules=(),
        start_outputs=(),
        limits=(),
    )


@cached_per_thread(8)
def _after_samples(dae: Dae, events: frozenset[int]) -> Dae:
    """Return a model whose rates are the states after some samples."""
    after = ca.SX(dae.x)
    for i in sorted(events):
        after[list(dae.events[i].states)] = dae.events[i].values
    return replace(dae, events=(), ode=ca.densify(after))
