"""Time goes on: steps whose ends are sums with rounding errors, and the stop time."""

from collections.abc import Iterator
from time import monotonic

import numpy as np

from cosim.fmi.check.finding import ADVICE, WRONG, Finding, Rule
from cosim.fmi.check.trials.bench import Bench, Note, Session, Skipped
from cosim.fmi.check.trials.summed_steps import Progress, summed_steps

SUMS = Rule(
    "steps",
    WRONG,
    "stop there, those that sum up their steps",
    "accept times with rounding errors",
)
FAILING = Rule("steps", WRONG, "stop there, whatever steps they take", "mend it; see its log")
NOT_FINITE = Rule("steps", WRONG, "compute on with it", "end with an error")
REFUSED_END = Rule(
    "stop",
    ADVICE,
    "fail in their last step, those that sum up their steps",
    "allow for rounding errors of the stop time",
)
BEYOND = Rule(
    "stop",
    ADVICE,
    "do not learn that they went too far, for example beyond the data of a table",
    "end with an error beyond a stop time that was given, as the FMI has it",
)
MOST_MADE = 1_000_000
SIZE = 1 / 60  # s
_SHARE = 1 / 12  # of all time is for the steps
_FEW_STEPS = 10


def steps(bench: Bench, kind: str) -> Iterator[Finding | Note]:
    """A million steps of 1/60 s, as far as the time allows, their ends summed up."""
    _needs_free_steps(bench, kind)
    end, made = monotonic() + _SHARE * bench.timeout, Progress()
    stop = bench.experiment("stopTime")
    with bench.session(kind) as session:
        session.start()
        try:
            for made in summed_steps(session, SIZE, MOST_MADE, bench.loop):
                if not made.finite:
                    yield NOT_FINITE.at(kind, f"not finite at {made.time:.6g} s")
                    return
                if monotonic() > end:
                    break
        except Exception as error:
            if stop is None or session.time + SIZE <= stop:
                fatal = "(fatal)" in str(error)  # after which no instance may be made
                own = fatal or _own_steps_fail(bench, kind, session.time + SIZE)
                told = f"a step of 1/60 s fails at {session.time:.6g} s: {error}"
                yield (FAILING if own else SUMS).at(kind, told)
                return
            yield Note(f"{made.done} steps of 1/60 s, beyond its stop time; then: {error}")
            return
        yield Note(f"{made.done} steps of 1/60 s, to {session.time:.6g} s")


def stop(bench: Bench, kind: str) -> Iterator[Finding]:
    """A step that ends a rounding error beyond the stop time is made, a whole one is refused."""
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
            told = (
                f"the last step ends {ends - limit:.1g} s beyond the stop time and fails: {error}"
            )
            yield REFUSED_END.at(kind, told)
            return
        if done < _FEW_STEPS:
            raise Skipped("it ends by itself before")
        try:
            beyond = len(list(session.steps(size, 1)))
        except Exception:
            return
        if beyond:
            yield BEYOND.at(kind, f"a step of {size:g} s beyond the stop time is made")


def _own_steps_fail(bench: Bench, kind: str, until: float) -> bool:
    """Tell whether steps of the FMU's own size do not reach a time either."""
    size = bench.step_size(kind)
    with bench.session(kind) as session:
        session.start()
        try:
            for i in range(int((until - session.start_time) / size) + 1):
                _step_to(session, session.start_time + (i + 1) * size)
        except Exception:
            return True
    return False


def _step_to(session: Session, end: float) -> None:
    for _ in session.steps(end - session.time, 1):
        session.time = end


def _needs_free_steps(bench: Bench, kind: str) -> None:
    if kind != "CoSimulation":
        raise Skipped("it is a trial of co-simulation")
    if not bench.offers(kind, "canHandleVariableCommunicationStepSize"):
        raise Skipped("it may want steps of its own size")
