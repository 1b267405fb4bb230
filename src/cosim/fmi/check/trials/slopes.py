"""Directional derivatives that an FMU tells, against differences of its values."""

from collections.abc import Iterator, Sequence

import numpy as np

from cosim.arrays import Vector
from cosim.fmi.check.finding import WRONG, Finding, Rule
from cosim.fmi.check.parsed import Described
from cosim.fmi.check.trials.bench import MOST_NAMES, Bench, Session, Skipped
from cosim.fmi.check.trials.knowns import (
    Known,
    knowns_of,
    moved_unknowns,
    need_model_exchange,
    states_among,
    tells_slopes,
)

DERIVATIVES = Rule(
    "derivatives",
    WRONG,
    "fail to converge, or get wrong sensitivities and linear models",
    "mend the directional derivative",
)


def derivatives(bench: Bench, kind: str) -> Iterator[Finding]:
    """Directional derivatives of derivatives and outputs agree with central differences."""
    need_model_exchange(kind)
    if not tells_slopes(bench, kind):
        raise Skipped("it offers no directional derivatives")
    unknowns = [rate for _, rate in bench.states()]
    unknowns += [output for output in bench.outputs() if output.variability == "continuous"]
    knowns = [known for known in knowns_of(bench) if known.surely]
    with bench.session(kind) as session:
        session.start()
        at = session.values([known.variable for known in knowns])
        states = states_among(knowns, at)
        sizes = np.abs(session.values(unknowns))
        for known, value in zip(knowns, at, strict=True):
            told = session.slopes(unknowns, known.variable)
            scale = max(abs(value), known.variable.nominal)
            coarse, fine, bend = _differences(session, unknowns, known, states, value, scale)
            noise = 1e4 * np.finfo(float).eps * np.maximum(sizes, sizes.max()) / (1e-6 * scale)
            doubt = 20 * np.abs(coarse - fine) + bend + noise
            bad = np.abs(told - coarse) > 1e-3 * np.maximum(np.abs(told), np.abs(coarse)) + doubt
            bad &= np.array([unknown.reference != known.variable.reference for unknown in unknowns])
            for k in np.flatnonzero(bad)[:MOST_NAMES]:
                yield DERIVATIVES.at(
                    unknowns[k].name,
                    f"its derivative to '{known.variable.name}' is given as {told[k]:.6g}, "
                    f"differences give {coarse[k]:.6g}",
                )


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
