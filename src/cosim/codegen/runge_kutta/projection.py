"""Coordinate projection: the smallest change of a state that makes its invariants vanish.

Sources  Eich, SIAM J. Numer. Anal. 30, 1993, 1467-1482 (convergence).
         Hairer & Wanner, Solving Ordinary Differential Equations II, 2nd ed. 1996, section VII.2.
"""

import casadi as ca
from casadi import SX

from casadi_models.dae import Dae
from cosim.codegen.initialization import law_of_knowns


def projection_step(dae: Dae, constants: int) -> ca.Function:
    """Return `project(t, x, u, c) -> (x, change)`, a Newton step on each invariant in its order.

    Each step moves the invariant's states by the least sum of squares, in its sizes; `change` is
    the largest of these moves. Later invariants are evaluated where earlier ones have moved to.

    Args:
        dae: A model with invariants.
        constants: Size of c, which begins with the parameters.
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
