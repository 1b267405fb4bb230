"""Runs of model exchange that take as many steps as they need.

fmpy's CVODE takes 500 steps at most from one output time to the next, which nothing sets. More
output times give it more; those that nobody asked for are left out again.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from cosim.errors import FmuError
from cosim.trajectory import Trajectory

_LIMIT = "mxstep steps taken"  # CVODE's words
FINER = (1, 10, 100)


def patiently(
    simulate: Callable[..., Trajectory],
    path: Any,
    *,
    output_interval: float,
    least: int = 1,
    **options: Any,
) -> Trajectory:
    """Run an FMU with ever more output times while its solver asks for more steps.

    Args:
        simulate: `simulate_fmu`, or what runs an FMU like it.
        path: The FMU.
        output_interval: Of the times that are returned, s.
        least: How many intervals of the first trial make one of those.
        options: See `simulate_fmu`.

    Raises:
        FmuError: See `simulate_fmu`.
    """
    for finer in FINER:
        factor = least * finer
        try:
            run = simulate(path, output_interval=output_interval / factor, **options)
        except FmuError as error:
            if _LIMIT not in str(error):
                raise
            if finer == FINER[-1]:
                raise FmuError(
                    f"{error}; more output times do not help it: try a looser relative tolerance, "
                    "or co-simulation, which takes the FMU's own solver"
                ) from error
            continue
        rows = np.union1d(np.arange(0, len(run), factor), [len(run) - 1])
        return replace(run, time=run.time[rows], values=run.values[rows])
    raise AssertionError  # the last trial returns or raises
