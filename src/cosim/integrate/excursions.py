"""`excursions`: where terms of several states are, within a part of a step, no lines in time.

Between rows, states are near lines; the bounds of a term over a part of a step follow from theirs.
Where they leave the line between its ends, the part is halved until they do not, or until a value
at a middle does.
"""

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae
from casadi_models.dae.single_terms import several_terms
from casadi_models.dae.time_bounds import bounds_within
from cosim.arrays import Integers, Truths, Vector
from cosim.codegen.changes import FLAT, apart
from cosim.codegen.landmarks import localized_inverses
from cosim.integrate.motion import Path
from cosim.memo import cached_per_thread

_PARTS = 4  # of an average step, at whose ends a term is seen by every step
_LEAST = 0.05  # distance from a line, as a share of the range of the term
_AT_ONCE, _MOST_ROUNDS = 512, 100  # parts that are halved together; halvings
_MOST_PARTS = 20_000
_SHORTEST = 2.0**-40  # of a part, in first ones


@dataclass(frozen=True, eq=False)
class SeveralTerms:
    """Terms that several quantities move.

    Attributes:
        values: For each term, `(moving, p) -> term`, where time, x, z and u move.
        bounds: For each term, `(low, high, p) -> bounds`, both ends.
        names: For each term, the quantities that move it.
        unbounded: The quantities of the terms without bounds, which are not searched.
    """

    values: tuple[ca.Function, ...]
    bounds: tuple[ca.Function, ...]
    names: tuple[str, ...]
    unbounded: tuple[str, ...]

    def along(self, term: int, p: Vector, path: Path) -> Vector:
        """Return a term on a path, (n,)."""
        return np.array(self.values[term](path.moved, p))[0, : len(path.time)]


@cached_per_thread(32)
def several_terms_of(dae: Dae) -> SeveralTerms | None:
    """Return the terms of several quantities; None if a model has none."""
    column = ca.vertcat(several_terms(dae)[0], localized_inverses(dae))
    if not column.numel():
        return None
    moving = ca.vertcat(dae.t, dae.x, dae.z, dae.u)
    ends = SX.sym("low", moving.numel()), SX.sym("high", moving.numel())
    values, known, names, unbounded = (list[Any]() for _ in range(4))
    own = {symbol.element_hash() for symbol in ca.vertsplit(moving)}
    for term in ca.vertsplit(column):
        symbols = [s for s in ca.symvar(term) if s.element_hash() in own]
        name = ", ".join(symbol.name() for symbol in symbols)
        bounds = bounds_within(term, moving, ends, dae.p)
        if bounds is None:
            unbounded.append(name)
        else:
            values.append(ca.Function("value", [moving, dae.p], [term], {"cse": True}))
            known.append(ca.Function("bounds", [*ends, dae.p], [*bounds], {"cse": True}))
            names.append(name)
    columns = (tuple(column) for column in (values, known, names, dict.fromkeys(unbounded)))
    return SeveralTerms(*columns)


def excursions(terms: SeveralTerms, path: Path, p: Vector, steps: int) -> list[tuple[int, Vector]]:
    """Return where terms are no lines within a part of an average step: a term, and edges, s.

    Args:
        terms: The terms.
        path: With at least two rows in an average step.
        p: Parameters.
        steps: Number of steps.
    """
    nodes = np.linspace(path.time[0], path.time[-1], _PARTS * steps + 1)
    bend = _bend(path, nodes)
    return [
        (term, edges)
        for term in range(len(terms.names))
        for edges in _of_term(terms, term, path, p, nodes, bend)
    ]


def _bend(path: Path, nodes: Vector) -> Vector:
    """Return how far what moves may be from lines between rows near nodes, (n, nodes)."""
    own = path.moved
    off = np.zeros_like(own)
    if own.shape[1] > 2:
        off[:, 1:-1] = np.abs(own[:, 2:] - 2 * own[:, 1:-1] + own[:, :-2]) / 4
        off[:, [0, -1]] = off[:, [1, -2]]
    rows = np.clip(path.time.searchsorted(nodes, "right") - 1, 0, own.shape[1] - 2)
    return np.maximum(off[:, rows], off[:, rows + 1])


@dataclass
class _Parts:
    """Parts of steps: begin and end, how far what moves is from lines, and the term's own line."""

    begins: Vector
    ends: Vector
    pads: Vector
    first: Vector
    last: Vector

    def at(self, which: Integers | Truths) -> "_Parts":
        columns = self.begins, self.ends, self.first, self.last
        begins, ends, first, last = (column[which] for column in columns)
        return _Parts(begins, ends, self.pads[:, which], first, last)

    def and_also(self, other: "_Parts") -> "_Parts":
        names = "begins", "ends", "pads", "first", "last"
        pairs = ((getattr(self, name), getattr(other, name)) for name in names)
        return _Parts(*(np.concatenate(pair, axis=-1) for pair in pairs))

    @property
    def middles(self) -> Vector:
        return np.asarray((self.begins + self.ends) / 2)

    def halves(self, values: Vector) -> "_Parts":
        """Return both halves of each, from the term at its middle; there, lines are closer."""
        closer, middles = replace(self, pads=self.pads / 4), self.middles
        first = replace(closer, ends=middles, last=values)
        return first.and_also(replace(closer, begins=middles, first=values))


def _of_term(
    terms: SeveralTerms,
    term: int,
    path: Path,
    p: Vector,
    nodes: Vector,
    bend: Vector,
) -> list[Vector]:
    """Return where a term leaves its line between two nodes: edges of parts, s."""
    seen = terms.along(term, p, path.at(nodes))

    def beyond(parts: _Parts) -> Vector:
        if not len(parts.begins):
            return np.empty(0)
        first, last = path.at(parts.begins).moved, path.at(parts.ends).moved
        span = np.minimum(first, last) - parts.pads, np.maximum(first, last) + parts.pads
        bounds = (np.array(end)[0, : len(parts.begins)] for end in terms.bounds[term](*span, p))
        least, most = bounds
        low, high = (ends(parts.first, parts.last) for ends in (np.minimum, np.maximum))
        off = np.maximum(most - low, high - least)
        return np.asarray(np.where(np.isnan(off), np.inf, off))

    pads = np.maximum(bend[:, :-1], bend[:, 1:])
    parts = _Parts(nodes[:-1], nodes[1:], pads, seen[:-1], seen[1:])
    size, shortest = float(np.ptp(seen)), (nodes[1] - nodes[0]) * _SHORTEST
    off, whole = beyond(parts), nodes[1] - nodes[0]
    for _ in range(_MOST_ROUNDS):
        wide = np.flatnonzero((off > _LEAST * size) & (parts.ends - parts.begins > shortest))
        if not len(wide) or len(off) > len(nodes) + _MOST_PARTS:
            break
        wide = wide[np.argsort(-off[wide], kind="stable")[:_AT_ONCE]]
        own, keep = parts.at(wide), np.delete(np.arange(len(off)), wide)
        value = terms.along(term, p, path.at(own.middles))
        size = max(size, float(np.ptp([*seen, *value])))
        halves = own.halves(value)
        off = np.append(off[keep], beyond(halves))
        parts = parts.at(keep).and_also(halves)
    changes = np.abs(parts.last - parts.first) > FLAT * size
    parts = parts.at(changes & (parts.ends - parts.begins < 0.75 * whole))
    spans = sorted(zip(parts.begins.tolist(), parts.ends.tolist(), strict=True))
    return apart(spans)
