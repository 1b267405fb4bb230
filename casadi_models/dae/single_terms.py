"""`single_terms`: parts of equations that time or one state, and parameters, alone determine."""

from collections.abc import Iterator, Sequence

import casadi as ca
from casadi import SX

from casadi_models.dae.frozen import Dae

_SUMS = (ca.OP_ADD, ca.OP_SUB, ca.OP_NEG)
_LOCAL = {  # what may change within a small part of its argument's way, and rest elsewhere
    ca.OP_EXP, ca.OP_EXPM1, ca.OP_TANH, ca.OP_ERF, ca.OP_ATAN, ca.OP_INV, ca.OP_DIV, ca.OP_POW,
    ca.OP_CONSTPOW, ca.OP_SINH, ca.OP_COSH, ca.OP_TAN, ca.OP_LOG, ca.OP_LOG1P, ca.OP_SQRT,
    ca.OP_CALL,
}  # fmt: skip
_NONE, _MANY = -1, -2  # in place of the position of what a node depends on


def single_terms(dae: Dae) -> dict[int, SX]:
    """Return the terms that depend on time or a single state, and may rest and change on its way.

    These are the largest such subexpressions of dx/dt and of the algebraic equations, except that
    a sum is split into its terms. Tables and other functions that are called count as terms.

    Returns:
        Expressions of a state and `dae.p` by the position of the state, (n, 1) each; those of
        time by the position after all states.
    """
    known = {symbol.element_hash(): i for i, symbol in enumerate(_elements(dae.x))}
    known[dae.t.element_hash()] = dae.x.numel()
    known |= {symbol.element_hash(): _NONE for symbol in _elements(dae.p)}
    of = dict[int, int]()  # by hash of a node: a position, none, or many
    terms = dict[int, list[SX]]()
    local = dict[int, bool]()
    found = dict[int, dict[int, SX]]()

    def note(node: SX) -> None:
        for term in terms[node.element_hash()]:
            if local[term.element_hash()]:
                found.setdefault(of[term.element_hash()], {})[term.element_hash()] = term

    roots = [*_elements(dae.ode), *_elements(dae.alg)]
    for node in _nodes(roots):
        key = node.element_hash()
        given = [node.dep(i) for i in range(node.n_dep())]
        keys = [operand.element_hash() for operand in given]
        movers = {of[k] for k in keys} - {_NONE}
        if not given:
            of[key] = _NONE if node.is_constant() else known.get(key, _MANY)
        else:
            of[key] = _NONE if not movers else movers.pop() if len(movers) == 1 else _MANY
        divides = node.op() != ca.OP_DIV or of[keys[-1]] != _NONE
        local[key] = any(local[k] for k in keys)
        local[key] |= of[key] >= 0 and bool(given) and node.op() in _LOCAL and divides
        own = [term for k in keys for term in terms[k]]
        terms[key] = own if given and node.op() in _SUMS else [node]
        terms[key] = terms[key] if of[key] >= 0 else []
        if of[key] == _MANY:
            for operand in given:
                note(operand)
    for root in roots:
        note(root)
    return {i: ca.densify(ca.vertcat(*group.values())) for i, group in sorted(found.items())}


def _elements(column: SX) -> list[SX]:
    return [column[i] for i in range(column.numel())] if column.numel() else []


def _nodes(roots: Sequence[SX]) -> Iterator[SX]:
    """Yield every node of expressions once, operands first."""
    seen = set[int]()
    waiting = [(root, False) for root in reversed(roots)]
    while waiting:
        node, ready = waiting.pop()
        key = node.element_hash()
        if ready:
            yield node
        elif key not in seen:
            seen.add(key)
            waiting.append((node, True))
            waiting += [(node.dep(i), False) for i in range(node.n_dep())]
