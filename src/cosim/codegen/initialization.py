"""Start values and algebraic unknowns: the two solutions that both roads need.

Both come as CasADi functions that can be called, and of which C code can be generated.
"""

from typing import Any

import casadi as ca
from casadi import MX, SX

from casadi_models.dae import Dae, StartRule
from cosim.codegen.functions import CALL, symbols_like
from cosim.memo import kept_per_thread

KNOWN = ["t", "x", "u", "p"]
DEFECT_LIMIT = 1e-9  # of an implicit start equation, as a Newton step relative to the states' size


@kept_per_thread(16)
def start_function(dae: Dae) -> ca.Function:
    """Return `model_start(t, x, u, p) -> (x, defect)`: exact starts kept, calculated ones solved.

    `defect` is the largest Newton step left in an implicit start rule; not a number where its
    solution does not exist.
    """
    t, x, _, u, p = symbols_like(dae)
    rows, defect = ca.vertsplit(x), MX(0)
    for i, rule in enumerate(dae.start_rules):
        known = [t, ca.vertcat(*rows), u, p]
        if rule.implicit:
            solution, left = _solve_rule(dae, rule, f"start_{i}", known)
            defect += left  # a sum keeps what is not a number
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
    """Return the symbols t, x, u, p of a model: what its algebraic unknowns follow from."""
    return [dae.t, dae.x, dae.u, dae.p]


@kept_per_thread(16)
def algebraic_function(dae: Dae) -> ca.Function:
    """Return `model_algebraic(t, x, z, u, p) -> z`, the consistent unknowns; `z` is a guess.

    Equations that are linear in z (every mechanical system here) are solved at once; others by
    Newton's method from the guess. Where there is no solution, the result is not a number.
    """
    if not dae.algebraics:
        return ca.Function("model_algebraic", dae.arguments, [SX(0, 1)], CALL, ["z_solved"])
    matrix = ca.jacobian(dae.alg, dae.z)
    t, x, z, u, p = symbols_like(dae)
    if not ca.depends_on(matrix, dae.z):
        offset = ca.substitute(dae.alg, dae.z, SX.zeros(dae.z.numel()))
        linear = law_of_knowns(dae, "linear_alg", matrix, -offset)
        slope, negated = linear(t, x, u, p)
        solution = ca.solve(slope, negated, "qr")
    else:
        known = knowns(dae)
        root, left = _newton_root("algebraic", dae.z, dae.alg, known, z, [t, x, u, p])
        solution = ca.if_else(left < DEFECT_LIMIT, root, ca.DM.nan(dae.z.numel()))
    return ca.Function("model_algebraic", [t, x, z, u, p], [solution], CALL, ["z_solved"])


def usual_start(dae: Dae) -> tuple[ca.DM, ca.DM, list[float], list[float]]:
    """Return x, z, u, p with which a model starts that nobody gives anything.

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
    return _newton_root(name, unknown, expression, knowns(dae), guess, arguments)


def _newton_root(
    name: str, unknown: SX, expression: SX, known: list[SX], guess: MX, arguments: list[MX]
) -> tuple[MX, MX]:
    """Return the root of an expression, and the Newton step left before the last one."""
    residual = ca.Function(name, [unknown, *known], [expression], {"cse": True})
    slope = ca.Function(f"{name}_slope", [unknown, *known], [ca.jacobian(expression, unknown)])
    options: dict[str, Any] = {"error_on_fail": False, "max_iter": 50, "abstol": 1e-13}
    root = ca.rootfinder(f"{name}_root", "fast_newton", residual, options)(guess, *arguments)
    step = ca.solve(slope(root, *arguments), residual(root, *arguments), "qr")
    return root - step, ca.norm_inf(step / (1 + ca.fabs(root)))
