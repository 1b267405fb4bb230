"""Input time series: piecewise linear between samples, held constant outside."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class InputSeries:
    """Samples of inputs over time, in SI units.

    Attributes:
        names: The inputs.
        time: Increasing sample times, s, (m,), m > 1.
        values: One column per input, (m, len(names)).
    """

    names: tuple[str, ...]
    time: Vector
    values: Vector

    def at(self, times: Vector) -> Vector:
        """Return the values at some times, (len(names), n)."""
        return np.array([np.interp(times, self.time, column) for column in self.values.T])
