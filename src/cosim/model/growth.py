"""`suppressed_growth`: a deviation that grows in a motion, but that its steps have not followed.

Near an unstable equilibrium a deviation grows from far below the absolute tolerance. The error
control does not see it there: steps become longer than the time of growth, and an implicit one
suppresses it. Where the states that grow together move along straight lines to the tolerance, the
eigenvalues at some places tell how far the deviation would have grown; to be seen from the
beginning, it needs a smaller tolerance. Where rounding alone keeps a motion at an equilibrium, no
tolerance helps.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, compress
from typing import Any, NamedTuple

import numpy as np

from cosim.arrays import Integers, Truths, Vector
from cosim.model.state_path import SHORTER, Bends, Departures, Span, Starts, StatePath
from cosim.text import moment

MOST_TRIALS_OF_GROWTH = 2  # as another deviation may grow after the first one
EFFECT = 100  # least error that matters, in relative tolerances
_EPS = float(np.finfo(float).eps)
_ROUNDINGS = 4  # of the rates, within which a push may be rounding
_PLACES = 9  # of a line, whose eigenvalues tell of growth
_MORE = 4  # times as many where the equations change along it
_STEADY = 0.1  # of the largest slope: changes that need no more places
_SAME = 1e-9  # of each slope: changes that move no eigenvalue noticeably
_MOST_EXPONENT = 600.0
_NOISE = 1e-12  # rounding of a step, relative to the states; linear systems multiply it
_COUPLED = 1e-6  # least share of a state in what grows


class Growth(NamedTuple):
    """A deviation that grows unseen.

    Attributes:
        state: Name of the state in which it is largest.
        time: When it begins at the latest, s.
        growth_time: In which it grows by the factor e at first, s.
        size: Its size at the beginning, in nominal values.
        until: When it has nominal size, s.
        rounding: Whether it is but rounding, which no tolerance makes smaller.
    """

    state: str
    time: float
    growth_time: float
    size: float
    until: float
    rounding: bool = False

    def closer(self, relative: float, absolute: float, before: "Closer | None" = None) -> "Closer":
        """Return the absolute tolerance that follows the deviation until it has nominal size.

        Args:
            relative: Relative tolerance of the run, which then is that of the deviation; if it is
                0, the absolute one is.
            absolute: Absolute tolerance of the run, in nominal values.
            before: What has followed an earlier deviation; more may come after this one.
        """
        share = np.array((relative or absolute) * self.size / absolute)
        if before is None:
            return Closer(share, self.until)
        return Closer(np.fmin(share, before.shares), np.inf)

    def note(self, closer: "Closer", absolute: float, followed: bool) -> str:
        """Return what to say of a run.

        Args:
            closer: See `closer`.
            absolute: Absolute tolerance of the run, in nominal values.
            followed: Whether the run was repeated with the smaller tolerance.
        """
        if self.rounding:
            return (
                f"from {moment(self.time, 6)} s on, {self.state} is at an unstable equilibrium but "
                f"for rounding, which grows by e every {self.growth_time:.3g} s; when the motion "
                "leaves it, and to which side, is chance"
            )
        own = f"absolute_tolerance {absolute * float(closer.shares):.2g}"
        if followed:
            until = f" up to {moment(closer.until, 6)} s" if np.isfinite(closer.until) else ""
            advice = f"ran with {own}{until}, so that it is followed"
        else:
            advice = f"it may be suppressed: it needs {own}"
        return (
            f"from {moment(self.time, 6)} s on, a deviation of {self.size:.2g} nominal values of "
            f"{self.state} grows by e every {self.growth_time:.3g} s; {advice}"
        )


def smallest_of(found: Iterable[Growth]) -> Growth | None:
    """Return the smallest deviation, which is no rounding if there is another one."""
    return min(found, key=lambda growth: (growth.rounding, growth.size), default=None)


class Closer(NamedTuple):
    """Smaller absolute tolerances for the first part of a run.

    Attributes:
        shares: Shares of its absolute tolerance, of shape () or (nx,).
        until: End of that part, s.
    """

    shares: Vector
    until: float


def suppressed_growth(
    path: StatePath, steps: int, relative: float, absolute: float
) -> Growth | None:
    """Return the smallest deviation that would become visible, but has not been followed.

    Args:
        path: Result of a solver with error control.
        steps: Number of its steps.
        relative, absolute: Its tolerances; the absolute one in nominal values.
    """
    for level, lines in _growing_lines(path, steps, relative, absolute):
        if found := level.smallest(lines):
            return found
    return None


def growing_times(path: StatePath, steps: int, relative: float, absolute: float) -> Vector:
    """Return between which times deviations may grow by the equations, s, (m, 2).

    Args:
        path, steps, relative, absolute: See `suppressed_growth`.
    """
    every = (line for _, lines in _growing_lines(path, steps, relative, absolute) for line in lines)
    return np.array([own.time[[first, last]] for own, first, last, _ in every]).reshape(-1, 2)


def _growing_lines(
    path: StatePath, steps: int, relative: float, absolute: float
) -> "Iterator[tuple[_Level, Iterable[_Line]]]":
    """Yield what is looked for, and the lines along which a deviation may grow by e."""
    if len(path.time) < 2 or not len(path.states):
        return
    bends = Bends.of(path, steps)
    departures: Departures | None = None
    for level in _levels(relative, absolute):
        spans = bends.spans(relative, level.calm, path)
        # where steps are closer than rows, a line may be short
        if spans or steps >= len(path.time):
            departures = departures or Departures.of(path, path.begins)
        starts = departures.starts(relative, level.calm, path) if departures else None
        if (spans or starts) and level.matters(path):
            own = ((path, *span) for span in compress(spans, _growing(path, spans)))
            yield level, chain(own, _growing_from(path, starts))


def has_lines(path: StatePath, steps: int, relative: float, absolute: float) -> bool:
    """Return whether a motion has lines along which a deviation may grow; see `suppressed_growth`.

    Rows tell, without those at the sides of events.
    """
    calm = _levels(relative, absolute)[-1].calm  # the most that is
    spans = Bends.of(path, steps).spans(relative, calm, path)
    return bool(spans) or steps >= len(path.time)


def growth_from_start(path: StatePath, relative: float, absolute: float) -> Growth | None:
    """Return the growth from a motion that begins as a line; see `suppressed_growth`."""
    departures = Departures.of(path, np.array([0]))
    for level in _levels(relative, absolute):
        starts = departures.starts(relative, level.calm, path)
        grows = starts is not None and level.matters(path)
        found = level.smallest(_growing_from(path, starts)) if grows else None
        if found:
            return found
    return None


_Line = tuple[StatePath, int, int, Truths]


class _Level(NamedTuple):
    """What is looked for: a change that is calm, what is visible, the error of a deviation.

    Of one that is smaller than `few`, more than half of the digits are lost.
    """

    calm: float
    least: float
    error: float
    few: float

    def matters(self, path: StatePath) -> bool:
        """Return whether an error may become visible, as slopes along a motion tell."""
        if self.error == np.inf:
            return True
        last, needed = len(path.time) - 1, float(np.log(self.least / self.error))
        for places, between in ((_PLACES, _MORE), (_MORE * _PLACES, 1)):
            rows, slopes = _slopes_at(path, 0, last, places)
            if not len(rows) or between * _exponent(path.time[rows], slopes) <= needed:
                return False
        return True

    def smallest(self, lines: Iterable[_Line]) -> Growth | None:
        """Return the smallest deviation that grows along lines."""
        every = (growth_along(*line, self.least, self.error) for line in lines)
        few = [own for own in every if own and (own.size < self.few or own.rounding)]
        return smallest_of(few)


def _levels(relative: float, absolute: float) -> list[_Level]:
    """Return the levels of what no step follows, and of what is followed with few digits."""
    half = controlled_half(relative, absolute)
    levels = [_Level(absolute, absolute, np.inf, half)]
    if relative:
        levels.append(_Level(half, EFFECT * relative, absolute, half))
    return levels


def controlled_half(relative: float, absolute: float) -> float:
    """Return the size of which the error control keeps half of the digits, in nominal values."""
    return float(absolute / np.sqrt(relative or 1.0))


def unfollowed_growth(
    path: StatePath, steps: int, relative: float, absolute: float, closer: Closer | None
) -> Growth | None:
    """Return the smallest deviation that a run has not followed, as after `Closer.until`.

    A smaller absolute tolerance helps where the relative one does not hide a deviation: where it
    does, the motion is a line although the deviation would long have become visible.

    Args:
        path, steps, relative, absolute: See `suppressed_growth`.
        closer: The smaller tolerances of the run; None if there are none.
    """
    if closer is None:
        return suppressed_growth(path, steps, relative, absolute)
    spans = Bends.of(path, steps).spans(relative, absolute, path)
    hidden = absolute / relative if relative else np.inf
    for first, last, calm in spans:
        line = replace(path, time=path.time[: last + 1], states=path.states[:, : last + 1])
        growth = growth_along(line, first, last, calm, hidden)
        if growth and not growth.rounding:
            return growth
    return suppressed_growth(path.since(closer.until), steps, relative, absolute)


def _growing_from(path: StatePath, starts: Starts | None) -> Iterator[_Line]:
    """Yield the lines along which a deviation may grow, with rows along them."""
    if starts is None:
        return
    begin = path.time[starts.rows]
    time = np.linspace(begin, begin + starts.lengths, _PLACES, axis=-1)
    line = path.states[:, starts.rows, None] + starts.rates[..., None] * (time - begin[:, None])
    states = np.where(starts.calm[..., None], line, _between(path, time))
    slopes = path.scaled_slopes(time.ravel(), states.reshape(len(states), -1))
    for k in np.flatnonzero(_may_grow(path, time, slopes)).tolist():
        every = np.union1d(path.time, time[k])
        rows = every.searchsorted(time[k, [0, -1]]).tolist()
        yield replace(path, time=every, states=_between(path, every)), *rows, starts.calm[:, k]


def _between(path: StatePath, times: Vector) -> Vector:
    """Return the states at times, s, (...), lines between the rows, (nx, ...)."""
    return np.array([np.interp(times, path.time, state) for state in path.states])


def _slopes_at_places(path: StatePath, first: int, last: int) -> tuple[Integers, Vector]:
    """Return rows and slopes at so many places of a line that the slopes are known between them."""
    rows, slopes = _slopes_at(path, first, last, _PLACES)
    if not len(rows) or _steady(slopes):
        return rows, slopes
    return _slopes_at(path, first, last, _MORE * _PLACES)


def _slopes_at(path: StatePath, first: int, last: int, places: int) -> tuple[Integers, Vector]:
    """Return some rows from a first to a last one, (m,), and the slopes there, (m, nx, nx).

    Slopes are in nominal values. Rows without finite ones are left out.
    """
    rows = np.unique(_spread(path.time, first, last, places))
    slopes = path.slopes_at(rows)
    finite = np.isfinite(slopes).all(axis=(1, 2))
    return rows[finite], slopes[finite]


def _spread(t: Vector, first: Any, last: Any, places: int) -> Integers:
    """Return some rows from first to last ones, (...), evenly in time, (..., places)."""
    wanted = t.searchsorted(np.linspace(t[first], t[last], places, axis=-1))
    return np.clip(wanted, np.asarray(first)[..., None], np.asarray(last)[..., None])


def _growing(path: StatePath, spans: Sequence[Span]) -> Truths:
    """Return in which spans, (n,), a deviation may grow; see `_may_grow`."""
    first, last = np.array([span[:2] for span in spans], dtype=int).reshape(-1, 2).T
    rows = _spread(path.time, first, last, _PLACES)
    return _may_grow(path, path.time[rows], path.slopes_at(rows.ravel()))


def _may_grow(path: StatePath, times: Vector, slopes: Vector) -> Truths:
    """Return along which lines, (n,), or soon after, a deviation may grow by e, as slopes tell.

    Args:
        path: Where they are.
        times: Some of each, s, (n, m).
        slopes: There, line after line, (n * m, nx, nx).
    """
    slopes = slopes.reshape(*times.shape, *2 * [len(path.states)])
    finite = np.asarray(np.isfinite(slopes).all(axis=(1, 2, 3)))
    found = ~finite
    times = times[finite]
    slopes = slopes[finite]
    between = np.where(_steady(slopes), 1, _MORE)
    found[finite] = between * _exponent(times, slopes, _end(times, path.time[-1])) > 1
    return found


def _end(times: Vector, latest: float) -> Vector:
    """Return when lines end at the latest that go on after some times, s, (..., m)."""
    return np.minimum(times[..., -1] + SHORTER * (times[..., -1] - times[..., 0]), latest)


def _exponent(t: Vector, slopes: Vector, end: Vector | float = -np.inf) -> Vector:
    """Return logarithms of the largest growth over times, s, (..., m), and from there to an end."""
    rates = np.fmax(_growth_rates(slopes), 0)
    found: Vector = np.trapezoid(rates, t) + rates[..., -1] * np.fmax(end - t[..., -1], 0)
    return found


def _growth_rates(slopes: Vector) -> Vector:
    """Return the largest real part of the eigenvalues at places, 1/s, (...)."""
    new, which = _distinct(slopes.reshape(-1, *slopes.shape[-2:]))
    rates: Vector = np.linalg.eigvals(new).real.max(axis=1)[which]
    return rates.reshape(slopes.shape[:-2])


def _distinct(slopes: Vector) -> tuple[Vector, Integers]:
    """Return the slopes that differ from those before, (m, nx, nx), and which is at each place."""
    changes = np.abs(slopes - np.roll(slopes, 1, axis=0)) > _SAME * np.abs(slopes)
    new = np.asarray(changes.any(axis=(1, 2)))  # few are, near a rest
    new[:1] = True
    return slopes[new], new.cumsum() - 1


def _steady(slopes: Vector) -> Truths:
    """Return whether slopes at places, (..., m, nx, nx), are nearly the same."""
    most = np.abs(slopes).max(axis=(-3, -2, -1))
    return np.asarray(np.ptp(slopes, axis=-3).max(axis=(-2, -1)) <= _STEADY * most)


def growth_along(
    path: StatePath, first: int, last: int, calm: Truths, least: float, error: float = np.inf
) -> Growth | None:
    """Return the smallest deviation that grows along a line and becomes visible by the last row.

    Args:
        path: See `suppressed_growth`.
        first, last: Rows between which states are lines in time.
        calm: Which of them are, (nx,).
        least: What is visible, in nominal values.
        error: Of a deviation that is larger; it then has to become visible.
    """
    t, sizes = path.time, path.sizes
    rate = path.rates(t[[first]], path.states[:, [first]])
    on_line = calm[:, None] & (t <= t[last])
    line = np.where(on_line, path.states[:, [first]] + rate * (t - t[first]), path.states)
    rows = np.unique([first, (first + last) // 2, last])
    jumps = path.jumps[(first <= path.jumps) & (path.jumps < last)]
    own = calm & path.grows  # others push
    changes = np.where(own[:, None], path.states[:, jumps + 1] - path.states[:, jumps], 0)
    changes /= sizes[:, None]
    if not (changes.any() or path.rates(t[rows], line[:, rows]).any()):
        return None
    course = _Course.of(replace(path, states=line), first, last, calm)
    if course is None:
        return None
    rows = np.unique([course.first, (course.first + last) // 2, last])
    f = path.rates(t[rows], line[:, rows]) / sizes[:, None]
    rounding = np.abs(course.slopes) @ np.abs(path.states[:, rows] / sizes[:, None])
    count = len(rows)
    times = t[np.append(rows, jumps)]
    found = list[Growth]()
    for value, direction in zip(course.values, course.directions, strict=True):
        push = np.abs(direction @ np.hstack((f, abs(value) * changes)))
        noise = np.abs(direction) @ rounding
        level = _ROUNDINGS * _EPS * np.append(noise, np.full(len(jumps), noise.max()))
        exponents = course.exponents(value.real)
        grown = np.interp(times, course.time, exponents)
        if 0 < push[0] <= level[0]:  # by then, rounding has grown
            level = np.fmax(level, level[0] * np.exp(grown))
        rising = push > level
        only = not rising.any()
        if only:
            rising[:count] = push[:count] > 0
            push[:count] = _NOISE * noise
        push[:count] = push[:count].min(where=rising[:count], initial=np.inf)
        grown[:count] = 0  # it may have begun before its row
        seen = np.fmin(push / abs(value), error) * np.exp(exponents[-1] - grown) > least
        if (rising & seen).any():
            state = path.names[int(np.argmax(np.abs(direction) * path.grows))]
            k = int(np.argmin(np.where(rising & seen, push, np.inf)))
            begin = float(times[k])
            size = float(push[k]) / abs(value)
            grown = exponents - np.interp(begin, course.time, exponents)
            wanted = -np.log(size)
            until = np.interp(wanted, grown, course.time) + max(wanted - grown[-1], 0) / value.real
            found.append(Growth(state, begin, 1 / float(value.real), size, float(until), only))
    return smallest_of(found)


@dataclass(frozen=True, eq=False)
class _Course:
    """How a deviation grows along a line.

    Attributes:
        first: Row at which it begins to grow.
        time: Places from there to where the line may end at the latest, s, (m,).
        fastest: Natural logarithm of the growth of what grows fastest, by then, (m,).
        slopes: Derivatives of dx/dt by the states, in nominal values, (nx, nx).
        values, directions: Eigenvalues, (k,), and left eigenvectors, (k, nx), of what grows.
    """

    first: int
    time: Vector
    fastest: Vector
    slopes: Vector
    values: Vector
    directions: Vector

    @classmethod
    def of(cls, path: StatePath, first: int, last: int, calm: Truths) -> "_Course | None":
        """Return how a deviation grows; None if it does not.

        Args:
            path: Its states lie on the line.
            first, last, calm: See `growth_along`.
        """
        t = path.time
        rows, slopes = _slopes_at_places(path, first, last)
        if not len(rows) or rows[0] != first:
            return None
        new, which = _distinct(slopes)
        values, left = (own[which] for own in np.linalg.eig(new.transpose(0, 2, 1)))
        own = path.grows  # others, as those that only events change, push at most
        left = left / np.fmax(np.linalg.norm(left[:, own], axis=1, keepdims=True), _EPS)
        amounts = np.abs(left[:, own])
        moves = (amounts > _COUPLED * amounts.max(axis=1, keepdims=True)) & ~calm[own, None]
        alone = ~moves.any(axis=1)
        fastest = np.where(alone | ~alone.any(axis=1, keepdims=True), values.real, -np.inf)
        rates = fastest.max(axis=1)
        rates = np.append(rates, rates[-1])  # the line may go on
        time = np.append(t[rows], max(_end(t[[first, last]], t[-1]), t[rows[-1]]))
        grown = np.append(0.0, np.cumsum((rates[1:] + rates[:-1]) / 2 * np.diff(time)))
        begin = int(np.argmin(grown[:-1]))
        grown = grown[begin:] - grown[begin]
        soon = 1 + int(np.argmax(grown > 1))  # places until it has grown by e
        place = begin + int(np.argmax(rates[begin : begin + soon]))
        growing = alone[place] & (values[place].real * (t[last] - t[rows[begin]]) > 1)
        if not growing.any():
            return None
        every = np.maximum.accumulate(grown)
        facts = slopes[place], values[place, growing], left[place, :, growing]
        return cls(int(rows[begin]), time[begin:], every, *facts)

    def exponents(self, rate: float) -> Vector:
        """Return the natural logarithm of a growth of another rate at first, (m,)."""
        share = rate / float(self.values.real.max())
        return np.minimum(share * self.fastest, _MOST_EXPONENT)
