"""What a module of a peer offers: ways to integrate, ways to evaluate the right-hand side."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Run = Callable[[], Vector]


@dataclass(frozen=True)
class Solver:
    """A way to integrate.

    Attributes:
        name: In the table.
        prepare: Relative tolerance -> a run that returns the states, (n, nx); everything
            that can be done once, compiling above all, is done here. The absolute tolerance is a
            hundredth of it where there are two.
        final: The same with costlier preparation, for the tolerances that are timed.
        tightest: Smallest tolerance that is tried.
    """

    name: str
    prepare: Callable[[float], Run]
    final: Callable[[float], Run] | None = None
    tightest: float = 3e-14


@dataclass(frozen=True)
class Evaluation:
    """A way to evaluate right-hand sides or accelerations.

    Attributes:
        name: In the table.
        run: Evaluates `count` times.
        count: How often.
        one: Whether a run is one call from Python for one state.
        held: Memory that a run uses without holding it.
    """

    name: str
    run: Callable[[], object]
    count: int = 1
    one: bool = False
    held: object = None
