"""Start values and algebraic unknowns: the two solutions that both roads need.

Both come as CasADi functions that can be called, and of which C code can be generated.
"""

from typing import Any

import casadi as ca
import numpy as np
from casadi import MX, SX
from numpy.typing import NDArray

from casadi_models.dae import Dae, StartRule
from cosim.errors import InitialConditionError
from cosim.keeping import kept_per_thread
from cosim.values import Values

Vector = NDArray[np.float64]

DEFECT_LIMIT = 1e-9  # of an implicit start equation, as a Newton step relative to the states' size


@kept_per_thread(16)
def start_function(dae: Dae) -> ca.Function:
    """Return `model_start(x, p) -> (x, defect)`: exact starts kept, calculated ones solved.

    `defect` is the largest Newton step left in an implicit start rule; not a number where its
    solution does not exist.
    """
    x, p = MX.sym("x", dae.x.numel()), MX.sym("p", dae.p.numel())
    rows, defect = ca.vertsplit(x), MX(0)
    for i, rule in enumerate(dae.start_rules):
        current = ca.vertcat(*rows)
        if rule.implicit:
            solution, left = _solve_rule(dae, rule, f"start_{i}", current, p)
            defect += left  # a sum keeps what is not a number
        else:
            law = ca.Function(f"start_{i}", [dae.x, dae.p], [rule.expression], {"cse": True})
            solution = law(current, p)
        for row, value in zip(rule.states, ca.vertsplit(solution), strict=True):
            rows[row] = value
    result = ca.vertcat(MX(0, 1), *rows)
    return ca.Function("model_start", [x, p], [result, defect], ["x", "p"], ["x_start", "defect"])


@kept_per_thread(16)
def algebraic_function(dae: Dae) -> ca.Function:
    """Return `model_algebraic(t, x, z, u, p) -> z`, the consistent unknowns; `z` is a guess.

    Equations that are linear in z (every mechanical system here) are solved at once; others by
    Newton's method from the guess. Where there is no solution, the result is not a number.
    """
    symbols = [dae.t, dae.x, dae.z, dae.u, dae.p]
    names = ["t", "x", "z", "u", "p"]
    if not dae.algebraics:
        return ca.Function("model_algebraic", symbols, [SX(0, 1)], names, ["z_solved"])
    matrix = ca.jacobian(dae.alg, dae.z)
    t, x, z, u, p = (
        MX.sym(name, symbol.numel()) for name, symbol in zip(names, symbols, strict=True)
    )
    if not ca.depends_on(matrix, dae.z):
        offset = ca.substitute(dae.alg, dae.z, SX.zeros(dae.z.numel()))
        linear = ca.Function(
            "linear_alg", [dae.t, dae.x, dae.u, dae.p], [matrix, -offset], {"cse": True}
        )
        slope, negated = linear(t, x, u, p)
        solution = ca.solve(slope, negated, "qr")
    else:
        known = [dae.t, dae.x, dae.u, dae.p]
        root, left = _root("algebraic", dae.z, dae.alg, known, z, [t, x, u, p])
        solution = ca.if_else(left < DEFECT_LIMIT, root, ca.DM.nan(dae.z.numel()))
    return ca.Function("model_algebraic", [t, x, z, u, p], [solution], names, ["z_solved"])


def start_values(dae: Dae, values: Values) -> Vector:
    """Return the start of every state, (nx,).

    Raises:
        InitialConditionError: A calculated start has no solution or leaves its bounds.
    """
    solved, defect = start_function(dae)(values.x, values.p)
    x = np.array(solved).ravel()
    if dae.start_rules and not (np.isfinite(x).all() and float(defect) < DEFECT_LIMIT):
        raise _no_start(dae, x, values)
    for variable, value in zip(dae.states, x, strict=True):
        if not variable.minimum <= value <= variable.maximum:
            raise InitialConditionError(
                f"{dae.full_name}: the start of {variable.name} is {value:g} {variable.unit}, "
                f"outside {variable.minimum:g} ... {variable.maximum:g}; change other start values"
            )
    return x


