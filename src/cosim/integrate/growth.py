"""`followed_growth`: a motion in which no unstable deviation is kept from growing.

Near an unstable equilibrium a deviation grows from far below the absolute tolerance. The error
control does not see it there: steps become longer than the time of growth, and an implicit one
suppresses it. Where the motion is a straight line to the tolerance, the eigenvalues tell how far
the deviation would have grown; to be seen from the beginning, it needs a smaller tolerance.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.integrate.motion import Motion, rates_at
from cosim.memo import cached_per_thread
from cosim.model.solver import AdaptiveSolver
from cosim.model.values import own_sizes

_EPS = float(np.finfo(float).eps)
_ROUNDINGS = 4  # of the rates, within which a push may be rounding
_FEWEST, _MOST_SPANS = 2, 8  # rows after the first of a line; lines
_MOST_EXPONENT = 600.0


class Growth(NamedTuple):
    """A deviation that grows unseen.

    Attributes:
        state: Name of the state in which it is largest.
        time: When it begins, s.
        growth_time: In which it grows by the factor e, s.
        size: Its size at the beginning, in nominal values.
    """

    state: str
    time: float
    growth_time: float
    size: float


def followed_growth(
    run: Callable[[AdaptiveSolver], Motion], solver: AdaptiveSolver, p: Vector
) -> Motion:
    """Return the motion of a solver, or of one with a smaller tolerance where deviations need it.

    Args:
        run: Integrates with a solver.
        solver: The solver.
        p: Parameters.
    """
    motion = run(solver)
    relative, absolute = solver.tolerance.pair
    growth = suppressed_growth(motion, p, relative, absolute)
    if growth is None:
        return motion
    smaller = relative * growth.size
    closer = run(replace(solver, absolute_tolerance=smaller))
    advice = f"ran with absolute_tolerance {smaller:.2g}, so that it is followed"
    if closer.reason:
        closer, advice = motion, f"it may be suppressed; give absolute_tolerance {smaller:.2g}"
    text = (
        f"from {growth.time:.6g} s on, a deviation of {growth.size:.2g} nominal values of "
        f"{growth.state} grows by e every {growth.growth_time:.3g} s; {advice}"
    )
    return replace(closer, note="; ".join(filter(None, (closer.note, text))))


def suppressed_growth(motion: Motion, p: Vector, relative: float, absolute: float) -> Growth | None:
    """Return the smallest deviation that would become visible, but has not been followed.

    Args:
        motion: Result of a solver with error control.
        p: Parameters.
        relative, absolute: Its tolerances; the absolute one in nominal values.
    """
    if motion.reason or len(motion.time) < 2 or not motion.dae.states:
        return None
    rows = _rows_per_step(motion)
    sizes = own_sizes(motion.dae, motion.states[:, 0])
    found = [
        growth
        for first, last in _straight(motion, rows, relative, absolute * sizes, p)
        if (growth := _growth(motion, first, last, p, absolute, sizes))
    ]
    return min(found, key=lambda growth: growth.size, default=None)


def _rows_per_step(motion: Motion) -> Vector:
    """Return rows that are about a step of the solver apart, in which it is never straight."""
    t, steps = motion.time, max(motion.counts.steps or 0, 1)
    wanted = np.linspace(t[0], t[-1], min(len(t), steps + 1))
    return np.unique(np.clip(t.searchsorted(wanted), 0, len(t) - 1))


def _straight(
    motion: Motion, rows: Vector, relative: float, absolute: Vector, p: Vector
) -> list[tuple[int, int]]:
    """Return spans, by their first and last row, in which all states are lines in time."""
    t, x = motion.time[rows], motion.states[:, rows]
    gaps = np.diff(t)
    slopes = np.diff(x, axis=1) / gaps
    if len(gaps) == 1:
        before = rates_at(motion, rows[:1], p)
    else:
        before = np.hstack((slopes[:, 1:2], slopes[:, :-1]))
    least = relative * np.abs(x[:, 1:]) + absolute[:, None]
    calm = np.concatenate(([0], (np.abs((slopes - before) * gaps) <= least).all(axis=0), [0]))
    edges = np.flatnonzero(np.diff(calm)).reshape(-1, 2)
    edges = edges[np.diff(edges)[:, 0] >= min(_FEWEST, len(gaps))]
    longest = sorted(edges.tolist(), key=lambda span: t[span[0]] - t[span[1]])[:_MOST_SPANS]
    return [(int(rows[first]), int(rows[last])) for first, last in longest]


def _growth(
    motion: Motion, first: int, last: int, p: Vector, absolute: float, sizes: Vector
) -> Growth | None:
    t = motion.time
    slopes = _slopes(motion, first, p) * sizes / sizes[:, None]
    if not np.isfinite(slopes).all():
        return None
    values, left = np.linalg.eig(slopes.T)
    growing = values.real * (t[last] - t[first]) > 1
    if not growing.any():
        return None
    rows = np.unique([first, (first + last) // 2, last])
    f = rates_at(motion, rows, p) / sizes[:, None]
    rounding = _EPS * np.abs(slopes) @ np.abs(motion.states[:, rows] / sizes[:, None])
    found = list[Growth]()
    for value, direction in zip(values[growing], left.T[growing], strict=True):
        push = np.abs(direction @ f)
        push = push[push > _ROUNDINGS * np.abs(direction) @ rounding]
        rate, size = float(value.real), float(push.min(initial=np.inf)) / abs(value)
        seen = size * np.exp(min(rate * (t[-1] - t[first]), _MOST_EXPONENT)) > absolute
        if len(push) and seen:
            state = motion.dae.states[int(np.argmax(np.abs(direction)))].name
            found.append(Growth(state, float(t[first]), 1 / rate, size))
    return min(found, key=lambda growth: growth.size, default=None)


def _slopes(motion: Motion, row: int, p: Vector) -> Vector:
    """Return the derivatives of the rates with respect to the states at a row, (nx, nx)."""
    u = motion.u[:, min(row, motion.u.shape[1] - 1)]
    at = motion.time[row], motion.states[:, row], motion.algebraics[:, row], u, p
    of_x, of_z, *closing = (np.array(block) for block in _blocks(motion.dae)(*at))
    if not closing:
        return np.asarray(of_x)
    try:
        return np.asarray(of_x - of_z @ np.linalg.solve(closing[1], closing[0]))
    except np.linalg.LinAlgError:
        return np.full(of_x.shape, np.nan)


@cached_per_thread(16)
def _blocks(dae: Dae) -> ca.Function:
    """Return the derivatives of dx/dt and of the algebraic equations by x and z."""
    laws = [dae.ode, dae.alg] if dae.algebraics else [dae.ode]
    blocks = [ca.densify(ca.jacobian(law, of)) for law in laws for of in (dae.x, dae.z)]
    return ca.Function("blocks", dae.arguments, blocks, {"cse": True})
