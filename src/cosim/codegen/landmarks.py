"""`landmarks`: where equations change on the way of a state, whatever the solver.

A step of an importer's solver sees a bump of the ground only if a stage lies in it. Each place at
which a term of one state changes is a relation, whose sign changes there: a solver that locates
events starts anew at these places, with steps from one to the next.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import chain

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae
from casadi_models.dae.expressions import at_irregular_place, column, in_postorder, irregular_place
from casadi_models.dae.inner_terms import (
    InnerTerm,
    SeveralInner,
    inner_terms,
    inner_terms_of_several,
    is_table,
    parameters_of,
    quantities_in,
)
from casadi_models.dae.relations import modes_of
from casadi_models.dae.time_bounds import bounds_within
from cosim.arrays import Integers, Truths, Vector
from cosim.codegen.changes import FLAT, are_near
from cosim.codegen.knots import knots_of
from cosim.codegen.term_changes import (
    ANYWHERE,
    FARTHEST,
    REACH,
    SEEN,
    Change,
    changes_in_waves,
    changes_of,
    growing_of,
    last_flat,
    short_ones,
)
from cosim.memo import cached_per_thread

_MOST = 500  # places of all terms of a state
_ACROSS = 9  # places on the way of one of several states through the only part where a term moves


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Places where terms of states and of time change.

    Attributes:
        arguments: Expressions of states or time, and parameters, that change their signs there,
            (n, 1).
        gentle: How far parameters keep changes from being short which are not with the start
            values, (1, 1) each; not positive: they are short, as the keys tell.
        times: Those of time that parameters do not move, s, ascending.
        moving: Names of the states with such terms, those of one joined by commas; "time" for
            those of time.
        followed: Names of the parameters that places follow.
        given: Names of the parameters that move places which do not follow them.
        passed: Names of the states with more places than are followed, or tables without knots.
    """

    arguments: SX
    gentle: Mapping[str, SX]
    times: Vector
    moving: tuple[str, ...]
    followed: tuple[str, ...]
    given: tuple[str, ...]
    passed: tuple[str, ...]


@cached_per_thread(16)
def landmarks(dae: Dae) -> Landmarks:
    """Return the places where terms change that rest before and after.

    Args:
        dae: The model, with frozen relations.
    """
    p = np.array([np.nan if v.start is None else v.start for v in dae.parameters], dtype=float)
    names = [*(state.name for state in dae.states), "time"]
    names += [v.name for v in (*dae.algebraics, *dae.inputs)]
    every_change, unknown = _changes_of_one(dae, p)
    passed = [names[moving] for moving in sorted(unknown)]
    for several in inner_terms_of_several(dae):
        across = _changes_of_several(dae, several, p)
        if across is None and not several.is_inverse:
            passed.append(", ".join(names[i] for term in several.each for i in term.movers))
        every_change += across or []
    rows, times, moving, given = list[SX](), [np.empty(0)], list[str](), set[str]()
    gentle = dict[str, SX]()
    for every in filter(None, map(_unseen, _by_direction(dae, every_change))):
        name = ", ".join(names[i] for i in every[0].term.movers)
        changes = short_ones(dae, every, p)
        for change in every:
            if change not in changes and (own := _depends(dae, change.surplus)):
                key = f"a change of {name} is short with the new {', '.join(own)}"
                gentle[key] = ca.fmin(gentle.get(key, SX.inf()), change.surplus)
        if not changes:
            continue
        moving.append(name)
        fixed = [change for change in changes if _has_fixed_times(dae, change)]
        for change in fixed:
            times.append(way_of(dae, change.term, change.places, p))
            given.update(_depends(dae, ca.vertcat(change.term.variable, change.term.value)))
        left = _without_repeated(dae, [change for change in changes if change not in fixed], p)
        many = sum(len(change.places) for change in left) > _MOST
        if many or not all(change.is_whole for change in changes):
            passed.append(name)
        if not many:
            rows += [c.term.variable - place for c in left for place in c.places.tolist()]
            given.update(dae.parameters[i].name for c in left for i in c.term.given)
    arguments = column(rows)
    return Landmarks(
        arguments=arguments,
        gentle=gentle,
        times=np.unique(np.concatenate(times)),
        moving=tuple(moving),
        followed=tuple(_depends(dae, arguments)),
        given=tuple(sorted(given)),
        passed=tuple(passed),
    )


def _changes_of_one(dae: Dae, p: Vector) -> tuple[list[Change], set[int]]:
    """Return where terms of one variable change, and the places of those in tables without knots.

    A place counts states, time, algebraic unknowns and inputs.
    """
    found, unknown = list[Change](), set[int]()
    for term in inner_terms(dae):
        of_tables = term.tables and all(is_table(function) for function, _ in term.tables)
        if of_tables and not len(knots_of(term)):
            unknown.update(term.movers)
        free = (own for own in quantities_in(dae, term) if term.given and not own.given)
        growing = (growing_of(dae, own, p) for own in chain([term], free))
        changes = changes_of(dae, term, p) or changes_in_waves(dae, term, p)
        found += changes or next(filter(None, growing), [])
    return found, unknown


