"""`time_terms`: parts of equations that time and parameters alone determine."""

import casadi as ca
from casadi import SX

from casadi_models.dae.frozen import Dae

_SUMS = (ca.OP_ADD, ca.OP_SUB, ca.OP_NEG)


def time_terms(dae: Dae) -> SX:
    """Return the terms of dx/dt and of the algebraic equations that depend on time alone.

    These are the largest such subexpressions, except that a sum is split into its terms. Terms that
    are linear in time are left out.

    Returns:
        Expressions of `dae.t` and `dae.p`, (n, 1).
    """
    if not ca.depends_on(ca.vertcat(dae.ode, dae.alg), dae.t):
        return SX(0, 1)
    function = ca.Function("laws", dae.arguments, [dae.ode, dae.alg], {"cse": True})
    symbols = [ca.vertsplit(column) for column in dae.arguments]
    # by place of the work vector: value, its terms, whether it depends on time, on other variables
    work: dict[int, tuple[SX, list[SX], bool, bool]] = {}
    found = list[SX]()
    for k in range(function.n_instructions()):
        code, given = function.instruction_id(k), function.instruction_input(k)
        to = function.instruction_output(k)
        if code == ca.OP_INPUT:
            column, row = given
            value = symbols[column][row]
            work[to[0]] = value, [value], column == 0, column in (1, 2, 3)
            continue
        if code == ca.OP_CONST:
            constant = SX(function.instruction_constant(k))
            work[to[0]] = constant, [], False, False
            continue
        operands = [work[i] for i in given]
        other = code in (ca.OP_OUTPUT, ca.OP_CALL) or any(o for *_, o in operands)
        if other:
            found += [term for _, terms, timed, mixed in operands if timed and not mixed
                      for term in terms]  # fmt: skip
        if code == ca.OP_OUTPUT:
            continue
        if other:
            for place in to:
                work[place] = SX(0), [], False, True
            continue
        values = [value for value, *_ in operands]
        value = SX.unary(code, *values) if len(values) == 1 else SX.binary(code, *values)
        terms = [term for _, own, timed, _ in operands if timed for term in own]
        timed = any(timed for *_, timed, _ in operands)
        work[to[0]] = value, terms if code in _SUMS else [value], timed, False
    bent = [term for term in found if ca.depends_on(ca.jtimes(term, dae.t, 1), dae.t)]
    return ca.densify(ca.cse(ca.vertcat(SX(0, 1), *bent)))
