"""`Change`: where a term of one variable changes: in bumps, slopes, waves, and where it grows."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae
from casadi_models.dae.expressions import column
from casadi_models.dae.inner_terms import InnerTerm, quantities_in
from casadi_models.dae.time_bounds import bounds_along, bounds_within
from cosim.arrays import Truths, Vector
from cosim.codegen.changes import (
    FLAT,
    GREATEST_SIZE,
    Changes,
    Values,
    apart,
    changes_between,
    changing_parts,
    in_decades,
    parted,
    unseen,
    with_surroundings,
)
from cosim.codegen.knots import knots_of

FARTHEST = 1e6  # largest value of a variable that is searched, in its unit
REACH = np.array([-FARTHEST, FARTHEST])
ANYWHERE = 1e20  # of the others meanwhile: as if they had no end, but for their powers
SEEN = 0.5  # least difference of a term before and after its change, as a share of its range,
#             that a step over it sees
_BEYOND = np.array([1e9, 1e12, 1e15])  # where the search of a term goes on that rests there
_INNER = 64  # samples of a part of a change
_NARROW = 0.125  # share of a wave; what takes more of it, some stage of a step sees
_IN_ONE = 64  # places in a change
_SUDDEN = 0.02  # share of the size of what moves a term, in which it may turn within a step
_SECTIONS, _ZOOMS = 16, 18  # of the way to where a term moves; each time, into one of them


@dataclass(frozen=True, eq=False)
class Change:
    """Where a term changes.

    Attributes:
        term: The term.
        places: Values of its variable there.
        is_step: Whether a step over all of them sees a change.
        is_whole: Whether `places` are all of them, and not a selection.
        is_wave: Whether the variable moves to and fro as what moves it goes on.
        surplus: How much larger than a small one the part of the way is in which it changes, by
            parameters; not positive: it is short.
    """

    term: InnerTerm
    places: Vector
    is_step: bool
    is_whole: bool = True
    is_wave: bool = False
    surplus: SX = SX(0)  # noqa: RUF009  # a number, which nothing changes


def short_ones(dae: Dae, changes: list[Change], p: Vector) -> list[Change]:
    """Return the changes in a small part of the way of what moves them."""
    surplus = value_at(dae, column(change.surplus for change in changes), p)
    return [change for change, own in zip(changes, surplus, strict=True) if own <= 0]


def value_at(dae: Dae, expression: SX, p: Vector) -> Vector:
    """Return the value of an expression of parameters."""
    return np.array(ca.Function("at", [dae.p], [ca.densify(expression)])(p)).ravel()


def changes_of(dae: Dae, term: InnerTerm, p: Vector, near: Vector = REACH) -> list[Change]:
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
    changes = list[Change]()
    for edges in apart(found.parts):
        at = with_surroundings(edges, _INNER)
        seen = values(at)
        if np.isnan(seen).any():  # no motion goes there
            continue
        step = abs(seen[-1] - seen[0]) >= SEEN * np.ptp(seen)
        changes.append(_change(term, at, seen, found, bool(step)))
    if len(found.pinched):  # narrower than the search goes
        changes.append(Change(term, found.pinched, is_step=False, is_whole=False))
    return changes


def growing_of(dae: Dae, term: InnerTerm, p: Vector) -> list[Change]:
    """Return where a term that grows beyond all numbers may act, if it does so suddenly.

    Wherever what moves it turns, it returns: no step sees it as one of a slope. Its places
    are those of its logarithm, whatever its unit and its factor are.
    """
    value = ca.Function("value", [term.symbol, dae.p], [term.value])

    def is_beyond(at: Vector) -> Truths:
        seen = np.abs(np.array(value(at.reshape(1, -1), p)).reshape(at.shape))
        return np.asarray(seen > GREATEST_SIZE)

    reach = np.clip(value_at(dae, _reach(dae, term), p), *REACH)
    grows = is_beyond(reach)
    if not grows.any():
        return []
    inwards = 8 * np.spacing(FARTHEST) * np.array([1, -1])
    reach[grows] = last_flat(is_beyond, reach[grows]) + inwards[grows]
    scale = in_decades(term.value)
    bounded, rests = term._replace(value=scale), reach.mean() if grows.all() else reach[~grows]
    every = (changes_of(dae, bounded, p, np.sort(np.append(end, rests))) for end in reach[grows])
    found = list[Change]()
    for change in (change for changes in every for change in changes):
        surplus = surplus_of(dae, term, change.places[len(change.places) // 2 :][:3])
        places = change.places[::2]
        found.append(Change(term, places, False, change.is_whole, surplus=surplus))
    return [c for c in found if short_ones(dae, [c], p) or ca.depends_on(c.surplus, dae.p)]


def surplus_of(dae: Dae, term: InnerTerm, places: Vector) -> SX:
    """Return how much larger places are than a small part of the way of a variable that may turn.

    Parameters change this way; it is positive where the variable does not turn there.
    """
    if term.movers == (len(dae.states),):  # time does not turn
        return SX(1)
    moving, others = ca.vertcat(dae.x, dae.t, dae.z, dae.u), (*dae.algebraics, *dae.inputs)
    sizes = [*(v.nominal for v in dae.states), dae.experiment.stop_time]
    sizes += [v.nominal for v in others]
    slopes = ca.fabs(ca.jacobian(term.variable, moving))
    line = ca.Function("line", [moving, dae.p], [term.variable, slopes @ ca.DM(sizes)])
    way = ca.fmax(ca.fabs(line(0, dae.p)[0]), line(sizes, dae.p)[1])
    return np.ptp(places) / _SUDDEN - ca.fmax(way, np.abs(places).max())


def changes_in_waves(dae: Dae, term: InnerTerm, p: Vector) -> list[Change]:
    """Return where a term changes in small parts of a wave in it, such as exp(-99 sin(x)**2)."""
    for own in quantities_in(dae, term, waves=True):
        ends = _reach(dae, own)
        reach = value_at(dae, ends, p)
        size = np.abs(reach).max()
        if not 0 < size < _BEYOND[-1]:
            continue
        every = _changes_in_wave(dae, own, p, reach, ends)
        short = [replace(change, is_step=False) for change in short_ones(dae, every, p)]
        is_free = not own.given and ca.depends_on(ends, dae.p)
        if not short and is_free and size < FARTHEST:
            every = _changes_in_wave(dae, own, p, reach * (FARTHEST / size), ends)
        gentle = [change for change in every if change.is_step or is_free]
        if short and len(dae.states) in term.movers:  # of time: its places are known before the run
            return []
        if short or gentle:
            return short or gentle
    return []


def _changes_in_wave(dae: Dae, term: InnerTerm, p: Vector, reach: Vector, ends: SX) -> list[Change]:
    """Return where a term changes in a reach of its variable, whose wave has other ends, too."""
    values, found = _bent(dae, term, np.empty(0), p, reach)
    changes = list[Change]()
    for edges in apart(found.parts):
        at = np.clip(with_surroundings(edges, _INNER), *reach)
        seen = values(at)
        height = 2 * (SX(edges[[0, -1]]) - ends[0]) / (ends[1] - ends[0]) - 1
        first, last = ca.vertsplit(ca.asin(ca.fmax(ca.fmin(height, 1), -1)) / np.pi)
        is_step = abs(seen[-1] - seen[0]) >= SEEN * np.ptp(seen)
        share = ca.fmin(0.5 - first, last + 0.5) if is_step else last - first
        is_slope = bool(is_step and reach[0] < edges[0] and edges[-1] < reach[1])
        change = _change(term, at, seen, found, is_slope)
        inside = (reach[0] < change.places) & (change.places < reach[1])
        places = change.places[inside]
        changes.append(replace(change, places=places, is_wave=True, surplus=share - _NARROW))
    return changes


def _reach(dae: Dae, term: InnerTerm) -> SX:
    """Return the least and the greatest value of the variable of a term, by parameters."""
    moving = ca.vertcat(dae.x, dae.t, dae.z, dae.u)
    ends = SX.sym("low", moving.numel()), SX.sym("high", moving.numel())
    bounds = bounds_within(term.variable, moving, ends)
    if bounds is None:
        return SX([-np.inf, np.inf])
    far = np.full(moving.numel(), ANYWHERE)
    return ca.Function("reach", [*ends, dae.p], [ca.vertcat(*bounds)])(-far, far, dae.p)


def _bent(
    dae: Dae, term: InnerTerm, knots: Vector, p: Vector, reach: Vector
) -> tuple[Values, Changes]:
    """Return a term as a function of its variable, and where it bends within a reach."""
    length, symbol = SX.sym("length"), term.symbol
    value = ca.Function("value", [symbol, dae.p], [term.value], {"cse": True})

    def values(at: Vector) -> Vector:
        return np.array(value(at[None], p))[0, : len(at)]

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


def _change(term: InnerTerm, at: Vector, seen: Vector, found: Changes, is_step: bool) -> Change:
    """Return where a term changes in a part, from its values there."""
    places = parted(at, seen, found.high - found.low)
    some = places[np.unique(np.linspace(0, len(places) - 1, _IN_ONE).astype(int))]
    return Change(term, some, is_step, len(some) == len(places))


def last_flat(rests: Callable[[Vector], Truths], begins: Vector) -> Vector:
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