def algebraic_values(dae: Dae, t: float, x: Vector, values: Values) -> Vector:
    """Return the algebraic unknowns that are consistent with the states, (nz,).

    Raises:
        InitialConditionError: The equations are singular at this state.
    """
    guess = np.array([v.start or 0.0 for v in dae.algebraics])
    try:
        z = np.array(algebraic_function(dae)(t, x, guess, values.u, values.p)).ravel()
    except RuntimeError:  # CasADi's factorization meets a singular matrix
        z = np.full(len(dae.algebraics), np.nan)
    if not np.isfinite(z).all():
        first = dae.algebraics[int(np.flatnonzero(~np.isfinite(z))[0])].name
        raise InitialConditionError(
            f"{dae.full_name}: the algebraic equations have no solution at the start ({first} is "
            "not finite); start away from the singularity or use another formulation"
        )
    return z


def _solve_rule(dae: Dae, rule: StartRule, name: str, x: MX, p: MX) -> tuple[MX, MX]:
    unknown = SX.sym("unknown", len(rule.states))
    filled = dae.x + 0
    for i, row in enumerate(rule.states):
        filled[row] = unknown[i]
    expression = ca.substitute(rule.expression, dae.x, filled)
    guess = ca.vertcat(*(x[i] for i in rule.states))
    return _root(name, unknown, expression, [dae.x, dae.p], guess, [x, p])


def _root(
    name: str, unknown: SX, expression: SX, known: list[SX], guess: MX, arguments: list[MX]
) -> tuple[MX, MX]:
    """Return the root of an expression, and the Newton step left before the last one."""
    residual = ca.Function(name, [unknown, *known], [expression], {"cse": True})
    slope = ca.Function(f"{name}_slope", [unknown, *known], [ca.jacobian(expression, unknown)])
    options: dict[str, Any] = {"error_on_fail": False, "max_iter": 50, "abstol": 1e-13}
    root = ca.rootfinder(f"{name}_root", "fast_newton", residual, options)(guess, *arguments)
    step = ca.solve(slope(root, *arguments), residual(root, *arguments), "qr")
    return root - step, ca.norm_inf(step / (1 + ca.fabs(root)))


def _no_start(dae: Dae, x: Vector, values: Values) -> InitialConditionError:
    """Say which rule has no solution: the first that yields no number, or the worst."""
    missing = [r for r in dae.start_rules if not np.isfinite(x[list(r.states)]).all()]
    implicit = [r for r in dae.start_rules if r.implicit]
    rule = missing[0] if missing else max(implicit, key=lambda r: _residual(dae, r, x, values))
    names = ", ".join(dae.states[i].name for i in rule.states)
    near = _closest(dae, rule, x, values) if rule.implicit else "its formula has no value"
    return InitialConditionError(
        f"{dae.full_name}: no start value of {names} satisfies the {rule.meaning}; "
        f"{near}; change the other start values or parameters"
    )


def _residual(dae: Dae, rule: StartRule, x: Vector, values: Values) -> float:
    return float(ca.norm_inf(ca.Function("law", [dae.x, dae.p], [rule.expression])(x, values.p)))


def _closest(dae: Dae, rule: StartRule, x: Vector, values: Values) -> str:
    """Say how near to a solution a scan around the guess comes, for one unknown."""
    trial, first = x.copy(), rule.states[0]
    trial[list(rule.states)] = values.x[list(rule.states)]
    best, at = np.inf, float("nan")
    for shift in np.linspace(-np.pi, np.pi, 721) if len(rule.states) == 1 else (0.0,):
        trial[first] = values.x[first] + shift
        residual = _residual(dae, rule, trial, values)
        if residual < best:
            best, at = residual, trial[first]
    return (
        f"the closest found leaves a residual of {best:.3g} at {dae.states[first].name} = {at:.4g}"
    )
