"""Impacts with restitution, and dry friction that sticks.

Source  Glocker, Set-Valued Force Laws, Springer 2001 (Newton's law for several contacts);
        Armstrong-Helouvry, Dupont & Canudas de Wit, Automatica 30 (1994) 1083-1138 (friction).
"""

from itertools import combinations
from typing import Any

import casadi as ca
from casadi import SX

from casadi_models.dae import Model

__all__ = ["friction", "friction_in_plane", "impact"]

# of the speeds' nominal values; a gap that closes faster does so not by rounding of an impact
_CLOSING = 1e-12
_MOST_CONTACTS = 6  # of one impact, whose sets of pushing contacts are tried one by one
_NEVER_ZERO = 1e-100  # m/s or N; below every velocity and force, and its square is not zero
_BACKWARD = 1e-3  # of the slow speed; at this speed backward, sliding has ended


def impact(
    model: Model,
    condition: Any,
    speeds: SX,
    mass: Any,
    directions: Any,
    restitution: Any,
    *,
    name: str = "impact",
) -> None:
    """Declare the event at which contacts close: speeds jump by Newton's law.

    With the gap speeds g = W^T u, impulses P along W make g+ = -e g:  M (u+ - u) = W P. They push:
    a contact that opens faster than that has none (P >= 0, g+ + e g >= 0, one of them 0). The
    kinetic energy does not grow for restitutions of 0 to 1; with several contacts, give all the
    same one.
    Nothing holds bodies together: one that comes to rest under a load ends the run (Zeno).

    Args:
        model: The model.
        condition: When the contacts close, e.g. `height < 0`.
        speeds: The generalized speeds u, states of the model, (n, 1); contacts that close slower
            than 1e-12 of the largest nominal value are at rest.
        mass: Their mass matrix M, (n, n).
        directions: W, the derivatives of the gap speeds by u, one column per contact, (n, k).
        restitution: e, 0 to 1; a number, a parameter, which gets these bounds, or an expression,
            for which an impact is an error if it is outside.
        name: For messages and `Trajectory.events`.

    Raises:
        ValueError: The restitution is a number outside 0 to 1, a shape does not fit, or there are
            more than 6 contacts.
    """
    e, m, w = SX(restitution), SX(mass), SX(directions)
    n = speeds.numel()
    if e.is_constant() and not 0 <= float(e) <= 1:
        raise ValueError(f"'{name}': restitution {float(e)} is not within 0 to 1")
    if m.shape != (n, n) or w.size1() != n:
        raise ValueError(
            f"'{name}': {n} speeds, but a mass matrix of shape {m.shape} and directions of shape "
            f"{w.shape}; give ({n}, {n}) and ({n}, contacts)"
        )
    known = e.is_constant() or model.bound(e, 0.0, 1.0)
    wrong = SX(0) if known else ca.floor(ca.sqrt(e * (1 - e)))  # 0 within 0 to 1, else no number
    if w.size2() > _MOST_CONTACTS:
        raise ValueError(
            f"'{name}': {w.size2()} contacts; an impact has at most {_MOST_CONTACTS} at once, so "
            "declare one for each group of contacts that close together"
        )
    along = ca.solve(m, w)
    impulses = _pushing(w.T @ along, (1 + e) * (w.T @ speeds)) + wrong
    least = _CLOSING * max(variable.nominal for variable in model.declared(speeds))
    closes = ca.logic_and(condition, ca.mmin(w.T @ speeds) < -least)
    model.when(closes, _values(speeds, speeds + along @ impulses), name=name)


def _pushing(matrix: SX, offset: SX) -> SX:
    """Return P with P >= 0, r = matrix P + offset >= 0, and P_i r_i = 0.

    The solution is unique, as the matrix is positive definite: of the sets of contacts that push,
    the one that violates the inequalities least.
    """
    k = offset.numel()
    found, least = SX.zeros(k), ca.fmax(0, ca.mmax(-offset))
    for size in range(1, k + 1):
        for chosen in combinations(range(k), size):
            rows, others = list(chosen), [i for i in range(k) if i not in chosen]
            impulses = SX.zeros(k)
            impulses[rows] = ca.solve(matrix[rows, rows], -offset[rows])
            left = (matrix @ impulses + offset)[others]
            violated = ca.mmax(ca.vertcat(0, -impulses[rows], -left))
            found = ca.if_else(violated < least, impulses, found)
            least = ca.fmin(violated, least)
    return found


def friction(
    speed: SX, normal: Any, sliding: Any, *, sticking: Any = None, decay: Any = 1e-3
) -> SX:
    """Return the force, or moment, of dry friction on a body that slides at a speed.

    At speed 0 the body sticks until the load exceeds the largest sticking force; as its sign is
    a relation, the solution then rests exactly.

    Args:
        speed: Sliding speed, a state or an expression of states, m/s or rad/s.
        normal: Normal force, or its moment at 1, N or N.m; not negative.
        sliding: Coefficient of sliding friction (1).
        sticking: Coefficient at rest (1); that of sliding when None.
        decay: Speed over which the coefficient falls from sticking to sliding (Stribeck).
    """
    coefficient = SX(sliding)
    if sticking is not None:
        coefficient += (SX(sticking) - sliding) * ca.exp(-((speed / decay) ** 2))
    return SX(-coefficient * normal * ca.sign(speed))


