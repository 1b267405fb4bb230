"""`switch_times`: when relations switch in equations that depend on time alone.

A run is halved until bounds of an argument and of its rate show for each part that the relation
keeps its mode there, or leaves it once. Within a run, the kernel of events finds these times from
event to event (fmu/solvers/hybrid/plan.h).
"""

import casadi as ca
import numpy as np

from casadi_models.dae import Dae
from casadi_models.dae.hybrid import Hybrid, hybrid
from casadi_models.dae.time_bounds import time_bounds
from cosim.arrays import Truths, Vector

_SHORTEST = 1e-12  # part, as a share of the run, for which no bounds have to tell
_SAMPLES = 4096  # parts of the run of an argument without bounds, or without values
_NO_VALUE = -np.inf  # in place of the mode of an argument without a value
_MOST_PARTS = 1 << 16  # for which bounds do not tell; more are halved no further


def switch_times(dae: Dae, begin: float, end: float) -> Vector:
    """Return when relations switch, s, ascending.

    If there are relations, the first time is the start: the value there may differ from the limit.

    Args:
        dae: A model whose equations depend on time alone.
        begin, end: Times, s.
    """
    system = hybrid(dae)
    if system is None:
        return np.empty(0)
    modes, found, left = _modes_of(system), np.empty(0), set(range(len(system.relations)))
    after = end + 8 * np.spacing(abs(end))  # what comes later by rounding alone is at the end
    while left:
        i = next(i for i in sorted(left) if not _follows(system, i, left - {i}))
        left.remove(i)
        spans = np.union1d([begin, after], found)
        within = np.array(modes((spans[None, :-1] + spans[None, 1:]) / 2))
        found = np.union1d(found, Argument(system, i, spans, within).switches())
        found = found[np.diff(found, prepend=-np.inf) > 8 * np.spacing(np.abs(found))]
    later = np.minimum(found[found > begin + _SHORTEST * (end - begin)], end)
    return np.unique(np.append(begin, later))


def _modes_of(system: Hybrid) -> ca.Function:
    """Return `t -> modes` of all relations, (n, 1)."""
    modes = ca.vertcat(
        *(ca.floor(r.argument) if r.floor else 2 * (r.argument >= 0) - 1 for r in system.relations)
    )
    for _ in system.relations:  # arguments may depend on other modes
        modes = ca.substitute(modes, system.modes, modes)
    return ca.Function("modes", [system.dae.t], [modes])


def _follows(system: Hybrid, i: int, others: set[int]) -> bool:
    """Return whether the argument of a relation depends on the modes of others."""
    modes = ca.vertcat(*(system.modes[j] for j in others))
    return bool(others) and ca.depends_on(system.relations[i].argument, modes)


class Argument:
    """The argument of a relation.

    Args:
        system: Frozen equations.
        i: The position of the relation.
        spans: Times between which all modes in the argument are constant, s, (n + 1,).
        modes: Modes of all relations within each span, (modes, n).
    """

    def __init__(self, system: Hybrid, i: int, spans: Vector, modes: Vector) -> None:
        dae, argument = system.dae, system.relations[i].argument
        bounds = time_bounds(dae, {i: argument})
        over, ends = [dae.t, bounds.length, dae.u], [bounds.low, bounds.high]
        self._bounds = (
            ca.Function("bounds", over, ends, {"cse": True}) if bounds.relations else None
        )
        self._value = ca.Function("value", [dae.t, dae.u], [argument], {"cse": True})
        self._floor, self._spans, self._modes = system.relations[i].floor, spans, modes

    def switches(self) -> Vector:
        """Return when it leaves its modes within the spans, s."""
        begins, lengths, spans = self.parts()
        # with middles, since both ends may be on boundaries
        times = np.column_stack((begins, begins + lengths / 2, begins + lengths)).ravel()
        spans = np.repeat(spans, 3)
        modes = self._modes_at(times, spans)
        inner = ~np.isnan(modes)
        times, spans, modes = times[inner], spans[inner], modes[inner]
        before = np.flatnonzero((modes[1:] != modes[:-1]) & (spans[1:] == spans[:-1]))
        low, high = times[before], times[before + 1]
        while True:
            middle = low + (high - low) / 2
            if not ((low < middle) & (middle < high)).any():
                break
            left = self._modes_at(middle, spans[before]) == modes[before + 1]
            low, high = np.where(left, low, middle), np.where(left, middle, high)
        return np.where(np.isnan(self._modes_at(low, spans[before])), low, high)

    def parts(self) -> Vector:
        """Return parts of the spans in each of which it leaves its mode at most once, in order.

        Returns:
            Begins and lengths, s, and the numbers of the spans, (3, parts).
        """
        known, whole = self._spans, self._spans[-1] - self._spans[0]
        if self._bounds is None:
            known = np.union1d(known, np.linspace(known[0], known[-1], _SAMPLES + 1))
        spans = np.searchsorted(self._spans, known[:-1], "right") - 1
        parts, found = np.array([known[:-1], np.diff(known), spans]), list[Vector]()
        while self._bounds is not None:
            unknown = (parts[1] > _SHORTEST * whole) & ~self._is_known(parts, whole)
            if not 0 < unknown.sum() <= _MOST_PARTS:
                break
            found.append(parts[:, ~unknown])
            begins, lengths, spans = parts[:, unknown]
            halves = [[begin, lengths / 2, spans] for begin in (begins, begins + lengths / 2)]
            parts = np.hstack(halves)
        parts = np.hstack((*found, parts))
        return np.asarray(parts[:, np.argsort(parts[0])])

    def _is_known(self, parts: Vector, whole: float) -> Truths:
        """Return whether bounds show that it leaves its mode at most once in each part."""
        begins, lengths, spans = parts
        assert self._bounds is not None
        ends = self._bounds(begins[None], lengths[None], self._modes[:, spans.astype(int)])
        (low, slowest, _), (high, fastest, _) = (np.array(end) for end in ends)
        keeps = high <= np.floor(low) + 1 if self._floor else (low >= 0) | (high <= 0)
        with np.errstate(invalid="ignore"):  # of infinite bounds
            near = high - low < (1 if self._floor else np.inf)
            finite = np.isfinite(fastest - slowest)
        once = near & ((slowest >= 0) | (fastest <= 0)) & finite
        known = keeps | once
        empty = ~known & (lengths < whole / _SAMPLES)
        for share in (0, 0.5, 1):
            if empty.any():
                empty &= np.isnan(self._values(begins + share * lengths, spans))
        return np.asarray(known | empty)

    def _values(self, times: Vector, spans: Vector) -> Vector:
        values: Vector = np.array(self._value(times[None], self._modes[:, spans.astype(int)]))[0]
        return values

    def _modes_at(self, times: Vector, spans: Vector) -> Vector:
        """Return its modes; `_NO_VALUE` where it has none, and not a number on a boundary."""
        values = self._values(times, spans)
        modes = np.floor(values) if self._floor else np.sign(values)
        on_boundary = values == (modes if self._floor else 0)
        modes = np.where(np.isnan(values), _NO_VALUE, modes)
        return np.where(on_boundary, np.nan, modes)
