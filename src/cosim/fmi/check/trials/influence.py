"""What has an influence on what: the dependencies that a file lists, against derivatives."""

from collections.abc import Iterator, Sequence
from contextlib import suppress

import numpy as np

from cosim.arrays import Vector
from cosim.fmi.check.finding import ADVICE, WRONG, Finding, Rule
from cosim.fmi.check.parsed import Described
from cosim.fmi.check.trials.bench import MOST_NAMES, Bench, Note, Session, Skipped
from cosim.fmi.check.trials.knowns import (
    Known,
    knowns_of,
    moved_unknowns,
    need_model_exchange,
    states_among,
    tells_slopes,
)

UNLISTED = Rule(
    "dependencies",
    WRONG,
    "take it for 0: wrong Jacobians in CasADi and in implicit solvers, loops not seen",
    "list it",
)
IDLE = Rule(
    "dependencies",
    ADVICE,
    "compute a fuller Jacobian than need be, and see loops that are none",
    "list what has an influence",
)
_POINTS = 5
_FEWEST = 3  # points that say something about what has no influence
_ROUNDING = {True: 1e-9, False: 1e-6}  # of derivatives that are told, and of differences


def dependencies(bench: Bench, kind: str) -> Iterator[Finding | Note]:
    """What is not listed has no influence at several points; what is listed, somewhere."""
    need_model_exchange(kind)
    every, sections = bench.described.variables, bench.described.sections
    listed = [u for u in (*sections["Outputs"], *sections["Derivatives"]) if u.needs is not None]
    listed = [u for u in listed if u.position >= 0 and bench.single(every[u.position])]
    knowns = list(knowns_of(bench))
    if not listed or not knowns:
        raise Skipped("it lists no dependencies, or has neither states nor inputs")
    unknowns = [every[u.position] for u in listed]
    needed = [{every[i].reference for i in u.needs or ()} for u in listed]
    largest, points = np.zeros((len(unknowns), len(knowns))), 0
    for matrix in _matrices(bench, kind, unknowns, knowns):
        largest = np.where(np.abs(matrix) > np.abs(largest), matrix, largest)
        points += 1
    rounding = _ROUNDING[tells_slopes(bench, kind)]
    idle: list[tuple[str, str]] = []
    for row, (unknown, needs) in enumerate(zip(unknowns, needed, strict=True)):
        for column, known in enumerate(knowns):
            slope, name = largest[row, column], known.variable.name
            if known.variable.reference == unknown.reference:
                continue  # a state as output: that it depends on itself goes without saying
            if known.variable.reference not in needs:
                if abs(slope) > rounding:
                    told = slope * unknown.nominal / known.variable.nominal
                    found = f"it does not list '{name}', its derivative to which is {told:.3g}"
                    yield UNLISTED.at(unknown.name, found)
            elif slope == 0 and known.surely and unknown.variability == "continuous":
                idle.append((unknown.name, name))
    if idle and points >= _FEWEST:
        pairs = ", ".join(f"'{one}' of '{other}'" for one, other in idle[:MOST_NAMES])
        found = f"{len(idle)} that are listed have no influence at {points} points: {pairs}"
        yield IDLE.at("ModelStructure", found + (", ..." if len(idle) > MOST_NAMES else ""))
    yield Note(f"{points} points")


def _matrices(
    bench: Bench, kind: str, unknowns: Sequence[Described], knowns: Sequence[Known]
) -> Iterator[Vector]:
    """Yield derivatives in nominal values at the start, then at points with other parameters."""
    own = np.array([unknown.nominal for unknown in unknowns])
    scale = np.array([known.variable.nominal for known in knowns])
    told = tells_slopes(bench, kind)
    rng = np.random.default_rng(0)
    with bench.session(kind) as session:
        session.start()
        at = session.values([known.variable for known in knowns])
        yield _matrix(session, unknowns, knowns, at, told=told) * scale / own[:, None]
    with suppress(Exception), bench.session(kind) as session:  # points that it may refuse
        _vary_parameters(session, rng)
        session.start()
        span = (bench.experiment("stopTime") or session.start_time + 1.0) - session.start_time
        start = session.values([known.variable for known in knowns])
        for i in range(1, _POINTS):
            size = 0.1 * np.maximum(np.abs(start), scale)
            at = start + size * rng.standard_normal(len(start))
            session.instance.setTime(session.start_time + 0.01 * i * span)
            yield _matrix(session, unknowns, knowns, at, told=told) * scale / own[:, None]


def _matrix(
    session: Session,
    unknowns: Sequence[Described],
    knowns: Sequence[Known],
    at: Vector,
    *,
    told: bool,
) -> Vector:
    """Return derivatives of unknowns to knowns at their values; 0 where they cannot be had."""
    states, columns = states_among(knowns, at), []
    for known, value in zip(knowns, at, strict=True):
        if known.state is None and known.surely:
            session.put(known.variable, value)
    if len(states):
        session.put_states(states)
    for known, value in zip(knowns, at, strict=True):
        if told:
            try:
                columns.append(session.slopes(unknowns, known.variable))
            except Exception:
                if known.surely:
                    raise
                columns.append(np.zeros(len(unknowns)))
        elif known.surely:
            scale = max(abs(value), known.variable.nominal)
            high, low = (
                moved_unknowns(session, unknowns, known, states, value + side * 1e-3 * scale)
                for side in (1, -1)
            )
            columns.append((high - low) / (2e-3 * scale))
            moved_unknowns(session, unknowns, known, states, value)
        else:
            columns.append(np.zeros(len(unknowns)))
    return np.array(columns).T


def _vary_parameters(session: Session, rng: np.random.Generator) -> None:
    """Change parameters a little within their bounds, so that no factor is 0 by chance."""
    for variable in session.bench.described.variables:
        if variable.causality == "parameter" and session.bench.single(variable):
            least = float(variable.texts.get("min", "-inf"))
            most = float(variable.texts.get("max", "inf"))
            value = float(variable.texts.get("start", "0"))
            moved = value + 0.02 * (1 + rng.random()) * (abs(value) or variable.nominal)
            with suppress(Exception):
                session.put(variable, min(max(moved, least), most))