def _by_direction(dae: Dae, changes: Iterable[Change]) -> list[list[Change]]:
    """Return changes in groups of one direction; one with two factors in the equations is one."""
    groups = dict[tuple[float, ...], dict[tuple[int, bytes], Change]]()
    for change in changes:
        key = change.term.variable.element_hash(), change.places.tobytes()
        direction = key[:1] if change.is_wave else _direction(dae, change.term)
        groups.setdefault(direction, {}).setdefault(key, change)
    return [[*group.values()] for group in groups.values()]


def _unseen(changes: list[Change]) -> list[Change]:
    """Return the changes in one direction that a step over all of them does not see."""
    steps = sum(change.is_step for change in changes)
    return [change for change in changes if not change.is_step or steps > 1]


def _has_fixed_times(dae: Dae, change: Change) -> bool:
    """Return whether a change is at times that follow no parameter during a run."""
    term = change.term
    if term.movers != (len(dae.states),) or ca.depends_on(dae.driving_outputs, dae.t):
        return False
    is_known = bool(term.given) or not ca.depends_on(term.variable, dae.p)
    return is_known and is_line(dae, term)


def _without_repeated(dae: Dae, changes: list[Change], p: Vector) -> list[Change]:
    """Return changes in one state without places near those of others, such as of its slopes.

    With any parameters, a place that is left out is nearer to another one than half of the way to
    its own neighbor. Those that follow parameters remain before those that do not.
    """
    if not all(is_line(dae, change.term) for change in changes):
        return changes
    others = p + (1 + np.abs(p)) * np.array(irregular_place(len(p))).ravel()
    found = list[Change]()
    for change in sorted(changes, key=lambda c: (len(c.term.given), -len(c.places))):
        other = np.where(np.isin(np.arange(len(p)), change.term.given), p, others)  # not followed
        each = change, *found
        with np.errstate(divide="ignore", invalid="ignore"):  # a factor may be 0 at the start
            ways = [[way_of(dae, c.term, c.places, q) for c in each] for q in (p, other)]
        both = [are_near(at, np.concatenate([np.empty(0), *every])) for at, *every in ways]
        left = ~np.all(both, axis=0).any(axis=1)
        if left.any():
            found.append(replace(change, places=change.places[left]))
    return found


def _direction(dae: Dae, term: InnerTerm) -> tuple[float, ...]:
    """Return in which direction of all that may move a term changes: a step undoes one along it."""
    moving = ca.vertcat(dae.x, dae.t, dae.z, dae.u)
    gradient = ca.gradient(term.variable, moving)
    found = np.array(at_irregular_place(gradient, ca.vertcat(moving, dae.p))).ravel()
    return tuple(np.round(found / found[np.argmax(np.abs(found))], 9).tolist())


@cached_per_thread(16)
def localized_inverses(dae: Dae) -> SX:
    """Return the reciprocals and powers of several quantities that rest but for a part, (n, 1)."""
    p = np.array([np.nan if v.start is None else v.start for v in dae.parameters], dtype=float)
    every = [several for several in inner_terms_of_several(dae) if several.is_inverse]
    known = ((s.value, _changes_of_several(dae, s, p) or []) for s in every)
    return column(value for value, changes in known if short_ones(dae, changes, p))


def _hides_places(several: SeveralInner) -> bool:
    """Return whether a term calls a table whose knots are unknown."""
    nodes = in_postorder([several.value])
    calls = (value.which_function() for _, value, _ in nodes if value.op() == ca.OP_CALL)
    return any(map(is_table, calls)) and not any(len(knots_of(term)) for term in several.alone)


def _changes_of_several(dae: Dae, several: SeveralInner, p: Vector) -> list[Change] | None:
    """Return where a term of several quantities may move; None if unknown."""
    each = (changes_of(dae, term, p) for term in several.alone)
    found = next(filter(None, each), list[Change]())
    moving = ca.vertcat(dae.x, dae.t, dae.z, dae.u)
    if found and not any(ca.which_depends(found[0].term.variable, moving, 2, False)):
        return found
    if not found and (peak := _around_peak(dae, several, p)):
        return peak
    beyond = _between_rests(dae, several, p) if several.each else []  # others: modes change it
    if found or beyond:
        return found + (beyond or [])
    grows = (growing_of(dae, term, p) for term in several.alone)
    return next(filter(None, grows), beyond)