def friction_in_plane(  # noqa: PLR0913 (a contact's data, four of them with defaults)
    model: Model,
    speeds: SX,
    mass: Any,
    velocity: Any,
    load: Any,
    normal: Any,
    sliding: Any,
    *,
    sticking: Any = None,
    bias: Any = 0.0,
    slow_speed: Any = 1e-7,
    name: str = "friction",
) -> SX:
    """Return the force of dry friction in a plane (or along a line); it sticks and slides.

    Sliding, the force opposes the velocity. When the velocity becomes zero, the contact sticks: the
    force is the one that keeps the velocity zero, until it would exceed the largest sticking force.
    The equations of motion are then M u' = load + W F, with W^T the derivative of the velocity by
    u. This declares discrete variables and events, whose names begin with `name`.

    Args:
        model: The model.
        speeds: The generalized speeds u, states of the model, (n, 1).
        mass: Their mass matrix M, (n, n).
        velocity: Of the sliding point against the surface, linear in u, (k, 1), m/s.
        load: The other generalized forces, (n, 1).
        normal: Normal force, N; not negative, and not a function of the friction.
        sliding: Coefficient of sliding friction (1).
        sticking: Coefficient at rest (1), at least that of sliding, which it is when None.
        bias: Rate of the velocity while the speeds are constant, (k, 1), m/s2.
        slow_speed: Speed below which the direction of sliding counts as constant, m/s; if the path
            is curved, the time of rest is wrong by up to this speed over the deceleration.
        name: For messages, `Trajectory.events` and the discrete variables.

    Raises:
        ValueError: A shape does not fit.
    """
    v, m, f = SX(velocity), SX(mass), SX(load)
    n, k = speeds.numel(), v.numel()
    if m.shape != (n, n) or f.shape != (n, 1):
        raise ValueError(
            f"'{name}': {n} speeds, but a mass matrix of shape {m.shape} and loads of shape "
            f"{f.shape}; give ({n}, {n}) and ({n}, 1)"
        )
    w = ca.jacobian(v, speeds).T
    along = ca.solve(m, w)
    apparent = w.T @ along
    holding = -ca.solve(apparent, along.T @ f + bias)
    most = SX(sliding if sticking is None else sticking) * normal
    held = ca.sumsqr(holding)
    excess = held / (held + most**2 + _NEVER_ZERO**2) - 0.5  # without unit: forces may be tiny

    sticks = model.discrete(f"{name}_sticks", "1", 0.0, "1 if the contact sticks, else 0")
    slow = model.discrete(
        f"{name}_slow", "1", 0.0, "1 if it slides in a constant direction, else 0"
    )
    meaning = "direction of slow sliding, within 45 deg of that of fast sliding"
    d = ca.vertcat(*(model.discrete(f"{name}_{i + 1}", "1", 0.0, meaning) for i in range(k)))
    size = ca.sumsqr(v) / SX(slow_speed) ** 2
    at_rest = size <= 0
    starts = ca.vertcat(ca.logic_and(at_rest, excess <= 0), size <= 1)
    model.start(ca.vertcat(sticks, slow), starts, f"{name}: mode")
    model.start(d, ca.if_else(at_rest, -_direction(holding), _direction(v)), f"{name}: direction")

    # v/|v| is singular where sliding ends. Written by its slant to d, it is even in v, so constant
    # on a straight path to rest and beyond, where solvers step before they know of the event. From
    # 80 deg on, which is never reached, the slant goes to zero, to be smooth.
    ahead = ca.dot(v, d)
    aside = v - ahead * d
    slant = aside * ahead / (ahead**2 + SX(slow_speed) ** 2)
    slant /= 1 + (ca.sumsqr(slant) / 100) ** 8
    fast = (d + slant) / ca.sqrt(1 + ca.sumsqr(slant))
    turned = (ca.sumsqr(aside) - ahead**2) / SX(slow_speed) ** 2 - 1
    new = {**_values(speeds, speeds - along @ ca.solve(apparent, v)), sticks: 1, slow: 1}
    model.when(ahead + sticks < -_BACKWARD * SX(slow_speed), new, name=f"{name} sticks")
    new = {**_values(d, -_direction(holding)), sticks: 0}
    model.when(sticks * (excess + 1) - 1 > 0, new, name=f"{name} slides")
    new = _values(d, _direction(v))
    model.when(size - 1 + 2 * slow < 0, {**new, slow: 1}, name=f"{name} slows down")
    model.when(slow * (size - 3) - 1 > 0, {**new, slow: 0}, name=f"{name} speeds up")
    model.when((1 - slow) * (turned + 1) - 1 > 0, new, name=f"{name} turns by 45 deg")
    opposed = -SX(sliding) * normal * (slow * d + (1 - slow) * fast)
    return SX(sticks * holding + (1 - sticks) * opposed)


def _direction(vector: SX) -> SX:
    """Return the unit vector; zero for zero."""
    return SX(vector / (ca.norm_2(vector) + _NEVER_ZERO))


def _values(states: SX, column: SX) -> dict[SX, Any]:
    """Return new values by state."""
    return dict(zip(ca.vertsplit(states), ca.vertsplit(column), strict=True))
