"""Runs of model exchange that take as many steps as they need, and say so.

fmpy's CVODE takes 500 steps at most from one output time to the next, which no argument of
`fmpy.simulate_fmu` sets.
"""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from threading import Lock
from typing import Any

from cosim.errors import FmuError
from cosim.trajectory import Trajectory

USUAL = 500
PATIENT_STEPS = 20_000  # between two output times: a second of a small FMU
LIMIT = "mxstep steps taken"  # CVODE's words
ADVICE = (
    "try closer output times, a looser relative tolerance, or co-simulation, which takes the FMU's "
    "own solver"
)
_ALONE = Lock()
_WHERE = re.compile(r"At t = ([\d.eE+-]+)")


def patiently(simulate: Callable[[], Trajectory]) -> Trajectory:
    """Run an FMU; once more with as many steps as it takes where those of fmpy do not suffice.

    Where a solution jumps, the second run is right. Where it is singular, a solver may go on along
    another one: `stats["note"]` says where the many steps began.

    Raises:
        FmuError: See `simulate_fmu`.
    """
    try:
        return simulate()
    except FmuError as error:
        if LIMIT not in str(error):
            raise
        found = _WHERE.search(str(error))
    with _many_steps():
        run = simulate()
    where = f" at {float(found[1]):.6g} s" if found else ""
    note = (
        f"fmpy's solver took more than {USUAL} steps between two outputs{where}: a jump, or a "
        "singularity from which it may have gone on along another solution; compare with "
        "co-simulation"
    )
    return replace(run, stats={**run.stats, "note": note})


@contextmanager
def _many_steps() -> Iterator[None]:
    """Let fmpy's solver take `PATIENT_STEPS` between two output times."""
    from fmpy import sundials

    with _ALONE:  # or the last one to leave would put back what it found
        usual = sundials.CVodeSolver

        def patient(*arguments: Any, **more: Any) -> Any:
            return usual(*arguments, **{"maxNumSteps": PATIENT_STEPS} | more)

        sundials.CVodeSolver = patient
        try:
            yield
        finally:
            sundials.CVodeSolver = usual
