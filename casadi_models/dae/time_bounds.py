"""Between which values expressions and their derivatives stay over a span of time, or of states.

Interval arithmetic on the graph, with expressions for the ends. Where an operation has a pole or no
value within the span, the bounds of the derivatives are not finite.

Source  Moore, Kearfott & Cloud, Introduction to Interval Analysis, SIAM 2009.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import product
from math import comb, prod
from typing import NamedTuple

import casadi as ca
from casadi import SX

from casadi_models.dae.expressions import applied, column, operations, replayed
from casadi_models.dae.frozen import Dae

_MOST_OPERATIONS = 500  # of an expression whose bounds over a part of a step tell something
_MOST_DEGREE = 4  # of a polynomial
_TRUTHS = {ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_AND, ca.OP_OR, ca.OP_NOT}
_LEAST = 1e-300  # distance of what is below 0
# Factors of the first and of the last operand, which are the same if there is one
_SUMS = {ca.OP_ADD: (1, 1), ca.OP_SUB: (1, -1), ca.OP_NEG: (-1, 0), ca.OP_TWICE: (2, 0)}
# Coefficients by what moves each product, in shares of its span: {(0, 0): c} is c (share of 0)^2
_Polynomial = dict[tuple[int, ...], SX]


class _Span(NamedTuple):
    """Least and greatest value of an expression; both are the value of one that stays.

    `terms` is the expression as a polynomial, if it is known to be one.
    """

    low: SX
    high: SX
    stays: bool
    terms: _Polynomial | None = None


class TimeBounds(NamedTuple):
    """Bounds of arguments of relations over the span from `dae.t` on.

    Attributes:
        length: Symbol of the length of the span, s.
        relations: Positions of the relations whose bounds are known.
        low, high: For each of these, bounds of the value and of the first and second time
            derivative, one after the other.
    """

    length: SX
    relations: tuple[int, ...]
    low: SX
    high: SX


class Enclosures(NamedTuple):
    """Bounds of arguments of relations over a part of a step.

    Attributes:
        given: Symbols of its length, s; of the least and greatest values of states and inputs, and
            of their least and greatest rates.
        relations: Positions of the relations whose bounds are known.
        low, high: For each of these, bounds of the value and of the time derivative in turns.
    """

    given: tuple[SX, SX, SX, SX, SX]
    relations: tuple[int, ...]
    low: SX
    high: SX

    @property
    def of_time(self) -> bool:
        """Whether the bounds depend on time, and thus on the length of the part."""
        return bool(ca.depends_on(ca.vertcat(self.low, self.high), self.given[0]))

    @property
    def moving(self) -> list[int]:
        """Positions of the states, and after them inputs, on whose spans the bounds depend."""
        ends = ca.vertcat(self.low, self.high)
        used = [ca.which_depends(ends, own, 1, False) for own in self.given[1:] if ends.numel()]
        return [i for i, each in enumerate(zip(*used, strict=True)) if any(each)]


class _UnknownError(Exception):
    """An operation whose bounds are not known."""


_MONOTONE = {
    ca.OP_EXP, ca.OP_EXPM1, ca.OP_LOG, ca.OP_LOG1P, ca.OP_SQRT, ca.OP_ASIN, ca.OP_ATAN,
    ca.OP_SINH, ca.OP_TANH, ca.OP_ASINH, ca.OP_ACOSH, ca.OP_ATANH, ca.OP_ERF, ca.OP_ERFINV,
}  # fmt: skip


def time_bounds(dae: Dae, expressions: Mapping[int, SX]) -> TimeBounds:
    """Return the bounds of expressions of time, parameters and modes, by position.

    Args:
        dae: Frozen equations.
        expressions: Arguments of relations by their positions.
    """
    length, known = SX.sym("length"), list[int]()
    lows, highs = list[SX](), list[SX]()
    for i, value in expressions.items():
        rate = ca.jtimes(value, dae.t, 1)
        rates = [rate, ca.jtimes(rate, dae.t, 1)]
        spans = _spans(value, rates, dae.t, lambda _, t: _Span(t, t + length, stays=False))
        if not spans:
            continue
        known.append(i)
        lows += [span.low for span in spans]
        highs += [span.high for span in spans]
    return TimeBounds(length, tuple(known), column(lows), column(highs))


def is_small(expression: SX) -> bool:
    """Return whether an expression has so few operations that its bounds tell something."""
    count: int = ca.Function("f", ca.symvar(expression), [expression]).n_instructions()
    return count <= _MOST_OPERATIONS


def enclosures(dae: Dae, expressions: Mapping[int, SX], modes: int) -> Enclosures:
    """Return the bounds of expressions of time, states and inputs, by position.

    Left out are those that depend on algebraic unknowns, or whose bounds would be wide and dear.

    Args:
        dae: Frozen equations.
        expressions: Arguments of relations, or margins of limits, by their positions.
        modes: How many of the last inputs are modes, which stay.
    """
    inputs = ca.vertsplit(dae.u)
    free = len(inputs) - modes
    moving = column([*ca.vertsplit(dae.x), *inputs[:free]])
    n = moving.numel()
    length = SX.sym("length")
    low, high, slowest, fastest = (SX.sym(name, n) for name in ("l", "h", "s", "f"))
    rates = SX.sym("d", n)
    starts = ca.vertcat(dae.t, low, slowest)
    ends = ca.vertcat(dae.t + length, high, fastest)
    known, found = list[int](), list[_Span]()
    for i, value in expressions.items():
        jumps = _TRUTHS.intersection(operations(value))  # no root is found of what does so
        if jumps or ca.depends_on(value, dae.z) or not is_small(value):
            continue
        rate = ca.jtimes(value, ca.vertcat(dae.t, moving), ca.vertcat(1, rates))
        spans = _spans(
            value,
            [rate],
            ca.vertcat(dae.t, moving, rates),
            lambda row, _: _Span(starts[row], ends[row], stays=False),
        )
        if not spans:
            continue
        found += spans
        known.append(i)
    least, most = column(span.low for span in found), column(span.high for span in found)
    return Enclosures((length, low, high, slowest, fastest), tuple(known), least, most)


def limit_enclosures(dae: Dae, modes: int = 0) -> Enclosures:
    """Return the bounds of the margins of a model's limits; see `enclosures`."""
    return enclosures(dae, dict(enumerate(margin for margin, _ in dae.limits)), modes)


