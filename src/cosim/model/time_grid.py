"""Output times of a run."""

import numpy as np
from numpy.typing import ArrayLike

from cosim.arrays import Vector
from cosim.errors import ParameterError
from cosim.model.values import number

LARGEST_TABLE = 8e9  # of a table of results


def time_grid(start: float, stop: float, interval: float, *, numbers: int = 1) -> Vector:
    """Return output times from start to stop, both included, (n,); one where they are equal.

    The times of a shorter run are the first times of a longer one, bit for bit.

    Args:
        start, stop: s.
        interval: Distance of the times, s; the last one may be shorter.
        numbers: How many numbers each time stands for, to refuse what no memory holds.

    Raises:
        ParameterError: A number is not finite, the interval not positive, or stop before start.
    """
    start, stop = number("run", "start_time", start), number("run", "stop_time", stop)
    interval = number("run", "output_interval", interval, positive=True)
    if stop < start:
        raise ParameterError(
            f"stop_time = {stop:g} s lies before start_time = {start:g} s; give a later stop"
        )
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
    if not whole or abs(count - whole) > 1e-6 * max(1.0, count):
        whole = int(count) + 1
    grid = start + interval * np.arange(whole + 1)
    grid[-1] = stop
    return checked_grid(grid)


def checked_grid(grid: ArrayLike) -> Vector:
    """Return a grid of two or more times.

    Raises:
        ParameterError: It is not increasing or not finite.
    """
    try:
        times = np.array(grid, dtype=float)
    except (TypeError, ValueError) as error:
        raise ParameterError(f"grid: {error}; give times in s") from error
    if times.ndim != 1 or len(times) < 2 or not np.isfinite(times).all():
        raise ParameterError("grid: give two or more finite times in one dimension")
    falling = np.flatnonzero(np.diff(times) <= 0)
    if falling.size:
        i = int(falling[0]) + 1
        raise ParameterError(
            f"grid: time {i} ({times[i]:.17g} s) is not after the one before it; give times that "
            "increase and that double precision can tell apart"
        )
    return times
