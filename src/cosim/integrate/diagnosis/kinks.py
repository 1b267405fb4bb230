"""Where a right-hand side has a kink or a jump: what a solver that gave up may have met."""

from collections.abc import Sequence

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae
from cosim.arrays import Vector

_OF_ONE = {ca.OP_SIGN: "sign", ca.OP_FABS: "fabs", ca.OP_FLOOR: "floor", ca.OP_CEIL: "ceil"}
_OF_TWO = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_FMIN: "fmin", ca.OP_FMAX: "fmax"}
# What is constant between its switches: where a comparison takes one of these, that one is named
_STEPS = {
    *(ca.OP_SIGN, ca.OP_FLOOR, ca.OP_CEIL, ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE),
    *(ca.OP_NOT, ca.OP_AND, ca.OP_OR),
}
_LONGEST_EXPRESSION = 60  # expression that a message shows


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
    text = str(expression)
    shown = text if len(text) <= _LONGEST_EXPRESSION else f"{text[:_LONGEST_EXPRESSION]}..."
    return f"{what} switches where {shown} is 0, and it is {float(values[nearest, 0]):.2g} there"


def _switches(dae: Dae) -> list[tuple[SX, str]]:
    """Return what is 0 where an operation of the equations switches, and the operation's name."""
    found: list[tuple[SX, str]] = []
    moves: dict[int, bool] = {}  # by hash of a node, whether it changes between switches, too
    for node in _nodes([*ca.vertsplit(dae.ode), *ca.vertsplit(dae.alg)]):
        if node.is_leaf():
            moves[node.element_hash()] = not node.is_constant()
            continue
        operation, terms = node.op(), [node.dep(k) for k in range(node.n_dep())]
        moved = any(moves[term.element_hash()] for term in terms)
        if moved and operation in _OF_ONE:
            found.append((terms[0], _OF_ONE[operation]))
        elif moved and operation in _OF_TWO:
            found.append((terms[0] - terms[1], _OF_TWO[operation]))
        moves[node.element_hash()] = moved and operation not in _STEPS
    return found


def _nodes(scalars: Sequence[SX]) -> list[SX]:
    """Return every node of a graph once, after those that it depends on."""
    found: dict[int, SX] = {}
    waiting = [scalar for scalar in reversed(scalars) if scalar.nnz()]
    while waiting:
        node = waiting[-1]
        inside = (node.dep(k) for k in range(node.n_dep()))
        missing = [part for part in inside if part.element_hash() not in found]
        if missing:
            waiting += reversed(missing)
            continue
        found.setdefault(node.element_hash(), waiting.pop())
    return list(found.values())
