"""`single_terms`: parts of equations that one moving quantity alone determines."""

from collections.abc import Iterator, Sequence
from itertools import product
from typing import NamedTuple

import casadi as ca
from casadi import SX

from casadi_models.dae.expressions import column, in_postorder, symbols
from casadi_models.dae.frozen import Dae
from casadi_models.dae.relations import Mode, modes_of

SUMS = (ca.OP_ADD, ca.OP_SUB, ca.OP_NEG)
_LOCAL = {  # what may change within a small part of its argument's way, and rest elsewhere
    ca.OP_EXP, ca.OP_EXPM1, ca.OP_TANH, ca.OP_ERF, ca.OP_ATAN, ca.OP_INV, ca.OP_DIV, ca.OP_POW,
    ca.OP_CONSTPOW, ca.OP_SINH, ca.OP_COSH, ca.OP_TAN, ca.OP_LOG, ca.OP_LOG1P, ca.OP_SQRT,
    ca.OP_HYPOT, ca.OP_ATAN2, ca.OP_CALL,
}  # fmt: skip
_RESTING = {
    ca.OP_EXP, ca.OP_EXPM1, ca.OP_TANH, ca.OP_ERF, ca.OP_ATAN, ca.OP_ATAN2, ca.OP_CALL,
}  # fmt: skip
_STAYS = {ca.OP_DIV: 0, ca.OP_POW: 1, ca.OP_CONSTPOW: 1}  # the operand that does, of an inverse
_MOST_OPERATIONS = 60  # of a term; larger ones are not narrow, and their bounds are wide
_MOST_MODES = 4  # of a called function
_NONE, _MANY, _MODES = -1, -2, -3  # in place of the position of what a node depends on


class _Node(NamedTuple):
    """A node of an expression.

    Attributes:
        value: The expression.
        moving: The position of the only quantity that moves it, `_NONE`, `_MODES` or `_MANY`.
        terms: The terms of which it is the sum, if one quantity moves it.
        is_local: Whether it may change within a small part of the quantity's way.
        inner: The local terms of sums in it, whose changes are small beside the other terms.
    """

    value: SX
    moving: int
    terms: tuple["_Node", ...]
    is_local: bool
    inner: tuple["_Node", ...] = ()


def single_terms(dae: Dae) -> dict[int, SX]:
    """Return the terms that depend on time or a single state, and may rest and change on its way.

    These are the largest such subexpressions of dx/dt, of the algebraic equations and of outputs
    that drive other models, except that a sum is split into its terms, also one within another
    term. Tables and other functions that are called count as terms.

    Returns:
        Expressions of a state and `dae.p` by the position of the state, (n, 1) each; those of
        time by the position after all states.
    """
    found, nodes = dict[int, list[SX]](), list(_nodes(dae))
    for term in _terms(dae, nodes):
        if term.is_local:
            found.setdefault(term.moving, []).append(term.value)
    for node, _ in nodes:
        if node.moving == _MANY and node.value.op() == ca.OP_CALL:
            for moving, value in _in_each_mode(dae, node.value.get_output(0)):
                found.setdefault(moving, []).append(value)
    return {i: ca.densify(ca.vertcat(*group)) for i, group in sorted(found.items())}


def several_terms(dae: Dae) -> tuple[SX, SX]:
    """Return the small terms that several quantities move, and that may rest and change.

    Time, states, unknowns and inputs count. Tables and other functions that are called are terms.

    Returns:
        Expressions of the symbols of the equations, (n, 1); and reciprocals and powers, which do
        not rest if what they depend on has no least size, (m, 1).
    """
    resting, inverse, sizes = list[SX](), list[SX](), dict[int, int]()
    for node, operands in _nodes(dae):
        value, code = node.value, node.value.op()
        size = sizes[_key(node)] = 1 + sum(sizes[_key(operand)] for operand in operands)
        if node.moving != _MANY or size > _MOST_OPERATIONS or not operands:
            continue
        if code in _RESTING and operands[-1].moving != _NONE:
            term = value if code != ca.OP_CALL else value.get_output(0)
            if code != ca.OP_CALL or not _in_each_mode(dae, term):
                resting.append(term)
        elif code == ca.OP_INV or (code in _STAYS and operands[_STAYS[code]].moving == _NONE):
            inverse.append(value)
    return column(resting), column(inverse)


