"""Where a run crosses a position in which its constraints lose rank.

Branches of motion meet there, bars that all lie in a line for instance: equations with multipliers
have no solution at the very position, and a solver whose steps straddle it may leave along another
branch without an error to be seen. The condition of the constraints, which a model declares as a
monitor, has its pole there; outputs alone would miss it.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.functions import equations
from cosim.integrate.diagnosis.validity import Breach
from cosim.memo import kept_per_thread
from cosim.model.rank import LOST, MONITOR, constraint_condition, distance_from_loss, watches_rank

SUSPECTED = 3.0  # intervals within which lines through neighbours reach 0 from both sides, at most
_POINTS, _ZOOMS = 33, 4
_COARSE = 1.5  # of the model's own output interval, at which branches can be told apart
_MOST_TIMES = 20_000  # at which a run is looked at


@kept_per_thread(8)
def watching_rank(dae: Dae) -> Dae:
    """Return a model whose last limit is the distance of its constraints from losing rank.

    It is one over their condition: 1 at best, 0 where rank is lost. A model without that monitor is
    returned as it is.
    """
    if constraint_condition(dae) is None:
        return dae
    margin = distance_from_loss(dae), "the constraints have full rank"
    return replace(dae, limits=(*dae.limits, margin))


def times_between(dae: Dae, grid: Vector) -> Vector | None:
    """Return output times with others between, close enough to see a crossing; None where they are.

    Args:
        dae: A model; one without that monitor has nothing to see.
        grid: Output times, s, (n,).
    """
    if not watches_rank(dae):  # explicit forms end at such a position
        return None
    span = float(grid[-1] - grid[0])
    gap = max(dae.experiment.output_interval, span / _MOST_TIMES)
    lengths = np.diff(grid)
    if not (lengths > _COARSE * gap).any():
        return None
    pieces = np.maximum(1, np.ceil(lengths / gap)).astype(int)
    inner = [
        np.linspace(a, b, k, endpoint=False)
        for a, b, k in zip(grid, grid[1:], pieces, strict=False)
    ]
    return np.concatenate((*inner, grid[-1:]))


def close_times(dae: Dae, grid: Vector) -> Vector:
    """Return even times over the span of a grid, close enough to see a crossing, s."""
    span = float(grid[-1] - grid[0])
    gap = min(dae.experiment.output_interval, span / (len(grid) - 1))
    pieces = int(np.ceil(span / max(gap, span / _MOST_TIMES)))
    return np.linspace(grid[0], grid[-1], pieces + 1)


class RankLoss(NamedTuple):
    """A position between two outputs, or at one, in which constraints lose rank.

    Attributes:
        position: Of the output before it.
        when: s.
        distance: One over the condition there.
    """

    position: int
    when: float
    distance: float

    def told(self, time: Vector) -> Breach:
        """Say what it means for a run that has gone on."""
        after = self.position + 1
        return Breach(
            after,
            f"from {time[after]:g} s on the motion may be another one: the constraints lose rank "
            f"at {self.when:.4g} s ({MONITOR} {1 / max(self.distance, 1e-16):.0e}), where branches "
            "of motion meet; dop853 with projection keeps to its own",
        )


def rank_losses(
    dae: Dae, time: Vector, states: Vector, algebraics: Vector, u: Vector, p: Vector, rank: Vector
) -> Iterator[RankLoss]:
    """Yield the positions in which constraints lose rank, in their order; of a stretch, its begin.

    Args:
        dae: The model.
        time: Output times, s, (n,).
        states, algebraics, u: There, n columns each; one of u where inputs are constant.
        p: Parameters.
        rank: Last limit of `watching_rank` there, (n,).
    """
    n, lost = len(time), rank * LOST < 1
    suspects = {*_suspects(time, rank), *(np.flatnonzero(lost[1:]).tolist())}
    if not suspects:
        return
    law, u, last = _law(dae), np.broadcast_to(u, (len(u), n)), -2
    for k in sorted(suspects):
        # along the motion, and along what it was before and after, lest the branch has changed
        parts = [(k, k + 2), (max(0, k - 2), k + 1), (k + 1, min(n, k + 4))]
        found = [(float(rank[k + 1]), float(time[k + 1]))]
        for begin, end in parts:
            at = slice(begin, end)
            end_values = (time[at], states[:, at], algebraics[:, at], u[:, at])
            rates = np.array(equations(dae)(end_values[0][None], *end_values[1:], p)[0])
            curve = _curve(time[at] - time[k], states[:, at], rates)
            found.append(_closest(law, curve, time[k : k + 2], algebraics[:, k], u[:, k], p))
        distance, when = min(found)
        if distance * LOST < 1 and time[0] < when < time[-1]:
            if k > last + 1:
                yield RankLoss(k, when, distance)
            last = k


@kept_per_thread(8)
def _law(dae: Dae) -> ca.Function:
    return ca.Function("rank", dae.arguments, [distance_from_loss(dae)], {"cse": True})


def _suspects(time: Vector, rank: Vector) -> list[int]:
    """Return the intervals in which a run of numbers seems to touch 0 like a modulus.

    The first and the last one have a neighbour on one side only, which stands for both.
    """
    if len(time) < 3:
        return []
    length, falls = time[1:] - time[:-1], rank[:-1] - rank[1:]
    with np.errstate(divide="ignore", invalid="ignore"):  # at a time that stands twice
        slope = falls / length
        before = np.concatenate((-slope[1:2], slope[:-1]))
        after = np.concatenate((-slope[1:], slope[-2:-1]))
        reach = rank[:-1] / before + rank[1:] / after
    touched = (before > 0) & (after > 0) & (reach <= SUSPECTED * length)
    return [int(k) for k in np.flatnonzero(touched)]


def _curve(time: Vector, states: Vector, rates: Vector) -> Vector:
    """Return the coefficients of the polynomial with these states and rates, lowest first."""
    powers = np.arange(2 * len(time))
    values = time[:, None] ** powers
    slopes = powers * time[:, None] ** np.maximum(powers - 1, 0)
    both = np.vstack((values, slopes)), np.hstack((states, rates)).T
    return np.asarray(np.linalg.solve(*both), dtype=float)


def _closest(
    law: ca.Function, curve: Vector, span: Vector, z: Vector, u: Vector, p: Vector
) -> tuple[float, float]:
    """Return the least distance from losing rank along a curve between two times, and when."""
    low, high = 0.0, float(span[1] - span[0])
    best, when = np.inf, 0.0
    for _ in range(_ZOOMS):
        s = np.linspace(low, high, _POINTS)
        x: Vector = (s[:, None] ** np.arange(len(curve)) @ curve).T
        distances = np.array(law((span[0] + s)[None], x, z, u, p)).ravel()
        distances = np.where(np.isfinite(distances), distances, np.inf)
        i = int(np.argmin(distances))
        best, when = float(distances[i]), float(s[i])
        width = (high - low) / (_POINTS - 1)
        low, high = max(low, when - width), min(high, when + width)
    return best, float(span[0]) + when
