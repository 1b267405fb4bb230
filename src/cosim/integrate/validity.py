"""Checks of a run: validity conditions, step sizes, and singular configurations."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from casadi_models.dae import Dae
from casadi_models.dae.invariants import CONSTRAINT_CONDITION, SINGULAR_CONDITION
from cosim.arrays import Integers, Vector
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
from cosim.text import Violation, moment, violated

SUSPECTED = 3.0  # intervals: most that lines through the neighbors need to reach 0 from both sides
_POINTS, _ZOOMS = 33, 8  # to the rounding of time
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
    found, time = list[Breach](), motion.time[:n]
    for i, (_, meaning) in enumerate(motion.dae.limits):
        when = left[i] if i in left else _first_left(motion, seen, n, i)
        k = int(time.searchsorted(when))
        if k < n:
            found.append(Breach(k, Violation(when, violated(meaning))))
    return found


def _first_left(motion: Motion, seen: Observed, n: int, limit: int) -> float:
    """Return when a margin is not positive first, s; infinite if it is in all of n rows."""
    time, margin = motion.time[:n], seen.margins[:n, limit]
    if n and not margin[0] > 0:
        return float(time[0])
    for k in _doubtful(time, margin).tolist():
        law = _margin(motion.dae, limit)
        least, when = _least(law, motion, seen, k, slice(k, k + 2), stops=True)
        if not least > 0:
            return when
        if not margin[k + 1] > 0:
            return float(time[k + 1])
    return np.inf


def _doubtful(time: Vector, margin: Vector) -> Integers:
    """Return the intervals in which a margin, (n,), may be 0 or less, by their begins.

    These end so, or are beside a least value that is near 0, or the margin may reach 0 in them and
    rise again, as |t| does at t = 0. What is not a number is not valid.
    """
    ends = np.flatnonzero(~(margin[1:] > 0))
    falls = np.diff(margin) < 0
    turns = 1 + np.flatnonzero(falls[:-1] & ~falls[1:])  # rows with least values
    before, least, after = margin[turns - 1], margin[turns], margin[turns + 1]
    # a parabola through three rows reaches at most so far below the least of them
    near = turns[least <= (before - least) + (after - least)]
    return np.unique(np.concatenate((ends, near - 1, near, _pointed(time, margin))))


def _pointed(time: Vector, margin: Vector) -> Integers:
    """Return the intervals in which lines through their neighbors reach 0 from both sides.

    The first and the last interval have a neighbor on one side only, which is used for both sides.
    """
    if len(time) < 3:
        return np.empty(0, dtype=np.int64)
    length, falls = time[1:] - time[:-1], margin[:-1] - margin[1:]
    with np.errstate(divide="ignore", invalid="ignore"):  # at a time that occurs twice
        slope = falls / length
        before = np.concatenate((-slope[1:2], slope[:-1]))
        after = np.concatenate((-slope[1:], slope[-2:-1]))
        reach = margin[:-1] / before + margin[1:] / after
    return np.flatnonzero((before > 0) & (after > 0) & (reach <= SUSPECTED * length))


def _least(
    law: ca.Function, motion: Motion, seen: Observed, k: int, rows: slice, *, stops: bool
) -> tuple[float, float]:
    """Return the least margin in an interval along the curve through some rows, and when, s.

    Args:
        law: The margin.
        motion: The motion.
        seen: Its algebraic unknowns.
        k: The interval, whose unknowns and inputs are those at its start.
        rows: Those through whose states and rates the curve goes.
        stops: Whether to return the first margin that is not positive, if there is one. What is not
            a number is such a margin then, and is passed over otherwise.
    """
    start, inputs = motion.time[k], np.broadcast_to(motion.u, (len(motion.u), len(motion.time)))
    time, states, z = motion.time[rows], motion.states[:, rows], seen.unknowns[rows].T
    rates = equations(motion.dae)(time[None], states, z, inputs[:, rows], motion.p)[0]
    curve = _curve(time - start, states, np.array(rates))
    low, high = 0.0, float(motion.time[k + 1] - start)
    for _ in range(_ZOOMS):
        s = np.linspace(low, high, _POINTS)
        x: Vector = (s[:, None] ** np.arange(len(curve)) @ curve).T
        at = (start + s)[None], x, seen.unknowns[k], inputs[:, k], motion.p
        margins = np.array(law(*at)).ravel()
        margins = np.where(np.isnan(margins), -np.inf if stops else np.inf, margins)
        outside = margins <= 0
        ends = stops and bool(outside.any())
        i = int(np.argmax(outside) if ends else np.argmin(margins))
        low, high = float(s[max(i - 1, 0)]), float(s[i if ends else min(i + 1, _POINTS - 1)])
    return float(margins[i]), float(start) + float(s[i])


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
        x, z: The initial values.
        monitors: Condition numbers, distances and drift, in the order of `Dae.monitors`; infinite
            at a singularity.
        margins: In the order of `Dae.limits`, in the unit of the limited quantity; the model is
            valid while every margin is positive.
    """

    x: Vector | None
    z: Vector | None
    monitors: tuple[float | None, ...]
    margins: tuple[float | None, ...]


def inspect_start(dae: Dae, begin: float = 0.0) -> Inspection:
    """Evaluate the monitors and validity margins of a model at its own initial values."""
    n = len(dae.monitors)
    expressions = [e for _, e in dae.monitors] + [margin for margin, _ in dae.limits]
    values = assign(dae)
    try:
        x, z = consistent_values(dae, begin, values)
    except InitialConditionError:  # a run reports it
        return Inspection(None, None, (None,) * n, (None,) * len(dae.limits))
    column = ca.vertcat(ca.SX(0, 1), *expressions)
    function = ca.Function("inspect", dae.arguments, [column])
    found = np.array(function(begin, x, z, values.u, values.p)).ravel().tolist()
    return Inspection(x, z, tuple(found[:n]), tuple(found[n:]))


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
    dae, time, distance = motion.dae, motion.time[:n], seen.margins[:n, -1]
    for k in _doubtful(time, distance - 1 / SINGULAR_CONDITION).tolist():
        law = _margin(with_singularity_margin(dae), -1)
        # also along the motion before and after, in case the solver changed the branch between
        parts = slice(k, k + 2), slice(max(0, k - 2), k + 1), slice(k + 1, min(n, k + 4))
        along = (_least(law, motion, seen, k, rows, stops=False) for rows in parts)
        nearest, when = min(*along, (float(distance[k + 1]), float(time[k + 1])))
        if nearest * SINGULAR_CONDITION < 1 and time[0] < when < time[-1]:
            break
    else:
        return None
    text = (
        f"singular configuration at {moment(when, 4)} s ({CONSTRAINT_CONDITION} "
        f"{1 / max(nearest, 1e-16):.0e}), where the motion has several continuations"
    )
    if not dae.has_conditioned_multipliers:
        text += "; use a formulation with multipliers"
    return Breach(k + 1, Violation(when, text, text))


def _curve(time: Vector, states: Vector, rates: Vector) -> Vector:
    """Return the coefficients of the Hermite interpolant of states and rates, lowest first."""
    powers = np.arange(2 * len(time))
    values = time[:, None] ** powers
    slopes = powers * time[:, None] ** np.maximum(powers - 1, 0)
    both = np.vstack((values, slopes)), np.hstack((states, rates)).T
    return np.asarray(np.linalg.solve(*both), dtype=float)
