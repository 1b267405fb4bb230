"""`LawsWithModes`: laws in which every relation has a mode in its place.

The mode of a sign is 1 or -1, that of a floor an integer; see `casadi_models.dae.hybrid`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import TypeVar

import casadi as ca
from casadi import SX

from casadi_models.dae.expressions import RELATIONS, column, operations
from casadi_models.dae.frozen import Dae
from casadi_models.dae.variables import Variable

COMPARISONS = ("<", "<=")
_COMPARISONS = {ca.OP_LT: -1, ca.OP_LE: 1}  # and the mode where both sides stay equal
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


class LawsWithModes:
    """The laws of a model, rebuilt operation by operation with modes for relations."""

    def __init__(self, laws: Sequence[SX], others: Sequence[SX], dae: Dae) -> None:
        self._switches = list[tuple[Relation, SX]]()
        self._domains = list[tuple[Relation, SX]]()
        smooth = ca.vertcat(SX(0, 1), *dae.smooth)
        columns = [*laws, *others, smooth]
        symbols = [*dae.arguments]
        self._function = ca.Function("laws", symbols, columns, {"cse": True})
        self._symbols = [ca.vertsplit(column) for column in symbols]
        self._read(len(laws), len(columns) - 1)
        sizes = [column.numel() for column in columns[:-1]]
        self.results = self._rebuilt(sizes)
        pairs = [*self._switches, *self._domains]  # domains follow from the other modes
        self.relations = [relation for relation, _ in pairs]
        self.modes = [mode for _, mode in pairs]

    def _read(self, laws: int, smooth: int) -> None:
        """Read the instructions: operands, whether they change, and which are in the laws."""
        function = self._function
        # by place of the work vector: the instruction that wrote there, and which of its results
        place: dict[int, tuple[int, int]] = {}
        self._codes, self._operands = list[int](), list[list[tuple[int, int]]]()
        changes, wanted, literal = list[bool](), set[int](), set[int]()
        self._targets: dict[tuple[int, int], tuple[int, int]] = {}
        for k in range(function.n_instructions()):
            code, given = function.instruction_id(k), function.instruction_input(k)
            operands = [] if code in (ca.OP_INPUT, ca.OP_CONST) else [place[i] for i in given]
            self._codes.append(code)
            self._operands.append(operands)
            if code == ca.OP_OUTPUT:
                output, row = function.instruction_output(k)
                self._targets[output, row] = operands[0]
                if output < laws:
                    wanted.add(operands[0][0])
                if output == smooth:
                    literal.add(operands[0][0])
                changes.append(False)
                continue
            for part, i in enumerate(function.instruction_output(k)):
                place[i] = (k, part)
            parameter = code == ca.OP_INPUT and given[0] == 4
            changes.append(
                not parameter if code == ca.OP_INPUT else any(changes[i] for i, _ in operands)
            )
        for k in range(len(self._codes) - 1, -1, -1):  # what a law depends on is in it
            if k in wanted:
                wanted.update(i for i, _ in self._operands[k])
            if k in literal:
                literal.update(i for i, _ in self._operands[k])
        self._events = {
            k
            for k in wanted - literal
            if changes[k] and self._codes[k] in RELATIONS
        }  # fmt: skip
        self._bounded = self._near_events(wanted - literal, changes)

    def _near_events(self, laws: set[int], changes: Sequence[bool]) -> set[int]:
        """Return the bounded operations of the laws that modes guard, or depend on modes."""
        switched, guarded = set[int](), set[int]()
        for k, operands in enumerate(self._operands):
            if k in self._events or any(i in switched for i, _ in operands):
                switched.add(k)
        for k in range(len(self._codes) - 1, -1, -1):
            operands = self._operands[k]
            if self._codes[k] == ca.OP_IF_ELSE_ZERO and operands[0][0] in switched:
                guarded.add(operands[1][0])
            elif k in guarded:
                guarded.update(i for i, _ in operands)
        return {
            k
            for k in laws & (switched | guarded)
            if self._codes[k] in _BOUNDED and any(changes[i] for i, _ in self._operands[k])
        }

    def _rebuilt(self, sizes: Sequence[int]) -> list[SX]:
        function, values = self._function, list[list[SX]]()
        for k, (code, operands) in enumerate(zip(self._codes, self._operands, strict=True)):
            terms = [values[i][part] for i, part in operands]
            if code == ca.OP_INPUT:
                argument, row = function.instruction_input(k)
                values.append([self._symbols[argument][row]])
            elif code == ca.OP_CONST:
                values.append([SX(function.instruction_constant(k))])
            elif code == ca.OP_OUTPUT:
                values.append([])
            elif code == ca.OP_CALL:
                values.append(self._called(terms, len(function.instruction_output(k))))
            elif k in self._events:
                values.append([self._switched(code, terms)])
            elif k in self._bounded:
                values.append([self._continued(code, terms)])
            else:
                values.append([applied(code, terms)])
        rows = [[self._targets[output, row] for row in range(n)] for output, n in enumerate(sizes)]
        return [column(values[k][part] for k, part in places) for places in rows]

    def _called(self, terms: Sequence[SX], results: int) -> list[SX]:
        """Return the results of a function that the laws call.

        Raises:
            ValueError: Several functions have these sizes, and CasADi does not tell which it is.
        """
        fitting = [
            f
            for f in self._function.find_functions(0)
            if f.nnz_in() == len(terms) and f.nnz_out() == results
        ]
        if len(fitting) != 1:
            raise ValueError("equations that call several functions of equal sizes have no events")
        return called(fitting[0], terms)

    def _switched(self, code: int, terms: Sequence[SX]) -> SX:
        """Return a relation with a mode, or several, in its place."""
        if code in _COMPARISONS:
            a, b = terms
            name = COMPARISONS[code == ca.OP_LE]
            return self._sign(b - a, name, _COMPARISONS[code]) > 0
        if len(terms) == 1:
            (a,) = terms
            match code:
                case ca.OP_SIGN:
                    return self._sign(a, "sign", 0)
                case ca.OP_FABS:
                    return self._sign(a, "fabs") * a
                case ca.OP_FLOOR:
                    return self._floor(a, "floor")
            return -self._floor(-a, "ceil")
        a, b = terms
        match code:
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
        return self._mode(Relation(argument, False, at_zero, operation), self._switches)

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


def called(function: ca.Function, terms: Sequence[SX]) -> list[SX]:
    """Return the nonzeros of all results of a function, from those of all arguments."""
    ends = accumulate((function.nnz_in(i) for i in range(function.n_in())), initial=0)
    nonzeros = ca.vertcat(*terms)
    given = [
        SX(function.sparsity_in(i), nonzeros[begin:end])
        for i, (begin, end) in enumerate(pairwise(ends))
    ]
    return [result.nz[i] for result in function.call(given) for i in range(result.nnz())]


def applied(code: int, terms: Sequence[SX]) -> SX:
    """Return the result of an operation by CasADi's code of it."""
    return SX.unary(code, *terms) if len(terms) == 1 else SX.binary(code, *terms)


