"""Trials of declared dependencies and directional derivatives against differences."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass

import numpy as np

from cosim.arrays import Vector
from cosim.fmi.check.finding import TRIAL_RULES, Finding
from cosim.fmi.check.parsed import Described
from cosim.fmi.check.trials.bench import MOST_NAMES, Bench, Note, Session, Skipped, altered
from cosim.fmi.run.instance import enter_continuous_time
from cosim.text import shortened


@dataclass(frozen=True)
class Known:
    """The variables on which unknowns may depend.

    Attributes:
        variable: As described.
        state: Its place among the states; None for inputs and parameters.
        required: Whether the FMU must provide derivatives with respect to it.
    """

    variable: Described
    state: int | None
    required: bool


def moved_unknowns(
    session: Session, unknowns: Sequence[Described], known: Known, states: Vector, value: float
) -> Vector:
    """Return the unknowns after one known is set to another value."""
    if not known.required:  # a parameter
        session.instance.enterEventMode()
        session.put(known.variable, value)
        enter_continuous_time(session.instance)
    elif known.state is None:
        session.put(known.variable, value)
    else:
        changed = states.copy()
        changed[known.state] = value
        session.put_states(changed)
    return session.values(unknowns)


def states_among(knowns: Sequence[Known], at: Vector) -> Vector:
    """Return the states among values of knowns, (n,)."""
    return np.array([v for k, v in zip(knowns, at, strict=True) if k.state is not None])


def knowns_of(bench: Bench) -> Iterator[Known]:
    """Yield states, then continuous inputs and, in FMI 3.0, tunable parameters."""
    with suppress(Skipped):
        for i, (state, _) in enumerate(bench.states()):
            yield Known(state, i, required=True)
    for variable in bench.reals("input", "continuous"):
        yield Known(variable, None, required=True)
    for variable in () if bench.second else bench.reals("parameter", "tunable"):
        yield Known(variable, None, required=False)


def need_model_exchange(kind: str) -> None:
    """Skip a trial of model exchange elsewhere."""
    Skipped.when(kind != "ModelExchange", "it is a trial of model exchange")


def offers_directional(bench: Bench, kind: str) -> bool:
    """Return whether an interface offers directional derivatives."""
    offered = ("providesDirectionalDerivative", "providesDirectionalDerivatives")
    return bench.offers(kind, *offered)


_POINTS = 5
_MORE_POINTS = 3  # for directional derivatives, beside the start
_FEWEST = 3  # points needed for a statement on missing influence
_LINEAR = ("constant", "fixed", "tunable")  # kinds with a factor that no state or input changes
_BENT = 1e-4  # change of a factor, of its size, that is no rounding
_DIRECTIONAL = 1e-3  # error of directional derivatives that counts, of their size
_CANCELLED = 1e-9  # rounding of what cancels, of the largest of all
_ROUNDING = {True: 1e-9, False: 1e-6}  # of directional derivatives, and of differences


def dependencies(bench: Bench, kind: str) -> Iterator[Finding | Note]:
    """Check that unlisted variables have no influence anywhere, and listed ones somewhere."""
    need_model_exchange(kind)
    every, sections = bench.described.variables, bench.described.sections
    listed = [u for u in (*sections["Outputs"], *sections["Derivatives"]) if u.needs is not None]
    listed = [u for u in listed if u.position >= 0 and bench.single(every[u.position])]
    knowns = list(knowns_of(bench))
    if not listed or not knowns:
        raise Skipped("it lists no dependencies, or has neither states nor inputs")
    unknowns = [every[u.position] for u in listed]
    needed = [{every[i].reference for i in u.needs or ()} for u in listed]
    matrices = list(_matrices(bench, kind, unknowns, knowns))
    largest, points = np.zeros((len(unknowns), len(knowns))), len(matrices)
    for matrix in matrices:
        largest = np.where(np.abs(matrix) > np.abs(largest), matrix, largest)
    exact = offers_directional(bench, kind)  # differences lose small influences in rounding
    rounding = _ROUNDING[exact]
    idle: list[str] = []
    for row, (unknown, needs) in enumerate(zip(unknowns, needed, strict=True)):
        for column, known in enumerate(knowns):
            slope, name = largest[row, column], known.variable.name
            if known.variable.reference == unknown.reference:
                continue  # a state as output: that it depends on itself goes without saying
            if known.variable.reference not in needs:
                if abs(slope) > rounding:
                    value = slope * unknown.nominal / known.variable.nominal
                    found = f"it does not list '{name}', its derivative to which is {value:.3g}"
                    yield TRIAL_RULES["unlisted"].at(unknown.name, found)
            elif exact and slope == 0 and known.required and unknown.variability == "continuous":
                idle.append(f"'{unknown.name}' of '{name}'")
    if idle and points >= _FEWEST:
        found = f"{len(idle)} that are listed have no influence at {points} points: "
        yield TRIAL_RULES["idle"].at("ModelStructure", found + shortened(idle, MOST_NAMES))
    kinds = [
        {every[i].reference: k for i, k in zip(u.needs or (), u.kinds, strict=False)}
        for u in listed
    ]
    yield from _bent(unknowns, knowns, kinds, matrices)
    yield Note(f"{points} points")


def _bent(
    unknowns: Sequence[Described],
    knowns: Sequence[Known],
    kinds: Sequence[Mapping[str, str]],
    matrices: Sequence[Vector],
) -> Iterator[Finding]:
    """Yield dependencies that are declared to be linear and are not.

    Args:
        unknowns, knowns: The rows and columns of the matrices.
        kinds: The declared kind by the value reference of the known, for each unknown.
        matrices: Derivatives at points; all but the first have the same parameters.
    """
    for row, (unknown, declared) in enumerate(zip(unknowns, kinds, strict=True)):
        for column, known in enumerate(knowns):
            kind = declared.get(known.variable.reference, "dependent")
            if kind not in _LINEAR:
                continue
            slopes = [m[row, column] for m in matrices[0 if kind == "constant" else 1 :]]
            if len(slopes) > 1 and np.ptp(slopes) > _BENT * np.abs(slopes).max():
                found = f"its dependency on '{known.variable.name}' is declared {kind}, but its "
                found += f"derivative goes from {min(slopes):.6g} to {max(slopes):.6g}"
                yield TRIAL_RULES["bent"].at(unknown.name, found)


def _matrices(
    bench: Bench, kind: str, unknowns: Sequence[Described], knowns: Sequence[Known]
) -> Iterator[Vector]:
    """Yield derivatives in nominal values at the start, then at points with other parameters."""
    own = np.array([unknown.nominal for unknown in unknowns])
    scale = np.array([known.variable.nominal for known in knowns])
    directional = offers_directional(bench, kind)
    rng = np.random.default_rng(0)
    with bench.started(kind) as session:
        at = session.values([known.variable for known in knowns])
        yield _matrix(session, unknowns, knowns, at, directional=directional) * scale / own[:, None]
    with suppress(Exception), bench.session(kind) as session:  # the FMU may reject a point
        for parameter in bench.reals("parameter"):  # a little, so that no factor is 0 by chance
            value = float(parameter.texts.get("start", "0"))
            with suppress(Exception):
                session.put(parameter, altered(parameter, value, 0.02 * (1 + rng.random())))
        session.start()
        start = session.values([known.variable for known in knowns])
        size = 0.1 * np.maximum(np.abs(start), scale)
        points = [
            (bench.start + 0.01 * i * bench.span, start + size * rng.standard_normal(len(start)))
            for i in range(1, _POINTS)
        ]
        for time, at in [*points, *_visited(bench, start)]:
            session.instance.setTime(time)
            slopes = _matrix(session, unknowns, knowns, at, directional=directional)
            yield slopes * scale / own[:, None]


def _matrix(
    session: Session,
    unknowns: Sequence[Described],
    knowns: Sequence[Known],
    at: Vector,
    *,
    directional: bool,
) -> Vector:
    """Return derivatives of unknowns to knowns at their values; 0 where they cannot be had."""
    states, columns = states_among(knowns, at), []
    _go_to(session, knowns, at)
    for known, value in zip(knowns, at, strict=True):
        column = np.zeros(len(unknowns))
        if directional:
            with nullcontext() if known.required else suppress(Exception):
                column = session.slopes(unknowns, known.variable)
        elif known.required:
            size = 1e-3 * max(abs(value), known.variable.nominal)
            high, low = (
                moved_unknowns(session, unknowns, known, states, value + step)
                for step in (size, -size)
            )
            column = (high - low) / (2 * size)
            moved_unknowns(session, unknowns, known, states, value)
        columns.append(column)
    return np.array(columns).T


def derivatives(bench: Bench, kind: str) -> Iterator[Finding]:
    """Directional derivatives of derivatives and outputs agree with central differences."""
    need_model_exchange(kind)
    Skipped.when(not offers_directional(bench, kind), "it offers no directional derivatives")
    unknowns = [rate for _, rate in bench.states()]
    unknowns += bench.reals("output", "continuous")
    knowns = [known for known in knowns_of(bench) if known.required]
    with bench.started(kind) as session:
        start = session.values([known.variable for known in knowns])
        findings = list(_compared(session, unknowns, knowns, start))
        rng = np.random.default_rng(0)
        scale = np.maximum(np.abs(start), [known.variable.nominal for known in knowns])
        near = (start + 0.1 * scale * rng.standard_normal(len(start)) for _ in range(_MORE_POINTS))
        points = [*((bench.start, at) for at in near), *_visited(bench, start)]
        with suppress(Exception):  # the FMU may reject a point
            for time, at in points if not findings else ():
                session.instance.setTime(time)
                _go_to(session, knowns, at)
                findings = findings or list(_compared(session, unknowns, knowns, at))
        yield from findings
    tunable = [known for known in knowns_of(bench) if not known.required]
    with suppress(Exception), bench.started(kind) as session:  # it need not provide these
        at = session.values([known.variable for known in tunable])
        findings = list(_compared(session, unknowns, tunable, at))
        yield from findings


def _visited(bench: Bench, start: Vector) -> Iterator[tuple[float, Vector]]:
    """Yield times, s, and values of knowns, states first, within the default experiment."""
    for time, states in bench.visited:
        yield time, np.concatenate([states, start[len(states) :]])


def _go_to(session: Session, knowns: Sequence[Known], at: Vector) -> None:
    """Set states and inputs."""
    for known, value in zip(knowns, at, strict=True):
        if known.state is None and known.required:
            session.put(known.variable, value)
    if len(states := states_among(knowns, at)):
        session.put_states(states)


def _compared(
    session: Session, unknowns: Sequence[Described], knowns: Sequence[Known], at: Vector
) -> Iterator[Finding]:
    """Compare directional derivatives with differences at values of the knowns."""
    states, bench = states_among(knowns, at), session.bench
    sizes = np.abs(session.values(unknowns))
    forward = list[Vector]()
    for known, value in zip(knowns, at, strict=True):
        reported = session.slopes(unknowns, known.variable)
        forward.append(reported)
        scale = max(abs(value), known.variable.nominal)
        coarse, fine, bend = _differences(session, unknowns, known, states, value, scale)
        noise = 1e4 * np.finfo(float).eps * np.maximum(sizes, sizes.max()) / (1e-6 * scale)
        doubt = 20 * np.abs(coarse - fine) + bend + noise
        size = np.maximum(np.abs(reported), np.abs(coarse))
        bad = np.abs(reported - coarse) > _DIRECTIONAL * size + doubt
        bad |= ~np.isfinite(reported) & (doubt < _DIRECTIONAL * np.abs(coarse))
        bad &= np.array([unknown.reference != known.variable.reference for unknown in unknowns])
        for k in np.flatnonzero(bad)[:MOST_NAMES]:
            yield TRIAL_RULES["derivatives"].at(
                unknowns[k].name,
                f"its derivative to '{known.variable.name}' is reported as {reported[k]:.6g}, "
                f"differences give {coarse[k]:.6g}",
            )
    if len(knowns) > 1:
        yield from _by_several(session, unknowns, knowns, np.array(forward))
    if not bench.second and bench.offers(session.kind, "providesAdjointDerivatives"):
        yield from _adjoint(session, unknowns, knowns, np.array(forward))


def _by_several(
    session: Session, unknowns: Sequence[Described], knowns: Sequence[Known], forward: Vector
) -> Iterator[Finding]:
    """Compare directional derivatives by all knowns with those by one, (knowns, unknowns)."""
    seed = np.random.default_rng(0).standard_normal(len(knowns))
    references = [int(v.reference) for v in unknowns], [int(k.variable.reference) for k in knowns]
    found = np.array(session.instance.getDirectionalDerivative(*references, seed))
    sizes, expected = np.abs(seed) @ np.abs(forward), seed @ forward
    known = np.isfinite(expected)
    noise = _DIRECTIONAL * sizes + _CANCELLED * sizes[known].max(initial=0)
    for k in np.flatnonzero(known & ~(np.abs(found - expected) <= noise))[:MOST_NAMES]:
        text = "its directional derivative by several variables is not the sum of those by one"
        yield TRIAL_RULES["derivatives"].at(unknowns[k].name, text)


def _adjoint(
    session: Session, unknowns: Sequence[Described], knowns: Sequence[Known], forward: Vector
) -> Iterator[Finding]:
    """Compare adjoint derivatives with directional ones, (knowns, unknowns)."""
    weights = np.random.default_rng(0).standard_normal(len(unknowns))
    references = [int(v.reference) for v in unknowns], [int(k.variable.reference) for k in knowns]
    found = session.instance.getAdjointDerivative(*references, weights, len(knowns))
    noise, expected = 1e-9 * (np.abs(forward) @ np.abs(weights)), forward @ weights
    wrong = np.isfinite(expected) & ~(np.abs(found - expected) <= noise)
    for k in np.flatnonzero(wrong)[:MOST_NAMES]:
        name = knowns[k].variable.name
        yield TRIAL_RULES["derivatives"].at(
            name, "the adjoint derivative to it is not the sum of the directional ones"
        )


_PART = 0.25  # of a communication step, for differences


def slopes(bench: Bench, kind: str) -> Iterator[Finding]:
    """Derivatives of outputs, which co-simulation offers, agree with differences of steps."""
    offered = bench.described.interfaces[kind].get("maxOutputDerivativeOrder", "0")
    outputs = bench.reals("output", "continuous")
    variable = bench.offers(kind, "canHandleVariableCommunicationStepSize")
    if offered == "0" or not outputs or not variable:
        raise Skipped("it offers no derivatives of outputs")
    size = _PART * bench.step_size(kind)
    with bench.started(kind) as session:
        list(session.steps(4 * size, 5))
        instance = session.instance
        get = instance.getOutputDerivatives
        places = [int(v.reference) for v in outputs]
        reported = np.array(get(places, [1] * len(places)))
        get(places, [int(offered)] * len(places))
        y = [session.values(outputs)]
        y += [session.values(outputs) for _ in session.steps(size, 4)]
    Skipped.when(len(y) < 5, "it ends by itself before")
    fine, coarse = ((4 * y[i] - 3 * y[0] - y[2 * i]) / (2 * i * size) for i in (1, 2))
    noise = bench.tolerance * np.maximum([v.nominal for v in outputs], np.abs(y[0])) / size
    doubt = 2 * np.abs(coarse - fine) + 0.01 * np.abs(fine) + noise
    for k in np.flatnonzero(~(np.abs(reported - fine) <= doubt))[:MOST_NAMES]:
        found = f"its derivative is reported as {reported[k]:.6g}, steps give {fine[k]:.6g}"
        yield TRIAL_RULES["slopes"].at(outputs[k].name, found)


def _differences(
    session: Session,
    unknowns: Sequence[Described],
    known: Known,
    states: Vector,
    value: float,
    scale: float,
) -> tuple[Vector, Vector, Vector]:
    """Return central differences with a coarse and a fine step, and how far the sides differ."""
    found = []
    middle = moved_unknowns(session, unknowns, known, states, value)
    for size in (1e-5 * scale, 1e-6 * scale):
        high = moved_unknowns(session, unknowns, known, states, value + size)
        low = moved_unknowns(session, unknowns, known, states, value - size)
        found.append((high - low) / ((value + size) - (value - size)))
        bend = np.abs(high - 2 * middle + low) / size
    moved_unknowns(session, unknowns, known, states, value)
    return found[0], found[1], bend
