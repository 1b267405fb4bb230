"""What must be known of a CasADi expression before it may stand in a `Dae`."""

from collections.abc import Callable, Collection, Container, Iterable, Iterator, Sequence
from math import isfinite
from typing import TypeVar

import casadi as ca
from casadi import MX, SX

from casadi_models.units import represented

COMPARING = {ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE}
RELATIONS = {
    *(ca.OP_LT, ca.OP_LE, ca.OP_SIGN, ca.OP_FABS, ca.OP_FLOOR, ca.OP_CEIL, ca.OP_FMIN, ca.OP_FMAX),
    *(ca.OP_FMOD, ca.OP_REMAINDER, ca.OP_COPYSIGN),
}  # operations at whose switches there are events
_GOLDEN = (5**0.5 - 1) / 2  # whose multiples spread evenly
_SQUARES = 1e-150  # elements whose squares are not rounded to 0


def operations(expression: SX) -> set[int]:
    """Return CasADi's codes of the operations of an expression."""
    function = ca.Function("f", ca.symvar(expression), [expression])
    return {function.instruction_id(i) for i in range(function.n_instructions())}


def column(expressions: Iterable[SX]) -> SX:
    """Stack columns into one dense column, (n, 1); n may be 0."""
    return ca.densify(ca.vertcat(SX(0, 1), *expressions))


def share(columns: Sequence[SX]) -> list[SX]:
    """Let all columns share their common subexpressions."""
    return [column([shared]) for shared in ca.cse(list(columns))]


def symbols(expression: SX) -> dict[int, str]:
    """Return the names of an expression's symbols under what identifies each of them."""
    return {symbol.element_hash(): symbol.name() for symbol in ca.symvar(expression)}


Node = tuple[int, SX, list[int]]  # its hash, itself, and the hashes of its operands


def in_postorder(roots: Sequence[SX], *, leftmost_first: bool = False) -> Iterator[Node]:
    """Yield every node of expressions once, after its operands.

    Args:
        roots: The expressions, (1, 1) each.
        leftmost_first: Whether operands follow in their order, as in functions of CasADi, and not
            the last one first.
    """
    seen = set[int]()
    waiting = [(root.element_hash(), root, list[int](), False) for root in reversed(roots)]
    while waiting:
        key, node, keys, ready = waiting.pop()
        if ready:
            yield key, node, keys
        elif key not in seen:
            seen.add(key)
            operands = [node.dep(i) for i in range(node.n_dep())]
            keys = [operand.element_hash() for operand in operands]
            waiting.append((key, node, keys, True))
            later = [(k, own, list[int](), False) for k, own in zip(keys, operands, strict=True)]
            waiting += later[::-1] if leftmost_first else later


def applied(code: int, terms: Sequence[SX]) -> SX:
    """Return the result of an operation by CasADi's code of it."""
    return SX.unary(code, *terms) if len(terms) == 1 else SX.binary(code, *terms)


_Value = TypeVar("_Value")


def replayed(
    rows: SX, leaf: Callable[[SX], _Value], operation: Callable[[int, list[_Value]], _Value]
) -> list[_Value]:
    """Return the values of the rows of a column, from its graph.

    Args:
        rows: (n, 1).
        leaf: Returns the value of a symbol or a constant.
        operation: Returns that of an operation, from CasADi's code of it and its operands.
    """
    values, every = dict[int, _Value](), ca.vertsplit(ca.densify(rows))
    for key, node, keys in in_postorder(every):
        values[key] = operation(node.op(), [values[k] for k in keys]) if keys else leaf(node)
    return [values[row.element_hash()] for row in every]


def reject_faulty(rows: Collection[tuple[str, SX]], known: SX, allowed: str) -> None:
    """Reject expressions that use unknown symbols or hold a NaN or an infinity.

    Args:
        rows: What each expression is, for messages, and the expression, a column.
        known: The symbols that may stand there.
        allowed: What those are, for messages.

    Raises:
        ValueError: Names the first faulty expression.
    """
    declared = symbols(known)
    if _fault(column(row for _, row in rows), declared) is None:
        return
    for what, expression in rows:
        fault = _fault(expression, declared)
        if fault:
            hint = "; for functions of math, use those of casadi: casadi.sin"
            raise ValueError(
                f"{what} {fault}; only {allowed} and finite numbers may stand there"
                f"{hint * fault.endswith('nan')}"
            )


