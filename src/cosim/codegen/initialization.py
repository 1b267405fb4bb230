"""Initial values, algebraic unknowns, and the projection of states onto constraints."""

from collections.abc import Sequence
from math import log
from typing import Any

import casadi as ca
from casadi import MX, SX

from casadi_models.dae import Dae, StartRule
from casadi_models.dae.expressions import linear_solution
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
    guess = ca.vertcat(*(x[i] for i in rule.states))
    return _newton_root(name, unknown, expression, knowns(dae), [guess, *arguments])


def _newton_root(
    name: str,
    unknown: SX,
    expression: SX,
    known: list[SX],
    arguments: list[MX],
    sizes: Sequence[MX | ca.DM] = (),
) -> tuple[MX, MX]:
    """Return the root of an expression, and the relative size of the last Newton step.

    Args:
        name: Of the functions.
        unknown: Its symbols, (n, 1).
        expression: Of these and the known symbols, (n, 1).
        known: Other symbols of it.
        arguments: The initial guess, and values of the known symbols.
        sizes: Of the unknowns and of the rows of the expression, as far as they are below 1; by
            the initial guess and Newton's first step when empty.
    """
    every = [unknown, *known]
    residual = ca.Function(name, every, [expression], {"cse": True})
    slope = ca.Function(f"{name}_slope", every, [ca.jacobian(expression, unknown)])
    if not sizes:
        terms = ca.Function(f"{name}_terms", every, [term_sizes(expression)], {"cse": True})
        sizes = _first_sizes(f"{name}_sizes", [residual, slope, terms], arguments)
    size, row = map(_small, sizes)
    symbols = [SX.sym(part, unknown.numel()) for part in ("share", "size", "row")]
    scaled = residual(symbols[0] * symbols[1], *known) / symbols[2]
    law = ca.Function(f"{name}_law", [symbols[0], *known, *symbols[1:]], [scaled], {"cse": True})
    options: dict[str, Any] = {"error_on_fail": False, "max_iter": 50, "abstol": 1e-13}
    find = ca.rootfinder(f"{name}_root", "fast_newton", law, options)
    root = size * find(arguments[0] / size, *arguments[1:], size, row)
    step = linear_solution(slope(root, *arguments[1:]), residual(root, *arguments[1:]))
    least = ca.fmax(size, 1 / _BASE)  # rounding of larger quantities may leave 1e-16
    return root - step, ca.norm_inf(step / (least + ca.fabs(root)))


def _first_sizes(name: str, laws: Sequence[ca.Function], arguments: Sequence[MX]) -> list[MX]:
    """Return the sizes of unknowns and rows by an initial guess and Newton's first step.

    Args:
        name: Of the function.
        laws: The rows, their slopes, and the sizes of the terms that make them.
        arguments: The initial guess, and values of the known symbols.
    """
    guess, *known = symbols = [MX.sym("argument", each.sparsity()) for each in arguments]
    rows, slopes, terms = (law(guess, *known) for law in laws)
    step = ca.fabs(linear_solution(slopes, rows))
    reached = ca.fmax(ca.fabs(guess), ca.if_else(step < ca.inf, step, 0))
    constant: dict[str, Any] = {"is_diff_in": len(arguments) * [False], "never_inline": True}
    found: list[MX] = ca.Function(name, symbols, [reached, terms], constant).call([*arguments])
    return found


def _small(size: MX | ca.DM) -> MX | ca.DM:
    """Return powers of 1024, which cost no digits, about sizes below 1; 1 for others."""
    power = _BASE ** -ca.floor(-ca.log(ca.fmax(size, 1e-100)) / log(_BASE))
    return ca.if_else(size > 0, ca.fmin(power, 1), 1)


def projection_step(dae: Dae, constants: int) -> ca.Function:
    """Return `project(t, x, u, c) -> (x, change)`, one Newton step for each invariant in turn.

    Each step is the least-squares change of the invariant's states, scaled by its sizes; `change`
    is the largest scaled change. An invariant is evaluated at the result of the previous step.

    Args:
        constants: Length of c, whose first elements are the parameters.
    """
    x, c = SX.sym("x", dae.x.numel()), SX.sym("c", constants)
    t, u = dae.t, dae.u
    p = c[: dae.p.numel()]
    here, change = SX(x), SX(0)
    for invariant in dae.invariants:
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
