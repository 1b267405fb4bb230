"""Check of a formula's dimensions by the units of its variables and numbers."""

import ast
import re
from collections.abc import Mapping
from math import log, nan

from casadi_models.units import MORE, UNITS, parse_unit
from cosim.errors import ParameterError

# Exponents of base units, and the logarithm of the factor to SI and the offset; nan is any. None is
# any dimension: that of a number or variable without a unit, and of products with it.
Dimension = Mapping[str, float] | None

_PURE: Dimension = {}  # of functions' values; added or compared, it fits any dimension
_RATIO = {"rad": nan, "offset": nan}  # a number or an angle
_ROUNDING = 1e-9
_TIME = "t", "time"
_POWER = r"[A-Za-z\u00b0\u03a9]+(?:\d+|(?:\^|\*\*)-?\d+)?"
NUMBER_WITH_UNIT = re.compile(
    r"(?<![\w.])(\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+(?:[eE][-+]?\d+)?)"
    rf"({_POWER}(?:[./*-]{_POWER})*)"
)
_ARITHMETIC = ast.Add | ast.Sub | ast.Mult | ast.Div | ast.Pow


def operations_of(node: ast.expr) -> tuple[ast.expr, list[ast.BinOp]]:
    """Return the first operand of a sum or product of any length, and its operations in order."""
    operations = list[ast.BinOp]()
    while isinstance(node, ast.BinOp) and isinstance(node.op, _ARITHMETIC):
        operations.append(node)
        node = node.left
    return node, operations[::-1]


class Dimensions:
    """Dimensions of the parts of a formula, in whose tree numbers with units are texts.

    Attributes:
        owner, text: For messages.
        tree: Of the formula.
        units: Of the variables by name, and of the formula's value by the name "".
        names: Of the formula.
        with_units: Whether a number in it has a unit; in a law without one, such as -phi - phi_dot,
            gains of 1 may have any.
    """

    def __init__(self, owner: str, text: str, tree: ast.expr, units: Mapping[str, str]) -> None:
        self.owner, self.text, self.tree, self.units = owner, text, tree, units
        nodes = [*ast.walk(tree)]
        self.names = {node.id for node in nodes if isinstance(node, ast.Name)}
        constants = (node.value for node in nodes if isinstance(node, ast.Constant))
        self.with_units = str in map(type, constants)

    def check(self) -> None:
        """Check a formula.

        Raises:
            ParameterError: What is compared or chosen from differs in dimension; or, if a number
                has a unit, terms of a sum do, an exponent, an argument of a function or the result
                has another, or a variable is not in SI units.
        """
        for name in ("", *self.names) if self.with_units else ():
            unit = parse_unit(self.units.get(name, ""))
            if unit is not None and not unit.is_si:
                raise mixed_units(self.owner, self.text, name or "the result", self.units[name])
        found, wanted = self.of(self.tree), self.units.get("", "")
        if self.with_units and not _fit(found, _of_unit(wanted)):
            raise self.refusal(f"the unit of the result is {_unit(found)} instead of {wanted}")

    def of(self, node: ast.expr) -> Dimension:
        """Return the dimension of an expression; a condition has none."""
        match node:
            case ast.Constant(value=str() as text):
                parts = NUMBER_WITH_UNIT.fullmatch(text)
                return _of_unit(parts[2], in_si=True) if parts else None
            case ast.Name(id=name):  # time is a number in a law such as 5N*t
                return None if name in _TIME else _of_unit(self.units.get(name, ""))
            case ast.UnaryOp(operand=operand):
                return self.of(operand)
            case ast.BinOp():
                return self.chained(node)
            case ast.BoolOp(values=parts):
                for part in parts:
                    self.of(part)
            case ast.Compare(left=left, comparators=others):
                self.common(left, *others)
            case ast.Call(func=ast.Name(id=name), args=arguments):
                return self.called(name, arguments)
        return None

    def chained(self, node: ast.expr) -> Dimension:
        """Return the dimension of a sum or product of any length."""
        first, operations = operations_of(node)
        found = self.of(first)
        for operation in operations:
            right = operation.right
            if isinstance(operation.op, ast.Add | ast.Sub):
                found = self.added(operation.left, found, right, self.of(right))
            elif isinstance(operation.op, ast.Pow):
                self.reject_dimension(right)
                found = _power(found, right)
            else:
                power = -1 if isinstance(operation.op, ast.Div) else 1
                found = _product(found, self.of(right), power)
        return found

    def called(self, name: str, arguments: list[ast.expr]) -> Dimension:
        """Return the dimension of a function's value."""
        first, *others = arguments
        if name == "where":
            self.of(first)
            return self.common(*others)
        if name in ("min", "max", "abs", "floor", "ceil"):
            return self.common(*arguments)
        if name == "sqrt":
            return _power(self.of(first), ast.Constant(0.5))
        if name in ("atan2", "sign"):
            self.common(*arguments)
        else:
            self.reject_dimension(first)
        return {"rad": 1.0} if name.startswith("a") else _PURE

    def common(self, first: ast.expr, *others: ast.expr) -> Dimension:
        """Return the common dimension of expressions."""
        found = self.compared(first)
        for other in others:
            its = self.compared(other)
            both = self.joined(first, found, other, its)
            first, found = (first if found else other), both
        return found

    def added(self, left: ast.expr, one: Dimension, right: ast.expr, other: Dimension) -> Dimension:
        """Return the dimension of a sum; None if it may be one of numbers."""
        return self.joined(left, one, right, other) if self.with_units or _fit(one, other) else None

    def compared(self, node: ast.expr) -> Dimension:
        """Return the dimension of a side of a comparison, where time alone is in s."""
        is_time = isinstance(node, ast.Name) and node.id in _TIME
        return _of_unit("s") if is_time else self.of(node)

    def joined(
        self, left: ast.expr, one: Dimension, right: ast.expr, other: Dimension
    ) -> Dimension:
        """Return the common dimension of two expressions."""
        if not _fit(one, other):
            raise self.refusal(
                f"{shown(left)} is in {_unit(one)}, but {shown(right)} in {_unit(other)}"
            )
        return one or other

    def reject_dimension(self, node: ast.expr) -> None:
        """Reject what has a dimension as an exponent or argument."""
        found = self.of(node)
        if self.with_units and not _fit(found, _RATIO):
            raise self.refusal(
                f"{shown(node)} is in {_unit(found)}, but must be a number or an angle in rad"
            )

    def refusal(self, reason: str) -> ParameterError:
        """Return an error with the remedy."""
        return ParameterError(
            f"{self.owner}: in '{self.text}', {reason}; combine quantities of one kind, or write a "
            "factor without a unit, as in 1*x, which may have any"
        )


