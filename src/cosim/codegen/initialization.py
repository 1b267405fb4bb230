"""Initial values, algebraic unknowns, and the projection of states onto constraints."""

from collections.abc import Iterable, Sequence
from math import log
from typing import Any

import casadi as ca
from casadi import MX, SX

from casadi_models.dae import Dae, StartRule
from casadi_models.dae.expressions import linear_solution
from casadi_models.dae.invariants import Invariant
from casadi_models.dae.relations import term_sizes
from cosim.codegen.functions import CALL, Laws, symbols_like
from cosim.memo import cached_per_thread

KNOWN = ["t", "x", "u", "p"]
_BASE = 1024.0
DEFECT_LIMIT = 1e-9  # largest remaining Newton step, relative to its size + |unknown|


@cached_per_thread(16)
def start_function(dae: Dae) -> ca.Function:
    """Return `model_start(t, x, u, p) -> (x, defect)`, which solves the calculated initial values.

    Exact initial values stay as they are. `defect` is the largest remaining Newton step of an
    implicit start rule; it is NaN if there is no solution.
    """
    t, x, _, u, p = symbols_like(dae)
    rows, defect = ca.vertsplit(x), MX(0)
    for i, rule in enumerate(dae.start_rules):
        known = [t, ca.vertcat(*rows), u, p]
        if rule.implicit:
            solution, left = _solve_rule(dae, rule, f"start_{i}", known)
            defect += left  # a sum propagates NaN
        else:
            solution = law_of_knowns(dae, f"start_{i}", rule.expression)(*known)
        for row, value in zip(rule.states, ca.vertsplit(solution), strict=True):
            rows[row] = value
    result = ca.vertcat(MX(0, 1), *rows)
    return ca.Function("model_start", [t, x, u, p], [result, defect], KNOWN, ["x_start", "defect"])


def law_of_knowns(dae: Dae, name: str, *expressions: SX) -> ca.Function:
    """Return a function of all but the algebraic unknowns: `(t, x, u, p) -> expressions`."""
    return ca.Function(name, knowns(dae), [*expressions], {"cse": True})


def knowns(dae: Dae) -> list[SX]:
    """Return the symbols t, x, u, p of a model, which determine its algebraic unknowns."""
    return [dae.t, dae.x, dae.u, dae.p]


@cached_per_thread(16)
def algebraic_function(dae: Dae) -> ca.Function:
    """Return `model_algebraic(t, x, z, u, p) -> z`, the consistent algebraic unknowns.

    The argument z is an initial guess. Equations that are linear in z, as in every mechanical
    system here, are solved directly; others by Newton's method. The result is NaN if there is no
    solution.
    """
    return _algebraic(dae, dae.balanced, dae.p)


def prepared_algebraic(laws: Laws) -> ca.Function:
    """Return `model_algebraic(t, x, z, u, c) -> z`, with constants c for the parameters."""
    return _algebraic(laws.dae, laws.alg, laws.c)


def _algebraic(dae: Dae, residual: SX, p: SX) -> ca.Function:
    known = [dae.t, dae.x, dae.u, p]
    t, x, z, u, _ = symbols_like(dae)
    given = MX.sym("p", p.numel())
    matrix = ca.jacobian(residual, dae.z)
    if not dae.algebraics:
        solution = z
    elif not ca.depends_on(matrix, dae.z):
        offset = ca.substitute(residual, dae.z, SX.zeros(dae.z.numel()))
        linear = ca.Function("linear_alg", known, [matrix, -offset], {"cse": True})
        solution = linear_solution(*linear(t, x, u, given))
    else:  # its limit is one of the residual in the author's units
        nominal = ca.DM([variable.nominal for variable in dae.algebraics])
        sizes = nominal, ca.DM(ca.jacobian_sparsity(dae.alg, dae.z), 1) @ nominal
        root, left = _newton_root("algebraic", dae.z, dae.alg, known, [z, t, x, u, given], sizes)
        solution = ca.if_else(left < DEFECT_LIMIT, root, ca.DM.nan(dae.z.numel()))
    return ca.Function("model_algebraic", [t, x, z, u, given], [solution], CALL, ["z_solved"])


def usual_start(dae: Dae) -> tuple[ca.DM, ca.DM, list[float], list[float]]:
    """Return x, z, u, p at the model's own initial values, inputs and parameters.

    Raises:
        RuntimeError: There is no solution.
    """
    p, u, guess = (
        [float(variable.start or 0.0) for variable in group]
        for group in (dae.parameters, dae.inputs, dae.algebraics)
    )
    x, _ = start_function(dae)(0.0, list(dae.x_start), u, p)
    return x, algebraic_function(dae)(0.0, x, guess, u, p), u, p


