"""Symbols and equations of a DAE in CasADi, read from each accepted form."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import casadi as ca
from casadi import DM, MX, SX

from cosim.errors import UnknownName, UsageError
from cosim.model.foreign.named_symbols import Symbol, named_apart, named_symbols, reject_duplicates
from cosim.model.foreign.scalar_graph import reject_calls, scalar_graph

SYMBOLS = ("t", "x", "z", "u", "p")
LAWS = ("ode", "alg", "quad")
EVENTS = ("zero", "transition")  # as of `casadi.integrator`
REDUCED = ("x_impl", "dx_impl", "I")  # what dae_reduce_index adds


@dataclass(frozen=True, eq=False)  # CasADi's == builds an expression
class System:
    """Named symbols and their facts, all SX or all MX.

    Attributes:
        symbols: Of t, x, z, u, p.
        laws: ode, alg, quad: columns; I: invariants.
        outputs: By name.
        transition: From (event, t, x, z, p, u) to new states, where a row of `zero` falls below 0.
        starts: That come with a Function: its own `default_in`, where it is not 0.
    """

    symbols: dict[str, tuple[Symbol, ...]]
    laws: dict[str, Any]
    outputs: dict[str, Any] = field(default_factory=dict)
    starts: dict[str, float] = field(default_factory=dict)
    transition: ca.Function | None = None

    def jumps(self) -> list[Any]:
        """Return the new states after each event."""
        count = self.laws["zero"].numel() if "zero" in self.laws else 0
        columns: list[Any] = [[s.symbol for s in self.symbols[k]] for k in SYMBOLS]
        t, x, z, u, p = (ca.veccat(*column) for column in columns)
        if self.transition is None:
            return []
        given = [t if t.numel() else 0.0, x, z, p, u]
        return [self.transition.call([i, *given])[0] for i in range(count)]


def read_system(who: str, system: Any, outputs: Mapping[str, Any]) -> System:
    """Return symbols and laws of a mapping, a Function, the path of one, or an index reduction."""
    if is_reduction(system):
        system = system[0]
    if isinstance(system, str | os.PathLike):
        system = _loaded(who, Path(system))
    if isinstance(system, ca.Function):
        return _of_function(who, system, outputs)
    if not isinstance(system, Mapping):
        raise UsageError.of_type("from_casadi", system, "a dict of expressions or a Function")
    for key in system:
        if key not in (every := (*SYMBOLS, *LAWS, *EVENTS, *REDUCED)):
            raise UnknownName.among(who, "key", key, every)
    transition = system.get("transition")
    if ("zero" in system) != isinstance(transition, ca.Function):
        raise UsageError(f"{who}: give 'zero' and the Function 'transition' together, or neither")
    given = {
        key: value
        for key, value in system.items()
        if not (value is None or (isinstance(value, SX | MX | DM) and value.numel() == 0))
    }
    symbols = {k: named_symbols(who, k, given[k]) if k in given else () for k in SYMBOLS}
    for extra, kind in (("x_impl", "x"), ("dx_impl", "z")):
        if extra in given:
            symbols[kind] += named_symbols(who, extra, given[extra])
    symbols = dict(zip(symbols, named_apart([*symbols.values()]), strict=True))
    reject_duplicates(who, [*symbols.values()])
    laws = {key: _stacked(who, key, given[key]) for key in (*LAWS, "zero", "I") if key in given}
    if "x_impl" in given:
        laws["ode"] = ca.vertcat(
            laws.get("ode", SX(0, 1)), _stacked(who, "dx_impl", given["dx_impl"])
        )
    found = {n: _expression(who, n, e) for n, e in outputs.items()}
    return System(symbols, laws, found, transition=transition)


def is_reduction(value: Any) -> bool:
    """Return whether this is what `casadi.dae_reduce_index` returns: a DAE and its index."""
    match value:
        case ({"x_impl": _}, {"index": _, **others}):
            return isinstance(value, tuple) and not others
    return False


def _of_function(who: str, function: ca.Function, outputs: Mapping[str, Any]) -> System:
    for input_name in function.name_in():
        if input_name not in SYMBOLS:
            raise UnknownName.among(who, "input", input_name, SYMBOLS)
    symbols: dict[str, tuple[Symbol, ...]] = dict.fromkeys(SYMBOLS, ())
    arguments = []
    for input_name in function.name_in():
        shape = function.size_in(input_name)
        arguments.append(MX.sym(input_name, *shape))
        if arguments[-1].numel():
            symbols[input_name] = (Symbol(input_name, shape, arguments[-1]),)
    results = dict(zip(function.name_out(), function.call(arguments, True, False), strict=True))
    laws = {key: ca.vec(results[key]) for key in LAWS if key in results}
    others = {n: e for n, e in results.items() if n not in laws and e.numel()}
    for output, expression in outputs.items():
        others[output] = _expression(who, output, expression)
    defaults = {n: function.default_in(i) for i, n in enumerate(function.name_in()) if symbols[n]}
    starts = {n: value for n, value in defaults.items() if value and n != "t"}
    return System(symbols, {k: law for k, law in laws.items() if law.numel()}, others, starts)


def _loaded(who: str, path: Path) -> ca.Function:
    try:
        return ca.Function.load(str(path))
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1]
        raise UsageError(f"{who}: {path} holds no CasADi Function ({reason})") from error


def _stacked(who: str, key: str, value: Any) -> Any:
    """Return a law as a column."""
    if isinstance(value, list | tuple):
        return ca.vertcat(*(_stacked(who, key, item) for item in value))
    return ca.vec(_expression(who, key, value))


def _expression(who: str, name: str, value: Any) -> Any:
    if isinstance(value, SX | MX):
        return value
    try:
        return SX(DM(value))
    except (NotImplementedError, TypeError, ValueError):
        raise UsageError(f"{who}: {name} is {value!r}; give an expression") from None


def entry_names(key: str, expression: Any) -> tuple[str, ...]:
    """Return the name of each entry of a scalar, vector or matrix."""
    return Symbol(key, expression.shape, expression).entries


def scalars(key: str, expression: Any) -> list[tuple[str, Any]]:
    """Return name and scalar of each entry of an expression."""
    return list(zip(entry_names(key, expression), ca.vertsplit(ca.vec(expression)), strict=True))


def reject_sizes(who: str, system: System) -> None:
    """Reject equations whose number differs from that of their unknowns.

    Raises:
        UsageError: Names both and their sizes.
    """
    for law, kind in (("ode", "x"), ("alg", "z")):
        rows = system.laws[law].numel() if law in system.laws else 0
        unknowns = sum(len(symbol.entries) for symbol in system.symbols[kind])
        if rows != unknowns:
            raise UsageError(f"{who}: {law} has {rows} rows, {kind} has {unknowns}; give as many")
    t = system.symbols["t"]
    if len(t) > 1 or (t and len(t[0].entries) > 1):
        raise UsageError(f"{who}: t has several entries; give one symbol")


def evaluated(
    who: str, system: System, values: Mapping[str, SX], expressions: Mapping[str, Any]
) -> dict[str, SX]:
    """Return expressions of the given symbols in those of the model."""
    columns: list[Any] = []
    arguments = []
    for kind in SYMBOLS:
        start = 0
        for symbol in system.symbols[kind]:
            size = len(symbol.entries)
            columns.append(symbol.symbol)
            arguments.append(ca.reshape(values[kind][start : start + size], *symbol.symbol.shape))
            start += size
    kinds = {type(column) for column in columns}
    if len(kinds) > 1:
        raise UsageError(f"{who}: symbols of SX and of MX are mixed; use one of them")
    if kinds == {MX}:
        laws = [e if isinstance(e, MX) else _as_mx(who, e) for e in expressions.values()]
        function = scalar_graph(who, columns, laws, list(expressions))
    else:
        _reject_strangers(who, columns, expressions)
        function = ca.Function("f", columns, [SX(e) for e in expressions.values()])
        reject_calls(who, function)
    return dict(zip(expressions, function.call(arguments, True, False), strict=True))


def _reject_strangers(who: str, columns: list[SX], expressions: Mapping[str, Any]) -> None:
    known = {s.element_hash() for s in ca.symvar(ca.veccat(SX(0, 1), *columns))}
    for name, expression in expressions.items():
        if isinstance(expression, MX):
            raise UsageError(f"{who}: {name} is MX, the symbols are SX; use one of them")
        strangers = [s.name() for s in ca.symvar(SX(expression)) if s.element_hash() not in known]
        if strangers:
            raise UsageError(
                f"{who}: {name} uses {', '.join(map(repr, strangers))}, which is among none of "
                "t, x, z, u, p"
            )


def _as_mx(who: str, expression: SX) -> MX:
    if ca.symvar(expression):
        raise UsageError(f"{who}: {expression} is SX, the symbols are MX; use one of them")
    return MX(DM(expression))
