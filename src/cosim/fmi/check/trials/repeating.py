"""The same again: after a reset, beside another instance, from a stored state."""

from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from typing import Any

import numpy as np

from cosim.arrays import Vector
from cosim.fmi.check.finding import WRONG, Finding, Rule
from cosim.fmi.check.trials.bench import Bench, Session, Skipped

RESET = Rule(
    "reset",
    WRONG,
    "give other results in the second run of a sweep or an optimization",
    "reset all its memory",
)
INSTANCES = Rule(
    "instances",
    WRONG,
    "mix the results of instances of one FMU in a process",
    "keep no state outside the instance",
)
ROLLBACK = Rule(
    "rollback",
    WRONG,
    "repeat steps from a wrong state: iterating masters, and steps that are halved",
    "store all that a step changes, with what the solver remembers",
)
_FEW = 20  # steps


def reset(bench: Bench, kind: str) -> Iterator[Finding]:
    """After a reset it gives the very same numbers."""
    with bench.session(kind) as session:
        first = few_numbers(session)
        session.instance.reset()
        again = few_numbers(session)
    yield from _same(RESET, session, first, again, "a run after reset differs")


def instances(bench: Bench, kind: str) -> Iterator[Finding]:
    """A second instance, elsewhere in time, does not change the first one."""
    if bench.offers(kind, "canBeInstantiatedOnlyOncePerProcess"):
        raise Skipped("it can be instantiated once per process only")
    with bench.session(kind) as one:
        alone = few_numbers(one)
    with bench.session(kind) as one, bench.session(kind) as other:
        other.start()
        beside = few_numbers(one, other)
    yield from _same(INSTANCES, one, alone, beside, "a second instance changes the first")


def rollback(bench: Bench, kind: str) -> Iterator[Finding]:
    """From a stored state it goes on with the very same numbers; so it does from its bytes."""
    if not bench.offers(kind, "canGetAndSetFMUstate", "canGetAndSetFMUState"):
        raise Skipped("its state cannot be stored")
    with bench.session(kind) as session:
        few_numbers(session)
        instance, time = session.instance, session.time
        state = instance.getFMUState()
        first = few_numbers(session, started=True)

        def from_state(stored: Any) -> Vector:
            instance.setFMUState(stored)
            session.time = time
            return few_numbers(session, started=True)

        told = "a run from a stored state differs"
        yield from _same(ROLLBACK, session, first, from_state(state), told)
        if bench.offers(kind, "canSerializeFMUstate", "canSerializeFMUState"):
            instance.setFMUState(state)
            session.time = time
            copy = instance.deserializeFMUState(instance.serializeFMUState(state))
            few_numbers(session, started=True)
            told = "a run from a state made of its bytes differs"
            yield from _same(ROLLBACK, session, first, from_state(copy), told)
            instance.freeFMUState(copy)
        instance.freeFMUState(state)


def few_numbers(session: Session, other: Session | None = None, *, started: bool = False) -> Vector:
    """Run a little and return all outputs; in model exchange, outputs and slopes of two states.

    The other instance is always ahead.
    """
    if not started:
        session.start()
    bench, outputs = session.bench, session.bench.outputs()
    rows = [session.values(outputs)]
    if session.kind == "CoSimulation":
        size = bench.step_size(session.kind)
        ahead = iter(()) if other is None else other.steps(size, 2 * _FEW)
        for _ in session.steps(size, _FEW):
            for _ in islice(ahead, 2):
                pass
            rows.append(session.values(outputs))
    else:
        with suppress(Skipped):
            rows += _near_slopes(session, other)
    return np.concatenate(rows)


def _near_slopes(session: Session, other: Session | None) -> Iterator[Vector]:
    """Return what a state and another near it give; the latter stays."""
    outputs, pairs = session.bench.outputs(), session.bench.states()
    states, rates = [state for state, _ in pairs], [rate for _, rate in pairs]
    if other is not None:
        _move(other, other.values(states))
        other.values(outputs)
    yield session.values(rates)
    yield session.values(outputs)
    _move(session, session.values(states))
    yield session.values(rates)
    yield session.values(outputs)


def _move(session: Session, at: Vector) -> None:
    session.put_states(at + 1e-3 * np.maximum(np.abs(at), 1.0))


def _same(rule: Rule, session: Session, one: Vector, other: Vector, told: str) -> Iterator[Finding]:
    if one.tobytes() != other.tobytes():
        yield rule.at(session.kind, f"{told}: {_differing(session.bench, one, other)}")


def _differing(bench: Bench, one: Vector, other: Vector) -> str:
    if len(one) != len(other):
        return "it ends at another time"
    at = int(np.flatnonzero((one != other) | np.signbit(one) ^ np.signbit(other))[0])
    outputs = bench.outputs()
    name = outputs[at % len(outputs)].name if outputs else "a derivative"
    return f"first in {name}, {one[at]:.17g} and {other[at]:.17g}"
