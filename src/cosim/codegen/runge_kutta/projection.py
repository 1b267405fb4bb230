"""Coordinate projection: the smallest change of a state that makes its invariants vanish.

Sources  Eich, SIAM J. Numer. Anal. 30, 1993, 1467-1482 (convergence).
         Hairer & Wanner, Solving Ordinary Differential Equations II, 2nd ed. 1996, section VII.2.
"""

import casadi as ca
from casadi import SX

from casadi_models.dae import Dae


def projection_step(dae: Dae, constants: int) -> ca.Function:
    """Return `project(x, c) -> (x, change)`, one Newton step on every invariant in its order.

    Each step moves the invariant's states by the least sum of squares, in its sizes; `change` is
    the largest of these moves. Later invariants are evaluated where earlier ones have moved to.

    Args:
        dae: A model with invariants.
        constants: Size of c, which begins with the parameters.
    """
    x, c = SX.sym("x", dae.x.numel()), SX.sym("c", constants)
    p = c[: dae.p.numel()]
    here, change = SX(x), SX(0)
    for invariant in dae.invariants:
        rows = list(invariant.states)
        slopes = ca.jacobian(invariant.residual, dae.x[rows])
        law = ca.Function("law", [dae.x, dae.p], [invariant.residual, slopes, invariant.sizes])
        residual, slopes, sizes = law(here, p)
        scaled = slopes @ ca.diag(sizes)
        multiplier = ca.ldl_solve(residual, *ca.ldl(ca.triu2symm(ca.triu(scaled @ scaled.T))))
        move = -scaled.T @ multiplier
        here[rows] += sizes * move
        change = ca.fmax(change, ca.norm_inf(move))
    options = {"cse": True}
    return ca.Function("project", [x, c], [here, change], ["x", "c"], ["moved", "change"], options)
