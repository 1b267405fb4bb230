"""Where a right-hand side has a kink or a jump: what a solver that gave up may have met."""

from collections.abc import Container, Iterator, Sequence

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae
from casadi_models.dae.expressions import operation_count
from cosim.arrays import Vector
from cosim.text.lists import shortened

_OF_ONE = {ca.OP_SIGN: "sign", ca.OP_FABS: "fabs", ca.OP_FLOOR: "floor", ca.OP_CEIL: "ceil"}
_OF_TWO = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_FMIN: "fmin", ca.OP_FMAX: "fmax"}
# What is constant between its switches: where a comparison takes one of these, that one is named
_STEPS = {
    *(ca.OP_SIGN, ca.OP_FLOOR, ca.OP_CEIL, ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE),
    *(ca.OP_NOT, ca.OP_AND, ca.OP_OR),
}
_LONGEST_EXPRESSION = 60  # letters, and operations, of an expression that a message shows
_MOST_NAMES = 8


def nearest_kink(dae: Dae, t: float, x: Vector, z: Vector, u: Vector, p: Vector) -> str:
    """Describe the expression of the equations that is nearest to where it switches.

    Args:
        dae: The model.
        t, x, z, u, p: Where, in the order of `Dae.arguments`.

    Returns:
        Empty where nothing switches.
    """
    found = _switches(dae)
    if not found:
        return ""
    values = np.array(
        ca.Function("at", dae.arguments, [ca.vertcat(*(e for e, _ in found))])(t, x, z, u, p)
    )
    nearest = int(np.argmin(np.abs(values.ravel())))
    expression, what = found[nearest]
    shown = _shown(expression, frozenset(parameter.name for parameter in dae.parameters))
    return f"{what} switches where {shown} is 0, and it is {float(values[nearest, 0]):.2g} there"


def _shown(expression: SX, parameters: Container[str]) -> str:
    """Write an expression out, or the beginning of it; of a large one, what it depends on.

    CasADi writes by recursion, which a deep expression would end the process with.
    """
    symbols = ca.symvar(expression)
    count = operation_count(ca.Function("f", symbols, [expression]))
    if count <= _LONGEST_EXPRESSION:
        text = str(expression)
        return text if len(text) <= _LONGEST_EXPRESSION else f"{text[:_LONGEST_EXPRESSION]}..."
    names = [symbol.name() for symbol in symbols]
    moving = [name for name in names if name not in parameters]
    parts = [shortened(moving, _MOST_NAMES)] if moving else []
    parts += ["parameters"] if len(moving) < len(names) else []
    return f"an expression of {' and '.join(parts)} ({count} operations)"


def _switches(dae: Dae) -> list[tuple[SX, str]]:
    """Return what is 0 where an operation of the equations switches, and the operation's name."""
    function = ca.Function("equations", dae.arguments, [dae.ode, dae.alg])
    operations = {function.instruction_id(i) for i in range(function.n_instructions())}
    if operations.isdisjoint({*_OF_ONE, *_OF_TWO}):
        return []
    found: list[tuple[SX, str]] = []
    moves: dict[int, bool] = {}  # by hash of a node, whether it changes between switches, too
    for key, node, terms in _nodes([*ca.vertsplit(dae.ode), *ca.vertsplit(dae.alg)]):
        if not terms:
            moves[key] = node.is_symbolic()
            continue
        operation, moved = node.op(), any(moves[term] for term, _ in terms)
        if moved and operation in _OF_ONE:
            found.append((terms[0][1], _OF_ONE[operation]))
        elif moved and operation in _OF_TWO:
            found.append((terms[0][1] - terms[1][1], _OF_TWO[operation]))
        moves[key] = moved and operation not in _STEPS
    return found


def _nodes(scalars: Sequence[SX]) -> Iterator[tuple[int, SX, list[tuple[int, SX]]]]:
    """Yield every node of a graph once, after the terms that it depends on; each with its hash."""
    met: set[int] = set()
    waiting: list[tuple[int, SX, list[tuple[int, SX]] | None]] = [
        (scalar.element_hash(), scalar, None) for scalar in reversed(scalars) if scalar.nnz()
    ]
    while waiting:
        key, node, terms = waiting.pop()
        if terms is not None:
            yield key, node, terms
        elif key not in met:
            met.add(key)
            terms = [(t.element_hash(), t) for t in map(node.dep, range(node.n_dep()))]
            waiting.append((key, node, terms))
            waiting += [(k, t, None) for k, t in reversed(terms) if k not in met]
