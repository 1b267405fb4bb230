"""`terms_of`, `pulse_times`: terms of time or one state, and where those of time change."""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae
from casadi_models.dae.inner_terms import InnerTerm, inner_terms, is_table
from casadi_models.dae.single_terms import single_terms
from casadi_models.dae.time_bounds import bounds_along
from cosim.arrays import Vector
from cosim.codegen.changes import (
    GREATEST_SIZE,
    Bounds,
    Values,
    bent_parts,
    in_decades,
    parted,
    with_surroundings,
)
from cosim.memo import cached_per_thread

_IN_STEP, _MOST_CELLS = 4, 4_000  # parts of a step, within which a term is a line; of a run
_NAMES = ["s", "p"], ["term"]
_CSE = {"cse": True}
_STEPS = 50  # at least, in a run
_INNER = 16  # samples of a part of a change


@dataclass(frozen=True, eq=False)
class Terms:
    """Terms of time or one state, which moves.

    Attributes:
        moving: The position of the state; that of time is after all states.
        values: For each term, `(moving, p) -> term`.
        bends: For each term, `(moving, length, p) -> bounds of how far from a line`, two; None
            where these are not known.
        tables: The terms that call tables.
        alone: For each term, whether it is nothing but a table along a line.
    """

    moving: int
    values: tuple[ca.Function, ...]
    bends: tuple[ca.Function | None, ...]
    tables: tuple[InnerTerm, ...]
    alone: tuple[bool, ...]

    def value(self, term: int, p: Vector) -> Values:
        """Return a term as a function of what moves."""
        return lambda at: np.asarray(np.array(self.values[term](at[None], p))[0, : len(at)])

    def off(self, term: int, p: Vector) -> Bounds | None:
        """Return bounds of its distance from a line, from begins and lengths; None if unknown."""
        bends = self.bends[term]
        if bends is None:
            return None

        def bound(begins: Vector, lengths: Vector) -> Vector:
            bounds = bends(begins[None], lengths[None], p)
            return np.fmin(*(np.array(off)[0, : len(begins)] for off in bounds))

        return bound


@cached_per_thread(32)
def terms_of(dae: Dae, *, decades: bool = False) -> tuple[Terms, ...]:
    """Return the terms of time, and of each state, that may rest and change on its way.

    Args:
        dae: The model, with frozen relations.
        decades: Whether to return them as `in_decades` does.
    """
    found, length = list[Terms](), SX.sym("length")
    for moving, terms in single_terms(dae).items():
        s = ca.vertcat(dae.x, dae.t)[moving]
        own = ca.vertsplit(in_decades(terms) if decades else terms)
        values = tuple(ca.Function("value", [s, dae.p], [term], *_NAMES, _CSE) for term in own)
        known = (bounds_along(term, s, length) for term in own)
        bends = tuple(
            bounds and ca.Function("bends", [s, length, dae.p], [*map(ca.densify, bounds)], _CSE)
            for bounds in known
        )
        tables = tuple(t for t in inner_terms(dae) if t.movers == (moving,) and t.tables)
        alone = tuple(_is_table_alone(term, s) for term in own)
        found.append(Terms(moving, values, bends, tables, alone))
    return tuple(found)


def bent(
    dae: Dae, terms: Terms, term: int, p: Vector, edges: Vector, knots: Vector
) -> tuple[Values, list[Vector]]:
    """Return a term as a function of what moves, and where it bends within cells: edges.

    One that is beyond all numbers in some of them acts in a branch only, beside which its values
    there are no bump: it bends where its decades do.

    Args:
        dae, terms: The model, and some of its `terms_of`.
        term: The position of the term in these.
        p, edges, knots: See `bent_parts`.
    """
    values, is_table = terms.value(term, p), terms.alone[term]
    parts = bent_parts(values, terms.off(term, p), edges, knots, is_table=is_table)
    if parts or (np.abs(values(edges)) < GREATEST_SIZE).all():
        return values, parts
    (own,) = (own for own in terms_of(dae, decades=True) if own.moving == terms.moving)
    values = own.value(term, p)
    return values, bent_parts(values, own.off(term, p), edges, knots)


def _is_table_alone(term: SX, s: SX) -> bool:
    """Return whether a term is nothing but a table of one variable along a line."""
    call = term.dep(0) if term.is_output() else term
    return (
        call.is_call()
        and call.n_dep() == 1
        and is_table(call.which_function())
        and ca.is_linear(call.dep(0), s)
    )


def _of_time(dae: Dae) -> Terms | None:
    return next((terms for terms in terms_of(dae) if terms.moving == len(dae.states)), None)


def pulse_times(dae: Dae, p: Vector, begin: float, end: float, longest: float = 0.0) -> Vector:
    """Return the times at which steps must end for a solver to see all terms of time, s.

    Args:
        dae: The model, with frozen relations.
        p: Parameters.
        begin, end: Times of the run, s.
        longest: Longest step of the solver, s; 0 for a part of the run.
    """
    found = _pulses(dae, p, begin, end, longest)
    times = np.unique(np.concatenate([np.empty(0), *found]))
    return np.asarray(times[(begin < times) & (times < end)])


def pulse_within_a_step(dae: Dae, p: Vector, begin: float, end: float, longest: float) -> bool:
    """Return whether a whole pulse may lie within a step of a solver; see `pulse_times`."""
    within = (np.clip(own, begin, end) for own in _pulses(dae, p, begin, end, longest))
    return any(0 < np.ptp(own) < longest for own in within)


def _pulses(dae: Dae, p: Vector, begin: float, end: float, longest: float) -> list[Vector]:
    """Return `pulse_times` of each pulse, also beyond the run."""
    terms, found = _of_time(dae), list[Vector]()
    if terms is None or not end > begin:
        return found
    longest = longest or (end - begin) / _STEPS
    count = int(np.clip(np.ceil(_IN_STEP * (end - begin) / longest), 1, _MOST_CELLS))
    cells = np.linspace(begin, end, count + 1)
    for i in range(len(terms.values)):
        values, parts = bent(dae, terms, i, p, cells, np.empty(0))
        for edges in parts:
            if len(edges) == 1:  # no solver can see what is shorter than rounding
                continue
            t = with_surroundings(edges, _INNER)
            seen = values(t)
            found.append(parted(t, seen, float(np.ptp(seen))))
    return found


def pulse_parameters(dae: Dae) -> tuple[str, ...]:
    """Return the parameters on which the terms of time depend."""
    terms = _of_time(dae)
    if terms is None or not dae.parameters:
        return ()
    which = np.any([value.which_depends("p", ["term"]) for value in terms.values], axis=0)
    return tuple(v.name for v, depends in zip(dae.parameters, which, strict=True) if depends)