def bounds_along(value: SX, moving: SX, length: SX) -> tuple[SX, SX] | None:
    """Return how far an expression may be from a line; None where no rule tells it.

    Args:
        value: An expression, (1, 1).
        moving: The symbol that goes from its value on over a length.
        length: Symbol of the length.

    Returns:
        The bound by its second derivative, and that by its values; both hold, but for NaN.
    """
    second = ca.jtimes(ca.jtimes(value, moving, 1), moving, 1)
    spans = _spans(value, [second], moving, lambda row, at: _moving(row, at, at + length))
    if not spans:
        return None
    around, bend = spans
    most = ca.fmax(ca.fabs(bend.low), ca.fabs(bend.high))
    return most * length**2 / 8, around.high - around.low


def bounds_within(value: SX, moving: SX, ends: tuple[SX, SX]) -> tuple[SX, SX] | None:
    """Return bounds of an expression; None where no rule tells them.

    Args:
        value: An expression, (1, 1).
        moving: The symbols that move, (n, 1); others stay.
        ends: Symbols of the least and greatest values of these, (n, 1) each.
    """
    low, high = map(ca.vertsplit, ends)
    spans = _spans(value, [], moving, lambda row, _: _moving(row, low[row], high[row]))
    return (spans[0].low, spans[0].high) if spans else None


