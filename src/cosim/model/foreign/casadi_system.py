"""Symbols and equations of a DAE in CasADi, read from each accepted form."""

import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import casadi as ca
from casadi import DM, MX, SX

from casadi_models.dae.expressions import symbols
from cosim.errors import UnknownName, UsageError
from cosim.model.foreign.named_symbols import Symbol, named_apart, named_symbols, reject_duplicates

LARGEST_SOLVE = 20  # rows of a linear system that is written out; operations grow with the cube

_TABLES = tomllib.loads(Path(__file__).with_name("casadi_nodes.toml").read_text(encoding="utf-8"))
_WHOLE = frozenset(getattr(ca, f"OP_{name}") for name in _TABLES["whole"])
_OF_A_LIBRARY = ("External", "GenericExternal")
_REPEATED = ("Map", "OmpMap", "ThreadMap")


def scalar_graph(
    who: str, symbols: Sequence[MX], expressions: Sequence[MX], names: Sequence[str] = ()
) -> ca.Function:
    """Return the SX function of matrix expressions.

    Raises:
        UsageError: Something in them has no equations, no C code, or is too large.
    """
    names = list(names) or [f"o{i}" for i in range(len(expressions))]
    known = {symbol.name() for symbol in symbols}
    for name, expression in zip(names, expressions, strict=True):
        used = (symbol.name() for symbol in ca.symvar(MX(expression)))
        _reject_strangers(who, name, [symbol for symbol in used if symbol not in known])
    flat = ca.Function("f", list(symbols), list(expressions))
    reject_calls(who, flat)
    scalars = [SX.sym(symbol.name(), symbol.shape[0], symbol.shape[1]) for symbol in symbols]
    results = _scalar_values(who, list(symbols), list(expressions), scalars)
    return ca.Function("f", scalars, results)


def reject_calls(who: str, function: ca.Function) -> None:
    """Reject a function that calls what cannot be generated as C code, or not be linearized.

    Raises:
        UsageError: Names the first of these, and what to do.
    """
    for called in function.find_functions():
        kind = called.class_name()
        if kind in _OF_A_LIBRARY:
            _reject_without_derivatives(who, called)
        elif kind not in _TABLES["generated"]:
            what = "a callback" if kind == "CallbackInternal" else f"of type {kind}"
            usual = "CasADi generates no C code for it; write it as equations"
            remedy = _TABLES["remedies"].get(kind, usual)
            raise UsageError(f"{who} calls '{called.name()}', {what}: {remedy}")


def _reject_without_derivatives(who: str, function: ca.Function) -> None:
    try:
        function.forward(1)
    except RuntimeError as error:
        raise UsageError(
            f"{who} calls '{function.name()}', an external function without derivatives: generate "
            "them into its C code (CodeGenerator.add of its jacobian() or forward(1)), or pass "
            "{'enable_fd': True} to casadi.external"
        ) from error


def _scalar_values(
    who: str, symbols: list[MX], expressions: list[MX], scalars: list[SX]
) -> list[SX]:
    """Evaluate with scalars; other nodes are expanded one after the other."""
    flat = ca.Function("f", symbols, expressions)
    places: list[MX] = []  # what stands for the results of nodes that are known
    results: list[MX] = []
    known: list[SX] = []
    for i in range(flat.n_instructions()):
        if not _is_apart(flat, i):
            continue
        node = flat.instruction_MX(i)
        parts = [node.dep(k) for k in range(node.n_dep())]
        parts = ca.graph_substitute(parts, results, places) if results else parts
        operands = _inlined_call(who, [*symbols, *places], parts, [*scalars, *known])
        if node.has_output():
            known += _call_values(who, node.which_function(), operands)
            found = [node.get_output(k) for k in range(node.n_out())]
        else:
            known.append(_node_value(f"node_{len(known)}", node, operands))
            found = [node]
        places += [MX.sym(f"node_{i}_{k}", r.sparsity()) for k, r in enumerate(found)]
        results += found
    if results:
        expressions = ca.graph_substitute(expressions, results, places)
    return _inlined_call(who, [*symbols, *places], expressions, [*scalars, *known])


def _is_apart(flat: ca.Function, i: int) -> bool:
    """Return whether CasADi's own expansion has no form for an instruction, or another meaning."""
    operation = flat.instruction_id(i)
    if operation == ca.OP_CALL:
        return _holds_apart(flat.instruction_MX(i).which_function())
    return operation in _WHOLE


def _holds_apart(function: ca.Function) -> bool:
    if function.class_name() == "Switch":
        return True
    if function.class_name() == "MXFunction":
        return any(_is_apart(function, i) for i in range(function.n_instructions()))
    return any(_holds_apart(called) for called in function.find_functions(1))


