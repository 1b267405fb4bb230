"""Expressions of SymPy as CasADi graphs, by SymPy's own printer interface."""

from collections import Counter
from collections.abc import Callable, Mapping
from functools import reduce
from typing import Any

import casadi as ca
from casadi import SX

from cosim.errors import UsageError
from cosim.host.optional_packages import optional_module

_NAMES = "sin cos tan asin acos atan atan2 sinh cosh tanh asinh acosh atanh exp log sign"
_FUNCTIONS = {name: name for name in _NAMES.split()} | {"Abs": "fabs", "Min": "fmin", "Max": "fmax"}


class _CasadiPrinter:
    """Methods of a SymPy printer that returns SX instead of text."""

    who: str
    values: dict[Any, SX]  # of symbols
    _print: Callable[[Any], SX]

    def _print_Symbol(self, node: Any) -> SX:
        return self.values[node]

    def _print_Number(self, node: Any) -> SX:
        return SX(float(node))

    _print_NumberSymbol = _print_Number  # pi

    def _print_Add(self, node: Any) -> SX:
        factors = [term.args if term.is_Mul else (term,) for term in node.args]
        counts = Counter(f for own in factors for f in own if not f.is_Number)
        common, times = max(counts.items(), key=lambda item: item[1], default=(0, 1))
        if times == 1:
            return reduce(SX.__add__, map(self._print, node.args))
        inside = [x / common for x, own in zip(node.args, factors, strict=True) if common in own]
        outside = [x for x, own in zip(node.args, factors, strict=True) if common not in own]
        rest = self._print(node.func(*outside))
        return self._print(common) * self._print(node.func(*inside)) + rest

    def _print_Mul(self, node: Any) -> SX:
        return reduce(SX.__mul__, map(self._print, node.args))

    def _print_Pow(self, node: Any) -> SX:
        base, exponent = self._print(node.base), node.exp
        if exponent.is_Rational and exponent.q == 2:
            base, exponent = ca.sqrt(base), 2 * exponent
        return base ** self._print(exponent)

    def _print_Application(self, node: Any) -> SX:
        if type(node).__name__ not in _FUNCTIONS:
            return self.emptyPrinter(node)
        function = getattr(ca, _FUNCTIONS[type(node).__name__])
        arguments = [*map(self._print, node.args)]
        return reduce(function, arguments) if len(arguments) > 1 else function(*arguments)

    def emptyPrinter(self, node: Any) -> SX:
        name = type(node).__name__
        raise UsageError(f"{self.who}: SymPy's {name} has no CasADi form here; replace it")


def printed(who: str, laws: Mapping[str, Any], values: Mapping[Any, SX]) -> dict[str, SX]:
    """Return matrices of SymPy as SX; common subexpressions are computed once."""
    sympy = optional_module("sympy", "sympy")
    printer: Any = type("Printer", (_CasadiPrinter, sympy.printing.printer.Printer), {})()
    plain = {leaf: sympy.Dummy() for leaf in values}  # cse would look into q(t)
    printer.who, printer.values = who, {plain[leaf]: value for leaf, value in values.items()}
    rows = [matrix.xreplace(plain) for matrix in laws.values()]
    common, rows = sympy.cse(rows, sympy.numbered_symbols(cls=sympy.Dummy), order="none")
    for symbol, expression in common:
        printer.values[symbol] = printer._print(expression)
    columns = [ca.vertcat(SX(0, 1), *map(printer._print, matrix)) for matrix in rows]
    shapes = [(max(matrix.cols, 1), matrix.rows) for matrix in rows]
    shaped = [ca.reshape(*both).T for both in zip(columns, shapes, strict=True)]
    return dict(zip(laws, shaped, strict=True))
