"""`inner_terms`: terms of moving quantities as functions of variables that parameters shift.

The term H exp(-((s - place) / width)**2) is, but for its factor, a function exp(-c**2) of
c = (s - place) / width. It holds no parameter: where it changes is known for all their values.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import casadi as ca
from casadi import SX

from casadi_models.dae.expressions import applied, in_postorder, symbols
from casadi_models.dae.frozen import Dae
from casadi_models.dae.relations import called, modes_of
from casadi_models.dae.single_terms import SUMS, several_terms, single_terms


class InnerTerm(NamedTuple):
    """A term as a function of one variable.

    Attributes:
        movers: The positions of the states that move it; after them are those of time, of the
            algebraic unknowns and of the inputs.
        variable: Linear in the only one, of several, or what a table is of; of `dae.x`, `dae.t`,
            `dae.p` and modes.
        symbol: What stands for it in `value`.
        value: The term, but for a factor; of the symbol and, if `given`, of `dae.p`.
        given: Positions of the parameters that change the value at a variable.
        tables: The functions that it calls, each with its argument.
    """

    movers: tuple[int, ...]
    variable: SX
    symbol: SX
    value: SX
    given: tuple[int, ...]
    tables: tuple[tuple[ca.Function, SX], ...]


class _Node(NamedTuple):
    """A node of a term: its roots are the variables in it, and its form is in their symbols."""

    code: int
    form: SX
    roots: frozenset[int]
    is_line: bool
    operands: tuple["_Node", ...]
    table: ca.Function | None = None


def inner_terms(dae: Dae) -> list[InnerTerm]:
    """Return the terms of time or a single state that may rest and change on its way."""
    moving = [*ca.vertsplit(dae.x), dae.t] if dae.states else [dae.t]
    return [
        own
        for place, terms in single_terms(dae).items()
        for term in ca.vertsplit(terms)
        for own in _inner(dae, (place,), moving[place], term)
    ]


class SeveralInner(NamedTuple):
    """A term that several states, time, unknowns or inputs move.

    Attributes:
        each: The term once for every variable in it, each of one state; in its value, the symbols
            of the others stand for their variables.
        alone: The term as a function of one quantity that all of them move, such as x + y: for
            every such quantity, the one nearest to what moves first.
        is_inverse: Whether it is a reciprocal or a power.
        value: The term.
    """

    each: tuple[InnerTerm, ...]
    alone: tuple[InnerTerm, ...]
    is_inverse: bool
    value: SX


def inner_terms_of_several(dae: Dae) -> list[SeveralInner]:
    """Return the terms of several states, time, unknowns or inputs, or of one of the latter."""
    columns = dae.x, dae.t, dae.z, dae.u
    moving = [symbol for column in columns for symbol in ca.vertsplit(column)]
    jumping = modes_of(dae)
    moving = moving[: len(moving) - jumping.numel()]
    places = {symbol.element_hash(): place for place, symbol in enumerate(moving)}
    known, found = {*places, *symbols(dae.p), *symbols(jumping)}, list[SeveralInner]()
    resting, inverse = map(ca.vertsplit, several_terms(dae))
    for i, term in enumerate((*resting, *inverse)):
        own = symbols(term)
        if not own.keys() <= known:
            continue
        movers = [symbol for symbol in moving if symbol.element_hash() in own]
        node, variables = _in_variables(dae, movers, term)
        given = parameters_of(dae, node.form)
        each = list[InnerTerm]()
        for variable, symbol in (variables[root] for root in sorted(node.roots)):
            (mover,) = symbols(variable).keys() & places.keys()
            each.append(InnerTerm((places[mover],), variable, symbol, node.form, given, ()))
        every = tuple(places[symbol.element_hash()] for symbol in movers)
        alone = _fixed(_alone(dae, every, ca.vertcat(*movers), term), jumping)
        ordered = _fixed(sorted(each, key=lambda term: term.movers), jumping)
        found.append(SeveralInner(ordered, alone, i >= len(resting), term))
    return found


def _fixed(terms: Iterable[InnerTerm], jumping: SX) -> tuple[InnerTerm, ...]:
    """Return the terms whose values do not depend on modes."""
    return tuple(term for term in terms if not ca.depends_on(term.value, jumping))


def quantities_in(dae: Dae, term: InnerTerm, *, waves: bool = False) -> Iterator[InnerTerm]:
    """Yield a term as a function of each quantity in it that its variable moves, by waves alone."""
    codes = {value.op() for _, value, _ in in_postorder([term.value])}
    if not waves or codes & {ca.OP_SIN, ca.OP_COS}:
        for own in _alone(dae, term.movers, term.symbol, term.value):
            yield own._replace(variable=ca.substitute(own.variable, term.symbol, term.variable))


def _alone(dae: Dae, places: tuple[int, ...], movers: SX, term: SX) -> Iterator[InnerTerm]:
    nodes = list(in_postorder([term]))
    if any(value.op() == ca.OP_CALL for _, value, _ in nodes):
        if len(places) == 1:
            yield from _inner(dae, places, movers, term)
        return
    for quantity, value, _ in nodes[:-1]:
        if not (value.n_dep() and all(ca.which_depends(value, movers, 1, False))):
            continue
        symbol, forms = SX.sym("q"), dict[int, SX]()
        for key, own, keys in nodes:
            operands = [forms[k] for k in keys]
            forms[key] = applied(own.op(), operands) if operands else own
            if key == quantity:
                forms[key] = symbol
        if not ca.depends_on(forms[nodes[-1][0]], movers):
            for found in _inner(dae, places, symbol, forms[nodes[-1][0]]):
                yield found._replace(variable=ca.substitute(found.variable, symbol, value))


def parameters_of(dae: Dae, value: SX) -> tuple[int, ...]:
    """Return the positions of the parameters on which an expression depends."""
    used = bool(dae.parameters) and value.numel() > 0
    which = ca.which_depends(value, dae.p, 1, False) if used else []
    return tuple(i for i, depends in enumerate(which) if depends)


def _in_variables(dae: Dae, moving: Sequence[SX], term: SX) -> tuple[_Node, list[tuple[SX, SX]]]:
    """Return the node of a term, and the variables in it with their symbols.

    Args:
        dae: The equations.
        moving: The quantities that move the term, which are the first variables.
        term: The term.
    """
    variables = [(symbol, SX.sym("c")) for symbol in moving]
    first = {symbol.element_hash(): root for root, symbol in enumerate(moving)}
    nodes = dict[int, _Node]()
    for key, value, keys in in_postorder([term]):
        operands = tuple(nodes[k] for k in keys)
        if key in first:
            root = first[key]
            nodes[key] = _Node(value.op(), variables[root][1], frozenset([root]), True, ())
        else:
            nodes[key] = _combined(dae, value, operands, variables)
    return nodes[term.element_hash()], variables


def _inner(dae: Dae, places: tuple[int, ...], moving: SX, term: SX) -> Iterator[InnerTerm]:
    node, variables = _in_variables(dae, [moving], term)
    for piece in _pieces(node):
        (root, *more) = piece.roots
        variable, symbol = variables[root]
        value = piece.form
        if more:
            variable, symbol = variables[0]
            first = [own for own, _ in variables]
            symbols = [own for _, own in variables]
            value = ca.substitute(value, ca.vertcat(*symbols), ca.vertcat(*first))
            value = ca.substitute(value, moving, symbol)
        tables = tuple(_tables(piece)) if not more else ()
        yield InnerTerm(places, variable, symbol, value, parameters_of(dae, value), tables)


def _combined(
    dae: Dae, value: SX, operands: tuple[_Node, ...], variables: list[tuple[SX, SX]]
) -> _Node:
    """Return the node of an operation; a line that parameters move becomes a variable."""
    code, roots = value.op(), frozenset[int]().union(*(o.roots for o in operands))
    movers = [o for o in operands if o.roots]
    if not movers:
        return _Node(code, value, roots, False, operands)
    others = [o.form for o in operands if not o.roots]
    linear = (
        code in SUMS
        or (code in (ca.OP_TWICE, ca.OP_MUL) and len(movers) == 1)
        or (code == ca.OP_DIV and not operands[1].roots)
    )  # fmt: skip
    forms = [o.form for o in operands]
    if linear and len(movers) == 1 and movers[0].is_line:
        if not others or not ca.depends_on(ca.vertcat(*others), ca.vertcat(dae.p, modes_of(dae))):
            return _Node(code, applied(code, forms), roots, True, operands)
        variables.append((value, SX.sym("c")))
        return _Node(code, variables[-1][1], frozenset([len(variables) - 1]), True, ())
    if code == ca.OP_CALL:
        function = value.which_function()
        if len(movers) == len(operands) and not movers[0].is_line and is_table(function):
            variables.append((value.dep(0), SX.sym("c")))  # in which it has its knots
            forms, roots = [variables[-1][1]], frozenset([len(variables) - 1])
            operands = (_Node(code, forms[0], roots, True, ()),)
        rows = called(function, forms)
        form = rows[0] if len(rows) == 1 else SX.nan()  # CasADi does not tell which of several
        return _Node(code, form, roots, False, operands, function)
    if len(operands) == 1 and operands[0].code == ca.OP_CALL:  # a result of a call
        return operands[0]
    return _Node(code, applied(code, forms), roots, False, operands)


def _pieces(node: _Node) -> Iterator[_Node]:
    """Yield the terms of a sum that move, without their factors."""
    movers = [o for o in node.operands if o.roots]
    factor = node.code == ca.OP_MUL or (node.code == ca.OP_DIV and not node.operands[1].roots)
    if node.is_line:
        return
    if node.code in (*SUMS, ca.OP_TWICE) or (factor and len(movers) == 1):
        for operand in movers:
            yield from _pieces(operand)
    else:
        yield node


def is_table(function: ca.Function) -> bool:
    """Return whether a function is a table of CasADi (`interpolant`)."""
    return "Interpolant" in function.class_name()


def _tables(node: _Node) -> Iterator[tuple[ca.Function, SX]]:
    if node.table is not None:
        yield node.table, node.operands[0].form
    for operand in node.operands:
        yield from _tables(operand)
