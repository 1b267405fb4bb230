"""`LawsWithModes`: laws in which every relation has a mode in its place.

The mode of a sign is 1 or -1, that of a floor an integer; see `casadi_models.dae.hybrid`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import Any

import casadi as ca
from casadi import SX

from casadi_models.dae.expressions import (
    RELATIONS,
    Node,
    applied,
    column,
    in_postorder,
    operations,
    replayed,
    symbols,
)
from casadi_models.dae.frozen import Dae
from casadi_models.dae.quotients import without_poles
from casadi_models.dae.variables import Variable

KEEPS = 2  # in place of a mode, where either side has the same value
# Operations that are defined on one side of a boundary, and may be continuous there
_BOUNDED = {
    ca.OP_SQRT: "sqrt",
    ca.OP_POW: "power",
    ca.OP_CONSTPOW: "power",
    ca.OP_ASIN: "asin",
    ca.OP_ACOS: "acos",
}
_AT_BOUNDARY = 1e-12  # beyond it, where only rounding has moved an operand


@dataclass(frozen=True, eq=False)  # CasADi's == builds an expression
class Relation:
    """What switches, and where.

    Attributes:
        argument: Its sign, or its floor, is the mode; of the frozen equations' symbols.
        floor: Whether the mode is the floor of the argument, not its sign.
        at_zero: Mode of a sign while its argument rests at 0: -1, 0 or 1, or `KEEPS` for that of
            either side.
        operation: The operation of the equations, for messages.
    """

    argument: SX
    floor: bool
    at_zero: int
    operation: str


@dataclass(frozen=True)
class Mode(Variable):
    """An input of frozen equations that is the mode of a relation.

    Attributes:
        is_sign: Whether it is -1 or 1, but for rest at 0, and not an integer.
    """

    is_sign: bool = True


def mode_inputs(relations: Sequence[Relation], first: int = 0) -> tuple[Mode, ...]:
    """Return the inputs that are the modes of relations, numbered from a position on."""
    return tuple(
        Mode(
            name=f"mode_{first + i + 1}",
            unit="1",
            meaning=f"mode of {relation.operation}",
            start=1.0,
            is_sign=not relation.floor,
        )
        for i, relation in enumerate(relations)
    )


def mode_count(dae: Dae) -> int:
    """Return how many inputs of a model, the last ones, are modes."""
    return sum(isinstance(variable, Mode) for variable in dae.inputs)


def modes_of(dae: Dae) -> SX:
    """Return the modes among the inputs, (n, 1), which jump and do not move."""
    return dae.u[dae.u.numel() - mode_count(dae) :]


class LawsWithModes:
    """The laws of a model, rebuilt operation by operation with modes for relations.

    Attributes:
        results: The laws and the others.
        relations, modes: What their modes stand for, and the symbols of these.
    """

    def __init__(self, laws: Sequence[SX], others: Sequence[SX], dae: Dae) -> None:
        self._switches = list[tuple[Relation, SX]]()
        self._domains = list[tuple[Relation, SX]]()
        *columns, smooth = map(ca.vertsplit, ca.cse([*laws, *others, column(dae.smooth)]))
        roots = [row for rows in (*columns, smooth) for row in rows]
        nodes = list(in_postorder(roots, leftmost_first=True))
        in_laws = _parts_of([row for rows in columns[: len(laws)] for row in rows], nodes)
        in_laws -= _parts_of(smooth, nodes)
        changes, self._constant = set[int](), symbols(dae.p)
        for key, value, keys in nodes:
            if changes.intersection(keys) or (value.is_symbolic() and key not in self._constant):
                changes.add(key)
        codes = {key: value.op() for key, value, keys in nodes if keys and key in in_laws & changes}
        self._events = {key for key, code in codes.items() if code in RELATIONS}
        bounded = {key for key, code in codes.items() if code in _BOUNDED}
        self._bounded = bounded & self._near_events(nodes)
        forms = dict[int, Any]()
        for key, value, keys in nodes:
            forms[key] = self._rebuilt(key, value, [forms[k] for k in keys])
        self.results = [column(forms[row.element_hash()] for row in rows) for rows in columns]
        pairs = [*self._switches, *self._domains]  # domains follow from the other modes
        self.relations = [relation for relation, _ in pairs]
        self.modes = [mode for _, mode in pairs]

    def _near_events(self, nodes: Sequence[Node]) -> set[int]:
        """Return the operations that modes guard, or that depend on modes."""
        switched, guarded = set(self._events), set[int]()
        for key, _, keys in nodes:
            if switched.intersection(keys):
                switched.add(key)
        for key, value, keys in reversed(nodes):
            if value.op() == ca.OP_IF_ELSE_ZERO and keys[0] in switched:
                guarded.add(keys[1])
            elif key in guarded:
                guarded.update(keys)
        return switched | guarded

    def _rebuilt(self, key: int, value: SX, terms: list[Any]) -> Any:
        """Return an operation on rebuilt terms; of a function that is called, all its results."""
        if not terms:
            return value
        if value.is_call():
            return called(value.which_function(), terms)
        if value.is_output():
            return terms[0][value.which_output()]
        if key in self._events:
            return self._switched(value.op(), terms)
        if key in self._bounded:
            return self._continued(value.op(), terms)
        return applied(value.op(), terms)

    def _switched(self, code: int, terms: Sequence[SX]) -> SX:
        """Return a relation with a mode, or several, in its place."""
        a, b = terms[0], terms[-1]
        match code:
            case ca.OP_LT:
                return self._sign(b - a, "<", -1) > 0
            case ca.OP_LE:
                return self._sign(b - a, "<=", 1) > 0
            case ca.OP_SIGN:
                return self._sign(a, "sign", 0)
            case ca.OP_FABS:
                return self._sign(a, "fabs") * a
            case ca.OP_FLOOR:
                return self._floor(a, "floor")
            case ca.OP_CEIL:
                return -self._floor(-a, "ceil")
            case ca.OP_FMIN:
                return ca.if_else(self._sign(b - a, "fmin") > 0, a, b)
            case ca.OP_FMAX:
                return ca.if_else(self._sign(b - a, "fmax") > 0, b, a)
            case ca.OP_COPYSIGN:
                return self._sign(a, "copysign") * a * self._sign(b, "copysign", 1)
            case ca.OP_REMAINDER:
                return a - b * self._floor(a / b + 0.5, "remainder")
        side = self._sign(a / b, "fmod")
        return a - b * side * self._floor(side * a / b, "fmod")

    def _continued(self, code: int, terms: Sequence[SX]) -> SX:
        """Return an operation that has its value at the boundary also a little beyond it.

        A step that passes an event needs values there. The boundary is a relation of its own:
        where the operand stays beyond it after all modes have followed, the result is NaN.
        """
        base, edge = terms[0], SX(0)
        if code == ca.OP_POW and terms[1].is_constant() and float(terms[1]).is_integer():
            return applied(code, terms)
        argument = base
        if code in (ca.OP_ASIN, ca.OP_ACOS):
            argument = 1 - base * base
            edge = applied(code, [ca.sign(base)])
        elif code != ca.OP_SQRT:
            edge = ca.if_else(terms[1] > 0, 0, ca.if_else(terms[1] < 0, ca.inf, 1))
        within = argument > 0
        # without a branch of infinite slope, which CasADi's derivatives would multiply by 0
        inner = ca.if_else(within, base, 0.5)
        found = ca.if_else(within, applied(code, [inner, *terms[1:]]), edge)
        outside = applied(code, terms) if code == ca.OP_POW else SX.nan()
        relation = Relation(argument + _AT_BOUNDARY, False, KEEPS, _BOUNDED[code])
        mode = self._mode(relation, self._domains)
        return ca.if_else(mode > 0, found, outside)

    def _sign(self, argument: SX, operation: str, at_zero: int = KEEPS) -> SX:
        relation = Relation(without_poles(argument, self._constant), False, at_zero, operation)
        return self._mode(relation, self._switches)

    def _floor(self, argument: SX, operation: str) -> SX:
        return self._mode(Relation(argument, True, KEEPS, operation), self._switches)

    def _mode(self, relation: Relation, pairs: list[tuple[Relation, SX]]) -> SX:
        """Return the mode of a relation, which becomes one of the pairs if it is new."""
        for i, (known, mode) in enumerate(pairs):
            ends = {known.at_zero, relation.at_zero}
            shared = known.floor == relation.floor and (len(ends) == 1 or ends == {0, KEEPS})
            if shared and ca.is_equal(known.argument, relation.argument, 3):
                pairs[i] = replace(known, at_zero=min(ends)), mode
                return mode
        mode = SX.sym(f"mode_{len(self._switches) + len(self._domains) + 1}")
        pairs.append((relation, mode))
        return mode


def _parts_of(roots: Sequence[SX], nodes: Sequence[Node]) -> set[int]:
    """Return what some roots depend on, with these, of nodes in the order of evaluation."""
    found = {root.element_hash() for root in roots}
    for key, _, keys in reversed(nodes):
        if key in found:
            found.update(keys)
    return found


def called(function: ca.Function, terms: Sequence[SX]) -> list[SX]:
    """Return the nonzeros of all results of a function, from those of all arguments."""
    ends = accumulate((function.nnz_in(i) for i in range(function.n_in())), initial=0)
    nonzeros = ca.vertcat(*terms)
    given = [
        SX(function.sparsity_in(i), nonzeros[begin:end])
        for i, (begin, end) in enumerate(pairwise(ends))
    ]
    return [result.nz[i] for result in function.call(given) for i in range(result.nnz())]


def term_sizes(laws: SX) -> SX:
    """Return the sizes of the terms that make each row, which may cancel: (n, 1).

    Rounding of a row is relative to them, not to its value. What a function other than a sum, a
    product or a quotient makes of terms has the size of its value.
    """
    if ca.OP_CALL in operations(laws):
        return ca.fabs(laws)

    def operation(code: int, terms: list[tuple[SX, SX]]) -> tuple[SX, SX]:
        values, sizes = zip(*terms, strict=True)
        value = applied(code, values)
        match code:
            case ca.OP_ADD | ca.OP_SUB:
                return value, sizes[0] + sizes[1]
            case ca.OP_NEG:
                return value, sizes[0]
            case ca.OP_TWICE:
                return value, 2 * sizes[0]
            case ca.OP_SQ:
                return value, sizes[0] * ca.fabs(values[0])
            case ca.OP_MUL:
                return value, ca.fmax(ca.fabs(values[0]) * sizes[1], ca.fabs(values[1]) * sizes[0])
            case ca.OP_DIV:
                own, other = sizes[0], ca.fabs(value) * sizes[1]
                return value, ca.fmax(own, other) / ca.fabs(values[1])
            case ca.OP_INV:
                return value, value * value * sizes[0]
            case ca.OP_IF_ELSE_ZERO:
                return value, ca.if_else(values[0], sizes[1], 0)
        return value, ca.fabs(value)

    rows = replayed(ca.cse(laws), lambda leaf: (leaf, ca.fabs(leaf)), operation)
    return column(size for _, size in rows)