_Value = TypeVar("_Value")


def replayed(
    function: ca.Function,
    symbol: Callable[[int, int], _Value],
    constant: Callable[[SX], _Value],
    operation: Callable[[int, list[_Value]], _Value],
) -> list[list[_Value]]:
    """Return the values of the rows of each result of a function, from its instructions.

    Args:
        function: An `SX` function with dense results.
        symbol: Returns the value of a symbol, from its argument and its row.
        constant: Returns that of a constant.
        operation: Returns that of an operation, from CasADi's code of it and its operands.
    """
    work = dict[int, _Value]()
    rows = [[constant(SX(0))] * function.numel_out(i) for i in range(function.n_out())]
    for k in range(function.n_instructions()):
        code, given = function.instruction_id(k), function.instruction_input(k)
        to = function.instruction_output(k)
        if code == ca.OP_OUTPUT:
            rows[to[0]][to[1]] = work[given[0]]
        elif code == ca.OP_INPUT:
            work[to[0]] = symbol(*given)
        elif code == ca.OP_CONST:
            work[to[0]] = constant(SX(function.instruction_constant(k)))
        else:
            work[to[0]] = operation(code, [work[i] for i in given])
    return rows


def term_sizes(laws: SX) -> SX:
    """Return the sizes of the terms that make each row, which may cancel: (n, 1).

    Rounding of a row is relative to them, not to its value. What a function other than a sum, a
    product or a quotient makes of terms has the size of its value.
    """
    given = ca.symvar(laws)
    function = ca.Function("laws", given, [ca.densify(laws)], {"cse": True})
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

    rows = replayed(
        function, lambda i, _: (given[i], ca.fabs(given[i])), lambda c: (c, ca.fabs(c)), operation
    )[0]
    return column(size for _, size in rows)
