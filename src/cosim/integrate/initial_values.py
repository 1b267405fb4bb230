"""Consistent initial values of states and algebraic unknowns."""

import casadi as ca
import numpy as np

from casadi_models.dae import Dae, StartRule
from cosim.arrays import Vector
from cosim.codegen.initialization import (
    DEFECT_LIMIT,
    algebraic_function,
    law_of_knowns,
    start_function,
)
from cosim.errors import InitialConditionError
from cosim.memo import cached_per_thread
from cosim.model.inputs import InputSeries
from cosim.model.values import Values
from cosim.text import with_unit

DEPENDENT = 1e-14  # ratio of the smallest and the largest singular value, for rows of length 1
WILD = 1e10  # nominal values: for unknowns of this size, singularity is checked


def consistent_values(dae: Dae, t: float, values: Values) -> tuple[Vector, Vector]:
    """Return `start_values`, (nx,), and the `algebraic_values` at them, (nz,)."""
    x = start_values(dae, t, values)
    return x, algebraic_values(dae, t, x, values)


def start_values(dae: Dae, t: float, values: Values) -> Vector:
    """Return the initial value of every state for a run that begins at t [s], (nx,).

    Raises:
        InitialConditionError: A calculated initial value has no solution or is out of bounds.
    """
    return _start_values(dae, t, *(row.tobytes() for row in (values.x, values.p, values.u))).copy()


@cached_per_thread(64)
def _start_values(dae: Dae, t: float, guesses: bytes, parameters: bytes, inputs: bytes) -> Vector:
    values = Values(*map(np.frombuffer, (guesses, parameters, inputs)))
    try:
        solved, defect = start_function(dae)(t, values.x, values.u, values.p)
        x = np.array(solved).ravel()
    except RuntimeError:  # CasADi's factorization meets a singular matrix
        x, defect = np.full(len(dae.states), np.nan), ca.DM(np.nan)
    if dae.start_rules and not (np.isfinite(x).all() and float(defect) < DEFECT_LIMIT):
        raise _no_start(dae, t, x, values)
    for variable, value in zip(dae.states, x, strict=True):
        if not variable.minimum <= value <= variable.maximum:
            raise InitialConditionError(
                f"{dae.full_name}: the start of {variable.name} is "
                f"{with_unit(value, variable.unit)}, outside {variable.minimum:g} ... "
                f"{variable.maximum:g}; change other start values"
            )
    return x


def algebraic_values(dae: Dae, t: float, x: Vector, values: Values) -> Vector:
    """Return the algebraic unknowns that are consistent with the states, (nz,).

    Raises:
        InitialConditionError: The equations are singular at this state.
    """
    if not dae.algebraics:
        return np.empty(0)
    guess = np.array([v.start or 0.0 for v in dae.algebraics])
    try:
        z = np.array(algebraic_function(dae)(t, x, guess, values.u, values.p)).ravel()
    except RuntimeError:  # CasADi's factorization meets a singular matrix
        z = np.full(len(dae.algebraics), np.nan)
    finite = bool(np.isfinite(z).all())
    wild = not finite or np.abs(z).max() > WILD * max(v.nominal for v in dae.algebraics)
    dependent = _dependent(dae, t, x, guess, values) if wild else ""
    if dependent or not finite:
        first = dae.algebraics[int(np.argmin(np.isfinite(z)))].name
        raise InitialConditionError(
            f"{dae.full_name}: the algebraic equations have no solution at the start "
            f"({dependent or f'{first} is not finite'}); start away from the singularity, leave "
            f"out repeated equations, {_other_guess(dae)}or use another formulation"
        )
    return z


def _dependent(dae: Dae, t: float, x: Vector, z: Vector, values: Values) -> str:
    """Describe the algebraic equations that depend on each other; empty if they are independent."""
    slopes = np.array(_slope_function(dae)(t, x, z, values.u, values.p))
    if not np.isfinite(slopes).all():
        return ""
    for axis in (1, 0):  # rows, then columns of length 1
        lengths = np.linalg.norm(slopes, axis=axis, keepdims=True)
        slopes = slopes / np.where(lengths > 0, lengths, 1.0)
    rows, sizes, _ = np.linalg.svd(slopes)
    if sizes[-1] > DEPENDENT * sizes[0]:
        return ""
    shares = np.abs(rows[:, -1])
    names = [str(i + 1) for i in np.flatnonzero(shares > 1e-3 * shares.max())]
    if len(names) == 1:
        row = ca.jacobian(dae.alg[int(names[0]) - 1], dae.z)
        nonlinear = ca.depends_on(row, dae.z)
        cause = "has slope 0 at the initial guess" if nonlinear else "contains no unknown"
        return f"equation {names[0]} of {len(shares)} {cause}"
    return f"equations {', '.join(names)} of {len(shares)} repeat each other"


def _other_guess(dae: Dae) -> str:
    """Return the advice to give another initial guess; empty if the equations are linear."""
    if not ca.depends_on(ca.jacobian(dae.alg, dae.z), dae.z):
        return ""
    return f"give another initial guess, as start value of {dae.algebraics[0].name}, "


@cached_per_thread(8)
def _slope_function(dae: Dae) -> ca.Function:
    return ca.Function("slopes", dae.arguments, [ca.densify(ca.jacobian(dae.alg, dae.z))])


def _no_start(dae: Dae, t: float, x: Vector, values: Values) -> InitialConditionError:
    """Return the error for the rule without solution: not finite, or of the largest residual."""
    missing = [r for r in dae.start_rules if not np.isfinite(x[list(r.states)]).all()]
    implicit = [r for r in dae.start_rules if r.implicit]
    rule = missing[0] if missing else max(implicit, key=lambda r: _residual(dae, r, t, x, values))
    names = ", ".join(dae.states[i].name for i in rule.states)
    near = _closest(dae, rule, t, x, values) if rule.implicit else "its formula has no value"
    what = rule.meaning.removeprefix("the ").removesuffix(" hold")
    return InitialConditionError(
        f"{dae.full_name}: no start value of {names} satisfies the {what}; "
        f"{near}; change the other start values, parameters or inputs"
    )


def _residual(dae: Dae, rule: StartRule, t: float, x: Vector, values: Values) -> float:
    law = law_of_knowns(dae, "law", rule.expression)
    return float(ca.norm_inf(law(t, x, values.u, values.p)))


def _closest(dae: Dae, rule: StartRule, t: float, x: Vector, values: Values) -> str:
    """Describe the smallest residual of a rule near its guess; one unknown is scanned."""
    trial, first = x.copy(), rule.states[0]
    trial[list(rule.states)] = values.x[list(rule.states)]
    best, at = np.inf, float("nan")
    for shift in np.linspace(-np.pi, np.pi, 721) if len(rule.states) == 1 else (0.0,):
        trial[first] = values.x[first] + shift
        residual = _residual(dae, rule, t, trial, values)
        if residual < best:
            best, at = residual, trial[first]
    return (
        f"the closest found leaves a residual of {best:.3g} at {dae.states[first].name} = {at:.4g}"
    )


def input_values(dae: Dae, grid: Vector, values: Values, inputs: InputSeries | None) -> Vector:
    """Return every input at the output times, (nu, n); (nu, 1) where all are constant."""
    if inputs is None:
        return values.u[:, None]
    table = np.tile(values.u[:, None], len(grid))
    known = [variable.name for variable in dae.inputs]
    for name, row in zip(inputs.names, inputs.with_jumps_at(grid).at(grid), strict=True):
        table[known.index(name)] = row
    return table
