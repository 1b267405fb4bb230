"""Chains of slender links with crossed hinges, by the articulated-body recursion."""

import casadi as ca
from casadi import SX

from casadi_models.mechanics import rotations
from casadi_models.mechanics.articulated import Link, accelerations


def crossed_chain(n: int) -> ca.Function:
    """Return `chain(q, u)`, the accelerations of n links under gravity."""
    q, u = SX.sym("q", n), SX.sym("u", n)
    links = [
        Link(
            i - 1,
            SX([0, 0, -1.0 if i else 0.0]),
            rotations.about(1 + i % 2, q[i]),
            rotations.unit(1 + i % 2),
            1.0,
            SX([0, 0, -0.5]),
            ca.diag(SX([1 / 12, 1 / 12, 0.01])),
        )
        for i in range(n)
    ]
    law = accelerations(links, u, SX(n, 1), SX([0, 0, -9.81]))
    return ca.Function("chain", [q, u], [law], {"cse": True})
