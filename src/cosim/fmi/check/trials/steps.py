"""Trials of an FMU's steps: their end, and the sum of many."""

from collections.abc import Iterator
from time import monotonic

import numpy as np

from cosim.fmi.check.finding import TRIAL_RULES, Finding
from cosim.fmi.check.trials.bench import MEMORY_GROWTH, Bench, Note, Skipped, memory_in_use

MOST_MADE = 1_000_000
SIZE = 1 / 60  # s
_SHARE = 1 / 12  # of all time is for the steps
_FEW_STEPS = 10


def steps(bench: Bench, kind: str) -> Iterator[Finding | Note]:
    """A million steps of 1/60 s, as far as the time allows, their ends summed up."""
    _needs_free_steps(bench, kind)
    end, made, looked = monotonic() + _SHARE * bench.timeout, 0, 0
    stop, outputs, used = bench.experiment("stopTime"), bench.outputs(), [memory_in_use()]
    with bench.session(kind) as session:
        session.start()
        try:
            for made, time in enumerate(session.steps(SIZE, MOST_MADE), start=1):
                if not np.isfinite(session.values(outputs)).all():
                    yield TRIAL_RULES["not-finite"].at(kind, f"not finite at {time:.6g} s")
                    return
                if made >= 2 * looked:
                    used, looked = [used[-1], memory_in_use()], made
                if monotonic() > end:
                    break
        except Exception as error:
            if stop is None or session.time + SIZE <= stop:
                fatal = "(fatal)" in str(error)  # after which no instance may be made
                own = fatal or _own_steps_fail(bench, kind, session.time + SIZE)
                found = f"a step of 1/60 s fails at {session.time:.6g} s: {error}"
                yield (TRIAL_RULES["failing"] if own else TRIAL_RULES["sums"]).at(kind, found)
                return
            yield Note(f"{made} steps of 1/60 s, beyond its stop time; then: {error}")
            return
        if (growth := used[-1] - used[0]) > MEMORY_GROWTH:
            found = f"{growth / 1e6:.1f} MB are lost in the second half of {looked} steps"
            yield TRIAL_RULES["memory"].at(kind, found)
        yield Note(f"{made} steps of 1/60 s, to {session.time:.6g} s")


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