def _in_each_mode(dae: Dae, term: SX) -> list[tuple[int, SX]]:
    """Return a term in all modes that it depends on, if only one quantity moves it in each.

    The argument of a table is often limited to its range.
    """
    moving, own = _moving(dae), symbols(term)
    modes = [
        symbol
        for symbol, variable in zip(ca.vertsplit(dae.u), dae.inputs, strict=True)
        if isinstance(variable, Mode) and variable.is_sign and symbol.element_hash() in own
    ]
    others = own.keys() - {mode.element_hash() for mode in modes}
    movers = {moving.get(key, _MANY) for key in others} - {_NONE}
    if not modes or len(modes) > _MOST_MODES or len(movers) != 1 or _MANY in movers:
        return []
    every = (ca.DM(values) for values in product((-1, 1), repeat=len(modes)))
    forms = [ca.substitute(term, ca.vertcat(*modes), values) for values in every]
    (mover,) = movers
    symbol = ca.vertcat(dae.x, dae.t)[mover]
    unique = {form.element_hash(): form for form in forms if ca.depends_on(form, symbol)}
    return [(mover, form) for form in unique.values()]


def _terms(dae: Dae, every: Sequence[tuple[_Node, list[_Node]]]) -> list[_Node]:
    """Return the largest terms that one quantity alone moves, each once, from all nodes."""
    nodes, found = dict[int, _Node](), dict[int, _Node]()
    for node, operands in every:
        nodes[_key(node)] = node
        if node.moving == _MANY:
            found |= {_key(t): t for operand in operands for t in operand.terms + operand.inner}
    for root in _roots(dae):
        node = nodes[root.element_hash()]
        found |= {_key(term): term for term in node.terms + node.inner}
    return list(found.values())


def _nodes(dae: Dae) -> Iterator[tuple[_Node, list[_Node]]]:
    """Yield every node of the equations once, after its operands, with these."""
    moving, nodes = _moving(dae), dict[int, _Node]()
    for key, value, keys in in_postorder(_roots(dae)):
        operands = [nodes[k] for k in keys]
        if operands:
            nodes[key] = _combined(value, operands)
        else:
            constant = _NONE if value.is_constant() else _MANY
            nodes[key] = _leaf(value, moving.get(key, constant))
        yield nodes[key], operands


def _roots(dae: Dae) -> list[SX]:
    laws = ca.vertcat(dae.ode, dae.alg, dae.driving_outputs)
    return [*ca.vertsplit(laws), *(margin for margin, _ in dae.limits)]


def _moving(dae: Dae) -> dict[int, int]:
    """Return what moves a symbol, by its hash: see `_Node.moving`."""
    moving = {symbol.element_hash(): i for i, symbol in enumerate(ca.vertsplit(dae.x))}
    moving[dae.t.element_hash()] = dae.x.numel()
    moving |= dict.fromkeys(symbols(modes_of(dae)), _MODES)
    return moving | dict.fromkeys(symbols(dae.p), _NONE)


def _key(node: _Node) -> int:
    return node.value.element_hash()


def _leaf(value: SX, moving: int) -> _Node:
    node = _Node(value, moving, (), is_local=False)
    return node._replace(terms=(node,)) if moving >= 0 else node


def _combined(value: SX, operands: Sequence[_Node]) -> _Node:
    """Return the node of an operation."""
    code, movers = value.op(), {operand.moving for operand in operands} - {_NONE}
    moving = movers.pop() if len(movers) == 1 else _MANY if movers else _NONE
    if moving < 0:
        return _Node(value, moving, (), is_local=False)
    divides = code != ca.OP_DIV or operands[-1].moving == moving
    is_local = (code in _LOCAL and divides) or any(operand.is_local for operand in operands)
    inner = {_key(term): term for operand in operands for term in operand.inner}
    is_scaled = code in (ca.OP_MUL, ca.OP_DIV) and not all(o.terms for o in operands)
    if code not in SUMS and not is_scaled:
        sums = [operand.terms for operand in operands if len(operand.terms) > 1]
        inner |= {_key(term): term for own in sums for term in own if term.is_local}
    node = _Node(value, moving, (), is_local, tuple(inner.values()))
    terms = tuple(term for operand in operands for term in operand.terms)
    return node._replace(terms=terms if code in SUMS else (node,))
