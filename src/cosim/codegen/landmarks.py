"""`landmarks`: where equations change on the way of a state, whatever the solver.

A step of an importer's solver sees a bump of the ground only if a stage lies in it. Each place at
which a term of one state changes is a relation, whose sign changes there: a solver that locates
events starts anew at these places, with steps from one to the next.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae
from casadi_models.dae.expressions import at_irregular_place, column, in_postorder
from casadi_models.dae.inner_terms import (
    InnerTerm,
    SeveralInner,
    in_waves,
    inner_terms,
    inner_terms_of_several,
    is_table,
    parameters_of,
)
from casadi_models.dae.relations import modes_of
from casadi_models.dae.time_bounds import bounds_along, bounds_within
from cosim.arrays import Integers, Truths, Vector
from cosim.codegen.changes import (
    FLAT,
    Changes,
    Values,
    apart,
    changes_between,
    changing_parts,
    parted,
    unseen,
    with_surroundings,
)
from cosim.codegen.knots import knots_of
from cosim.memo import cached_per_thread

_FARTHEST = 1e6  # largest value of a variable that is searched, in its unit
_REACH = np.array([-_FARTHEST, _FARTHEST])
_BEYOND = np.array([1e9, 1e12, 1e15])  # where the search of a term goes on that rests there
_ANYWHERE = 1e20  # of the others meanwhile: as if they had no end, but for their powers
_SEEN = 0.5  # least difference of a term before and after its change, as a share of its range,
#              that a step over it sees
_INNER = 64  # samples of a part of a change
_NARROW = 0.125  # share of a wave; what takes more of it, some stage of a step sees
_IN_ONE, _MOST = 64, 500  # places in a change, and of all terms of a state
_LEAST_SIZE, _GREATEST_SIZE = 1e-12, 1e30  # of a term that grows, where its places are
_GROWTH = 28.0  # asinh(value / _LEAST_SIZE) of a value near 1, about which they are dense
_SUDDEN = 0.02  # share of the size of what moves a term, in which it may turn within a step
_ACROSS = 9  # places on the way of one of several states through the only part where a term moves
_SECTIONS, _ZOOMS = 16, 18  # of the way to such a part; each time, into one of them


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Places where terms of states and of time change.

    Attributes:
        arguments: Expressions of states or time, and parameters, that change their signs there,
            (n, 1).
        times: Those of time that parameters do not move, s, ascending.
        moving: Names of the states with such terms, those of one joined by commas; "time" for
            those of time.
        followed: Names of the parameters that places follow.
        given: Names of the parameters that move places which do not follow them.
        passed: Names of the states with more places than are followed, or tables without knots.
    """

    arguments: SX
    times: Vector
    moving: tuple[str, ...]
    followed: tuple[str, ...]
    given: tuple[str, ...]
    passed: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Change:
    """Where a term changes.

    Attributes:
        term: The term.
        places: Values of its variable there.
        is_step: Whether a step over all of them sees a change.
        is_whole: Whether `places` are all of them, and not a selection.
        is_wave: Whether the variable moves to and fro as what moves it goes on.
    """

    term: InnerTerm
    places: Vector
    is_step: bool
    is_whole: bool = True
    is_wave: bool = False


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
    for changes in filter(None, map(_unseen, _by_direction(dae, every_change))):
        name = ", ".join(names[i] for i in changes[0].term.movers)
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
        times=np.unique(np.concatenate(times)),
        moving=tuple(moving),
        followed=tuple(_depends(dae, arguments)),
        given=tuple(sorted(given)),
        passed=tuple(passed),
    )


def _changes_of_one(dae: Dae, p: Vector) -> tuple[list[_Change], set[int]]:
    """Return where terms of one variable change, and the places of those in tables without knots.

    A place counts states, time, algebraic unknowns and inputs.
    """
    found, unknown = list[_Change](), set[int]()
    for term in inner_terms(dae):
        of_tables = term.tables and all(is_table(function) for function, _ in term.tables)
        if of_tables and not len(knots_of(term)):
            unknown.update(term.movers)
        found += _changes(dae, term, p) or _changes_in_waves(dae, term, p) or _growing(dae, term, p)
    return found, unknown


def _by_direction(dae: Dae, changes: Iterable[_Change]) -> list[list[_Change]]:
    """Return changes in groups of one direction; one with two factors in the equations is one."""
    groups = dict[tuple[float, ...], dict[tuple[int, bytes], _Change]]()
    for change in changes:
        key = change.term.variable.element_hash(), change.places.tobytes()
        direction = key[:1] if change.is_wave else _direction(dae, change.term)
        groups.setdefault(direction, {}).setdefault(key, change)
    return [[*group.values()] for group in groups.values()]


