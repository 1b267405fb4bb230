"""`Times`: the output times of a run."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from casadi_models.dae import Dae
from cosim.arrays import Vector, reals
from cosim.errors import ParameterError, UsageError
from cosim.model.values import number

LARGEST_TABLE = 8e9  # of a table of results
_NEAR = 1e-9  # relative distance of times that masters take as one
_LONGER = 1e-2  # intervals: by so much the last one is longer rather than a rest follows


def time_grid(start: float, stop: float, interval: float, *, numbers: int = 1) -> Vector:
    """Return output times from start to stop, both included, s, (n,); one if they are equal.

    The times of a shorter run are the first times of a longer one, bit for bit.

    Args:
        start, stop: First and last output time, s.
        interval: Distance of the times, s; the last one may be shorter, or longer by a hundredth.
        numbers: Numbers per output time, to reject results that do not fit into memory.

    Raises:
        ParameterError: A number is not finite, the interval not positive, or stop before start.
    """
    start, stop = number("run", "start_time", start), number("run", "stop_time", stop)
    interval = number("run", "output_interval", interval, positive=True)
    reject_span(start, stop)
    if stop == start:
        return np.array([start])
    count = (stop - start) / interval
    size = 8 * count * (1 + numbers)
    if size > LARGEST_TABLE:
        raise ParameterError(
            f"output_interval = {interval:g} s makes {count:.3g} output times of {numbers} "
            f"numbers, {size / 1e9:.3g} GB; give a larger one"
        )
    whole = round(count)
    rounding = max(1e-6 * max(1.0, count), 2 * np.spacing(max(abs(start), abs(stop))) / interval)
    if not whole or abs(count - whole) > min(rounding, _LONGER):
        whole = int(count) + 1
    grid = start + interval * np.arange(whole)
    return checked_grid(np.append(grid[grid < stop], stop))  # the last one may round to the stop


def one_time(a: ArrayLike, b: ArrayLike, start: float) -> Any:
    """Return whether times are the same but for rounding; they count from the start of the run.

    As `near` in fmu/master/run.h.

    Args:
        a, b: Times, s, of shapes that fit.
        start: Start of the run, s.
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    if not (np.isfinite(a).all() and np.isfinite(b).all()):  # a time that never comes
        return a == b
    rounding = 4 * np.finfo(float).eps * np.maximum(np.abs(a), np.abs(b))
    since = np.maximum(np.abs(a - start), np.abs(b - start))
    return np.abs(a - b) <= np.maximum(rounding, _NEAR * since)


def reject_span(start: float, stop: float, owner: str = "") -> None:
    """Reject a stop time before the start time, or nearer than the least normal number, s.

    Raises:
        ParameterError: With the owner, e.g. "crank.fmu: ", first.
    """
    if stop < start:
        raise ParameterError(
            f"{owner}stop_time = {stop:g} s lies before start_time = {start:g} s; give a later stop"
        )
    if 0 < stop - start < np.finfo(float).tiny:
        raise ParameterError(f"{owner}a run of {stop - start:g} s has no steps; give a later stop")


def checked_grid(grid: ArrayLike, name: str = "grid") -> Vector:
    """Return a grid of two or more times; `name` is that of the argument.

    Raises:
        ParameterError: The grid is not increasing or not finite.
    """
    try:
        times = reals(grid)
    except (TypeError, ValueError) as error:
        raise ParameterError(f"{name}: {error}; give times in s") from error
    if times.ndim != 1 or len(times) < 2 or not np.isfinite(times).all():
        raise ParameterError(f"{name}: give two or more finite times in one dimension")
    falling = np.flatnonzero(np.diff(times) <= 0)
    if falling.size:
        i = int(falling[0]) + 1
        raise ParameterError(
            f"{name}: time {i} ({times[i]:.17g} s) is not after the one before it; give times that "
            f"increase from {times[0]:.17g} s on and that double precision can tell apart"
        )
    return times


@dataclass(frozen=True)
class Times:
    """Output times of a run: a span with an interval, or explicit times.

    Attributes:
        start: Start of the run, s.
        stop: End of the run, s. None: the model's own span after `start`, or the last of `own`.
        interval: Distance of the output times, s; the model's own when None.
        own: Explicit output times, s, as the bytes of an array of doubles; see `at`.

    Raises:
        ParameterError: A time is not finite, the interval is not positive, or the run would end
            before it begins.

    Example:
        >>> Times(stop=2.0, interval=0.5), Times.at([0.3, 0.7]).requested
        (Times(start=0.0, stop=2.0, interval=0.5, own=b''), array([0.3, 0.7]))
    """

    start: float = 0.0
    stop: float | None = None
    interval: float | None = None
    own: bytes = b""

    def __post_init__(self) -> None:
        start = number("run", "start_time", self.start)
        if self.interval is not None:
            number("run", "output_interval", self.interval, positive=True)
        if self.stop is not None:
            reject_span(start, number("run", "stop_time", self.stop))

    @classmethod
    def at(cls, times: ArrayLike, start: float = 0.0, stop: float | None = None) -> "Times":
        """Return explicit output times, s, (n,), of a run from `start` (to `stop`)."""
        try:
            own = np.atleast_1d(reals(times))
        except (TypeError, ValueError, OverflowError):
            raise UsageError.of_type("output_times", times, "times in s, (n,)") from None
        if own.ndim != 1 or not own.size or not np.isfinite(own).all():
            raise ParameterError("output_times: give finite times in s, in one dimension")
        found = cls(start, stop, own=own.tobytes())
        if own.size > 1 or own[0] != start:
            grid = own if own[0] == start else np.concatenate(([start], own))
            checked_grid(grid, "output_times")
        return found

    def grid(self, dae: Dae, numbers: int = 1) -> Vector:
        """Return the times at which a run is computed, s, (n,).

        Raises:
            ParameterError: The times are not increasing, or no memory holds the results.
        """
        if self.own:
            ends = [self.start] if self.stop is None else [self.start, self.stop]
            return np.unique(np.concatenate((ends, self.requested)))
        experiment = dae.experiment
        return time_grid(
            self.start,
            self.start + experiment.stop_time if self.stop is None else self.stop,
            experiment.output_interval if self.interval is None else self.interval,
            numbers=numbers,
        )

    @property
    def requested(self) -> Vector:
        """Explicit output times, s, (n,); empty if a span and an interval are given."""
        return np.frombuffer(self.own)

    def mean_interval(self, dae: Dae) -> float:
        """Return the distance of the output times of a run, s; of explicit ones, the mean."""
        if not self.own:
            return dae.experiment.output_interval if self.interval is None else self.interval
        begin, end = self.span(dae)
        return (end - begin) / max(1, len(np.setdiff1d(self.requested, begin)))

    def span(self, dae: Dae) -> tuple[float, float]:
        """Return begin and end of a run, s."""
        if self.stop is not None:
            return self.start, self.stop
        return self.start, float(self.requested[-1]) if self.own else (
            self.start + dae.experiment.stop_time
        )


def reject_rounded(name: str, step: float | None, begin: float, end: float) -> None:
    """Reject a step, s, that is within the rounding of the times of a run.

    Raises:
        ParameterError: It is so short.
    """
    latest = max(abs(begin), abs(end))
    if step is not None and step < 4 * np.spacing(latest):
        raise ParameterError(
            f"{name} = {step:g} s is within the rounding of times up to {latest:g} s; give a "
            "longer one"
        )
