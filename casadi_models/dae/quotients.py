"""`without_poles`: an expression with the sign of another one, which changes only at zeros."""

from collections import Counter
from collections.abc import Collection, Iterable
from enum import IntEnum
from math import prod
from typing import NamedTuple

import casadi as ca
from casadi import SX

from casadi_models.dae.expressions import applied, operations, replayed
from casadi_models.dae.time_bounds import is_small

_DIVIDING = {ca.OP_DIV, ca.OP_INV, ca.OP_TAN, ca.OP_CONSTPOW, ca.OP_POW}


class _Range(IntEnum):
    """Which values an expression may have."""

    ANY = 0
    NOT_NEGATIVE = 1
    POSITIVE = 2


class _Factor:
    """A factor of a denominator; equal to another one of the same expression."""

    def __init__(self, value: SX, range_: _Range) -> None:
        self.value, self.range = value, range_

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Factor) and hash(self) == hash(other)

    def __hash__(self) -> int:
        return int(self.value.element_hash())


_Factors = Counter[_Factor]  # with their powers


class _Quotient(NamedTuple):
    """An expression as a quotient.

    Attributes:
        value: The expression.
        range: Which values it may have.
        moves: Whether it may change during a run.
        above, below: The factors of its numerator and its denominator.
    """

    value: SX
    range: _Range
    moves: bool
    above: _Factors
    below: _Factors


def without_poles(argument: SX, constant: Collection[int]) -> SX:
    """Return an expression with the sign of another one, and without poles where that may change.

    A quotient has the sign of its numerator times its denominator. Poles within other functions
    stay, and so does an expression without any, or one whose numerator would be a large one.

    Args:
        argument: (1, 1).
        constant: Hashes of the symbols that do not change during a run.
    """
    used = operations(argument)
    if ca.OP_CALL in used or not _DIVIDING.intersection(used):
        return argument

    def leaf(node: SX) -> _Quotient:
        moves = node.is_symbolic() and node.element_hash() not in constant
        return _whole(node, _range_of(node.op(), [], node), moves)

    quotient = replayed(argument, leaf, _result)[0]
    if all(factor.range == _Range.POSITIVE for factor in quotient.below):
        return argument
    odd = (f.value for f, power in quotient.below.items() if power % 2 and f.range == _Range.ANY)
    found = prod(odd, start=_product(quotient.above))
    return found if is_small(found) else argument


def _whole(value: SX, range_: _Range, moves: bool) -> _Quotient:
    return _Quotient(value, range_, moves, _one(value, range_), Counter())


def _one(value: SX, range_: _Range) -> _Factors:
    return Counter([_Factor(value, range_)])


def _result(code: int, operands: list[_Quotient]) -> _Quotient:
    """Return the result of an operation."""
    value = applied(code, [operand.value for operand in operands])
    found = _whole(value, _range_of(code, operands, value), any(each.moves for each in operands))
    if not found.moves:
        return found
    a, b = operands[0], operands[-1]
    above, below = found.above, found.below
    match code:
        case ca.OP_NEG:
            above, below = a.above + _one(SX(-1), _Range.ANY), a.below
        case ca.OP_TWICE:
            above, below = a.above + _one(SX(2), _Range.POSITIVE), a.below
        case ca.OP_ADD | ca.OP_SUB:
            below = a.below | b.below
            terms = [_product(each.above + (below - each.below)) for each in (a, b)]
            above = _one(applied(code, terms), found.range)
        case ca.OP_MUL | ca.OP_SQ:
            above, below = a.above + b.above, a.below + b.below
        case ca.OP_IF_ELSE_ZERO:
            above, below = _one(applied(code, [a.value, _product(b.above)]), b.range), b.below
        case ca.OP_DIV if not b.moves:
            above, below = a.above + _one(1 / b.value, b.range), a.below
        case ca.OP_DIV:
            above, below = a.above + b.below, a.below + b.above
        case ca.OP_INV:
            above, below = a.below, a.above
        case ca.OP_TAN:
            above, below = (_one(f(a.value), _Range.ANY) for f in (ca.sin, ca.cos))
        case ca.OP_CONSTPOW | ca.OP_POW if power := _inverse_power(b.value):
            above, below = (
                Counter({factor: power * n for factor, n in factors.items()})
                for factors in (a.below, a.above)
            )
    return found._replace(above=above, below=below)


def _product(factors: _Factors) -> SX:
    return prod((factor.value for factor in factors.elements()), start=SX(1))


def _inverse_power(exponent: SX) -> int:
    """Return the n of a power -n with an integer n; 0 for another exponent."""
    number = float(exponent) if exponent.is_constant() else 0.0
    return -int(number) if number < 0 and number.is_integer() else 0


def _range_of(code: int, operands: Iterable[_Quotient], value: SX) -> _Range:
    """Return which values a result may have."""
    if value.is_constant():
        number = float(value)
        return _Range.POSITIVE if number > 0 else _Range.ANY if number < 0 else _Range.NOT_NEGATIVE
    ranges = [operand.range for operand in operands]
    match code:
        case ca.OP_EXP | ca.OP_COSH:
            return _Range.POSITIVE
        case ca.OP_ADD if min(ranges) > _Range.ANY:
            return max(ranges)
        case ca.OP_MUL | ca.OP_DIV | ca.OP_TWICE | ca.OP_SQRT | ca.OP_INV:
            return min(ranges)
        case ca.OP_SQ | ca.OP_FABS | ca.OP_HYPOT:
            return max(_Range.NOT_NEGATIVE, min(ranges))
    return _Range.ANY