def _unseen(changes: list[_Change]) -> list[_Change]:
    """Return the changes in one direction that a step over all of them does not see."""
    steps = sum(change.is_step for change in changes)
    return [change for change in changes if not change.is_step or steps > 1]


def _has_fixed_times(dae: Dae, change: _Change) -> bool:
    """Return whether a change is at times that follow no parameter during a run."""
    term = change.term
    if term.movers != (len(dae.states),) or ca.depends_on(dae.driving_outputs, dae.t):
        return False
    is_known = bool(term.given) or not ca.depends_on(term.variable, dae.p)
    return is_known and is_line(dae, term)


def _without_repeated(dae: Dae, changes: list[_Change], p: Vector) -> list[_Change]:
    """Return changes in one state without places near those of others, such as of its slopes.

    A place is left out that is nearer to another one than half of the way to its own neighbor.
    Those that follow parameters remain before those that do not.
    """
    if not all(is_line(dae, change.term) for change in changes):
        return changes
    every, found = np.empty(0), list[_Change]()
    for change in sorted(changes, key=lambda c: (len(c.term.given), -len(c.places))):
        with np.errstate(divide="ignore", invalid="ignore"):  # a factor may be 0 at the start
            at = way_of(dae, change.term, change.places, p)
            gaps = np.abs(np.diff(at, prepend=np.nan, append=np.nan))
            room = np.nan_to_num(np.fmin(gaps[:-1], gaps[1:]) / 2, posinf=0.0)
            is_near = (np.abs(at[:, None] - every) <= room[:, None]).any(axis=1)
        every = np.append(every, at[~is_near])
        if not is_near.all():
            found.append(replace(change, places=change.places[~is_near]))
    return found


def _direction(dae: Dae, term: InnerTerm) -> tuple[float, ...]:
    """Return in which direction of all that may move a term changes: a step undoes one along it."""
    moving = ca.vertcat(dae.x, dae.t, dae.z, dae.u)
    gradient = ca.gradient(term.variable, moving)
    found = np.array(at_irregular_place(gradient, ca.vertcat(moving, dae.p))).ravel()
    return tuple(np.round(found / found[np.argmax(np.abs(found))], 9).tolist())


def _changes(dae: Dae, term: InnerTerm, p: Vector, near: Vector = _REACH) -> list[_Change]:
    """Return where a term changes on the way of its variable, and rests before and after."""
    knots = knots_of(term)
    values, found = _bent(dae, term, knots, p, near)
    far = np.concatenate((-_BEYOND[::-1], near, _BEYOND))
    ends = values(far)
    with np.errstate(invalid="ignore"):
        rests = np.abs(ends[[1, -2]] - ends[[0, -1]]) <= FLAT * np.ptp(ends)
    if rests.all():
        beyond = _bent(dae, term, knots, p, far)[1]
        found = beyond if beyond.is_whole else found
    changes = list[_Change]()
    for edges in apart(found.parts):
        at = with_surroundings(edges, _INNER)
        seen = values(at)
        if np.isnan(seen).any():  # no motion goes there
            continue
        step = abs(seen[-1] - seen[0]) >= _SEEN * np.ptp(seen)
        changes.append(_change(term, at, seen, found, bool(step)))
    if len(found.pinched):  # narrower than the search goes
        changes.append(_Change(term, found.pinched, is_step=False, is_whole=False))
    return changes


