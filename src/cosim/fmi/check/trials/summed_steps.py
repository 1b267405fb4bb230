"""Many communication steps of one size, whose ends are sums with rounding errors."""

import ctypes
from collections.abc import Iterator
from pathlib import Path
from time import monotonic
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from cosim.codegen.interruptible import interruptible
from cosim.fmi.check.trials.bench import Session
from cosim.fmi.run.compiled_run import Ending, Recorded, Run, functions_of, refuse_failed_call

_SHORT = 0.1  # s; of a call that makes many steps


class Progress(NamedTuple):
    """How far the steps have come: their number, the time, s; whether the outputs are numbers."""

    done: int = 0
    time: float = 0.0
    finite: bool = True


def summed_steps(
    session: Session, size: float, most: int, library: Path | None
) -> Iterator[Progress]:
    """Make steps and read the real outputs after each.

    Args:
        session: An initialized instance for co-simulation; keeps its time.
        size: Of the steps, s.
        most: Number of steps; there are fewer where the FMU wants to end.
        library: Of `co_simulation_library`; without it, a step takes a hundred times as long.

    Raises:
        Exception: What the FMU refuses.
    """
    if library is None:
        return _one_by_one(session, size, most)
    return _in_c(session, size, most, library)


def _one_by_one(session: Session, size: float, most: int) -> Iterator[Progress]:
    outputs = session.bench.outputs()
    for i, time in enumerate(session.steps(size, most)):
        yield Progress(i + 1, time, bool(np.isfinite(session.values(outputs)).all()))


def _in_c(session: Session, size: float, most: int, library: Path) -> Iterator[Progress]:
    loop = ctypes.CDLL(str(library))
    loop.run_steps.argtypes, loop.run_steps.restype = [ctypes.POINTER(Run)], None
    bench = session.bench
    outputs = [SimpleNamespace(type=v.kind, valueReference=int(v.reference))
               for v in bench.outputs()]  # fmt: skip
    recorded, row = Recorded(session.instance, bench.fmpy, outputs), np.empty(len(outputs))
    recorded.structure.rows = row.ctypes.data
    functions = functions_of(session.instance, bench.fmpy)
    done, points = 0, 1
    while done < most:
        run = Run(
            functions=ctypes.pointer(functions),
            recording=ctypes.pointer(recorded.structure),
            start=session.time,
            interval=size,
            points=min(points, most - done),
        )
        began = monotonic()
        with interruptible(loop) as interrupts:
            loop.run_steps(ctypes.byref(run))
        done, session.time = done + run.steps, run.time
        _refuse(run, interrupts)
        if run.steps:
            yield Progress(done, run.time, run.how != Ending.NOT_A_NUMBER)
        if run.how != Ending.DONE:
            return
        if monotonic() - began < _SHORT:
            points *= 2


def _refuse(run: Run, interrupts: list[int]) -> None:
    refuse_failed_call(run, interrupts)
    if run.how == Ending.STUCK:
        from fmpy.fmi1 import FMICallException

        raise FMICallException(function="fmi2DoStep", status=2)
