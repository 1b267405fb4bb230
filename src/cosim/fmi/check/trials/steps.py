"""Trials of an FMU's steps: their end, and the sum of many."""

import ctypes
from collections.abc import Iterator
from pathlib import Path
from time import monotonic
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from cosim.fmi.check.finding import TRIAL_RULES, Finding
from cosim.fmi.check.trials.bench import MEMORY_GROWTH, Bench, Note, Session, Skipped, memory_in_use
from cosim.fmi.run.c_structures import Ending, Recorded, Run, functions_of, reject_failed_call
from cosim.host.signals import interruptible

MOST_MADE = 1_000_000
SIZE = 1 / 60  # s
_SHARE = 1 / 12  # of all time is for the steps
_FEW_STEPS = 10


def steps(bench: Bench, kind: str) -> Iterator[Finding | Note]:
    """A million steps of 1/60 s, as far as the time allows, their ends summed up."""
    _needs_free_steps(bench, kind)
    end, made = monotonic() + _SHARE * bench.timeout, Progress()
    stop, used, looked = bench.experiment("stopTime"), [memory_in_use()], 0
    with bench.session(kind) as session:
        session.start()
        try:
            for made in summed_steps(session, SIZE, MOST_MADE, bench.loop):
                if not made.finite:
                    yield TRIAL_RULES["not-finite"].at(kind, f"not finite at {made.time:.6g} s")
                    return
                if made.done >= 2 * looked:
                    used, looked = [used[-1], memory_in_use()], made.done
                if monotonic() > end:
                    break
        except Exception as error:
            if stop is None or session.time + SIZE <= stop:
                fatal = "(fatal)" in str(error)  # after which no instance may be made
                own = fatal or _own_steps_fail(bench, kind, session.time + SIZE)
                found = f"a step of 1/60 s fails at {session.time:.6g} s: {error}"
                yield (TRIAL_RULES["failing"] if own else TRIAL_RULES["sums"]).at(kind, found)
                return
            yield Note(f"{made.done} steps of 1/60 s, beyond its stop time; then: {error}")
            return
        if (growth := used[-1] - used[0]) > MEMORY_GROWTH:
            found = f"{growth / 1e6:.1f} MB are lost in the second half of {looked} steps"
            yield TRIAL_RULES["memory"].at(kind, found)
        yield Note(f"{made.done} steps of 1/60 s, to {session.time:.6g} s")


def stop(bench: Bench, kind: str) -> Iterator[Finding]:
    """A step ends a rounding error beyond the stop time; a whole step beyond it is rejected."""
    _needs_free_steps(bench, kind)
    size = bench.step_size(kind)
    with bench.session(kind) as session:
        ends = session.start_time
        for _ in range(_FEW_STEPS):
            ends += size
        limit = np.nextafter(ends, -np.inf)  # which the last step exceeds by a rounding error
        session.start(stop_time=float(limit))
        try:
            done = len(list(session.steps(size, _FEW_STEPS)))
        except Exception as error:
            early = session.time < ends - 1.5 * size or "(fatal)" in str(error)
            if early or _own_steps_fail(bench, kind, float(ends)):
                raise
            found = (
                f"the last step ends {ends - limit:.1g} s beyond the stop time and fails: {error}"
            )
            yield TRIAL_RULES["rejected-end"].at(kind, found)
            return
        if done < _FEW_STEPS:
            raise Skipped("it ends by itself before")
        try:
            beyond = len(list(session.steps(size, 1)))
        except Exception:
            return
        if beyond:
            yield TRIAL_RULES["beyond"].at(
                kind, f"a step of {size:g} s beyond the stop time is made"
            )


def _own_steps_fail(bench: Bench, kind: str, until: float) -> bool:
    """Return whether steps of the FMU's own size fail to reach a time as well."""
    size = bench.step_size(kind)
    with bench.session(kind) as session:
        session.start()
        try:
            for i in range(int((until - session.start_time) / size) + 1):
                end = session.start_time + (i + 1) * size
                for _ in session.steps(end - session.time, 1):
                    session.time = end
        except Exception:
            return True
    return False


def _needs_free_steps(bench: Bench, kind: str) -> None:
    if kind != "CoSimulation":
        raise Skipped("it is a trial of co-simulation")
    if not bench.offers(kind, "canHandleVariableCommunicationStepSize"):
        raise Skipped("it may require steps of its own size")


_SHORT = 0.1  # s; of a call that makes many steps


class Progress(NamedTuple):
    """Progress of the steps: their number, the time, s; whether the outputs are finite."""

    done: int = 0
    time: float = 0.0
    finite: bool = True


def summed_steps(
    session: Session, size: float, most: int, library: Path | None
) -> Iterator[Progress]:
    """Make steps and read the real outputs after each.

    Args:
        session: An initialized instance for co-simulation; its time is updated.
        library: Of `co_simulation_library`; without it, a step costs a hundred times as much.

    Raises:
        Exception: The FMU rejected a call.
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
        _reject_failed(run, interrupts)
        if run.steps:
            yield Progress(done, run.time, run.how != Ending.NOT_A_NUMBER)
        if run.how != Ending.DONE:
            return
        if monotonic() - began < _SHORT:
            points *= 2


def _reject_failed(run: Run, interrupts: list[int]) -> None:
    """Raise the error of a failed call, or of a step that the FMU did not make."""
    reject_failed_call(run, interrupts)
    if run.how == Ending.STUCK:
        from fmpy.fmi1 import FMICallException

        raise FMICallException(function="fmi2DoStep", status=2)
