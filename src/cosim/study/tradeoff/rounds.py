"""Runs of every configuration in turn, within the time that a study may take."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from time import perf_counter

from cosim.scene.roads import Road
from cosim.study.tradeoff.configuration import Configuration
from cosim.study.tradeoff.record import LEFT_OUT, Event, Outcome, Record

SLOW = 5.0  # s; what takes longer is not run with tighter tolerances, smaller steps, interpreted
LONG = 0.5  # s; what takes longer is timed once
Tell = Callable[[str], None]


def measure(
    wanted: Sequence[Configuration],
    events: list[Event],
    run: Callable[[Configuration], Event],
    record: Record,
    repeats: int,
    deadline: float,
    tell: Tell,
) -> None:
    """Run what the events lack, one round after the other.

    Args:
        wanted: Every configuration, of each family the cheapest first.
        events: Runs that there are already; new ones are added.
        run: Runs a configuration.
        record: Where runs are kept; what was left out for lack of time is not.
        repeats: Rounds after the first one.
        deadline: Of `perf_counter`, s; after it no run begins.
        tell: Called after each run of the first round, and after each round.
    """
    counts = Counter(event.configuration for event in events)
    took: dict[Configuration, float] = {}
    for event in events:
        took.setdefault(event.configuration, event.run_time)
    failed = {e.configuration for e in events if not e.errors}
    for number in range(repeats + 1):
        began = perf_counter()
        for i, configuration in enumerate(wanted, start=1):
            if counts[configuration] > number or configuration in failed:
                continue
            if number and took[configuration] > LONG:
                continue
            if perf_counter() > deadline:
                if number:
                    tell(f"no time for more repeats: {number - 1} of {repeats} are complete")
                    return
                left = Outcome(LEFT_OUT, "no time was left; resume the study")
                events.append(Event(configuration, left))
                failed.add(configuration)
                continue
            reason = None if number else _too_slow(configuration, took)
            left = Outcome(LEFT_OUT, reason or "")
            event = Event(configuration, left) if reason else run(configuration)
            record.append(event)
            events.append(event)
            counts[configuration] += 1
            if number == 0:
                took[configuration] = event.run_time
                if not event.errors:
                    failed.add(configuration)
                tell(f"{i}/{len(wanted)} {_said(event)}")
        tell(f"round {number} of {repeats}: {perf_counter() - began:.0f} s")


def _too_slow(configuration: Configuration, took: Mapping[Configuration, float]) -> str | None:
    """Say which run, that cannot take longer than this one, was slow already."""
    for other, time in took.items():
        if time > SLOW and _no_slower(other, configuration):
            return f"{other.short} took {time:.1f} s, more than {SLOW:g} s"
    return None


def _no_slower(other: Configuration, configuration: Configuration) -> bool:
    """Tell whether a run is coarser, or the compiled twin of an interpreted one."""
    twins = (other.road, configuration.road) == (Road.NATIVE, Road.INTERPRETED)
    alike = replace(other, road=configuration.road) if twins else other
    return alike.family == configuration.family and (
        (other.tolerance or 0) >= (configuration.tolerance or 0)
        and (other.step or 0) >= (configuration.step or 0)
    )


def _said(event: Event) -> str:
    if not event.errors:
        return f"{event.configuration}: {event.outcome}"
    worst = max(event.errors, key=event.errors.__getitem__)
    calls = "" if event.rhs_calls is None else f", {event.rhs_calls} calls"
    told = f"error {event.errors[worst]:.1e} ({worst}){calls}, {1e3 * event.run_time:.2f} ms"
    return f"{event.configuration}: {told}"
