"""`excursions`: where terms of several states are, within a part of a step, no lines in time.

Between rows, states are near lines; the bounds of a term over a part of a step follow from theirs.
Where they leave the line between its ends, the part is halved until they do not, or until a value
at a middle does.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae
from casadi_models.dae.expressions import symbols
from casadi_models.dae.relations import modes_of
from casadi_models.dae.single_terms import several_terms
from casadi_models.dae.time_bounds import bounds_within
from cosim.arrays import Integers, Vector
from cosim.codegen.changes import bent_parts
from cosim.codegen.landmarks import localized_inverses
from cosim.integrate.motion import Path
from cosim.memo import cached_per_thread

_PARTS = 4  # of an average step, at whose ends a term is seen by every step
_ROUNDING = 1e-14  # relative distance of times that are one


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
    own = symbols(moving).keys() - symbols(modes_of(dae)).keys()
    for term in ca.vertsplit(column):
        movers = [s for s in ca.symvar(term) if s.element_hash() in own]
        name = ", ".join(symbol.name() for symbol in movers)
        bounds = bounds_within(term, moving, ends)
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
    pads = _off_lines(path, nodes)
    jumps = path.time[1:][np.diff(path.time) == 0]  # a mode that jumps there passes over nothing
    return [
        (term, edges)
        for term in range(len(terms.names))
        for edges in _of_term(terms, term, path, p, nodes, pads)
        if len(edges) > 1 or not np.isclose(edges, jumps, rtol=_ROUNDING, atol=0).any()
    ]


def _off_lines(path: Path, nodes: Vector) -> Vector:
    """Return how far what moves may be from lines between nodes, (moving, n): as next to them."""
    ends, middles = path.at(nodes).moved, path.at((nodes[:-1] + nodes[1:]) / 2).moved
    off = np.abs(ends[:, :-1] - 2 * middles + ends[:, 1:])
    around = np.pad(off, ((0, 0), (1, 1)))
    return np.asarray(np.maximum(off, np.maximum(around[:, :-2], around[:, 2:])))


def _largest(rows: Vector, begins: Integers, ends: Integers) -> Vector:
    """Return the largest values of rows, (k, n), from begins to before ends, (k, m)."""
    edges = np.column_stack((begins, ends)).ravel()
    padded = np.pad(rows, ((0, 0), (0, 1)))  # an end may be n
    return np.asarray(np.maximum.reduceat(padded, edges, axis=1)[:, ::2])


def _of_term(
    terms: SeveralTerms, term: int, path: Path, p: Vector, nodes: Vector, pads: Vector
) -> list[Vector]:
    """Return where a term leaves its line between two nodes: edges of parts, s.

    Args:
        terms, path, p: See `excursions`.
        term: The position of the term.
        nodes: Times, s, (n + 1,).
        pads: How far what moves may be from lines between nodes, (moving, n).
    """

    def values(times: Vector) -> Vector:
        return terms.along(term, p, path.at(times))

    def off(begins: Vector, lengths: Vector) -> Vector:
        cells = np.clip(nodes.searchsorted(begins, "right") - 1, 0, len(nodes) - 2)
        beyond = np.clip(nodes.searchsorted(begins + lengths), cells + 1, len(nodes) - 1)
        pad = _largest(pads, cells, beyond) * (lengths / np.diff(nodes)[cells]) ** 2
        first, last = path.at(begins).moved, path.at(begins + lengths).moved
        span = np.minimum(first, last) - pad, np.maximum(first, last) + pad
        least, most = (np.array(end)[0, : len(begins)] for end in terms.bounds[term](*span, p))
        high = np.maximum(values(begins), values(begins + lengths))
        return np.asarray(np.maximum(most - high, high - least))

    return bent_parts(values, off, nodes, np.empty(0))
