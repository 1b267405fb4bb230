"""Checks of a run: validity conditions, step sizes, and singular configurations."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from casadi_models.dae import Dae
from casadi_models.dae.invariants import CONSTRAINT_CONDITION, SINGULAR_CONDITION
from cosim.arrays import Vector
from cosim.codegen.functions import equations
from cosim.codegen.runge_kutta.tableau import DIVERGED
from cosim.errors import InitialConditionError
from cosim.integrate.initial_values import consistent_values
from cosim.integrate.modes import hybrid
from cosim.integrate.motion import Motion
from cosim.integrate.outputs import Observed
from cosim.memo import cached_per_thread
from cosim.model.values import assign
from cosim.series.samples import NOT_GIVEN, ROUNDING_OF_OTHERS
from cosim.text import Violation, violated

STEP_DOUBT = 1e-2  # largest change of a state when a fixed step is halved, in nominal values


class Breach(NamedTuple):
    """The position of the first output time that is not valid, and the reason with its time."""

    position: int
    reason: Violation


def breaches(motion: Motion, seen: Observed, n: int, left: Mapping[int, float]) -> list[Breach]:
    """Return when each validity condition of the model is violated for the first time.

    A violation is located between output times, where the margin of its condition passes 0 or may
    do so and return, on the cubic through the states and their rates.

    Args:
        motion: The motion.
        seen: Its margins.
        n: Number of output times to check.
        left: When conditions are violated first, s, by their positions, as far as that is known
            better.
    """
    found = list[Breach]()
    for i, (_, meaning) in enumerate(motion.dae.limits):
        if i in left:
            k = int(motion.time[:n].searchsorted(left[i]))
            if k < n:
                found.append(Breach(k, Violation(left[i], violated(meaning))))
            continue
        margin = seen.margins[:n, i]
        for k in _doubtful(margin):
            when = float(motion.time[0]) if k < 0 else _first_outside(motion, seen, i, k)
            if when is not None:
                found.append(Breach(k + 1, Violation(when, violated(meaning))))
                break
    return found


def _doubtful(margin: Vector) -> list[int]:
    """Return the intervals in which a margin may be 0 or less, up to the first that ends so.

    Args:
        margin: At the output times, (n,); what is not a number is not valid.

    Returns:
        Positions of their begins; -1 for the first output time itself.
    """
    outside = ~(margin > 0)
    first = int(np.argmax(outside)) if outside.any() else len(margin)
    if first == 0:
        return [-1] if len(margin) else []
    inside = margin[:first]
    falls = np.diff(inside) < 0
    turns = 1 + np.flatnonzero(falls[:-1] & ~falls[1:])  # rows with least values
    before, least, after = inside[turns - 1], inside[turns], inside[turns + 1]
    # a parabola through three rows reaches at most so far below the least of them
    near = turns[least <= (before - least) + (after - least)]
    last = [first - 1] if first < len(margin) else []
    return sorted({*(near - 1).tolist(), *near.tolist(), *last})


def _first_outside(motion: Motion, seen: Observed, limit: int, k: int) -> float | None:
    """Return when a margin is 0 first in an interval between output times, s; None if it is not."""
    law, ends, p = _margin(motion.dae, limit), slice(k, k + 2), motion.p
    u = np.broadcast_to(motion.u, (len(motion.u), len(motion.time)))[:, ends]
    states, unknowns, time = motion.states[:, ends], seen.unknowns[ends].T, motion.time[ends]
    rates = np.array(equations(motion.dae)(time[None], states, unknowns, u, p)[0])
    curve = _curve(time - time[0], states, rates)
    low, high = 0.0, float(time[1] - time[0])
    for _ in range(2 * _ZOOMS):  # to the rounding of time
        s = np.linspace(low, high, _POINTS)
        x: Vector = (s[:, None] ** np.arange(len(curve)) @ curve).T
        margin = np.array(law((time[0] + s)[None], x, unknowns[:, 0], u[:, 0], p)).ravel()
        outside = ~(margin > 0)
        if outside.any():
            first = int(np.argmax(outside))
            low, high = float(s[max(first - 1, 0)]), float(s[first])
        else:
            least = int(np.argmin(margin))
            low, high = float(s[max(least - 1, 0)]), float(s[min(least + 1, _POINTS - 1)])
    if outside.any():
        return float(time[0]) + high
    return float(time[1]) if not seen.margins[k + 1, limit] > 0 else None


@cached_per_thread(32)
def _margin(dae: Dae, limit: int) -> ca.Function:
    return ca.Function("margin", dae.arguments, [dae.margins[limit]], {"cse": True})


class StepCheck(NamedTuple):
    """What half the step tells of a run with fixed steps, which have no error control.

    Attributes:
        breach: Where the runs differ too much first; None if nowhere.
        diverges: Whether the longer steps make a state `DIVERGED` times too large, or half of them
            fail.
        note: Which state has few digits, although the runs do not differ too much.
    """

    breach: Breach | None = None
    diverges: bool = False
    note: str = ""


def step_check(dae: Dae, time: Vector, states: Vector, finer: Vector, step: float) -> StepCheck:
    """Compare a run of fixed steps with the same run with half the step.

    The difference estimates the error of the longer step. It is too large above `STEP_DOUBT` in
    nominal values. A state without a nominal value has few digits above this share of its largest
    value.

    Args:
        dae: The model.
        time: Output times, s, (n,).
        states: With the longer step, (nx, n).
        finer: With half the step, (nx, up to n); shorter if that run failed.
        step: The longer step, s.
    """
    nominal = np.array([variable.nominal for variable in dae.states])
    known = finer.shape[1]
    change = np.full(states.shape, np.inf)
    with np.errstate(over="ignore", invalid="ignore"):
        change[:, :known] = np.abs(states[:, :known] - finer)
        scaled = change / nominal[:, None]
        peaks = [np.abs(run[:, :known]).max(axis=1, initial=0) for run in (states, finer)]
    outside = np.flatnonzero(~(scaled.max(axis=0, initial=0) <= STEP_DOUBT))
    if outside.size:
        i = int(outside[0])
        row = int(np.argmax(scaled[:, i]))
        off = f"half the step changes {dae.states[row].name} by {change[row, i]:.2g}"
        what = f"the step of {step:g} s is too long: {off if i < known else 'half of it fails'}"
        large = peaks[0] > DIVERGED * np.maximum(peaks[1], nominal)
        diverges = bool(large.any()) or known < states.shape[1]
        return StepCheck(Breach(i, Violation(float(time[i]), what)), diverges)
    size = np.maximum(*peaks)
    free = np.array([variable.nominal == NOT_GIVEN for variable in dae.states], dtype=bool)
    free &= size > ROUNDING_OF_OTHERS * size.max(initial=0)
    shares = np.where(free, change.max(axis=1, initial=0) / np.where(free, size, 1), 0)
    if not (shares > STEP_DOUBT).any():
        return StepCheck()
    row = int(np.argmax(shares))
    share = f"{100 * shares[row]:.2g} % of its largest value"
    text = f"half the step changes {dae.states[row].name} by {share}; set a smaller step_size"
    return StepCheck(note=text)


@dataclass(frozen=True)
class Inspection:
    """Monitors and validity margins at the initial values; None if these do not exist.

    Attributes:
        monitors: Condition numbers, distances and drift, in the order of `Dae.monitors`; infinite
            at a singularity.
        margins: In the order of `Dae.limits`, in the unit of the limited quantity; the model is
            valid while every margin is positive.
    """

    monitors: tuple[float | None, ...]
    margins: tuple[float | None, ...]


def inspect_start(dae: Dae) -> Inspection:
    """Evaluate the monitors and validity margins of a model at its own initial values."""
    n = len(dae.monitors)
    expressions = [e for _, e in dae.monitors] + [margin for margin, _ in dae.limits]
    values = assign(dae)
    try:
        x, z = consistent_values(dae, 0.0, values)
    except InitialConditionError:  # a run reports it
        return Inspection((None,) * n, (None,) * len(dae.limits))
    column = ca.vertcat(ca.SX(0, 1), *expressions)
    function = ca.Function("inspect", dae.arguments, [column])
    found = np.array(function(0.0, x, z, values.u, values.p)).ravel().tolist()
    return Inspection(tuple(found[:n]), tuple(found[n:]))


SUSPECTED = 3.0  # intervals: most that lines through the neighbors need to reach 0 from both sides
_POINTS, _ZOOMS = 33, 4
_COARSE = 1.5  # of the model's own output interval, which resolves the branches of its motion
_MOST_TIMES = 20_000  # at which a run is checked


@cached_per_thread(8)
def with_singularity_margin(dae: Dae) -> Dae:
    """Return a model with the distance from a singular configuration as last validity margin.

    The distance is the reciprocal condition number of the constraints: 1 at best, 0 in a singular
    configuration. A model without that monitor is returned unchanged.
    """
    if dae.constraint_condition is None:
        return dae
    margin = dae.distance_from_singularity, "the configuration is not singular"
    return replace(dae, limits=(*dae.limits, margin))


def times_between(dae: Dae, grid: Vector, step: float | None = None) -> Vector:
    """Return output times with further times between, to detect what happens there.

    Args:
        dae: The model; without events, validity conditions and the monitor of its constraints,
            nothing is added.
        grid: Output times, s, (n,).
        step: Of a solver with fixed steps, s, which end at these times; else they are the model's
            output interval apart, or more in very long runs.
    """
    # explicit formulations fail in singular configurations
    watched = dae.has_conditioned_multipliers or dae.limits or hybrid(dae)
    if not watched or len(grid) < 2:
        return grid
    span = float(grid[-1] - grid[0])
    gap = max(step or dae.experiment.output_interval, span / _MOST_TIMES)
    lengths = np.diff(grid)
    if not (lengths > _COARSE * gap).any():
        return grid
    pieces = np.maximum(1, np.ceil(lengths / gap * (1 - 1e-12))).astype(int)
    if step is not None:
        pieces = np.array(
            [_whole_steps(*pair) for pair in zip(lengths / step, pieces, strict=True)]
        )
    begins, steps, firsts = (
        np.repeat(each, pieces) for each in (grid[:-1], lengths / pieces, pieces.cumsum() - pieces)
    )
    return np.append(begins + (np.arange(len(begins)) - firsts) * steps, grid[-1])


def _whole_steps(steps: float, pieces: int) -> int:
    """Return the largest number of pieces, up to the given one, that are steps without a rest."""
    count = max(1, int(np.ceil(steps * (1 - 1e-12))))
    return next(n for n in range(min(pieces, count), 0, -1) if count % n == 0)


class SingularConfiguration(NamedTuple):
    """A singular configuration between two output times, or at one.

    Attributes:
        position: Position of the output time before it.
        when: Its time, s.
        distance: Reciprocal condition number of the constraints at that time.
    """

    position: int
    when: float
    distance: float


PROJECTION = 'pass it with drift_control="projection" (--drift-control projection)'


def first_singular_configuration(motion: Motion, seen: Observed, n: int) -> Breach | None:
    """Return how many output times lie before the first singular configuration, and a message.

    Args:
        motion: The motion.
        seen: Its margins; the last one is that of `with_singularity_margin`.
        n: Number of output times to check.

    Returns:
        None if no configuration is singular.
    """
    dae, time, states = motion.dae, motion.time[:n], motion.states[:, :n]
    unknowns, inputs, distance = seen.unknowns[:n].T, motion.u[:, :n], seen.margins[:n, -1]
    every = singular_configurations(dae, time, states, unknowns, inputs, motion.p, distance)
    first = next(every, None)
    if first is None:
        return None
    text = (
        f"singular configuration at {first.when:.4g} s ({CONSTRAINT_CONDITION} "
        f"{1 / max(first.distance, 1e-16):.0e}), where the motion has several continuations"
    )
    if not dae.has_conditioned_multipliers:
        text += "; use a formulation with multipliers"
    return Breach(first.position + 1, Violation(first.when, text, text))


def singular_configurations(
    dae: Dae, time: Vector, states: Vector, algebraics: Vector, u: Vector, p: Vector, rank: Vector
) -> Iterator[SingularConfiguration]:
    """Yield the singular configurations of a run in their order; of an interval, its start.

    Args:
        dae: The model.
        time: Output times, s, (n,).
        states, algebraics, u: Values at these times, n columns each; one of u if it is constant.
        p: Parameters.
        rank: Margin of `with_singularity_margin` at these times, (n,).
    """
    n, singular = len(time), rank * SINGULAR_CONDITION < 1
    suspects = {*_suspects(time, rank), *(np.flatnonzero(singular[1:]).tolist())}
    if not suspects:
        return
    law = _margin(with_singularity_margin(dae), -1)
    u, last = np.broadcast_to(u, (len(u), n)), -2
    for k in sorted(suspects):
        # also along the motion before and after, in case the solver changed the branch between
        parts = [(k, k + 2), (max(0, k - 2), k + 1), (k + 1, min(n, k + 4))]
        found = [(float(rank[k + 1]), float(time[k + 1]))]
        for begin, end in parts:
            at = slice(begin, end)
            end_values = (time[at], states[:, at], algebraics[:, at], u[:, at])
            rates = np.array(equations(dae)(end_values[0][None], *end_values[1:], p)[0])
            curve = _curve(time[at] - time[k], states[:, at], rates)
            found.append(_closest(law, curve, time[k : k + 2], algebraics[:, k], u[:, k], p))
        distance, when = min(found)
        if distance * SINGULAR_CONDITION < 1 and time[0] < when < time[-1]:
            if k > last + 1:
                yield SingularConfiguration(k, when, distance)
            last = k


def _suspects(time: Vector, rank: Vector) -> list[int]:
    """Return the intervals in which a sequence may reach 0 and rise again, as |t| does at t = 0.

    The first and the last interval have a neighbor on one side only, which is used for both sides.
    """
    if len(time) < 3:
        return []
    length, falls = time[1:] - time[:-1], rank[:-1] - rank[1:]
    with np.errstate(divide="ignore", invalid="ignore"):  # at a time that occurs twice
        slope = falls / length
        before = np.concatenate((-slope[1:2], slope[:-1]))
        after = np.concatenate((-slope[1:], slope[-2:-1]))
        reach = rank[:-1] / before + rank[1:] / after
    touched = (before > 0) & (after > 0) & (reach <= SUSPECTED * length)
    return [int(k) for k in np.flatnonzero(touched)]


def _curve(time: Vector, states: Vector, rates: Vector) -> Vector:
    """Return the coefficients of the Hermite interpolant of states and rates, lowest first."""
    powers = np.arange(2 * len(time))
    values = time[:, None] ** powers
    slopes = powers * time[:, None] ** np.maximum(powers - 1, 0)
    both = np.vstack((values, slopes)), np.hstack((states, rates)).T
    return np.asarray(np.linalg.solve(*both), dtype=float)


def _closest(
    law: ca.Function, curve: Vector, span: Vector, z: Vector, u: Vector, p: Vector
) -> tuple[float, float]:
    """Return the least distance from a singular configuration along a curve, and its time, s."""
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
