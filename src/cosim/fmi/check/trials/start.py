"""Trials of an FMU's initialization, and of the repeatability of its runs."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from itertools import islice
from typing import Any

import numpy as np

from cosim.arrays import Vector
from cosim.fmi.check.finding import TRIAL_RULES, Finding, Rule
from cosim.fmi.check.parsed import Described
from cosim.fmi.check.trials.bench import MOST_NAMES, Bench, Session, Skipped, altered
from cosim.fmi.run.arrays import Access, with_elements
from cosim.fmi.run.typed_values import REALS
from cosim.text import shortened

_NOISE = 1e-9  # of an output in nominal values
_WHOLE = 1.0  # s; a multiple of most fixed steps inside
_ROUNDING = 1e-6  # of a time


def start(bench: Bench, kind: str) -> Iterator[Finding]:
    """It instantiates, initializes, and its outputs are finite then."""
    with bench.started(kind) as session:
        outputs = bench.numbers(*REALS)
        bad = ~np.isfinite(session.access(outputs).get())
        if bad.any():
            names = [v.name for v, b in zip(outputs, bad, strict=True) if b]
            yield TRIAL_RULES["no-start"].at(
                kind, f"not finite at the start: {shortened(names, MOST_NAMES)}"
            )


def initialization(bench: Bench, kind: str) -> Iterator[Finding]:
    """Its outputs can be read in initialization mode and keep their values when it ends."""
    outputs = bench.reals("output")
    Skipped.when(not outputs, "it has no real outputs")
    own = [*bench.reals("output"), *bench.reals("local")]
    held = [v for v in own if v.variability == "discrete" or v.initial == "exact"]
    held = held if bench.has_events else []
    with bench.session(kind) as session:
        session.enter()
        try:
            start_values = session.values(held)
            before = session.values(outputs)
        except Exception as error:
            yield TRIAL_RULES["read-early"].at(
                kind, f"its outputs cannot be read in initialization mode: {error}"
            )
            return
        session.instance.exitInitializationMode()
        after = session.values(outputs)
        if (start_values != session.values(held)).any():
            raise Skipped("an event at the start changes variables")
    for output, early, late in zip(outputs, before, after, strict=True):
        scale = max(abs(late), output.nominal)
        if not abs(early - late) <= _NOISE * scale and not (np.isnan(early) and np.isnan(late)):
            found = f"it is {early:.6g} in initialization mode, {late:.6g} right after it"
            yield TRIAL_RULES["other-early"].at(output.name, found)
    if kind == "CoSimulation" and "ModelExchange" in bench.described.interfaces:
        yield from _exchanged_start(bench, outputs, before)


def _exchanged_start(
    bench: Bench, outputs: Sequence[Described], found: Vector
) -> Iterator[Finding]:
    """Compare outputs in initialization mode of co-simulation with those of model exchange."""
    exact = found
    with bench.session("ModelExchange") as session, suppress(Exception):  # which fails by itself
        session.enter()
        exact = session.values(outputs)
    for output, own, other in zip(outputs, found, exact, strict=True):
        if abs(own - other) > 10 * bench.tolerance * max(abs(other), output.nominal):
            text = f"it starts with {own:.6g}, in model exchange with {other:.6g}"
            yield TRIAL_RULES["starts-otherwise"].at(output.name, text)


def time(bench: Bench, kind: str) -> Iterator[Finding]:
    """The independent variable is the time."""
    clocks = bench.reals("independent")
    Skipped.when(not clocks, "it has no variable for the time")
    with bench.started(kind, bench.start + bench.step_size(kind)) as session:
        if kind == "CoSimulation":
            variable = bench.offers(kind, "canHandleVariableCommunicationStepSize")
            if not list(session.steps(_WHOLE if variable else bench.step_size(kind), 1)):
                raise Skipped("it ends by itself before")
        else:
            session.time += bench.step_size(kind)
            session.instance.setTime(session.time)
        (value,) = session.values(clocks)
        if not abs(value - session.time) <= _ROUNDING * abs(session.time):
            found = f"it is {value:.6g} at {session.time:.6g} s"
            yield TRIAL_RULES["time"].at(clocks[0].name, found)


def fixed(bench: Bench, kind: str) -> Iterator[Finding]:
    """A fixed parameter is rejected during a run."""
    parameters = bench.reals("parameter", "fixed")
    Skipped.when(not parameters, "it has no fixed real parameter")
    for parameter in parameters[:MOST_NAMES]:  # a rejected call may end the instance
        with bench.started(kind) as session:
            (value,) = session.values([parameter])
            with suppress(Exception):
                session.put(parameter, value)
                yield TRIAL_RULES["fixed"].at(
                    parameter.name, "a fixed parameter is accepted in a run"
                )


def callbacks(bench: Bench, kind: str) -> Iterator[Finding]:
    """It runs the same without the callbacks that importers need not pass."""
    yield from _without(bench, kind, TRIAL_RULES["callbacks"], logger=bench.second)


def logger(bench: Bench, kind: str) -> Iterator[Finding]:
    """It runs the same without a logger."""
    Skipped.when(not bench.second, "it is among the callbacks of FMI 3.0 that may be missing")
    yield from _without(bench, kind, TRIAL_RULES["logger"], logger=False)


def _without(bench: Bench, kind: str, rule: Rule, *, logger: bool) -> Iterator[Finding]:
    missing = "a missing logger" if rule.name == "logger" else "missing callbacks"
    with bench.session(kind) as session:
        expected = few_numbers(session)
    with bench.session(kind) as session:
        try:
            session.instantiate_bare(logger=logger)
            got = few_numbers(session)
        except Exception as error:
            yield rule.at(kind, f"with {missing} it fails: {error}")
            return
    if got.tobytes() != expected.tobytes():
        yield rule.at(kind, f"with {missing} it gives other numbers")


_FEW = 20  # steps


def reset(bench: Bench, kind: str) -> Iterator[Finding]:
    """After a reset it gives the very same numbers."""
    with bench.session(kind) as session:
        first = few_numbers(session)
        _disturb(session)
        session.instance.reset()
        again = few_numbers(session)
        yield from _same(TRIAL_RULES["reset"], session, first, again, "a run after reset differs")
        expected: Vector | None = None
        with suppress(Exception), bench.session(kind) as fresh:  # it may reject values
            _put_other_settings(fresh)
            expected = few_numbers(fresh)
        session.instance.reset()
        if expected is not None:
            _put_other_settings(session)
            found = few_numbers(session)
            text = "a run with other values after reset differs from that of a new instance"
            yield from _same(TRIAL_RULES["reset"], session, expected, found, text)


def instances(bench: Bench, kind: str) -> Iterator[Finding]:
    """A second instance, with other values and elsewhere in time, does not change the first one."""
    if bench.offers(kind, "canBeInstantiatedOnlyOncePerProcess"):
        raise Skipped("it can be instantiated once per process only")
    with bench.session(kind) as one:
        alone = few_numbers(one)
    with bench.session(kind) as one, bench.session(kind) as other:
        try:
            _put_other_settings(other)
            other.start()
        except Exception:  # it rejects them; then no call but a reset is allowed
            other.instance.reset()
            other.start()
        together = few_numbers(one, other)
    yield from _same(
        TRIAL_RULES["instances"], one, alone, together, "a second instance changes the first"
    )


def rollback(bench: Bench, kind: str) -> Iterator[Finding]:
    """From a stored state it goes on with the very same numbers; so it does from its bytes."""
    if not bench.offers(kind, "canGetAndSetFMUstate", "canGetAndSetFMUState"):
        raise Skipped("its state cannot be stored")
    with bench.session(kind) as session:
        few_numbers(session)
        instance, time = session.instance, session.time
        state = instance.getFMUState()
        first = few_numbers(session, started=True)
        later = instance.getFMUState()  # which is not the same

        def from_state(stored: Any) -> Vector:
            _disturb(session)
            instance.setFMUState(stored)
            session.time = time
            return few_numbers(session, started=True)

        found = "a run from a stored state differs"
        yield from _same(TRIAL_RULES["rollback"], session, first, from_state(state), found)
        if bench.offers(kind, "canSerializeFMUstate", "canSerializeFMUState"):
            instance.setFMUState(state)
            session.time = time
            copy = instance.deserializeFMUState(instance.serializeFMUState(state))
            few_numbers(session, started=True)
            found = "a run from a state made of its bytes differs"
            yield from _same(TRIAL_RULES["rollback"], session, first, from_state(copy), found)
            instance.freeFMUState(copy)
        instance.freeFMUState(later)
        instance.freeFMUState(state)


def _disturb(session: Session) -> None:
    """Change the inputs of an instance that goes back to another state."""
    with suppress(Exception):  # it may reject values
        for known, _, access in _settable(session, ("input",)):
            access.set([altered(known, value, 0.1) for value in access.get()])


def _put_other_settings(session: Session) -> None:
    """Give parameters and inputs other values than those of the file, before the start."""
    for known, group, access in _settable(session, ("parameter", "input")):
        if all(one.start for one in group):  # else only the FMU knows them
            access.set([altered(known, float(one.start), 0.02) for one in group])


def _settable(
    session: Session, causalities: Sequence[str]
) -> Iterator[tuple[Described, list[Any], Access]]:
    """Yield real parameters and continuous inputs, each with its elements and access to them."""
    bench, groups = session.bench, dict[tuple[str, str], list[Any]]()
    for one in with_elements(bench.fmpy).modelVariables:
        if not one.dimensions:
            groups.setdefault((one.type, str(one.valueReference)), []).append(one)
    for known in bench.described.variables:
        is_real = known.kind in ("Real", "Float64") and known.causality in causalities
        if is_real and (known.causality == "parameter" or known.variability == "continuous"):
            group = groups.get((known.kind, known.reference), [])
            yield known, group, session.access(group)


def few_numbers(session: Session, other: Session | None = None, *, started: bool = False) -> Vector:
    """Run a little and return outputs and time; in model exchange also slopes of two states.

    The other instance is always ahead.
    """
    if not started:
        session.start()
    bench = session.bench
    if not (shown := bench.numbers()):
        raise Skipped("it has no outputs that are numbers")
    recorded = session.access(shown).get
    rows = [recorded()]
    if session.kind == "CoSimulation":
        size = bench.step_size(session.kind)
        ahead = iter(()) if other is None else other.steps(size, 2 * _FEW)
        for _ in session.steps(size, _FEW):
            for _ in islice(ahead, 2):
                pass
            rows.append(recorded())
    else:
        with suppress(Skipped):
            rows += _near_slopes(session, other, recorded)
    return np.concatenate(rows).astype(float)


def _near_slopes(
    session: Session, other: Session | None, recorded: Callable[[], list[Any]]
) -> Iterator[Any]:
    """Yield derivatives and outputs at a state and at a state near it, where the session stays."""
    pairs = session.bench.states()
    states, rates = [state for state, _ in pairs], [rate for _, rate in pairs]
    if other is not None:
        other.put_states(moved(other.values(states)))
        other.access(other.bench.numbers()).get()
    yield session.values(rates)
    yield recorded()
    session.put_states(moved(session.values(states)))
    yield session.values(rates)
    yield recorded()


def moved(at: Vector) -> Vector:
    """Return states near others, (n,)."""
    return np.asarray(at + 1e-3 * np.maximum(np.abs(at), 1.0))


def _same(
    rule: Rule, session: Session, one: Vector, other: Vector, found: str
) -> Iterator[Finding]:
    if not np.array_equal(one, other, equal_nan=True):
        yield rule.at(session.kind, f"{found}: {_differing(session.bench, one, other)}")


def _differing(bench: Bench, one: Vector, other: Vector) -> str:
    if len(one) != len(other):
        return "it ends at another time"
    at = int(np.flatnonzero((one != other) & ~(np.isnan(one) & np.isnan(other)))[0])
    outputs = bench.numbers()
    name = outputs[at % len(outputs)].name
    return f"first in {name}, {one[at]:.17g} and {other[at]:.17g}"
