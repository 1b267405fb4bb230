"""Variational equations: how a solution moves with its start, the parameters and the inputs.

    x' = f(t, x, z, u, p)    S' = f_x S + f_z Z + [0 f_p f_u]
    0 = g(t, x, z, u, p)     0 = g_x S + g_z Z + [0 g_p g_u]

S and Z are the derivatives of x and z with respect to (start, p, u), S = [1 0 0] at the start.
"""

import casadi as ca
from casadi import MX

from casadi_models.dae import Dae
from cosim.codegen.functions import CALL, equations, symbols_like
from cosim.codegen.initialization import algebraic_function
from cosim.memo import kept_per_thread


def directions(dae: Dae) -> int:
    """Return how many derivatives each unknown has."""
    return int(dae.x.numel() + dae.p.numel() + dae.u.numel())


@kept_per_thread(16)
def variational_rhs(dae: Dae) -> ca.Function:
    """Return `rhs(t, X, Z, u, p) -> (dX/dt, Z)`, X = (x, S) and Z = (z, dz/d(start, p, u)) stacked.

    Of the given Z, a guess, z alone is used.
    """
    nx, nz, nq = dae.x.numel(), dae.z.numel(), directions(dae)
    t, _, _, u, p = symbols_like(dae)
    every, guess = MX.sym("x", nx * (1 + nq)), MX.sym("z", nz * (1 + nq))
    x, slopes = every[:nx], ca.reshape(every[nx:], nx, nq)
    z = algebraic_function(dae)(t, x, guess[:nz], u, p)
    function = equations(dae)
    ode, alg = function(t, x, z, u, p)
    by = function.jacobian()(t, x, z, u, p, ode, alg)
    ode_by, alg_by = dict(zip(CALL, by[:5], strict=True)), dict(zip(CALL, by[5:], strict=True))
    none = MX(nx, nx)
    rates = ode_by["x"] @ slopes + ca.horzcat(none, ode_by["p"], ode_by["u"])
    moved = MX(0, nq)
    if nz:
        own = ca.horzcat(MX(nz, nx), alg_by["p"], alg_by["u"])
        moved = -ca.solve(alg_by["z"], alg_by["x"] @ slopes + own, "qr")
        rates += ode_by["z"] @ moved
    stacked = [ca.vertcat(ode, ca.vec(rates)), ca.vertcat(z, ca.vec(moved))]
    dense = [ca.densify(column) for column in stacked]
    return ca.Function("rhs", [t, every, guess, u, p], dense)
