"""`deepest_trough`: a state that has shrunk below the error control of its run, and grows again.

A concentration, a population or a deviation from a symmetric motion grows in proportion to itself:
where it is 0, it stays 0. Below the absolute tolerance divided by the relative one, a solver
controls fewer of its digits than requested, and all that it becomes later has no more of them: it
may even change its sign, which the equations forbid. It needs a smaller absolute tolerance.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from cosim.arrays import Integers, Truths, Vector
from cosim.model.growth import EFFECT, Closer
from cosim.model.state_path import StatePath
from cosim.series.samples import ROUNDING_OF_OTHERS
from cosim.text import moment

MOST_TRIALS = 6  # of a run, each with a smaller tolerance
_TINY = 1e-60  # nominal values, of a state whose own rate is proportional to it
_FEW_LOOKS, _LOOKS = 3, 50  # rows of a motion at which a state may rest at 0
_SPARE = 0.01  # of the least tolerance that controls all digits
_DEEPER = 1e-12  # share of a tolerance that may resolve what is an error of the solver
_LEAST_SHARE = 1e-270  # of an absolute tolerance


class Trough(NamedTuple):
    """Where states have lost digits.

    Attributes:
        state: Name of the state that needs the smallest tolerance.
        time: When it is least, s.
        size: Its size there, in nominal values.
        shares: Share of the absolute tolerance that each state needs, (nx,).
    """

    state: str
    time: float
    size: float
    shares: Vector

    def closer(self, *_known: float | Closer | None) -> Closer:
        """Return the tolerances that control the digits, to the end of the run."""
        return Closer(self.shares, np.inf)

    def note(self, closer: Closer, absolute: float, followed: bool) -> str:
        """Return what to say of a run; see `Growth.note`."""
        own = f"absolute_tolerance {absolute * closer.shares.min():.2g}"
        what = f"{self.state} shrinks to {self.size:.2g} nominal values at {moment(self.time, 6)} s"
        if followed:
            return f"{what}, and grows again; ran with {own}, so that its digits are controlled"
        return f"{what}, and grows again with few of its digits; it needs {own}"


def deepest_trough(
    path: StatePath,
    tolerance: tuple[float, float],
    shares: Vector,
    *,
    complete: bool = True,
) -> Trough | None:
    """Return where states have lost digits with which they grow again; None if none has.

    Args:
        path: Result of a solver with error control, with several rows in each of its steps.
        tolerance: Relative and absolute tolerance, the latter in nominal values.
        shares: Share of the absolute tolerance that each state had, (nx,).
        complete: Whether the solver has not failed; if it has, a state need not grow again.
    """
    relative, absolute = tolerance
    if len(path.time) < 2 or not min(tolerance) > 0:
        return None
    levels = np.abs(path.states) / path.sizes[:, None]
    needed = shares.copy()
    rests = _Rests(path)
    alone = np.zeros(len(shares), dtype=bool)
    doubtful = (levels > 0) & (levels < (absolute * shares / relative)[:, None])
    for i in np.flatnonzero(doubtful.any(axis=1)).tolist():  # others are 0 or never low
        alone[i] = rests.of(np.arange(len(shares)) == i)[i]
    # of states that vanish only together, half of the digits may be lost at first
    limits = np.where(alone | (shares < 1), relative, np.sqrt(relative))
    limits = absolute * shares / limits
    low = levels < limits[:, None]
    worst: tuple[float, int, int, float] | None = None
    for i, rows in _spans(low, path):
        end = int(rows[-1]) + 1
        is_left = complete and end < len(path.time) and path.time[end] > path.time[end - 1]
        if not levels[i, rows].any():
            continue
        lost = _lost(rests, path, levels, low, i, rows)
        grows = is_left or not complete
        if lost is None or not (grows or _should_grow(path, i, int(rows[0]), limits[i])):
            continue
        row, size, group = lost
        # the error that it gets from there, in nominal values
        peak = levels[group, end:].max() if is_left else np.inf
        matters = relative * (1 if shares[i] < 1 else EFFECT)
        if absolute * shares[i] * peak <= matters * size:
            continue
        unknown = not alone[i] and _crosses(path, i, rows)
        share = _DEEPER * shares[i] if unknown else _SPARE * relative * size / absolute
        needed[group] = np.fmax(np.fmin(needed[group], share), _LEAST_SHARE)
        if needed[i] < shares[i] and (worst is None or share < worst[0]):
            worst = share, i, row, size
    if worst is None:
        return None
    return Trough(path.names[worst[1]], float(path.time[worst[2]]), worst[3], needed)


def _spans(low: Truths, path: StatePath) -> Iterator[tuple[int, Integers]]:
    """Yield which state is low, and its rows, for each time that it is; a jump ends it."""
    for i in np.flatnonzero(low.any(axis=1)).tolist():
        changes = path.states[i, path.jumps] != path.states[i, path.jumps + 1]
        ends = np.union1d(path.jumps[changes], np.flatnonzero(np.diff(low[i]))) + 1
        parts = np.split(np.arange(low.shape[1]), ends)
        yield from ((i, rows) for rows in parts if low[i, rows[0]])


def _should_grow(path: StatePath, i: int, first: int, limit: float) -> bool:
    """Return whether a state that is low from a row on grows to a limit by its own rate."""
    rows = np.unique(np.linspace(first, len(path.time) - 1, 4 * _LOOKS).astype(int))
    value = float(path.states[i, first])
    growth = _growth(path, i, rows, value).max()
    return value != 0 and bool(growth >= np.log(limit * path.sizes[i] / abs(value)))


def _growth(path: StatePath, i: int, rows: Integers, value: float) -> Vector:
    """Return the powers of e by which a state would grow from the first row on, from a value."""
    states = path.states[:, rows].copy()
    states[i] = value
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        rates = path.rates(path.time[rows], states)[i] / value
        steps = np.diff(path.time[rows]) * (rates[1:] + rates[:-1]) / 2
        return np.nan_to_num(np.concatenate(([0.0], np.cumsum(steps))))


def _crosses(path: StatePath, i: int, rows: Integers) -> bool:
    """Return whether a state changes its sign."""
    return bool(np.ptp(np.sign(path.states[i, rows])) > 0)


def _lost(
    rests: "_Rests", path: StatePath, levels: Vector, low: Truths, i: int, rows: Integers
) -> tuple[int, float, Truths] | None:
    """Return where a low state is least, its size there, and which states share its fate, (nx,)."""
    alone = np.arange(len(levels)) == i
    if rests.of(alone)[i]:
        # where its digits are lost, its own rate tells how low it should be
        growth = _growth(path, i, rows, _TINY * path.sizes[i])
        own = levels[i, rows[0]] * np.exp(growth)
        if not _crosses(path, i, rows):
            own = np.fmin(own, np.where(levels[i, rows] > 0, levels[i, rows], np.inf))
        return int(rows[np.argmin(own)]), max(float(own.min()), float(np.finfo(float).tiny)), alone
    row = int(rows[np.argmin(np.max(levels[:, rows], axis=0, where=low[:, rows], initial=0))])
    group = rests.of(low[:, row])
    if not group[i]:
        return None
    size = float(levels[group, row].max())
    return (row, size, group) if size > ROUNDING_OF_OTHERS else None


def resting(rates: Callable[[Vector], Vector], states: Vector, group: Truths) -> Truths:
    """Return which states of a group stay 0 where they are 0 together, (nx,).

    Args:
        rates: Rates of all states at some places, (nx, places), from the states there.
        states: States at these places, (nx, places).
        group: Which states belong to the group, (nx,).
    """
    last = np.zeros_like(group)
    while (group != last).any():
        last = group
        group = last & (rates(np.where(last[:, None], 0, states)) == 0).all(axis=1)
    return group


class _Rests:
    """Which states of a path stay 0 where they are 0 together."""

    def __init__(self, path: StatePath) -> None:
        self._path, self._known = path, dict[bytes, Truths]()

    def of(self, group: Truths) -> Truths:
        """Return which states of a group do."""
        key = group.tobytes()
        if key not in self._known:
            for count in (_FEW_LOOKS, _LOOKS):  # most groups fail at the first rows
                rows = np.unique(np.linspace(0, len(self._path.time) - 1, count).astype(int))
                rates = partial(self._path.rates, self._path.time[rows])
                group = resting(rates, self._path.states[:, rows], group)
            self._known[key] = group
        return self._known[key]
