"""`TimeSearch`: when relations that depend on time alone leave their modes.

Where an argument is linear in time, this follows at once. For others, a run is searched in spans
that grow and shrink, like steps. By the bounds of its argument and of the two derivatives of that
(`time_bounds`), a relation cannot leave its mode within a span, or does so exactly once; otherwise
the span is halved. fmu/solvers/hybrid/plan.h does the same.
"""

from array import array
from collections.abc import Iterator, Sequence
from math import copysign, inf, isfinite, nextafter, ulp
from typing import Any, NamedTuple

import casadi as ca
from casadi import SX

from casadi_models.dae.frozen import Dae
from casadi_models.dae.hybrid import Hybrid, hybrid
from casadi_models.dae.time_bounds import ORDERS

_LEAST = 4  # units in the last place of the end of the run: the length of the shortest span
_NOISE = 16  # those of the present time within which an event is one that has just been
_SAME = 1e-12  # share of a run within which a switch is at its begin
_SAMPLES = 4096  # in the run, of expressions without bounds, and where others have no value


class _Call:
    """A function on arrays of its own."""

    def __init__(self, function: ca.Function) -> None:
        buffer: Any  # CasADi's hints want a size, which a view brings along
        buffer, self._evaluate = function.buffer()
        self._buffer = buffer
        sizes = [function.numel_in(i) for i in range(function.n_in())]
        self.given = [array("d", bytes(8 * size)) for size in sizes]
        self.found = [array("d", bytes(8 * function.numel_out(i))) for i in range(function.n_out())]
        for i, values in enumerate(self.given):
            if values:
                buffer.set_arg(i, memoryview(values))
        for i, values in enumerate(self.found):
            if values:
                buffer.set_res(i, memoryview(values))

    def __call__(self, *times: float) -> "list[array[float]]":
        """Return the results at a time, or over a span."""
        for own, t in zip(self.given, times, strict=False):
            own[0] = t
        self._evaluate()
        return self.found


class _Guard(NamedTuple):
    """What is positive within a mode: sign (argument - boundary).

    Attributes:
        row: Of the argument among those of the search.
        sign, boundary: By the mode.
    """

    row: int
    sign: float
    boundary: float


class _Sides(NamedTuple):
    """A guard and its rate at a time."""

    t: float
    value: float
    rate: float


class _Point(NamedTuple):
    """Values and rates of the guards at a time."""

    t: float
    values: list[float]
    rates: list[float]


