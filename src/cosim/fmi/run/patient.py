"""Runs of model exchange that take as many steps as they need.

fmpy's CVODE takes 500 steps at most from one output time to the next, which no argument of
`fmpy.simulate_fmu` sets.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

MOST_STEPS = 200_000  # between two output times: some seconds of a small FMU
LIMIT = "mxstep steps taken"  # CVODE's words
ADVICE = "try a looser relative tolerance, or co-simulation, which takes the FMU's own solver"


@contextmanager
def many_steps() -> Iterator[None]:
    """Let fmpy's solver take `MOST_STEPS` between two output times; results are the same bits."""
    try:
        from fmpy import sundials
    except (ImportError, OSError):  # fmpy brings none for this platform, and says so
        yield
        return
    usual = sundials.CVodeSolver

    def patient(*arguments: Any, **more: Any) -> Any:
        return usual(*arguments, **{"maxNumSteps": MOST_STEPS} | more)

    sundials.CVodeSolver = patient
    try:
        yield
    finally:
        sundials.CVodeSolver = usual
