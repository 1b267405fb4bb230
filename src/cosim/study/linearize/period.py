"""The period of a model's samples and of its coefficients in time."""

from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from math import inf, isfinite, lcm, pi
from typing import NamedTuple

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae
from casadi_models.dae.expressions import applied, operations, replayed
from cosim.errors import InitialConditionError
from cosim.model.values import Values

MOST_PERIODS = 1000  # of one period, in a common period
SAME_RATIO = 1e-12  # relative difference of equal ratios of periods, and of equal slopes


class Samples(NamedTuple):
    """The times offset, offset + period, ... of an event, s."""

    period: float
    offset: float

    def near(self, *times: float) -> float:
        """Return by how much some times may miss a sample by rounding, s."""
        return max(1e-9 * self.period, 4 * float(np.spacing(max(map(abs, times)))))

    def within(self, begin: float, end: float, *, at_begin: bool) -> Iterator[float]:
        """Yield the times from `begin` to `end`: with one of the two, as `at_begin` says."""
        count = round((begin - self.offset) / self.period) - 1
        near = self.near(begin, end)
        while (time := self.offset + count * self.period) <= end + near:
            count += 1
            first, last = abs(time - begin) <= near, abs(time - end) <= near
            if first or last:
                if first == at_begin and not (first and last):
                    yield begin if first else end
            elif time > begin:
                yield time


class _InTime(NamedTuple):
    """How an expression depends on explicit time.

    After a common multiple T of the periods, it has grown by slope T.

    Attributes:
        number: Its value if it is constant; otherwise None.
        slope: Mean rate, 1/s; not a number for any other law.
        periods: Periods, s.
    """

    number: float | None
    slope: float
    periods: frozenset[float]

    @property
    def is_periodic(self) -> bool:
        return self.slope == 0


_APERIODIC = _InTime(None, float("nan"), frozenset())


def period_of(dae: Dae, values: Values) -> float | None:
    """Return the common period of samples and coefficients, s; None for a model without.

    Raises:
        InitialConditionError: The linear system depends on time, but has no period.
    """
    sampled = [(i, event) for i, event in enumerate(dae.events) if event.sampled]
    periods = {of_samples(dae, i, values).period for i, _ in sampled}
    laws = ca.vertcat(dae.ode, dae.alg, *(event.values for _, event in sampled))
    if _varies_in_time(dae, laws):
        own = _in_time(dae, values, laws)
        if not all(law.is_periodic for law in own):
            changed = [dae.states[state] for _, event in sampled for state in event.states]
            names = [v.name for v in (*dae.states, *dae.algebraics, *changed)]
            wrong = next(name for name, law in zip(names, own, strict=True) if not law.is_periodic)
            raise InitialConditionError(
                f"{dae.full_name}: the equation of {wrong} depends on time without a period, so "
                "that no eigenvalues tell whether the motion is stable; replace time in it by a "
                "parameter or an input"
            )
        periods = periods.union(*(law.periods for law in own))
    if not periods:
        return None
    others = [event.name for event in dae.events if not event.sampled and not event.message]
    if others:
        raise InitialConditionError(
            f"{dae.full_name}: the event '{others[0]}' may happen within a period, so that the "
            "linear map over the period is not known; linearize the model without this event"
        )
    return _common(dae, sorted(periods))


def of_samples(dae: Dae, i: int, values: Values) -> Samples:
    """Return the sample times of an event, by its position."""
    count = dae.events[i].condition
    assert count.op() == ca.OP_FLOOR
    line = count.dep(0)
    law = ca.Function("law", [dae.t, dae.p], [line, ca.jacobian(line, dae.t)])
    begin, rate = map(float, law(0.0, values.p))
    return Samples(1 / rate, -begin / rate)


def _varies_in_time(dae: Dae, laws: SX) -> bool:
    """Tell whether the linear system of laws depends on explicit time."""
    knowns = ca.vertcat(dae.x, dae.z, dae.u)
    if not ca.depends_on(laws, dae.t):
        return False
    slopes = ca.jacobian(laws, knowns)
    return bool(ca.depends_on(slopes, ca.vertcat(dae.t, dae.x, dae.z)))


