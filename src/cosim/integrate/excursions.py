"""`excursions`: where terms of several states are, within a part of a step, no lines in time.

Between rows, states are near lines; the bounds of a term over a part of a step follow from theirs.
Where they leave the line between its ends, the part is halved until they do not, or until a value
at a middle does.
"""

from dataclasses import dataclass
from functools import partial

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae
from casadi_models.dae.single_terms import several_terms
from casadi_models.dae.time_bounds import bounds_within
from cosim.arrays import Vector
from cosim.codegen.changes import bent_parts
from cosim.integrate.motion import Motion
from cosim.memo import cached_per_thread

_PARTS = 4  # of an average step, at whose ends a term is seen by every step


@dataclass(frozen=True, eq=False)
class SeveralTerms:
    """Terms that several quantities move.

    Attributes:
        values: `(moving, p) -> terms`, (n,), where time, x, z and u move.
        bounds: `(low, high, p) -> bounds of the terms`, both ends, (n,) each.
        names: For each term, the quantities that move it.
        unbounded: The quantities of the terms without bounds, which are not searched.
    """

    values: ca.Function
    bounds: ca.Function
    names: tuple[str, ...]
    unbounded: tuple[str, ...]

    def along(self, term: int, p: Vector, motion: Motion, times: Vector) -> Vector:
        """Return a term at times of a motion, (n,)."""
        return np.array(self.values(_moved(motion, times), p))[term, : len(times)]


@cached_per_thread(32)
def several_terms_of(dae: Dae) -> SeveralTerms | None:
    """Return the terms of several quantities; None if a model has none."""
    column = several_terms(dae)
    if not column.numel():
        return None
    moving = ca.vertcat(dae.t, dae.x, dae.z, dae.u)
    ends = SX.sym("low", moving.numel()), SX.sym("high", moving.numel())
    known, rows, names, unbounded = list[SX](), list[tuple[SX, SX]](), list[str](), list[str]()
    own = {symbol.element_hash() for symbol in ca.vertsplit(moving)}
    for term in ca.vertsplit(column):
        symbols = [s for s in ca.symvar(term) if s.element_hash() in own]
        name = ", ".join(symbol.name() for symbol in symbols)
        bounds = bounds_within(term, moving, ends, dae.p)
        if bounds is None:
            unbounded.append(name)
        else:
            known.append(term)
            rows.append(bounds)
            names.append(name)
    columns = [ca.densify(ca.vertcat(SX(0, 1), *column)) for column in zip(*rows, strict=True)]
    values = ca.densify(ca.vertcat(SX(0, 1), *known))
    return SeveralTerms(
        ca.Function("values", [moving, dae.p], [values], {"cse": True}),
        ca.Function("bounds", [*ends, dae.p], columns or [SX(0, 1)] * 2, {"cse": True}),
        tuple(names),
        tuple(dict.fromkeys(unbounded)),
    )


def _moved(motion: Motion, times: Vector) -> Vector:
    """Return time, states, unknowns and inputs on lines between rows, (n, times)."""
    return np.vstack((times, *(np.interp(times, motion.time, row) for row in motion.moving)))


def excursions(
    terms: SeveralTerms, motion: Motion, p: Vector, steps: int
) -> list[tuple[int, float, float]]:
    """Return where terms are no lines within a part of an average step: a term, begin and end, s.

    Args:
        terms: The terms.
        motion: With at least two rows in an average step.
        p: Parameters.
        steps: Number of steps.
    """
    nodes = np.linspace(motion.time[0], motion.time[-1], _PARTS * steps + 1)
    bend = _bend(motion, nodes)
    pads = np.maximum(bend[:, :-1], bend[:, 1:])
    return [
        (term, *part)
        for term in range(len(terms.names))
        for part in _of_term(terms, term, motion, p, nodes, pads)
    ]


def _bend(motion: Motion, nodes: Vector) -> Vector:
    """Return how far what moves may be from lines between rows near nodes, (n, nodes)."""
    own = _moved(motion, motion.time)
    off = np.zeros_like(own)
    if own.shape[1] > 2:
        off[:, 1:-1] = np.abs(own[:, 2:] - 2 * own[:, 1:-1] + own[:, :-2]) / 4
        off[:, [0, -1]] = off[:, [1, -2]]
    return np.vstack([np.interp(nodes, motion.time, row) for row in off])


def _of_term(
    terms: SeveralTerms, term: int, motion: Motion, p: Vector, nodes: Vector, pads: Vector
) -> list[tuple[float, float]]:
    """Return where a term leaves its line between two nodes: begins and ends, s.

    Args:
        terms, motion, p: See `excursions`.
        term: The position of the term.
        nodes: Times, s, (n + 1,).
        pads: How far what moves may be from lines between nodes, (moving, n).
    """
    values = partial(terms.along, term, p, motion)

    def off(begins: Vector, lengths: Vector) -> Vector:
        cells = np.searchsorted(nodes, begins + lengths / 2) - 1
        pad = pads[:, cells] * (lengths / np.diff(nodes)[cells]) ** 2  # in parts, lines are closer
        first, last = _moved(motion, begins), _moved(motion, begins + lengths)
        span = np.minimum(first, last) - pad, np.maximum(first, last) + pad
        least, most = (np.array(end)[term, : len(begins)] for end in terms.bounds(*span, p))
        high = np.maximum(values(begins), values(begins + lengths))
        return np.asarray(np.maximum(most - high, high - least))

    return bent_parts(values, off, nodes, np.empty(0))