def _fault(expression: SX, declared: Container[int]) -> str | None:
    used = symbols(expression)
    strangers = [name for identity, name in used.items() if identity not in declared]
    if strangers:
        return f"uses {quoted(strangers)}"
    function = ca.Function("f", ca.symvar(expression), [expression])
    for i in range(function.n_instructions()):
        if function.instruction_id(i) == ca.OP_CONST:
            constant = function.instruction_constant(i)
            if not isfinite(constant):
                return f"holds the constant {constant}"
    return None


def operation_count(function: ca.Function) -> int:
    """Count what a Function calculates: its instructions but for those that only move numbers."""
    moves = (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST)
    codes = (function.instruction_id(i) for i in range(function.n_instructions()))
    return sum(code not in moves for code in codes)


def irregular_place(count: int) -> ca.DM:
    """Return values between 0.2 and 0.8 that no formula prefers, (count, 1)."""
    return ca.DM([0.2 + 0.6 * (k * _GOLDEN % 1) for k in range(1, count + 1)])


def at_irregular_place(expression: SX, known: SX) -> ca.DM:
    """Return an expression where its symbols, a column, have values that no formula prefers."""
    return ca.densify(ca.Function("at", [known], [expression])(irregular_place(known.numel())))


def are_equal(one: SX, other: SX) -> bool:
    """Return whether two columns are the same function, by their values at an irregular place."""
    both = ca.horzcat(one, other)
    first, second = ca.horzsplit(at_irregular_place(both, ca.veccat(*ca.symvar(both))))
    rounding = 1e-9 * ca.fabs(second) + 1e-12 * ca.norm_fro(second)
    return all((ca.fabs(first - second) <= rounding).elements())  # NaN is not


def is_cheaper(one: SX, other: SX) -> bool:
    """Return whether a column has fewer operations than an equal one, and needs nothing else."""
    graphs = [ca.Function("f", ca.symvar(e), [e], {"cse": True}) for e in (one, other)]
    fewer = operation_count(graphs[0]) < operation_count(graphs[1])
    return fewer and symbols(one).keys() <= symbols(other).keys() and are_equal(one, other)


def linear_solution(matrix: MX, right: MX, *, transposed: bool = False) -> MX:
    """Return the solution of linear equations, (n, m); not finite where there is none.

    Args:
        matrix: (n, n), with rows of similar size; see `Dae.balanced`. n may be 0.
        right: Right-hand sides, (n, m).
        transposed: Solve the equations of the transposed matrix.
    """
    if not matrix.numel():
        return MX(*right.shape)
    elements = matrix.nz[:]
    matrix = MX(matrix.sparsity(), elements * (ca.fabs(elements) > _SQUARES))  # else NaN
    # eps: by default, a column of small elements is taken for a singularity
    method = ca.Linsol("linear_solution", "qr", matrix.sparsity(), {"eps": 0.0})
    return method.solve(matrix, right, transposed)


def implicit_change(symbols: Sequence[SX], slopes: SX, moved: SX) -> ca.Function:
    """Return how the solution z of equations g(y, z) = 0 changes as y moves in a direction s.

    By the implicit function theorem, (dg/dz) w = -(dg/dy) s.

    Args:
        symbols: Arguments of the function, which returns w, (n, 1).
        slopes: dg/dz, (n, n); see `linear_solution`.
        moved: (dg/dy) s, (n, 1).
    """
    law = ca.Function("along", symbols, [slopes, -moved], {"cse": True})
    arguments = [MX.sym("argument", symbol.sparsity()) for symbol in symbols]
    change = linear_solution(*law(*arguments))
    return ca.Function("implicit_change", arguments, [change], {"always_inline": True})


def is_structurally_regular(residual: SX, unknowns: SX) -> bool:
    """Return whether every unknown can be matched to a residual of its own that depends on it."""
    jacobian = ca.jacobian_sparsity(residual, unknowns)
    return bool(ca.sprank(jacobian) == unknowns.numel() == residual.numel())


def no_expression(what: str, value: object) -> str:
    """Say that something is no expression."""
    return f"{what} is {represented(value)}; give an SX expression"


def as_text(expression: SX) -> str:
    """Return an expression as text, with the signs of negative numbers merged: x+3, not x--3."""
    return str(expression).replace("--", "+").replace("+-", "-")


def quoted(names: Iterable[str]) -> str:
    """Join names for a message."""
    return ", ".join(f"'{name}'" for name in names)