def _growing(dae: Dae, term: InnerTerm, p: Vector) -> list[_Change]:
    """Return where a term that grows beyond all numbers may act, if it does so suddenly.

    Wherever what moves it turns, it returns: no step sees it as one of a slope. Its places
    are those of its logarithm, whatever its unit and its factor are.
    """
    value = ca.Function("value", [term.symbol, dae.p], [term.value])

    def is_beyond(at: Vector) -> Truths:
        seen = np.abs(np.array(value(at.reshape(1, -1), p)).reshape(at.shape))
        return np.asarray(seen > _GREATEST_SIZE)

    reach = np.clip(_reach(dae, term, p), *_REACH)
    grows = is_beyond(reach)
    if not grows.any():
        return []
    inwards = 8 * np.spacing(_FARTHEST) * np.array([1, -1])
    reach[grows] = _last_flat(is_beyond, reach[grows]) + inwards[grows]
    scale = ca.tanh(ca.asinh(term.value / _LEAST_SIZE) / _GROWTH)
    bounded, rests = term._replace(value=scale), reach.mean() if grows.all() else reach[~grows]
    every = (_changes(dae, bounded, p, np.sort(np.append(end, rests))) for end in reach[grows])
    return [
        replace(change, term=term, places=change.places[::2], is_step=False)
        for changes in every
        for change in changes
        if _is_sudden(dae, term, change.places[len(change.places) // 2 :][:3], p)
    ]


def _is_sudden(dae: Dae, term: InnerTerm, places: Vector, p: Vector) -> bool:
    """Return whether places are in a small part of the way of a variable, which may turn there."""
    if term.movers == (len(dae.states),):  # time does not turn
        return False
    moving, others = ca.vertcat(dae.x, dae.t, dae.z, dae.u), (*dae.algebraics, *dae.inputs)
    sizes = [*(v.nominal for v in dae.states), dae.experiment.stop_time]
    sizes += [v.nominal for v in others]
    slopes = ca.fabs(ca.jacobian(term.variable, moving))
    line = ca.Function("line", [moving, dae.p], [term.variable, slopes @ ca.DM(sizes)])
    first, (_, way) = float(line(0, p)[0]), map(float, line(sizes, p))
    size = np.nanmax(np.abs([first, way, *places[[0, -1]]]))
    return bool(np.ptp(places) <= _SUDDEN * size)


def _changes_in_waves(dae: Dae, term: InnerTerm, p: Vector) -> list[_Change]:
    """Return where a term changes in small parts of a wave in it, such as exp(-99 sin(x)**2)."""
    if len(dae.states) in term.movers:  # of time: its places are known before the run
        return []
    for own in in_waves(dae, term):
        reach = _reach(dae, own, p)
        if not np.abs(reach).max() < _FARTHEST:
            continue
        values, found = _bent(dae, own, np.empty(0), p, reach)
        changes = list[_Change]()
        for edges in apart(found.parts):
            at = np.clip(with_surroundings(edges, _INNER), *reach)
            seen = values(at)
            first, last = np.arcsin(np.interp(edges[[0, -1]], reach, [-1, 1])) / np.pi
            is_step = abs(seen[-1] - seen[0]) >= _SEEN * np.ptp(seen)
            share = min(0.5 - first, last + 0.5) if is_step else last - first
            if share <= _NARROW:
                change = _change(own, at, seen, found, False)
                inside = (reach[0] < change.places) & (change.places < reach[1])
                changes.append(replace(change, places=change.places[inside], is_wave=True))
        if changes:
            return changes
    return []


def _reach(dae: Dae, term: InnerTerm, p: Vector) -> Vector:
    """Return the least and the greatest value of the variable of a term."""
    moving = ca.vertcat(dae.x, dae.t, dae.z, dae.u)
    ends = SX.sym("low", moving.numel()), SX.sym("high", moving.numel())
    bounds = bounds_within(term.variable, moving, ends)
    if bounds is None:
        return np.array([-np.inf, np.inf])
    far = np.full(moving.numel(), _ANYWHERE)
    reach = ca.Function("reach", [*ends, dae.p], [ca.vertcat(*bounds)])
    return np.array(reach(-far, far, p)).ravel()


def _bent(
    dae: Dae, term: InnerTerm, knots: Vector, p: Vector, reach: Vector
) -> tuple[Values, Changes]:
    """Return a term as a function of its variable, and where it bends within a reach."""
    length, symbol = SX.sym("length"), term.symbol
    value = ca.Function("value", [symbol, dae.p], [term.value], {"cse": True})

    def values(at: Vector) -> Vector:
        return np.array(value(at[None], p)).ravel()

    bounds = bounds_along(term.value, symbol, length)
    if bounds is not None:
        off = ca.Function("beyond", [symbol, length, dae.p], list(bounds), {"cse": True})

        def beyond(begins: Vector, widths: Vector) -> Vector:
            return np.fmin(*(np.array(o).ravel() for o in off(begins[None], widths[None], p)))

        found = changing_parts(values, beyond, reach)
    elif len(knots) > 1:
        found = changes_between(values, knots)
    else:
        return values, unseen(reach)
    return values, found if found.is_whole or len(found.pinched) else unseen(reach)


def _change(term: InnerTerm, at: Vector, seen: Vector, found: Changes, is_step: bool) -> _Change:
    """Return where a term changes in a part, from its values there."""
    places = parted(at, seen, found.high - found.low)
    some = places[np.unique(np.linspace(0, len(places) - 1, _IN_ONE).astype(int))]
    return _Change(term, some, is_step, len(some) == len(places))


@cached_per_thread(16)
def localized_inverses(dae: Dae) -> SX:
    """Return the reciprocals and powers of several quantities that rest but for a part, (n, 1)."""
    p = np.array([np.nan if v.start is None else v.start for v in dae.parameters], dtype=float)
    every = [several for several in inner_terms_of_several(dae) if several.is_inverse]
    return ca.vertcat(SX(0, 1), *(s.value for s in every if _changes_of_several(dae, s, p)))


def _hides_places(several: SeveralInner) -> bool:
    """Return whether a term calls a table whose knots are unknown."""
    nodes = in_postorder([several.value])
    calls = (value.which_function() for _, value, _ in nodes if value.op() == ca.OP_CALL)
    return any(map(is_table, calls)) and not any(len(knots_of(term)) for term in several.alone)


def _changes_of_several(dae: Dae, several: SeveralInner, p: Vector) -> list[_Change] | None:
    """Return where a term of several quantities may move; None if unknown."""
    each = (_changes(dae, term, p) for term in several.alone)
    found = next(filter(None, each), list[_Change]())
    moving = ca.vertcat(dae.x, dae.t, dae.z, dae.u)
    if found and not any(ca.which_depends(found[0].term.variable, moving, 2, False)):
        return found
    if not found and (peak := _around_peak(dae, several, p)):
        return peak
    beyond = _between_rests(dae, several, p) if several.each else []  # others: modes change it
    if found or beyond:
        return found + (beyond or [])
    grows = (_growing(dae, term, p) for term in several.alone)
    return next(filter(None, grows), beyond)


def _between_rests(dae: Dae, several: SeveralInner, p: Vector) -> list[_Change] | None:
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
        least, columns = np.full((len(terms), len(to)), -_ANYWHERE), np.arange(len(to))
        most = -least
        least[rows, columns], most[rows, columns] = np.minimum(begins, to), np.maximum(begins, to)
        low, high = (np.array(end).ravel() for end in bounds(least, most, p))
        return np.asarray(high - low)

    begins = np.tile(_REACH, len(terms))
    rows = np.arange(len(begins)) // 2
    size = float(ranges(rows[:1], begins[:1], -begins[:1])[0])
    if not np.isfinite(size):
        return []

    def rests(to: Vector) -> Truths:
        own = ranges(np.tile(rows, len(to)), np.tile(begins, len(to)), to.ravel())
        return np.asarray(own.reshape(to.shape) <= FLAT * size)

    last = _last_flat(rests, begins)
    found = [
        _Change(term, np.linspace(first, final, _ACROSS), is_step=False)
        for term, first, final in zip(terms, last[::2], last[1::2], strict=True)
        if -_FARTHEST < first < final < _FARTHEST
    ]
    return found if found or _is_slope(dae, several, size, p) else None


def _is_slope(dae: Dae, several: SeveralInner, size: float, p: Vector) -> bool:
    """Return whether a term of a size differs between both far ends of some quantity."""
    terms = several.each
    symbols = ca.vertcat(*(term.symbol for term in terms))
    value = ca.Function("value", [symbols, dae.p], [terms[0].value])
    corners = _FARTHEST * np.hstack([np.eye(len(terms)), -np.eye(len(terms))])
    seen = np.array(value(corners, p)).reshape(2, -1)
    return bool((np.abs(np.diff(seen, axis=0)) >= _SEEN * size).any())


def _around_peak(dae: Dae, several: SeveralInner, p: Vector) -> list[_Change]:
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
    return [_Change(term, lattice, is_step=False) for term in terms]


def _last_flat(rests: Callable[[Vector], Truths], begins: Vector) -> Vector:
    """Return the places up to which a term rests from begins on, towards 0 and beyond.

    Args:
        rests: Returns whether it rests from each of the begins to places, (m, n).
        begins: (n,).
    """
    last, moves = begins, -begins
    for _ in range(_ZOOMS):
        edges = np.linspace(last, moves, _SECTIONS + 1)
        inner = ~rests(edges[1:-1])
        section = np.argmax(np.vstack((inner, np.full(len(begins), True))), axis=0)
        last, moves = (edges[section + i, np.arange(len(begins))] for i in (0, 1))
    return last


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