def _spans(
    value: SX, rates: Sequence[SX], symbols: SX, moving: Callable[[int, SX], _Span]
) -> list[_Span]:
    """Return the spans of a value and of its derivatives from those of moving symbols.

    Where the value jumps within its span, those of its derivatives are not finite.

    Returns:
        Of the value, and of each derivative; [] if they are unknown.
    """
    places = {symbol.element_hash(): row for row, symbol in enumerate(ca.vertsplit(symbols))}
    rows, jumps = ca.cse(ca.vertcat(value, *rates)), list[SX]()

    def leaf(node: SX) -> _Span:
        place = places.get(node.element_hash())
        return _constant(node) if place is None else moving(place, node)

    def operation(side: int, code: int, operands: list[_Span]) -> _Span:
        if code == ca.OP_CALL:
            raise _UnknownError
        if all(operand.stays for operand in operands):
            return _constant(applied(code, [operand.low for operand in operands]))
        if code == ca.OP_HYPOT:
            squares = [_operated(ca.OP_SQ, [operand]) for operand in operands]
            return _operated(ca.OP_SQRT, [_operated(ca.OP_ADD, squares)])
        if code == ca.OP_ATAN2:
            y, x = map(_within_terms, operands)
            jumps.append(ca.logic_and(ca.logic_and(y.low < 0, y.high >= 0), x.low < 0))
            return _angle(y, x, jumps[-1], side if len(jumps) == 1 else 0)
        if code == ca.OP_IF_ELSE_ZERO and not operands[0].stays:
            jumps.append(operands[0].low != operands[0].high)
        return _operated(code, operands)

    def on(side: int) -> list[_Span]:
        jumps.clear()
        return [*map(_within_terms, replayed(rows, leaf, partial(operation, side)))]

    try:
        found, *slopes = on(1)
    except _UnknownError:
        return []
    if jumps:
        below = on(-1)[0]
        found = _around(column([found.low, found.high, below.low, below.high]))
    for jump in jumps:
        known = ca.if_else(jump, SX.nan(), 1)
        slopes = [_Span(known * s.low, known * s.high, False) for s in slopes]
    return [found, *slopes]


def _operated(code: int, operands: Sequence[_Span]) -> _Span:
    """Return the span of an operation, and its polynomial if it is one."""
    terms = _polynomial(code, operands)
    if terms is None:
        return _result(code, [_within_terms(operand) for operand in operands])
    return _result(code, operands)._replace(terms=terms)


def _polynomial(code: int, operands: Sequence[_Span]) -> _Polynomial | None:
    """Return the result of an operation as a polynomial; None if it is none of a low degree."""
    a, b = operands[0].terms, operands[-1].terms
    if a is None or b is None:
        return None
    if code == ca.OP_DIV and operands[-1].stays:
        return _times(a, {(): 1 / b[()]})
    if code in _SUMS:
        first, last = _SUMS[code]
        zero = SX(0)
        return {key: first * a.get(key, zero) + last * b.get(key, zero) for key in a | b}
    return _times(a, b) if code in (ca.OP_MUL, ca.OP_SQ) else None


def _times(a: _Polynomial, b: _Polynomial) -> _Polynomial | None:
    found: _Polynomial = {}
    for (one, x), (other, y) in product(a.items(), b.items()):
        key = tuple(sorted(one + other))
        found[key] = found.get(key, 0) + x * y
    return found if max(map(len, found)) <= _MOST_DEGREE else None


def _within_terms(span: _Span) -> _Span:
    """Return the span of a polynomial between its Bernstein coefficients; others as they are."""
    terms = span.terms
    if terms is None or max(map(len, terms)) < 2:
        return span
    degrees = {row: max(key.count(row) for key in terms) for key in terms for row in key}

    def coefficient(place: Sequence[int]) -> SX:
        found = SX(0)
        for key, factor in terms.items():
            pairs = zip(place, degrees.items(), strict=True)
            shares = (comb(i, key.count(row)) / comb(n, key.count(row)) for i, (row, n) in pairs)
            found += factor * prod(shares)
        return found

    places = product(*(range(n + 1) for n in degrees.values()))
    every = column(map(coefficient, places))
    is_finite = ca.fabs(ca.sum1(every)) < SX.inf()  # fmin and fmax pass over NaN
    low = ca.if_else(is_finite, ca.fmax(span.low, ca.mmin(every)), span.low)
    high = ca.if_else(is_finite, ca.fmin(span.high, ca.mmax(every)), span.high)
    return _Span(low, high, False)


