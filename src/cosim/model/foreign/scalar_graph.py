"""Expansion of CasADi's matrix expressions into the scalar operations of a `Dae`.

Calls of functions that have C code of their own (interpolants, `fast_newton`, maps) stay calls.
What has no scalar form (a large linear system, `low`, entries at calculated places) becomes one.
"""

import tomllib
from collections.abc import Sequence
from pathlib import Path

import casadi as ca
from casadi import MX, SX

from cosim.errors import UsageError

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
        if strangers := [s.name() for s in ca.symvar(MX(expression)) if s.name() not in known]:
            raise UsageError(
                f"{who}: {name} uses {', '.join(map(repr, strangers))}, which is among none of "
                "t, x, z, u, p"
            )
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
    values: list[SX] = whole.call(operands)
    return values


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
    called: SX = function.call(values)[0]
    return called


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