class TimeSearch:
    """The search of a hybrid model; not for several threads at once.

    Args:
        system: Frozen equations.
    """

    def __init__(self, system: Hybrid) -> None:
        dae, bounds = system.dae, system.time_bounds
        nonlinear = [i for i, own in enumerate(system.of_time) if own and not system.linear[i]]
        self._bounded = len(bounds.relations)
        self._order = [*bounds.relations, *(i for i in nonlinear if i not in bounds.relations)]
        self._linear = [i for i, linear in enumerate(system.linear) if linear]
        self._floors = system.floors
        rest, ends = [dae.u, dae.p, dae.x, dae.z], [bounds.low, bounds.high]

        def sides(name: str, relations: Sequence[int]) -> _Call:
            column = ca.vertcat(SX(0, 1), *(system.relations[i].argument for i in relations))
            results = [ca.densify(a) for a in (column, ca.jtimes(column, dae.t, 1))]
            return _Call(ca.Function(name, [dae.t, *rest], results, {"cse": True}))

        self._at, self._lines = sides("at", self._order), sides("lines", self._linear)
        over = ca.Function("over", [dae.t, bounds.length, *rest], ends, {"cse": True})
        self._over = _Call(over)

    def first(
        self, now: float, u: Sequence[float], p: Sequence[float], end: float
    ) -> tuple[float, frozenset[int]]:
        """Return the next time at which relations leave their modes, and which ones do.

        A relation whose argument jumps there is not among them: its value tells its mode. What
        comes after the end by rounding alone happens at the end.

        Args:
            now: The present time, s.
            u, p: Inputs with modes, and parameters.
            end: Until when to search, s.

        Returns:
            Infinity if there is none up to the end.
        """
        if not now < end:
            return inf, frozenset()
        for call, place in ((self._at, 1), (self._lines, 1), (self._over, 2)):
            call.given[place][:] = array("d", u)
            call.given[place + 1][:] = array("d", p)
        modes = u[len(u) - len(self._floors) :]
        values, rates = self._lines(0.0) if self._linear else ((), ())
        times = {
            i: self._linear_root(i, now, modes[i], value, rate)
            for i, value, rate in zip(self._linear, values, rates, strict=True)
        }
        until = min([end, *times.values()])
        time, left = self._first_nonlinear(now, modes, until + 8 * ulp(until))
        times |= dict.fromkeys(left, time)
        first = min([time, *times.values()])
        if not first <= end + 8 * ulp(end):
            return inf, frozenset()
        near = 8 * ulp(first)
        return min(first, end), frozenset(i for i, t in times.items() if abs(t - first) <= near)

    def _linear_root(self, i: int, now: float, mode: float, value: float, rate: float) -> float:
        """Return when an argument `value + rate t` leaves its mode, s; infinity if never."""
        floor = self._floors[i]
        if not rate or (not floor and mode * rate > 0):
            return inf
        boundary = (mode + 1 if rate > 0 else mode) if floor else 0.0
        root = (boundary - value) / rate
        return max(root, nextafter(now, inf))

    def _first_nonlinear(
        self, now: float, modes: Sequence[float], end: float
    ) -> tuple[float, frozenset[int]]:
        if not self._order:
            return inf, frozenset()
        guards = [g for row in range(len(self._order)) for g in self._guards(row, modes)]
        bounded = [guard for guard in guards if guard.row < self._bounded]
        time, left = self._first_bounded(bounded, now, end) if bounded else (inf, set[int]())
        for guard in guards[len(bounded) :]:
            own = self._first_sampled(guard, now, min(end, time))
            if own < time:
                time, left = own, set()
        if time < inf:  # others that switch at the same time
            near = 8 * ulp(time)
            later = self._point(guards, time + near)
            for guard, value, rate in zip(guards, later.values, later.rates, strict=True):
                if 4 * near * rate <= value < 0:
                    left.add(guard.row)
        return time, frozenset(self._order[row] for row in left)

    def _guards(self, row: int, modes: Sequence[float]) -> list[_Guard]:
        mode = float(modes[self._order[row]])
        if self._floors[self._order[row]]:
            return [_Guard(row, 1.0, mode), _Guard(row, -1.0, mode + 1)]
        return [_Guard(row, mode, 0.0)]

    def _point(self, guards: Sequence[_Guard], t: float) -> _Point:
        values, rates = self._at(t)
        return _Point(
            t,
            [sign * (values[row] - boundary) for row, sign, boundary in guards],
            [sign * rates[row] for row, sign, _ in guards],
        )

    def _first_bounded(
        self, guards: Sequence[_Guard], now: float, end: float
    ) -> tuple[float, set[int]]:
        a, soon = self._point(guards, now), self._point(guards, now + _NOISE * ulp(now))
        if any(v < 0 and later < 0 for v, later in zip(a.values, soon.values, strict=True)):
            return nextafter(now, inf), set()
        shortest = _LEAST * ulp(max(abs(now), abs(end)))
        least, length = shortest, end - now
        while a.t < end:
            a = _Point(a.t, [0.0 if v < 0 else v for v in a.values], a.rates)  # but for rounding
            b = self._point(guards, min(a.t + length, end))
            lows, highs = self._over(a.t, b.t - a.t)
            found = [
                self._leaves(guard, _Sides(a.t, a.values[k], a.rates[k]),
                             _Sides(b.t, b.values[k], b.rates[k]), lows, highs)
                for k, guard in enumerate(guards)
            ]  # fmt: skip
            unknown = None in found
            if unknown and length > least:
                length = max(length / 2, least)
                continue
            times = [
                inf if t == inf or (t is None and not b.values[k] < 0)
                else self._root(guards[k], a.t, b.t if t is None else t)
                for k, t in enumerate(found)
            ]  # fmt: skip
            first = min(times)
            if first < inf:
                near = first + 8 * ulp(first)
                known = (k for k, t in enumerate(found) if t is not None)
                return first, {guards[k].row for k in known if times[k] <= near}
            if unknown:  # it only touches its boundary, or has no value
                least = max(shortest, min(2 * least, (end - now) / _SAMPLES))
                length = least
            else:
                least = shortest if length > 8 * least else least
                length *= 2
            a = b
        return inf, set()

    def _leaves(
        self, guard: _Guard, a: "_Sides", b: "_Sides", lows: Sequence[float],
        highs: Sequence[float],
    ) -> float | None:  # fmt: skip
        """Return a time until which a guard becomes negative just once after a time.

        Args:
            guard: Not negative at the begin.
            a, b: The guard at the begin and the end of a span.
            lows, highs: Bounds over the span.

        Returns:
            Infinity if it does not become negative; None if the bounds do not tell.
        """
        row, sign, boundary = guard
        own = slice(ORDERS * row, ORDERS * (row + 1))
        ends = (lows[own], highs[own]) if sign > 0 else (highs[own], lows[own])
        (low, slowest, least), (high, fastest, most) = ([sign * v for v in side] for side in ends)
        if low - sign * boundary >= 0:
            return inf
        if not (isfinite(high - low) and isfinite(fastest - slowest)):
            return None
        if slowest >= 0:
            return inf if b.value >= 0 else None
        curved = isfinite(most - least)
        if fastest <= 0 or (curved and most <= 0):
            return b.t if b.value < 0 else inf
        length = b.t - a.t
        reach = slowest * fastest * length
        if b.value >= 0 and fastest * a.value - slowest * b.value + reach > 0:
            return inf
        if curved and min(a.value, b.value) > most * length * length / 8:
            return inf
        if not (curved and least >= 0):
            return None
        if b.value < 0:
            return b.t if a.rate < 0 else None
        return inf if a.rate >= 0 or b.rate <= 0 else self._dip(guard, a, b)

    def _dip(self, guard: _Guard, a: "_Sides", b: "_Sides") -> float:
        """Return a time at which a convex guard is negative between two; infinity if none is."""
        halve = False
        while True:
            length, bend = b.t - a.t, b.rate - a.rate
            touched = a.value + a.rate * (a.value - b.value + b.rate * length) / bend
            t = a.t + length * (0.5 if halve else -a.rate / bend)
            if touched > 0 or not a.t < t < b.t:
                if touched > 0 or halve:
                    return inf
                t = a.t + length / 2
                if not a.t < t < b.t:
                    return inf
            _, (value,), (rate,) = self._point([guard], t)
            if value < 0:
                return t
            if rate < 0:
                a = _Sides(t, value, rate)
            else:
                b = _Sides(t, value, rate)
            halve = not halve

    def _root(self, guard: _Guard, low: float, high: float) -> float:
        """Return the first time at which a guard is negative that becomes so once."""
        t, trial = high, 0
        while True:
            _, (value,), (rate,) = self._point([guard], t)
            outside = -inf < value < 0
            low, high = (low, t) if outside else (t, high)
            middle = low + (high - low) / 2
            if not low < middle < high:
                return high
            trial += 1
            t = middle
            if rate and trial % 3 and isfinite(value / rate):  # by Newton's method, to beyond it
                root = (high if outside else low) - value / rate
                root += copysign(2 * ulp(root), -1 if outside else 1)
                t = root if low < root < high else middle

    def _first_sampled(self, guard: _Guard, now: float, end: float) -> float:
        """Return when a guard of which no bounds are known is negative at samples."""
        low = now
        for k in range(1, _SAMPLES + 1):
            high = now + (end - now) * k / _SAMPLES
            if self._point([guard], high).values[0] < 0:
                return self._root(guard, low, high)
            low = high
        return inf


def switch_times(dae: Dae, begin: float, end: float) -> Iterator[float]:
    """Yield when relations switch in a model whose equations depend on time alone, s.

    If it has relations, the first time is the begin: the value there may differ from the limit.
    """
    system = hybrid(dae)
    if system is None:
        return
    modes = ca.vertcat(
        *(ca.floor(r.argument) if r.floor else 2 * (r.argument >= 0) - 1 for r in system.relations)
    )
    for _ in system.relations:  # arguments may depend on other modes
        modes = ca.substitute(modes, system.modes, modes)
    by_value, search = ca.Function("modes", [dae.t], [modes]), TimeSearch(system)
    now, near = begin, begin + _SAME * (end - begin)
    yield begin
    while now < end:
        now, _ = search.first(now, by_value(now).full().ravel().tolist(), [], end)
        if near < now <= end:
            yield now
        now = max(now + _NOISE * ulp(now), near)
