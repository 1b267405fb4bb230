"""`first_left`: when validity conditions are violated first, be it for a small part of a step.

A condition is a relation on which no law depends. The kernel of events encloses its margin between
two rows of a motion, and searches where that proves nothing; there the motion gets further rows.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae
from casadi_models.dae.expressions import column
from casadi_models.dae.hybrid import Hybrid
from casadi_models.dae.time_bounds import limit_enclosures
from cosim.arrays import Truths, Vector
from cosim.errors import MissingTool
from cosim.integrate.call import call_on_arrays
from cosim.integrate.kernel import Kernel, Rows
from cosim.integrate.modes import Instant
from cosim.integrate.motion import Motion
from cosim.memo import cached_per_thread

Again = Callable[[Vector], Motion]  # further times of rows -> the motion with these

_ROUNDS, _MOST_ROWS = 4, 50_000  # of rows that are added; in a motion
_INNER = 8  # parts of an interval that proves nothing
_SPANS = 1, 32  # parts of a run, whose spans are tried first
_CLOSE = 1e-9  # relative difference of times that are one
_NEAR = 6  # rows on each side of a violation, each 1/8 as far from it as the one before


class _Watched(NamedTuple):
    """Validity conditions whose margins have bounds.

    Attributes:
        limits: Their positions in the model.
        system: Their margins as relations; its states are the model's states and inputs that they
            depend on.
        moved: Positions of these among all states and inputs.
        rates: `(t, x, z, u, p) -> rates of these states`, inputs left out.
        margins: `(t, moved, p) -> margins`.
        lows: `(t, length, least, most, p) -> lower bounds of margins` over a length from t on, from
            values of what moves.
    """

    limits: tuple[int, ...]
    system: Hybrid
    moved: tuple[int, ...]
    rates: ca.Function
    margins: ca.Function
    lows: ca.Function


@cached_per_thread(16)
def _watched(dae: Dae) -> _Watched | None:
    """Return the validity conditions whose margins have bounds; None if there are none."""
    limits = limit_enclosures(dae).relations
    if not limits:
        return None
    margins = ca.densify(ca.vertcat(*(dae.limits[i][0] for i in limits)))
    moving = ca.vertcat(dae.x, dae.u)
    depends = ca.which_depends(margins, moving, 1, False) if moving.numel() else []
    moved = tuple(i for i, own in enumerate(depends) if own)
    x = column(moving[i] for i in moved)
    variables = tuple((*dae.states, *dae.inputs)[i] for i in moved)
    none = SX(0, 1)
    plain = Dae(
        "limits", "", "", "", dae.experiment, dae.t, x, none, none, dae.p, SX.zeros(len(moved)),
        none, none, variables, (), (), dae.parameters, (), (), (), (), (0.0,) * len(moved),
    )  # fmt: skip
    system = Hybrid(plain, (), (), ()).watching_more(margins, "limit")
    system = replace(system, of_time=(False,) * len(limits), encloses_lines=True)
    part = system.enclosures
    rows = (dae.ode[i] for i in moved if i < dae.x.numel())
    rates = ca.densify(ca.vertcat(none, *rows))
    return _Watched(
        limits,
        system,
        moved,
        ca.Function("rates", dae.arguments, [rates], {"cse": True}),
        ca.Function("margins", [dae.t, x, dae.p], [margins], {"cse": True}),
        ca.Function("lows", [dae.t, *part.given[:3], dae.p], [part.low[::2]], {"cse": True}),
    )


def first_left(motion: Motion, again: Again) -> dict[int, float]:
    """Return when validity conditions whose margins have bounds are violated first, s.

    Args:
        motion: The motion.
        again: Returns it with further rows.

    Returns:
        Times by the positions of the conditions in the model, infinite if a condition holds.

    Raises:
        UsageError: See `kernel_library`.
    """
    watched = _watched(motion.dae)
    if watched is None or len(motion.time) < 2:
        return {}
    if _holds(watched, motion):
        return dict.fromkeys(watched.limits, np.inf)
    try:
        search = _Search(watched, motion.p, float(np.ptp(motion.time)))
    except MissingTool:  # without a compiler, rows show most
        return {}
    found, rows, last = search.left(motion), np.empty(0), None
    for _ in range(_ROUNDS):
        rows = np.union1d(rows, found.more)
        if not len(found.more) or len(rows) > _MOST_ROWS or _agree(found, last):
            break
        found, last = search.left(again(rows)), found
    return dict(zip(watched.limits, found.times.tolist(), strict=True))


def _holds(watched: _Watched, motion: Motion) -> bool:
    """Return whether spans of what moves between close rows prove that the conditions hold."""
    t = motion.time
    steps = motion.counts.steps
    if motion.instants or not steps or not motion.is_as_dense_as(max(3, steps)):
        return False
    u = np.broadcast_to(motion.u, (len(motion.u), len(t)))
    nx = len(motion.states)
    x = np.array([motion.states[i] if i < nx else u[i - nx] for i in watched.moved])
    x = x.reshape(-1, len(t))
    bend = np.abs(np.diff(x, 2)).max(axis=1, initial=0)  # eight times what lines are off
    buffer, low = watched.lows.buffer(), np.empty(len(watched.limits))
    for parts in _SPANS:
        edges = np.arange(0, len(t) - 1, -(-(len(t) - 1) // parts))
        ends = np.append(edges[1:], len(t) - 1)
        least, most = (
            function(function.reduceat(x, edges, axis=1), x[:, ends]).T
            for function in (np.minimum, np.maximum)
        )
        spans = t[edges, None], (t[ends] - t[edges])[:, None], least - bend, most + bend
        every = zip(*spans, strict=True)
        if all(call_on_arrays(buffer, [*own, motion.p], [low]) and low.min() > 0 for own in every):
            return True
    return False


class _Left(NamedTuple):
    """When conditions are violated first, s, infinite for never; and rows that tell it closer."""

    times: Vector
    more: Vector


def _agree(one: _Left, other: _Left | None) -> bool:
    """Return whether two searches have the same result, but for the error of a cubic."""
    if other is None or not np.isfinite(one.times).all():
        return False
    return bool(np.isclose(one.times, other.times, _CLOSE, 0).all())


class _Search:
    """The search of the kernel, for the conditions of a model."""

    def __init__(self, watched: _Watched, p: Vector, span: float) -> None:
        self.watched = watched
        self.p = p
        nominal = np.array([v.nominal for v in watched.system.dae.states])
        self.kernel = Kernel(watched.system, p, nominal, span)

    def left(self, motion: Motion) -> _Left:
        """Return when each condition is violated first in a motion."""
        rows, margins = self._rows(motion.with_sides())
        t = rows.times
        kernel = self.kernel
        ones, none = np.ones(margins.shape[1]), np.empty(0)
        kernel.begin(Instant(float(t[0]), rows.x[0], none, none, none, ones))
        rows = rows._replace(inside=kernel.switching.slack + margins)
        outside = ~(margins > 0)
        times = np.full(len(ones), np.inf)
        times[outside[0]] = t[0]
        kernel.switching.slack[outside[0]] = np.inf  # from now on, it is not looked at
        more = [np.empty(0)]
        for k in np.flatnonzero(~kernel.stay(rows) | outside[1:].any(axis=1)).tolist():
            if np.isfinite(times).all():
                break
            begin, end = t[k : k + 2].tolist()
            while True:
                time, i = self._next(rows, k, outside[k + 1] & ~np.isfinite(times))
                if i < 0:
                    break
                times[i] = time
                kernel.switching.slack[i] = np.inf
                near = (end - begin) * 8.0 ** -np.arange(_NEAR)
                more.append(np.clip([time - near, time + near], begin, end).ravel())
            more.append(np.linspace(begin, end, _INNER + 1))
        every = np.unique(np.concatenate(more))
        return _Left(times, every[~np.isin(every, t)])

    def _next(self, rows: Rows, k: int, outside: Truths) -> tuple[float, int]:
        """Return the first violation between two rows, and of which condition; or -1.

        Conditions that are `outside` at the end have been violated before.
        """
        end = slice(k, k + 2)
        if rows.times[k + 1] > rows.times[k]:
            columns = *(a[end] for a in rows[:-1]), rows.defects[k : k + 1]
            found = self.kernel.search(Rows(*columns), np.empty(0))
            if found[1] >= 0:
                return found
        i = int(np.argmax(outside))
        return float(rows.times[k + 1]), i if outside[i] else -1

    def _rows(self, motion: Motion) -> tuple[Rows, Vector]:
        """Return the rows of what moves the margins, and these, (n, conditions)."""
        t = motion.time
        watched = self.watched
        columns = t[None], motion.states, motion.algebraics, motion.u, self.p
        x = np.vstack((motion.states, motion.u))[list(watched.moved)].T
        own = np.array(watched.rates(*columns)).reshape(-1, len(t)).T
        with np.errstate(divide="ignore", invalid="ignore"):
            moving = np.gradient(x[:, own.shape[1] :], t, axis=0)
        dx = np.hstack((own, np.where(np.isfinite(moving), moving, 0)))
        margins = np.array(watched.margins(t[None], x.T, self.p)).reshape(-1, len(t)).T
        modes = np.ones_like(margins)
        every = t, x, dx, modes, 0 * modes, margins, _defects(t, x, dx)
        return Rows.of(*every), margins


def _defects(t: Vector, x: Vector, dx: Vector) -> Vector:
    """Return what the slopes of cubics between rows are off by at most, (n - 1, nx).

    The cubic through the neighbors of a row is off there by a derivative of order 4, which is
    at most so large between the rows, too.
    """
    h = np.diff(t)
    found = np.zeros((len(t), x.shape[1]))
    if len(t) > 2:
        s, r, length = h[:-1, None], h[1:, None], (t[2:] - t[:-2])[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            a = r / length
            b = s / length
            cubic = a * a * (1 + 2 * b) * x[:-2] + b * b * (1 + 2 * a) * x[2:]
            cubic += length * a * b * (a * dx[:-2] - b * dx[2:])
            off = np.abs(cubic - x[1:-1]) / (s * r) ** 2
        found[1:-1] = np.where((s > 0) & (r > 0), off, 0)
        found[[0, -1]] = found[[1, -2]]
    return np.asarray(np.maximum(found[:-1], found[1:]) * h[:, None] ** 3)