def _common(dae: Dae, periods: Sequence[float]) -> float:
    """Return the common period of several ones, s."""
    longest, multiple = periods[-1], 1
    for period in periods:
        ratio = longest / period
        near = Fraction(ratio).limit_denominator(MOST_PERIODS)
        if abs(float(near) - ratio) > SAME_RATIO * ratio or near.numerator > MOST_PERIODS**2:
            raise InitialConditionError(
                f"{dae.full_name}: the periods {period:.13g} s and {longest:.13g} s have no common "
                "period, so that there is no linear map over one; choose periods with a ratio of "
                "small integers"
            )
        multiple = lcm(multiple, near.denominator)
    return longest * multiple


def _in_time(dae: Dae, values: Values, laws: SX) -> list[_InTime]:
    """Return how each law of a model depends on explicit time."""
    if ca.OP_CALL in operations(laws):
        return [_APERIODIC] * laws.numel()
    known = ca.vertsplit(ca.vertcat(dae.u, dae.p)), (*values.u, *values.p)
    numbers = {symbol.element_hash(): value for symbol, value in zip(*known, strict=True)}

    def leaf(node: SX) -> _InTime:
        key = node.element_hash()
        if node.is_constant() or key in numbers:
            return _number(numbers[key] if key in numbers else float(node))
        return _InTime(None, float(key == dae.t.element_hash()), frozenset())

    return replayed(ca.cse(laws), leaf, _result)


def _number(value: float) -> _InTime:
    return _InTime(float(value), 0.0, frozenset())


def _result(code: int, terms: Sequence[_InTime]) -> _InTime:
    """Return how the result of an operation depends on time."""
    numbers = [term.number for term in terms if term.number is not None]
    if len(numbers) == len(terms):
        return _number(float(applied(code, [SX(number) for number in numbers])))
    periods = frozenset[float]().union(*(term.periods for term in terms))
    if code in _LINEAR:
        slope = _LINEAR[code](*terms)
        return _InTime(None, slope, periods) if isfinite(slope) else _APERIODIC
    first, a = terms[0], abs(terms[0].slope)
    if a and isfinite(a):
        if code in (ca.OP_SIN, ca.OP_COS):
            return _InTime(None, 0.0, periods | {2 * pi / a})
        if code == ca.OP_TAN:
            return _InTime(None, 0.0, periods | {pi / a})
        if code in (ca.OP_FLOOR, ca.OP_CEIL):
            return _InTime(None, first.slope, periods | {1 / a})
        if code in (ca.OP_FMOD, ca.OP_REMAINDER) and terms[1].number:
            return _InTime(None, 0.0, periods | {abs(terms[1].number) / a})
    if all(term.is_periodic for term in terms):
        return _InTime(None, 0.0, periods)
    return _APERIODIC


def _sum(a: float, b: float) -> float:
    """Return the sum of two slopes; 0 where rounding alone is left, as of t - 49 floor(t / 49)."""
    return 0.0 if abs(a + b) <= SAME_RATIO * max(abs(a), abs(b)) else a + b


def _product(a: _InTime, b: _InTime) -> float:
    if a.number is not None:
        return a.number * b.slope
    if b.number is not None:
        return a.slope * b.number
    return 0.0 if a.is_periodic and b.is_periodic else inf


def _quotient(a: _InTime, b: _InTime) -> float:
    if b.number is not None:
        return a.slope / b.number if b.number else inf
    return 0.0 if a.is_periodic and b.is_periodic else inf


_LINEAR: dict[int, Callable[..., float]] = {
    ca.OP_ADD: lambda a, b: _sum(a.slope, b.slope),
    ca.OP_SUB: lambda a, b: _sum(a.slope, -b.slope),
    ca.OP_NEG: lambda a: -a.slope,
    ca.OP_TWICE: lambda a: 2 * a.slope,
    ca.OP_MUL: _product,
    ca.OP_DIV: _quotient,
}