def mixed_units(owner: str, text: str, name: str, unit: str) -> ParameterError:
    """Return an error of a formula with numbers in SI units and a variable in another unit."""
    return ParameterError(
        f"{owner}: '{text}' has numbers with units, which become SI values, but {name} is in "
        f"{unit}; write all numbers without units"
    )


def shown(node: ast.expr) -> str:
    """Return an expression as in the formula."""
    return ast.unparse(node).replace("'", "").replace(" ** ", "^").replace("**", "^")


def _of_unit(name: str, *, in_si: bool = False) -> Dimension:
    """Return the dimension of a variable's unit, or of a number that is converted to SI."""
    unit = parse_unit(name)
    if unit is None or name == "1":
        return None
    si = {"factor": log(unit.factor), "offset": unit.offset} if not in_si else {}
    return {"rad": 0.0 if unit.base else nan} | dict(unit.base) | si


def _product(one: Dimension, other: Dimension, power: int) -> Dimension:
    if one is None or other is None:
        return None
    names = one.keys() | other.keys()
    return {n: one.get(n, 0) + power * other.get(n, 0) for n in names} | _RATIO


def _power(base: Dimension, exponent: ast.expr) -> Dimension:
    try:
        power = float(ast.literal_eval(exponent))
    except ValueError:  # of an exponent that is no number
        return None
    return base and {name: power * n for name, n in base.items()} | _RATIO


def _fit(one: Dimension, other: Dimension) -> bool:
    """Return whether two dimensions may be those of one quantity."""
    if not one or not other:
        return True
    apart = (abs(one.get(n, 0) - other.get(n, 0)) for n in one.keys() | other.keys())
    return not any(gap > _ROUNDING for gap in apart)  # nan is not


def _unit(dimension: Dimension) -> str:
    """Return the name of a unit with a dimension."""
    powers = {name: n for name, n in sorted((dimension or {}).items()) if abs(n) > _ROUNDING}
    known = (name for name in (*UNITS, *MORE) if name != "1" and _fit(_of_unit(name), dimension))
    product = ".".join(f"{name}{n:g}" if n != 1 else name for name, n in powers.items())
    return (next(known, "") or product) if powers else "1"
