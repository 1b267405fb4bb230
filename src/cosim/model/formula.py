"""Parser of formulas such as `10*sin(2*pi*t)` or `abs(phi) > 45deg` to CasADi expressions."""

import ast
import operator
import re
from collections.abc import Callable, Container, Iterator, Mapping
from contextlib import contextmanager
from functools import reduce
from math import e, pi
from typing import Any

import casadi as ca
from casadi import SX

from casadi_models.units import parse_unit
from cosim.errors import ParameterError, UnknownName
from cosim.model.dimensions import NUMBER_WITH_UNIT, Dimensions, operations_of, shown

_CONSTANTS = {"pi": pi, "e": e}
_FUNCTIONS: Mapping[str, tuple[int, Callable[..., Any]]] = {
    **{
        name: (1, getattr(ca, name))
        for name in ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh")
    },
    **{name: (1, getattr(ca, name)) for name in ("exp", "log", "sqrt", "sign", "floor", "ceil")},
    "abs": (1, ca.fabs),
    "atan2": (2, ca.atan2),
    "min": (2, ca.fmin),
    "max": (2, ca.fmax),
    "where": (3, ca.if_else),  # where(condition, value if so, value if not)
}
_FACTORS = "write * between factors, as in 2*sin(t), and units without a blank, as in 3deg"
_LOGIC = "write `and` for & and `or` for |"
_CHOOSE = "write where(t > 1, 2, 0): the condition, the value if it holds, and the other one"
_REMEDIES = {  # by what a text that is no formula contains
    r"\bif\b|\?": _CHOOSE,
    r"&&|\|\|": _LOGIC,
    r"(?<![=<>!])=(?!=)": "write <, > or, for discrete variables, == between two values",
    r"\.[*/^]": "write *, / and ^ without a point",
    r"(?<![\w.'])[\d.]+\s*[A-Za-z(]": _FACTORS,
}
_OTHER_NAMES_OF_WHERE = ("ifelse", "if_else", "step", "heaviside")
_OPERATORS: Mapping[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_COMPARISONS: Mapping[type, Callable[[Any, Any], Any]] = {
    ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge
}  # fmt: skip


def expression(
    owner: str, text: str, symbols: Mapping[str, SX], units: Mapping[str, str] | None = None
) -> SX:
    """Read a formula.

    Numbers may carry a unit without a blank, `45deg` or `9.81m/s^2`, whose powers belong to it;
    `^` is a power; `where(t > 1, 2, 0)` chooses.

    Args:
        owner: For messages.
        symbols: By name.
        units: Of the symbols by name, and of the result by the name "".

    Raises:
        ParameterError: It is no formula of numbers, names and known functions, its dimensions are
            inconsistent, or it has numbers with a unit, which become SI values, and variables in
            other units.
        UnknownName: A name in it does not exist.
    """
    node = _parsed(owner, text, symbols)
    with _shallow(owner, text):
        value = SX(_Reader(owner, text, symbols).value(node))
        Dimensions(owner, text, node, units or {}).check()
        return value


def condition(
    owner: str, text: str, symbols: Mapping[str, SX], units: Mapping[str, str] | None = None
) -> SX:
    """Read a condition: comparisons, `and`, `or`, `not`; see `expression`.

    Raises:
        ParameterError: It is no condition, or see `expression`.
        UnknownName: A name in it does not exist.
    """
    node = _parsed(owner, text, symbols)
    with _shallow(owner, text):
        holds = SX(_Reader(owner, text, symbols).condition(node))
        Dimensions(owner, text, node, units or {}).check()
        return holds


@contextmanager
def _shallow(owner: str, text: str) -> Iterator[None]:
    """Reject a formula that is nested more deeply than Python allows."""
    try:
        yield
    except (RecursionError, MemoryError):
        raise ParameterError(
            f"{owner}: the formula '{text}' is nested too deeply; split it, or write a model"
        ) from None


def _parsed(owner: str, text: str, names: Container[str]) -> ast.expr:
    """Return the tree of a formula, in which numbers with a unit are texts."""
    if not isinstance(text, str):
        raise ParameterError(f"{owner}: {text!r} is no formula; give a text, e.g. '10*sin(t)'")
    plain = quoted(owner, text, names).replace("^", "**")  # ^ would bind less than +
    try:
        with _shallow(owner, text):
            return ast.parse(plain.strip(), mode="eval").body
    except (SyntaxError, ValueError) as error:
        for found, remedy in _REMEDIES.items():
            if re.search(found, plain):
                raise ParameterError(f"{owner}: '{text}' is no formula; {remedy}") from None
        raise ParameterError(
            f"{owner}: '{text}' is no formula ({getattr(error, 'msg', error)}); write it as in "
            "Python, e.g. 10*sin(2*pi*t)"
        ) from None


def quoted(owner: str, text: str, names: Container[str] = ()) -> str:
    """Return a formula with its numbers with a unit in quotes.

    Raises:
        ParameterError: One of them can be read in two ways.
    """
    return NUMBER_WITH_UNIT.sub(lambda match: _quoted(owner, match, names), text)


def _quoted(owner: str, match: re.Match[str], names: Container[str]) -> str:
    """Return a number with a unit in quotes; the longest matching unit is taken.

    Raises:
        ParameterError: A part of the unit may be a name of the model, or a power not part of it.
    """
    number, unit = match[1], match[2]
    for end in range(len(unit), 0, -1):
        rest = unit[end:]
        after = (rest + match.string[match.end() :]).lstrip()
        is_function = after.startswith("(")  # min, not the minute
        if parse_unit(unit[:end]) is None or is_function or (rest and rest[0].isalnum()):
            continue
        _, *factors = re.findall(r"[A-Za-z\u00b0\u03a9]+", unit[:end])
        is_difference = "-" in re.sub(r"[*^]-", "", unit[:end])
        is_power = after.startswith(("^", "**"))
        if is_difference or is_power or any(name in names for name in factors):
            raise ParameterError(
                f"{owner}: in '{match.string}', '{number}{unit[:end]}' can be read in two ways; "
                "write blanks around what does not belong to the unit, and powers as 3cm^2 or "
                "(3cm)^2"
            )
        return f"'{number}{unit[:end]}'{rest}"
    return match[0]


class _Reader:
    def __init__(self, owner: str, text: str, symbols: Mapping[str, SX]) -> None:
        self.owner, self.text, self.symbols = owner, text, symbols

    def value(self, node: ast.expr) -> Any:
        """Return the value of an arithmetic expression."""
        match node:
            case ast.Constant(value=bool()):
                raise self.refusal(node)
            case ast.Constant(value=int() | float() as number):
                return float(str(number))  # of any length
            case ast.Name(id=name):
                return self.named(name)
            case ast.Constant(value=str()):
                return self.in_si(node)
            case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=str()) as operand):
                return self.in_si(operand, -1)  # the minus belongs to the temperature
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return -self.value(operand)
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self.value(operand)
            case ast.BinOp(op=op) if type(op) in _OPERATORS:
                return self.chained(node)
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                return self.called(node, name, arguments)
        raise self.refusal(node)

    def chained(self, node: ast.expr) -> Any:
        """Return the value of a sum or product of any length, whose first terms lie deepest."""
        first, operations = operations_of(node)
        value = SX(self.value(first))
        for operation in operations:
            value = _OPERATORS[type(operation.op)](value, SX(self.value(operation.right)))
        return value

    def in_si(self, node: ast.Constant, sign: int = 1) -> float:
        """Return the SI value of a number with a unit."""
        parts = NUMBER_WITH_UNIT.fullmatch(str(node.value))
        unit = parse_unit(parts[2]) if parts else None
        if parts is None or unit is None:
            raise self.refusal(node)
        return sign * float(parts[1]) * unit.factor + unit.offset

    def condition(self, node: ast.expr) -> Any:
        """Return whether a condition holds, 1 or 0."""
        match node:
            case ast.Compare(left=left, ops=operators, comparators=others):
                sides = [SX(self.value(side)) for side in (left, *others)]
                if not {*map(type, operators)} <= _COMPARISONS.keys():
                    raise self.refusal(node)
                pairs = zip(operators, sides[:-1], sides[1:], strict=True)
                return reduce(ca.logic_and, (_COMPARISONS[type(op)](a, b) for op, a, b in pairs))
            case ast.BoolOp(op=op, values=parts):
                both = isinstance(op, ast.And)
                return reduce(ca.logic_and if both else ca.logic_or, map(self.condition, parts))
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return ca.logic_not(self.condition(operand))
        raise ParameterError(
            f"{self.owner}: '{self.text}' is no condition; compare two values, e.g. "
            "abs(phi) > 45deg"
        )

    def named(self, name: str) -> Any:
        if name in self.symbols:
            return self.symbols[name]
        if name in _CONSTANTS:
            return _CONSTANTS[name]
        raise UnknownName.among(f"{self.owner}: '{self.text}'", "name", name, self.symbols)

    def called(self, node: ast.expr, name: str, arguments: list[ast.expr]) -> Any:
        if name in _OTHER_NAMES_OF_WHERE:
            raise ParameterError(f"{self.owner}: '{self.text}': no function {name}; {_CHOOSE}")
        UnknownName.reject(f"{self.owner}: '{self.text}'", "function", _FUNCTIONS, name)
        count, function = _FUNCTIONS[name]
        if len(arguments) != count:
            raise self.refusal(node)
        if name == "where":
            condition, *values = arguments
            first, second = (SX(self.value(value)) for value in values)
            return ca.if_else(self.condition(condition), first, second)
        return function(*(SX(self.value(argument)) for argument in arguments))

    def refusal(self, node: ast.expr) -> ParameterError:
        if any(isinstance(part, ast.BitAnd | ast.BitOr) for part in ast.walk(node)):
            return ParameterError(f"{self.owner}: '{self.text}' is not understood; {_LOGIC}")
        called = node.func if isinstance(node, ast.Call) else None
        if isinstance(called, ast.Attribute) and called.attr in _FUNCTIONS:
            remedy = f"write {called.attr}(...) instead of {ast.unparse(called)}(...)"
            return ParameterError(f"{self.owner}: '{self.text}' is not understood; {remedy}")
        if isinstance(node, ast.Compare | ast.BoolOp):
            return ParameterError(
                f"{self.owner}: '{shown(node)}' in '{self.text}' is no number; {_CHOOSE}"
            )
        return ParameterError(
            f"{self.owner}: '{shown(node)}' in '{self.text}' is not understood; use numbers, "
            f"names, + - * / ^ and {', '.join(_FUNCTIONS)}"
        )