def _solve_rule(dae: Dae, rule: StartRule, name: str, arguments: list[MX]) -> tuple[MX, MX]:
    unknown = SX.sym("unknown", len(rule.states))
    filled = dae.x + 0
    for i, row in enumerate(rule.states):
        filled[row] = unknown[i]
    expression = ca.substitute(rule.expression, dae.x, filled)
    _, x, _, _ = arguments
    constant: dict[str, Any] = {"is_diff_in": 5 * [False], "never_inline": True}
    terms = [ca.fabs(unknown), term_sizes(expression)]
    given = [ca.vertcat(*(x[i] for i in rule.states)), *arguments]
    sizes = ca.Function(f"{name}_sizes", [unknown, *knowns(dae)], terms, constant).call(given)
    return _newton_root(name, unknown, expression, knowns(dae), given, sizes)


def _newton_root(
    name: str,
    unknown: SX,
    expression: SX,
    known: list[SX],
    arguments: list[MX],
    sizes: Sequence[MX | ca.DM],
) -> tuple[MX, MX]:
    """Return the root of an expression, and the relative size of the last Newton step.

    The arguments are an initial guess and the known values. The sizes of unknowns and of rows count
    where they are small: then, not 1 but powers of 1024 about them are what steps are compared to.
    """
    size, row = (
        ca.if_else(each > 0, ca.fmin(_BASE ** -ca.floor(-ca.log(each) / log(_BASE)), 1), 1)
        for each in sizes
    )
    guess, *given = arguments
    residual = ca.Function(name, [unknown, *known], [expression], {"cse": True})
    slope = ca.Function(f"{name}_slope", [unknown, *known], [ca.jacobian(expression, unknown)])
    share, *scales = (SX.sym(part, unknown.numel()) for part in ("share", "size", "row"))
    scaled = residual(share * scales[0], *known) / scales[1]
    law = ca.Function(f"{name}_law", [share, *known, *scales], [scaled], {"cse": True})
    options: dict[str, Any] = {"error_on_fail": False, "max_iter": 50, "abstol": 1e-13}
    find = ca.rootfinder(f"{name}_root", "fast_newton", law, options)
    root = size * find(guess / size, *given, size, row)
    step = linear_solution(slope(root, *given), residual(root, *given))
    least = ca.fmax(ca.fmax(size, 1 / _BASE), ca.mmax(row))  # rounding of large terms is no step
    return root - step, ca.norm_inf(step / (least + ca.fabs(root)))


def _joined(invariants: Iterable[Invariant]) -> list[Invariant]:
    """Return invariants that have no states in common, in the order of the first of each."""
    found = list[Invariant]()
    for one in invariants:
        parts = [other for other in found if {*other.states} & {*one.states}]
        first = found.index(parts[0]) if parts else len(found)
        parts.append(one)
        sizes = {
            i: size
            for part in reversed(parts)
            for i, size in zip(part.states, ca.vertsplit(part.sizes), strict=True)
        }
        residual = ca.vertcat(*(part.residual for part in parts))
        joined = Invariant(tuple(sizes), residual, ca.vertcat(*sizes.values()), one.meaning)
        apart = [other for other in found if other not in parts]
        found = [*apart[:first], joined, *apart[first:]]
    return found


def projection_step(dae: Dae, constants: int) -> ca.Function:
    """Return `project(t, x, u, c) -> (x, change)`, one Newton step for each invariant in turn.

    Each step is the least-squares change of the invariant's states, scaled by its sizes; `change`
    is the largest scaled change. An invariant is evaluated at the result of the previous step;
    those that move the same states are one, as each would undo what another has done.

    Args:
        constants: Length of c, whose first elements are the parameters.
    """
    x, c = SX.sym("x", dae.x.numel()), SX.sym("c", constants)
    t, u = dae.t, dae.u
    p = c[: dae.p.numel()]
    here, change = SX(x), SX(0)
    for invariant in _joined(dae.invariants):
        rows = list(invariant.states)
        slopes = ca.jacobian(invariant.residual, dae.x[rows])
        law = law_of_knowns(dae, "law", invariant.residual, slopes, invariant.sizes)
        residual, slopes, sizes = law(t, here, u, p)
        scaled = slopes @ ca.diag(sizes)
        multiplier = ca.ldl_solve(residual, *ca.ldl(ca.triu2symm(ca.triu(scaled @ scaled.T))))
        move = -scaled.T @ multiplier
        here[rows] += sizes * move
        change = ca.fmax(change, ca.norm_inf(move))
    options = {"cse": True}
    names = ["t", "x", "u", "c"], ["moved", "change"]
    return ca.Function("project", [t, x, u, c], [here, change], *names, options)