def _moving(row: int, low: SX, high: SX) -> _Span:
    """Return the span of a symbol as a polynomial, so that its products are no wider."""
    return _Span(low, high, False, {(): low, (row,): high - low})


def _constant(value: SX) -> _Span:
    return _Span(value, value, True, {(): value})


def _result(code: int, operands: Sequence[_Span]) -> _Span:
    """Return the span of an operation of which an operand moves."""
    a, b = operands[0], operands[-1]
    if code in _MONOTONE:
        return _Span(applied(code, [a.low]), applied(code, [a.high]), False)
    rule = _RULES.get(code)
    if rule is None:
        raise _UnknownError
    return rule(a, b)


def _middle(a: _Span) -> tuple[SX, SX]:
    """Return the middle and the radius: without a branch, so that NaN is passed on."""
    if a.stays:
        return a.low, SX(0)
    radius = ca.if_else(a.low == a.high, 0, (a.high - a.low) / 2)  # also of infinite ends
    return (a.low + a.high) / 2, radius


def _sum(a: _Span, b: _Span) -> _Span:
    return _Span(a.low + b.low, a.high + b.high, False)


def _negative(a: _Span, _: _Span) -> _Span:
    return _Span(-a.high, -a.low, False)


def _product(a: _Span, b: _Span) -> _Span:
    for factor, other in ((a, b), (b, a)):
        if factor.stays and factor.low.is_constant():
            ends = (factor.low * other.low, factor.low * other.high)
            return _Span(*(ends if float(factor.low) >= 0 else ends[::-1]), False)
    return _around(column(x * y for x in (a.low, a.high) for y in (b.low, b.high)))


def _around(values: SX) -> _Span:
    """Return the span of some values, (n, 1); NaN if one is, or if some are +-infinite."""
    is_known = ca.fabs(ca.sum1(values)) <= SX.inf()  # fmin and fmax pass over NaN
    low, high = (ca.if_else(is_known, f(values), SX.nan()) for f in (ca.mmin, ca.mmax))
    return _Span(low, high, False)


def _angle(y: _Span, x: _Span, jumps: SX, side: int) -> _Span:
    """Return the span of an angle.

    Args:
        y, x: Spans of its sine and its cosine, or of their multiples.
        jumps: Whether they hold places where it jumps by a turn.
        side: Of which side of these the span is: 1 above, -1 below, 0 both.
    """
    if not side:
        above, below = (_angle(y, x, jumps, own) for own in (1, -1))
        return _around(column([above.low, above.high, below.low, below.high]))
    low = ca.if_else(jumps, 0, y.low) if side > 0 else y.low
    high = y.high if side > 0 else ca.if_else(jumps, -_LEAST, y.high)
    return _around(column(ca.atan2(a, b) for a in (low, high) for b in (x.low, x.high)))


def _inverse(a: _Span, _: _Span) -> _Span:
    if a.stays:
        return _constant(1 / a.low)
    without_zero = a.low * a.high > 0
    low, high = (ca.if_else(without_zero, 1 / end, SX.nan()) for end in (a.high, a.low))
    return _Span(low, high, False)


def _power_of(a: _Span, n: int) -> _Span:
    """Return the span of a positive integer power."""
    if n == 1:
        return a
    if n % 2:
        return _Span(a.low**n, a.high**n, False)
    middle, radius = _middle(a)
    nearest = ca.fmax(ca.fmax(a.low, -a.high), 0)
    return _Span(nearest**n, (ca.fabs(middle) + radius) ** n, False)