def _between_rests(dae: Dae, several: SeveralInner, p: Vector) -> list[Change] | None:
    """Return where a term may move that rests if one quantity is far away; None if unknown.

    It rests beyond parts of the way of each quantity, wherever the others are: whoever gets to
    where it moves passes the end of one of them. A slope, which ends at another value than it
    begins, has none.
    """
    terms = several.each
    symbols = ca.vertcat(*(term.symbol for term in terms))
    ends = SX.sym("low", len(terms)), SX.sym("high", len(terms))
    within = bounds_within(terms[0].value, symbols, ends)
    if within is None:
        return None if _hides_places(several) else []
    bounds = ca.Function("bounds", [*ends, dae.p], list(within), {"cse": True})

    def ranges(rows: Integers, begins: Vector, to: Vector) -> Vector:
        """Return those of the term while one quantity each, by its row, goes from begin on."""
        least, columns = np.full((len(terms), len(to)), -ANYWHERE), np.arange(len(to))
        most = -least
        least[rows, columns], most[rows, columns] = np.minimum(begins, to), np.maximum(begins, to)
        low, high = (np.array(end).ravel() for end in bounds(least, most, p))
        return np.asarray(high - low)

    begins = np.tile(REACH, len(terms))
    rows = np.arange(len(begins)) // 2
    size = float(ranges(rows[:1], begins[:1], -begins[:1])[0])
    if not np.isfinite(size):
        return []

    def rests(to: Vector) -> Truths:
        own = ranges(np.tile(rows, len(to)), np.tile(begins, len(to)), to.ravel())
        return np.asarray(own.reshape(to.shape) <= FLAT * size)

    last = last_flat(rests, begins)
    found = [
        Change(term, np.linspace(first, final, _ACROSS), is_step=False)
        for term, first, final in zip(terms, last[::2], last[1::2], strict=True)
        if -FARTHEST < first < final < FARTHEST
    ]
    return found if found or _is_slope(dae, several, size, p) else None


def _is_slope(dae: Dae, several: SeveralInner, size: float, p: Vector) -> bool:
    """Return whether a term of a size differs between both far ends of some quantity."""
    terms = several.each
    symbols = ca.vertcat(*(term.symbol for term in terms))
    value = ca.Function("value", [symbols, dae.p], [terms[0].value])
    corners = FARTHEST * np.hstack([np.eye(len(terms)), -np.eye(len(terms))])
    seen = np.array(value(corners, p)).reshape(2, -1)
    return bool((np.abs(np.diff(seen, axis=0)) >= SEEN * size).any())


def _around_peak(dae: Dae, several: SeveralInner, p: Vector) -> list[Change]:
    """Return where an exp of a quadratic with a peak may move; none for other terms.

    That is within an ellipsoid about the peak, outside of which it is below FLAT of its greatest
    value. Parameters may move the peak, and change its widths.
    """
    if several.value.op() != ca.OP_EXP or not several.each:
        return []
    moving = ca.vertcat(dae.x, dae.t, dae.z, dae.u)
    places = sorted({mover for term in several.each for mover in term.movers})
    movers = moving[places]
    hessian, gradient = ca.hessian(several.value.dep(0), movers)
    if ca.depends_on(hessian, moving):
        return []
    known = np.array(ca.Function("hessian", [dae.p], [ca.densify(hessian)])(p))
    if not np.isfinite(known).all() or not (np.linalg.eigvalsh(known) < 0).all():
        return []
    inverse = ca.inv(ca.densify(hessian))
    peak = -inverse @ ca.substitute(gradient, movers, SX.zeros(len(places)))
    half_widths = ca.sqrt(2 * np.log(FLAT) * ca.diag(inverse))  # of the ellipsoid
    shares = (movers - peak) / half_widths
    symbol = SX.sym("share")
    terms = (
        InnerTerm((mover,), share, symbol, several.value, (), ())
        for mover, share in zip(places, ca.vertsplit(shares), strict=True)
    )
    lattice = np.linspace(-1, 1, _ACROSS)
    return [Change(term, lattice, is_step=False) for term in terms]


def _depends(dae: Dae, expression: SX) -> list[str]:
    """Return the names of the parameters on which an expression depends."""
    return [dae.parameters[i].name for i in parameters_of(dae, expression)]


def is_line(dae: Dae, term: InnerTerm) -> bool:
    """Return whether the variable of a term is linear in the only quantity that moves it."""
    symbols = ca.vertcat(dae.x, dae.t, dae.z, dae.u)[list(term.movers)]
    is_fixed = not ca.depends_on(term.variable, modes_of(dae))
    return is_fixed and len(term.movers) == 1 and bool(ca.is_linear(term.variable, symbols))


def way_of(dae: Dae, term: InnerTerm, places: Vector, p: Vector) -> Vector:
    """Return the values of what moves a term at values of its variable, which is a line."""
    (mover,) = term.movers
    symbol = ca.vertcat(dae.x, dae.t, dae.z, dae.u)[mover]
    line = [term.variable, ca.jacobian(term.variable, symbol)]
    value, slope = ca.Function("line", [symbol, dae.p], line)(0, p)
    return np.asarray((places - float(value)) / float(slope))
