"""`followed_growth`: a motion in which no unstable deviation is kept from growing."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import casadi as ca
import numpy as np

from casadi_models.dae import Dae
from casadi_models.dae.expressions import at_irregular_place
from cosim.arrays import Truths, Vector
from cosim.codegen.functions import equations
from cosim.errors import CosimError
from cosim.integrate.call import INTERRUPTED
from cosim.integrate.engine import Counts
from cosim.integrate.motion import Motion, rates_at
from cosim.memo import cached_per_thread
from cosim.model.growth import (
    MOST_TRIALS_OF_GROWTH,
    Closer,
    Growth,
    controlled_half,
    growing_times,
    growth_from_start,
    has_lines,
    unfollowed_growth,
)
from cosim.model.solver import AdaptiveSolver, Tolerance
from cosim.model.state_path import StatePath
from cosim.model.troughs import MOST_TRIALS, Trough, deepest_trough, resting
from cosim.model.values import error_sizes, own_sizes
from cosim.text import one_note

_MOST_STEPS = 2_000  # in which a motion is looked at
_LOOKS = 3  # whether a deviation grows: from the start on, in the last half, the last quarter
_FADES = 1.5  # times as much in the second half of a time as in the first: no growth

# The motion over output times, s, (n,), from states and unknowns at the first, (nx,) and (nz,)
Continuation = Callable[[Vector, Vector, Vector], Motion]


def followed_growth(
    run: Callable[[Closer | None], Motion],
    look: Callable[[Closer | None, int], Motion],
    go_on: Continuation | None,
    solver: AdaptiveSolver,
) -> Motion:
    """Return the motion of a solver, or one with smaller tolerances where digits are lost.

    Args:
        run: Integrates, the first part with smaller tolerances.
        look: The same, with several rows in each of so many steps.
        go_on: Goes on from other states; None without events and relations.
        solver: The solver.
    """
    relative, absolute = solver.tolerance.pair
    motion, refined = _with_digits(run, look, solver.tolerance)
    ended = refined or motion.reason == INTERRUPTED
    growth = None if ended else growth_in(motion, solver.tolerance, go_on)
    if growth is None:
        return motion
    closer = growth.closer(relative, absolute)
    if growth.rounding:
        return _noted(motion, growth.note(closer, absolute, False))
    found, later = motion, None
    for _ in range(MOST_TRIALS_OF_GROWTH):
        followed = run(closer)
        if followed.reason == INTERRUPTED:
            return followed
        if followed.reason:
            break
        found, later = followed, growth_in(followed, solver.tolerance, None, closer)
        if later is None or later.rounding or later.time < closer.until:
            break
        closer = later.closer(relative, absolute, closer)
    helps = found is followed and (later is None or later.rounding)
    noted = _noted(found, growth.note(closer, absolute, helps))
    # no tolerance follows rounding
    return _noted(noted, later.note(closer, absolute, False)) if helps and later else noted


def _noted(motion: Motion, text: str) -> Motion:
    return replace(motion, note=one_note(motion.note, text))


def _with_digits(
    run: Callable[[Closer | None], Motion],
    look: Callable[[Closer | None, int], Motion],
    requested: Tolerance,
) -> tuple[Motion, bool]:
    """Return a motion whose states keep their digits in troughs, and whether one has lost some."""
    motion, tolerance = run(None), requested.pair
    if not tolerance[1] or not may_grow_again(motion.dae):
        return motion, False
    sizes = _sizes(motion, requested)
    steps = min(motion.counts.steps or 0, _MOST_STEPS)
    few = not (motion.is_as_dense_as(2 * steps) or motion.reason)
    seen = look(None, steps) if few else motion
    shares = np.ones(len(sizes))
    first: Trough | None = None
    for trial in range(MOST_TRIALS + 1):
        if INTERRUPTED in (seen.reason, motion.reason):
            return replace(motion, reason=INTERRUPTED), False
        seen_path = _path(seen, sizes)
        trough = deepest_trough(seen_path, tolerance, shares, complete=not seen.reason)
        if trough is None or trial == MOST_TRIALS:
            break
        shares = trough.shares
        found = run(trough.closer())
        if found.reason and not motion.reason:
            break
        first = trough
        motion = found
        seen = look(trough.closer(), steps) if few else motion
    worst = first or trough
    if worst is None:
        return motion, False
    return _noted(motion, worst.note(worst.closer(), tolerance[1], trough is None)), True


@cached_per_thread(64)
def may_grow_again(dae: Dae) -> bool:
    """Return whether states that stay 0 where they are 0 together may shrink and grow again.

    Each of them lets the others grow. Populations and concentrations are such states; in a
    mechanical system, a state brings others back.
    """
    symbols = ca.vertcat(dae.x, dae.t, dae.z, dae.u)
    place = np.abs(np.array(at_irregular_place(symbols, symbols))).reshape(-1, 1)
    x, t, z, u = np.split(place, np.cumsum([a.numel() for a in (dae.x, dae.t, dae.z)]))
    p = np.array([parameter.start for parameter in dae.parameters], dtype=float)

    def rates(states: Vector) -> Vector:
        return np.array(equations(dae)(t, states, z, u, p)[0])

    starts = np.array(dae.x_start)
    sizes = np.fmax(own_sizes(dae, starts), np.abs(starts))[:, None]
    grown = np.hstack([rates(scale * sizes * x) for scale in (1e-3, 1.0, 1e3)])
    group, last = (grown != 0).any(axis=1), None
    while (group != last).any():
        last = group
        group = resting(rates, x, last)
        others = np.where(group[:, None], 0, x)
        drives = rates(others + np.diag(x[:, 0]))[:, group]
        drives[np.eye(len(x), dtype=bool)[:, group]] = 0
        group = group & (drives >= 0).all(axis=1)
    grows, shrinks = np.any(grown > 0, axis=1), np.any(grown < 0, axis=1)
    return bool(np.any(group & grows & shrinks))


def growth_in(
    motion: Motion,
    tolerance: Tolerance,
    go_on: Continuation | None,
    closer: Closer | None = None,
) -> Growth | None:
    """Return the smallest deviation that a motion does not follow; see `unfollowed_growth`.

    Args:
        motion, tolerance, closer: The motion, and how it was found.
        go_on: Tells what events make of a deviation; None if there are none.
    """
    if not any_grows(motion.dae) or not len(motion.time):
        return None
    path = _path(motion, _sizes(motion, tolerance))
    known = motion.counts.steps or 0, *tolerance.pair
    if go_on and _is_held(motion, path, known, go_on):
        return None
    return unfollowed_growth(path, *known, closer)


def _is_held(
    motion: Motion, path: StatePath, known: tuple[int, float, float], go_on: Continuation
) -> bool:
    """Return whether events or friction hold each deviation that may grow by the equations.

    Args:
        motion, path: The motion, and its path.
        known: Its steps and tolerances.
        go_on: See `growth_in`.
    """
    begin, spans = -np.inf, growing_times(path, *known)
    for _ in range(_LOOKS):
        spans = spans[spans[:, 1] > begin]
        if not len(spans):
            break
        begin = max(begin, float(spans[:, 0].min()))
        row = int(path.time.searchsorted(begin, "right")) - 1
        if not _fades(motion, path, row, controlled_half(*known[1:]), go_on):
            return False
        begin = (begin + float(path.time[-1])) / 2
    return True


def _fades(motion: Motion, path: StatePath, row: int, size: float, go_on: Continuation) -> bool:
    """Return whether a deviation does not grow up to the end.

    Args:
        motion, path, go_on: See `_is_held`.
        row: Of the path, at which the deviation begins.
        size: Of the deviation there, in nominal values; it shall not come half-way to 1.
    """
    begin, states = path.time[row], path.states[:, row]
    rows = np.flatnonzero(motion.time > begin)
    if not len(rows):
        return False
    shares = size * (1 + np.modf(np.sqrt(2) * np.arange(len(states)))[0])  # no symmetric deviation
    states = states + np.where(path.grows, shares * path.sizes, 0)
    times, guess = np.append(begin, motion.time[rows]), motion.algebraics[:, rows[0]]
    try:
        other = go_on(times, states, guess)
    except CosimError:  # an event has no result from there
        return False
    if other.reason or other.note or len(other.time) < len(times):
        return False
    deviations = np.abs(other.states[:, 1:] - motion.states[:, rows]) / path.sizes[:, None]
    largest = np.append(shares.max(), deviations[path.grows].max(axis=0))
    first, second = np.array_split(largest, 2)
    return bool(largest.max() < np.sqrt(size) and second.max() <= _FADES * first.max())


def may_grow(motion: Motion, tolerance: Tolerance) -> bool:
    """Return whether `growth_in` may find one, also where the events of a motion are not known."""
    if not any_grows(motion.dae) or len(motion.time) < 2:
        return False
    path = _path(motion, _sizes(motion, tolerance))
    return has_lines(path, motion.counts.steps or 0, *tolerance.pair)


def _sizes(motion: Motion, tolerance: Tolerance) -> Vector:
    """Return the nominal values of the states that the error control of a motion had, (nx,)."""
    return error_sizes(motion.dae, motion.states[:, 0], tolerance.absolute)


def _path(motion: Motion, sizes: Vector) -> StatePath:
    """Return the path of a motion; unknowns and inputs are those of the row before a place."""
    motion = motion.with_sides()

    def rates(times: Vector, states: Vector) -> Vector:
        z, u = _known(motion, times)
        at = replace(motion, time=times, states=states, algebraics=z, u=u)
        return rates_at(at, slice(None))

    def slopes(times: Vector, states: Vector) -> Vector:
        return _slopes(motion.dae, times[None], states, *_known(motion, times), motion.p)

    names = [state.name for state in motion.dae.states]
    return StatePath(names, motion.time, motion.states, sizes, rates, slopes, _fed_back(motion.dae))


def _known(motion: Motion, times: Vector) -> tuple[Vector, Vector]:
    """Return the algebraic unknowns and the inputs of the rows at or before times."""
    rows = motion.time.searchsorted(times, "right") - 1
    u = np.broadcast_to(motion.u, (len(motion.u), len(motion.time)))
    return motion.algebraics[:, rows], u[:, rows]


def any_grows(dae: Dae) -> bool:
    """Return whether any deviation may grow by e, because its states act on themselves."""
    return bool(_fed_back(dae).any())


@cached_per_thread(16)
def _fed_back(dae: Dae) -> Truths:
    """Return which states act on their own rates, be it by others, (nx,); no others grow by e.

    Algebraic unknowns are taken to pass on everything.
    """
    if dae.algebraics:
        return np.ones(len(dae.states), dtype=bool)
    acts = ca.jacobian_sparsity(dae.ode, dae.x)
    _, order, ends = acts.scc()
    found = np.array([acts.has_nz(i, i) for i in range(len(dae.states))], dtype=bool)
    for first, last in pairwise(ends):
        found[order[first:last]] |= last - first > 1
    return found


def _slopes(dae: Dae, t: Vector, x: Vector, z: Vector, u: Vector, p: Vector) -> Vector:
    """Return the derivatives of dx/dt by the states at places, (m, nx, nx).

    They are not numbers where the algebraic equations do not determine their unknowns.

    Args:
        dae: The model.
        t, x, z, u, p: The places, where the algebraic equations hold: (1, m), (nx, m) ...; one
            column may serve all.
    """
    blocks = _blocks(dae).call([t, x, z, u, p])
    by_x, by_z, alg_x, alg_z = (_at_places(block, t.size) for block in blocks)
    for k in range(t.size if dae.algebraics else 0):
        try:
            by_x[k] -= by_z[k] @ np.linalg.solve(alg_z[k], alg_x[k])
        except np.linalg.LinAlgError:
            by_x[k] = np.nan
    return by_x


def _at_places(block: ca.DM, places: int) -> Vector:
    """Return matrices beside each other, (n, m * places), as (places, n, m)."""
    columns = block.shape[1] // places
    found = np.zeros((places, block.shape[0], columns))
    row, column = (np.array(own, dtype=int) for own in block.sparsity().get_triplet())
    found[column // max(columns, 1), row, column % max(columns, 1)] = block.nonzeros()
    return found


@cached_per_thread(16)
def _blocks(dae: Dae) -> ca.Function:
    pairs = ((of, by) for of in (dae.ode, dae.alg) for by in (dae.x, dae.z))
    slopes = [ca.jacobian(*pair) for pair in pairs]
    return ca.Function("slopes", dae.arguments, slopes, {"cse": True})


def growing_starts(
    dae: Dae, starts: Sequence[Vector], span: tuple[float, float], tolerance: tuple[float, float]
) -> Truths:
    """Return in which runs a deviation from a motion that begins as a line grows unseen, (runs,).

    Args:
        dae: A model without algebraic unknowns.
        starts: Initial and nominal values of the states, inputs, parameters: (runs, nx) twice,
            (runs, nu), (runs, np).
        span: Start and end of the runs, s.
        tolerance: Relative and absolute tolerance, the latter in nominal values.
    """
    x, sizes, u, p = (rows.T for rows in starts)
    begin, end = span
    found = np.zeros(x.shape[1], dtype=bool)
    if not (found.size and any_grows(dae)):
        return found
    at = np.full((1, len(found)), begin)
    slopes = _slopes(dae, at, x, np.empty((0, 1)), u, p) * sizes.T[:, None] / sizes.T[:, :, None]
    growth = np.nan_to_num(np.linalg.norm(slopes, axis=(1, 2)), posinf=0.0)
    for i in np.flatnonzero(growth * (end - begin) > 1):
        at = np.array([begin, end])
        motion = Motion(dae, at, x[:, [i, i]], np.empty((0, 2)), u[:, [i]], p[:, i], Counts())
        found[i] = growth_from_start(_path(motion, sizes[:, i]), *tolerance) is not None
    return found