def _power(a: _Span, b: _Span) -> _Span:
    if b.stays and b.low.is_constant() and float(b.low).is_integer():
        n = int(float(b.low))
        if not n:
            return _constant(SX(1))
        found = _power_of(a, abs(n))
        return found if n > 0 else _inverse(found, found)
    base = _Span(ca.log(a.low), ca.log(a.high), a.stays)
    exponent = _product(b, base)
    return _Span(ca.exp(exponent.low), ca.exp(exponent.high), False)


def _wave(function: Callable[[SX], SX]) -> Callable[[_Span, _Span], _Span]:
    def rule(a: _Span, _: _Span) -> _Span:
        middle, radius = _middle(a)
        value = function(middle)
        return _Span(ca.fmax(value - radius, -1), ca.fmin(value + radius, 1), False)

    return rule


def _tangent(a: _Span, _: _Span) -> _Span:
    low, high = ca.tan(a.low), ca.tan(a.high)
    without_pole = ca.logic_and(a.high - a.low < 3, low <= high)
    low, high = (ca.if_else(without_pole, end, SX.nan()) for end in (low, high))
    return _Span(low, high, False)


def _hyperbolic_cosine(a: _Span, b: _Span) -> _Span:
    ends = _sum(_result(ca.OP_EXP, [a]), _result(ca.OP_EXP, [_negative(a, b)]))
    return _Span(ends.low / 2, ends.high / 2, False)


def _chosen(condition: _Span, a: _Span) -> _Span:
    """Return the span of an operand where a condition holds, and of 0 where it does not."""
    low, high = (SX.binary(ca.OP_IF_ELSE_ZERO, condition.high, end) for end in (a.low, a.high))
    if condition.stays:
        return _Span(low, high, False)
    low = ca.if_else(condition.low, low, ca.fmin(low, 0))
    return _Span(low, ca.if_else(condition.low, high, ca.fmax(high, 0)), False)


_RULES: dict[int, Callable[[_Span, _Span], _Span]] = {  # of one operand, or of the first and last
    ca.OP_ADD: _sum,
    ca.OP_SUB: lambda a, b: _sum(a, _negative(b, b)),
    ca.OP_NEG: _negative,
    ca.OP_TWICE: lambda a, b: _sum(a, a),
    ca.OP_MUL: _product,
    ca.OP_INV: _inverse,
    ca.OP_DIV: lambda a, b: _product(a, _inverse(b, b)),
    ca.OP_SQ: lambda a, _: _power_of(a, 2),
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
    ca.OP_SIN: _wave(ca.sin),
    ca.OP_COS: _wave(ca.cos),
    ca.OP_TAN: _tangent,
    ca.OP_ACOS: lambda a, b: _Span(ca.acos(a.high), ca.acos(a.low), False),
    ca.OP_COSH: _hyperbolic_cosine,
    ca.OP_IF_ELSE_ZERO: _chosen,
    ca.OP_LT: lambda a, b: _Span(a.high < b.low, a.low < b.high, False),
    ca.OP_LE: lambda a, b: _Span(a.high <= b.low, a.low <= b.high, False),
    ca.OP_EQ: lambda a, b: _Span(SX(0), ca.logic_and(a.low <= b.high, b.low <= a.high), False),
    ca.OP_NE: lambda a, b: _Span(ca.logic_or(a.high < b.low, b.high < a.low), SX(1), False),
    ca.OP_AND: lambda a, b: _Span(ca.logic_and(a.low, b.low), ca.logic_and(a.high, b.high), False),
    ca.OP_OR: lambda a, b: _Span(ca.logic_or(a.low, b.low), ca.logic_or(a.high, b.high), False),
    ca.OP_NOT: lambda a, _: _Span(ca.logic_not(a.high), ca.logic_not(a.low), False),
}
