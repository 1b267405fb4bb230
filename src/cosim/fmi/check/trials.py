"""What an FMU must do when it runs: one small function per rule, each on instances of its own."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import islice
from time import monotonic

import numpy as np

from cosim.arrays import Vector
from cosim.fmi.check.bench import Bench, Session, Skipped
from cosim.fmi.check.finding import ADVICE, WRONG, Finding
from cosim.fmi.check.parsed import Described

MOST_STEPS = 6000  # of 1/60 s: 100 s
_MOST_SECONDS = 10.0  # wall time of the steps
_FEW = 20  # steps of reruns
_NAMES = 5  # in one finding
Trial = Callable[[Bench, str], Iterator[Finding]]


def start(bench: Bench, kind: str) -> Iterator[Finding]:
    """It instantiates, initializes, and its outputs are finite then."""
    with bench.session(kind) as session:
        session.start()
        outputs = bench.outputs()
        bad = ~np.isfinite(session.values(outputs))
        if bad.any():
            names = _listed([v.name for v, b in zip(outputs, bad, strict=True) if b])
            yield _wrong("start", kind, f"not finite at the start: {names}", "mend its equations")


def reset(bench: Bench, kind: str) -> Iterator[Finding]:
    """After a reset it gives the very same numbers."""
    with bench.session(kind) as session:
        first = _numbers(session)
        session.instance.reset()
        again = _numbers(session)
    if first.tobytes() != again.tobytes():
        where = _differing(bench, first, again)
        yield _wrong("reset", kind, f"a run after reset differs: {where}", "reset all its memory")


def instances(bench: Bench, kind: str) -> Iterator[Finding]:
    """A second instance, elsewhere in time, does not change the first one."""
    attributes = bench.described.interfaces[kind]
    if attributes.get("canBeInstantiatedOnlyOncePerProcess") == "true":
        raise Skipped("it can be instantiated once per process only")
    with bench.session(kind) as one:
        alone = _numbers(one)
    with bench.session(kind) as one, bench.session(kind) as other:
        other.start()
        beside = _numbers(one, other)
    if alone.tobytes() != beside.tobytes():
        where = _differing(bench, alone, beside)
        yield _wrong(
            *("instances", kind, f"a second instance changes the first: {where}"),
            "keep no state outside the instance",
        )


def derivatives(bench: Bench, kind: str) -> Iterator[Finding]:
    """Directional derivatives of the state derivatives agree with central differences."""
    _needs_slopes(bench, kind)
    pairs = bench.states()
    rates = [rate for _, rate in pairs]
    with bench.session(kind) as session:
        session.start()
        at = session.values([state for state, _ in pairs])
        for i, (state, _) in enumerate(pairs):
            session.put_states(at)
            told = session.slopes(rates, state)
            scale = max(abs(at[i]), _nominal(state))
            coarse, fine = (_central(session, rates, at, i, h * scale) for h in (1e-5, 1e-6))
            sizes = np.abs(session.values(rates))
            noise = 1e4 * np.finfo(float).eps * np.maximum(sizes, sizes.max()) / (1e-6 * scale)
            doubt = 20 * np.abs(coarse - fine) + noise
            bad = np.abs(told - coarse) > 1e-3 * np.maximum(np.abs(told), np.abs(coarse)) + doubt
            for k in np.flatnonzero(bad)[:_NAMES]:
                yield _wrong(
                    *("derivatives", rates[k].name),
                    f"its derivative to '{state.name}' is told as {told[k]:.6g}, "
                    f"differences give {coarse[k]:.6g}",
                    "mend the directional derivative",
                )


def dependencies(bench: Bench, kind: str) -> Iterator[Finding]:
    """What is not listed as a dependency has the derivative 0."""
    _needs_slopes(bench, kind)
    every = bench.described.variables
    sections = bench.described.sections
    listed = [u for u in (*sections["Outputs"], *sections["Derivatives"]) if u.needs is not None]
    listed = [u for u in listed if u.position >= 0 and bench.single(every[u.position])]
    if not listed:
        raise Skipped("it lists no dependencies")
    unknowns = [every[u.position] for u in listed]
    needed = [{every[i].reference for i in u.needs or ()} for u in listed]
    with bench.session(kind) as session:
        session.start()
        for known, surely in _knowns(bench):
            try:
                told = session.slopes(unknowns, known)
            except Exception:
                if surely:
                    raise
                continue
            scale = _nominal(known)
            for unknown, needs, slope in zip(unknowns, needed, told, strict=True):
                own = _nominal(unknown)
                if known.reference not in needs and abs(slope) * scale > 1e-9 * own:
                    yield _wrong(
                        *("dependencies", unknown.name),
                        f"it does not list '{known.name}', its derivative to which is {slope:.3g}",
                        "list it: importers take what is not listed for 0",
                    )


def fixed(bench: Bench, kind: str) -> Iterator[Finding]:
    """A fixed parameter is refused in continuous-time mode."""
    if kind != "ModelExchange":
        raise Skipped("it is a trial of model exchange")
    every = bench.described.variables
    found = (v for v in every if v.causality == "parameter" and v.variability == "fixed")
    parameters = [v for v in found if bench.single(v)]
    if not parameters:
        raise Skipped("it has no fixed real parameter")
    for parameter in parameters[:_NAMES]:  # a refusal may end the instance
        with bench.session(kind) as session:
            session.start()
            (value,) = session.values([parameter])
            with suppress(Exception):
                session.put(parameter, value)
                yield Finding(
                    *(ADVICE, "fixed", parameter.name, "a fixed parameter is accepted in a run"),
                    "refuse it with an error, or make it tunable",
                )


def steps(bench: Bench, kind: str) -> Iterator[Finding]:
    """Steps of 1/60 s, whose times are sums, go on to the default stop time."""
    if kind != "CoSimulation":
        raise Skipped("it is a trial of co-simulation")
    attributes = bench.described.interfaces[kind]
    if attributes.get("canHandleVariableCommunicationStepSize") != "true":
        raise Skipped("it may want steps of its own size")
    stop = bench.experiment("stopTime")
    end = monotonic() + _MOST_SECONDS
    with bench.session(kind) as session:
        session.start()
        time, outputs = session.start_time, bench.outputs()
        try:
            for time in session.steps(1 / 60, MOST_STEPS, np.inf if stop is None else stop):
                if not np.isfinite(session.values(outputs)).all():
                    yield _wrong("steps", kind, f"not finite at {time:.6g} s", "end with an error")
                    return
                if monotonic() > end:
                    return
        except Exception as error:
            told = f"a step of 1/60 s fails at {time:.6g} s: {error}"
            yield _wrong("steps", kind, told, "accept times with rounding errors")


TRIALS: tuple[Trial, ...] = (start, reset, instances, derivatives, dependencies, fixed, steps)


def _wrong(rule: str, place: str, found: str, cure: str) -> Finding:
    return Finding(WRONG, rule, place, found, cure)


def _nominal(variable: Described) -> float:
    return abs(float(variable.texts.get("nominal", "1"))) or 1.0


def _listed(names: list[str]) -> str:
    return ", ".join(names[:_NAMES]) + (", ..." if len(names) > _NAMES else "")


def _numbers(session: Session, other: Session | None = None) -> Vector:
    """Run a little and return all outputs; in model exchange, outputs and slopes at the start.

    The other instance is always ahead.
    """
    session.start()
    bench, outputs = session.bench, session.bench.outputs()
    rows = [session.values(outputs)]
    if session.kind == "CoSimulation":
        size = float(bench.described.interfaces[session.kind].get("fixedInternalStepSize", "0"))
        size = size or bench.experiment("stepSize") or 0.01
        ahead = iter(()) if other is None else other.steps(size, 2 * _FEW)
        for _ in session.steps(size, _FEW):
            for _ in islice(ahead, 2):
                pass
            rows.append(session.values(outputs))
    else:
        with suppress(Skipped):
            pairs = bench.states()
            if other is not None:
                at = other.values([state for state, _ in pairs])
                other.put_states(at + 1e-3 * np.maximum(np.abs(at), 1.0))
                other.values(outputs)
            rows.append(session.values([rate for _, rate in pairs]))
            rows.append(session.values(outputs))
    return np.concatenate(rows)


def _differing(bench: Bench, one: Vector, other: Vector) -> str:
    if len(one) != len(other):
        return "it ends at another time"
    at = int(np.flatnonzero((one != other) | np.signbit(one) ^ np.signbit(other))[0])
    outputs = bench.outputs()
    name = outputs[at % len(outputs)].name if outputs else "a derivative"
    return f"first in {name}, {one[at]:.17g} and {other[at]:.17g}"


def _needs_slopes(bench: Bench, kind: str) -> None:
    if kind != "ModelExchange":
        raise Skipped("it is a trial of model exchange")
    attributes = bench.described.interfaces[kind]
    offered = ("providesDirectionalDerivative", "providesDirectionalDerivatives")
    if not any(attributes.get(name) == "true" for name in offered):
        raise Skipped("it offers no directional derivatives")


def _knowns(bench: Bench) -> Iterator[tuple[Described, bool]]:
    """Yield what unknowns may depend on, and whether a derivative to it must be given."""
    with suppress(Skipped):
        yield from ((state, True) for state, _ in bench.states())
    third = bench.described.version == "3"
    for variable in bench.described.variables:
        if not bench.single(variable):
            continue
        if variable.causality == "input" and variable.variability == "continuous":
            yield variable, True
        elif third and (variable.causality, variable.variability) == ("parameter", "tunable"):
            yield variable, False


def _central(session: Session, rates: list[Described], at: Vector, i: int, h: float) -> Vector:
    sides = []
    for side in (h, -h):
        moved = at.copy()
        moved[i] += side
        session.put_states(moved)
        sides.append((session.values(rates), moved[i]))
    session.put_states(at)
    (above, high), (below, low) = sides
    return np.asarray((above - below) / (high - low))