def _call_values(who: str, function: ca.Function, operands: list[SX]) -> list[SX]:
    """Return the results of a call that is not expanded."""
    operands = [ca.project(o, function.sparsity_in(k)) for k, o in enumerate(operands)]
    kind = function.class_name()
    if kind == "Switch":
        return _selected(who, function, operands)
    if kind == "MXFunction" and (inside := _inside(function)):
        return _scalar_values(who, *inside, operands)
    if kind in _REPEATED:
        one, times = function.info()["f"], function.info()["n"]
        shares = [ca.horzsplit(o, one.size2_in(k)) for k, o in enumerate(operands)]
        calls = [_call_values(who, one, [s[i] for s in shares]) for i in range(times)]
        return [ca.horzcat(*column) for column in zip(*calls, strict=True)]
    inputs = function.mx_in()  # called by its C code
    whole = ca.Function("whole", inputs, function.call(inputs), {"never_inline": True})
    return whole.call(operands)


def _inside(function: ca.Function) -> tuple[list[MX], list[MX]] | None:
    """Return symbols and expressions of a function; None where its author wants it called."""
    symbols = function.mx_in()
    try:
        return symbols, function.call(symbols, True, False)
    except RuntimeError:  # always_inline contradicts its option never_inline
        return None


def _selected(who: str, switch: ca.Function, operands: list[SX]) -> list[SX]:
    """Return the case of a `Switch`; as where CasADi runs it, its index is cut towards zero."""
    index, arguments = ca.densify(operands[0]), operands[1:]
    *cases, results = [
        _call_values(who, case, arguments) for case in (*switch.info()["f"], switch.info()["f_def"])
    ]
    for i, case in reversed([*enumerate(cases)]):
        inside = ca.logic_and(index >= i, index < i + 1) if i else ca.fabs(index) < 1
        results = [ca.if_else(inside, *pair) for pair in zip(case, results, strict=True)]
    return [ca.project(r, switch.sparsity_out(k)) for k, r in enumerate(results)]


def _node_value(name: str, node: MX, operands: list[SX]) -> SX:
    """Return the value of a node; unless it is a small linear system, as a call of a function."""
    if node.op() == ca.OP_SOLVE and node.dep(1).size1() <= LARGEST_SOLVE:
        right, matrix = operands
        return ca.solve(matrix.T if node.info()["tr"] else matrix, right)
    deps = [node.dep(k) for k in range(node.n_dep())]
    symbols = [MX.sym(f"i{k}", dep.sparsity()) for k, dep in enumerate(deps)]
    if node.op() == ca.OP_SOLVE:  # by a method of which C code can be generated
        matrix_like = symbols[1].T if node.info()["tr"] else symbols[1]
        result = ca.solve(matrix_like, symbols[0], "qr")
    else:
        (result,) = ca.graph_substitute([node], deps, symbols)
    function = ca.Function(name, symbols, [result], {"never_inline": True})
    values = [ca.project(o, s.sparsity()) for o, s in zip(operands, symbols, strict=True)]
    return function.call(values)[0]


def _inlined_call(who: str, symbols: list[MX], expressions: list[MX], values: list[SX]) -> list[SX]:
    try:
        results: list[SX] = ca.Function("f", symbols, expressions).expand().call(values)
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1]
        raise UsageError(
            f"{who} cannot be written out in scalar operations ({reason}); write it with other "
            "CasADi operations, or as algebraic equations"
        ) from error
    return results


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
    UsageError.reject("from_casadi", system, Mapping, "a dict of expressions or a Function")
    UnknownName.reject(who, "key", (*SYMBOLS, *LAWS, *EVENTS, *REDUCED), *system)
    transition = system.get("transition")
    if ("zero" in system) != isinstance(transition, ca.Function):
        raise UsageError(f"{who}: give 'zero' and the Function 'transition' together, or neither")
    if isinstance(transition, ca.Function) and transition.n_in() != 1 + len(SYMBOLS):
        raise UsageError(f"{who}: 'transition' needs the inputs index, t, x, z, p, u")
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
    UnknownName.reject(who, "input", SYMBOLS, *function.name_in())
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
        known = symbols(ca.veccat(SX(0, 1), *columns))
        for name, expression in expressions.items():
            if isinstance(expression, MX):
                raise UsageError(f"{who}: {name} is MX, the symbols are SX; use one of them")
            own = symbols(SX(expression))
            _reject_strangers(who, name, [own[key] for key in own if key not in known])
        function = ca.Function("f", columns, [SX(e) for e in expressions.values()])
        reject_calls(who, function)
    return dict(zip(expressions, function.call(arguments, True, False), strict=True))


def _reject_strangers(who: str, name: str, strangers: Sequence[str]) -> None:
    if strangers:
        raise UsageError(
            f"{who}: {name} uses {', '.join(map(repr, strangers))}, which is among none of "
            "t, x, z, u, p"
        )


def _as_mx(who: str, expression: SX) -> MX:
    if ca.symvar(expression):
        raise UsageError(f"{who}: {expression} is SX, the symbols are MX; use one of them")
    return MX(DM(expression))
