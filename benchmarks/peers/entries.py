"""Entries of a peer's module: solvers, and evaluations of the right-hand side."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Run = Callable[[], Vector]


@dataclass(frozen=True)
class Solver:
    """A solver of a peer.

    Attributes:
        name: Name in the table.
        prepare: Function from a relative tolerance to a run that returns the states, (n, nx). It
            does everything that can be done once, such as compilation. The absolute tolerance is a
            hundredth of the relative one.
        final: The same with slower preparation, for the tolerances that are timed.
        tightest: Smallest tolerance to try.
    """

    name: str
    prepare: Callable[[float], Run]
    final: Callable[[float], Run] | None = None
    tightest: float = 3e-14


@dataclass(frozen=True)
class Evaluation:
    """An evaluation of right-hand sides or accelerations.

    Attributes:
        name: Name in the table.
        run: Function that evaluates `count` times.
        count: Number of evaluations in a run.
        one: Whether a run is one call from Python for one state.
        held: Objects whose memory a run uses; this reference prevents their release.
    """

    name: str
    run: Callable[[], object]
    count: int = 1
    one: bool = False
    held: object = None
