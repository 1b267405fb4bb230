"""Impacts with restitution, and dry friction that sticks.

Source  Glocker, Set-Valued Force Laws, Springer 2001 (Newton's law for several contacts);
        Armstrong-Helouvry, Dupont & Canudas de Wit, Automatica 30 (1994) 1083-1138 (friction).
"""

from typing import Any

import casadi as ca
from casadi import SX

from casadi_models.dae import Model


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

    With the gap speeds g = W^T u, impulses P along W make g+ = -e g:  M (u+ - u) = W P. The kinetic
    energy does not grow for restitutions of 0 to 1; with several contacts, give all the same one.

    Args:
        model: The model.
        condition: When the contacts close, e.g. `height < 0`.
        speeds: The generalized speeds u, states of the model, (n, 1).
        mass: Their mass matrix M, (n, n).
        directions: W, the derivatives of the gap speeds by u, one column per contact, (n, k).
        restitution: e, 0 to 1; a number or a parameter.
        name: For messages and `Trajectory.events`.

    Raises:
        ValueError: The restitution is a number outside 0 to 1, or a shape does not fit.
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
    along = ca.solve(m, w)
    impulses = ca.solve(w.T @ along, -(1 + e) * (w.T @ speeds))
    after = ca.vertsplit(speeds + along @ impulses)
    model.when(condition, dict(zip(ca.vertsplit(speeds), after, strict=True)), name=name)


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
