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
from cosim.values import Values

Vector = NDArray[np.float64]

DEFECT_LIMIT = 1e-9  # of an implicit start equation, as a Newton step relative to the states' size


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
            solution, step = _solve_rule(dae, rule, f"start_{i}", current, p)
            defect += step  # a sum keeps what is not a number
        else:
            law = ca.Function(f"start_{i}", [dae.x, dae.p], [rule.expression], {"cse": True})
            solution = law(current, p)
        for row, value in zip(rule.states, ca.vertsplit(solution), strict=True):
            rows[row] = value
    result = ca.vertcat(MX(0, 1), *rows)
    return ca.Function("model_start", [x, p], [result, defect], ["x", "p"], ["x_start", "defect"])


def algebraic_function(dae: Dae) -> ca.Function:
    """Return `model_algebraic(t, x, z, u, p) -> z`, the consistent unknowns; `z` is a guess.

    Equations that are linear in z (every mechanical system here) are solved at once; others by
    Newton's method from the guess.
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
        residual = ca.Function("alg", [dae.z, dae.t, dae.x, dae.u, dae.p], [dae.alg], {"cse": True})
        solution = _newton("algebraic_root", residual)(z, t, x, u, p)
    return ca.Function("model_algebraic", [t, x, z, u, p], [solution], names, ["z_solved"])


def start_values(dae: Dae, values: Values) -> Vector:
    """Return the start of every state, (nx,).

    Raises:
        InitialConditionError: A calculated start has no solution or leaves its bounds.
    """
    solved, defect = start_function(dae)(values.x, values.p)
    x = np.array(solved).ravel()
    for rule in dae.start_rules:
        names = ", ".join(dae.states[i].name for i in rule.states)
        if not np.isfinite(x[list(rule.states)]).all() or not float(defect) < DEFECT_LIMIT:
            near = _closest(dae, rule, x, values) if rule.implicit else "its formula has no value"
            raise InitialConditionError(
                f"{dae.full_name}: no start value of {names} satisfies the {rule.meaning}; "
                f"{near}; change the other start values or parameters"
            )
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
    z = np.array(algebraic_function(dae)(t, x, guess, values.u, values.p)).ravel()
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
    residual = ca.Function(name, [unknown, dae.x, dae.p], [expression], {"cse": True})
    slope = ca.Function(
        f"{name}_slope", [unknown, dae.x, dae.p], [ca.jacobian(expression, unknown)]
    )
    guess = ca.vertcat(*(x[i] for i in rule.states))
    root = _newton(f"{name}_root", residual)(guess, x, p)
    step = ca.solve(slope(root, x, p), residual(root, x, p), "qr")
    return root - step, ca.norm_inf(step / (1 + ca.fabs(root)))


def _newton(name: str, residual: ca.Function) -> ca.Function:
    options: dict[str, Any] = {"error_on_fail": False, "max_iter": 50, "abstol": 1e-13}
    return ca.rootfinder(name, "fast_newton", residual, options)


def _closest(dae: Dae, rule: StartRule, x: Vector, values: Values) -> str:
    """Say how near to a solution a scan around the guess comes, for one unknown."""
    law = ca.Function("law", [dae.x, dae.p], [rule.expression])
    trial = values.x.copy()
    best, at = np.inf, float("nan")
    for shift in np.linspace(-np.pi, np.pi, 721) if len(rule.states) == 1 else (0.0,):
        trial[rule.states[0]] = values.x[rule.states[0]] + shift
        residual = float(ca.norm_inf(law(trial, values.p)))
        if residual < best:
            best, at = residual, trial[rule.states[0]]
    name = dae.states[rule.states[0]].name
    return f"the closest found leaves a residual of {best:.3g} at {name} = {at:.4g}"
