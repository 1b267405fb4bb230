"""Derivatives of integrators: variational equations, chained over the output times.

CasADi cannot differentiate a library. Its reverse mode through SUNDIALS leaves adjoint quadratures
out of the error control (casadi/casadi#4383); its forward mode through SUNDIALS gives up where
sensitivities begin at 0, and through Runge-Kutta methods it leaves them all out of the error
control. Here the Jacobian of a run is made of those from one output time to the next, each one
integrated with its error under control; CasADi uses it for forward and reverse products alike.
"""

import casadi as ca
import numpy as np
from casadi import MX

from casadi_models.dae import Dae
from cosim.codegen.runge_kutta.explicit_library import (
    dop853_method,
    explicit_function,
    explicit_library,
    fixed_step_method,
)
from cosim.codegen.variational import directions, variational_rhs
from cosim.integrate.engine import Problem
from cosim.integrate.families.explicit import Dop853
from cosim.integrate.families.fixed_step import FixedStep
from cosim.integrate.families.plugin import COMMON, tolerances
from cosim.integrate.solver import AdaptiveSolver, Solver

MOST_JACOBIAN_NUMBERS = 3_000_000  # in the Jacobian of a whole run
FEW_EQUATIONS = 150  # for which an implicit method is worth its linear equations, interpreted


def size_of_jacobian(dae: Dae, points: int) -> int:
    """Return how many numbers the Jacobian of a run has."""
    known = dae.x.numel() + dae.p.numel() + points * dae.u.numel()
    return int(points * (dae.x.numel() + dae.z.numel()) * known)


def jacobian_of_run(problem: Problem, solver: Solver) -> ca.Function:
    """Return the Jacobian of an integrator's function, as CasADi's `custom_jacobian` takes it.

    Compiled, it is that of the same steps for a solver with fixed ones, else of `dop853` at the
    tolerances of the solver; interpreted, of `erk`, or of `rosenbrock` where a solver for what is
    stiff has few equations.
    """
    dae, grid = problem.dae, problem.grid
    interval = (_compiled if problem.compiled else _interpreted)(problem, solver)
    nx, nz, n = dae.x.numel(), dae.z.numel(), len(grid)
    np_, nu = dae.p.numel(), dae.u.numel()
    x0, z0, p = MX.sym("x0", nx), MX.sym("z0", nz), MX.sym("p", np_)
    u = MX.sym("u", nu, n)
    by_x0, by_p, by_u = MX.eye(nx), MX(nx, np_), MX(nx, nu * n)
    state: list[tuple[MX, MX, MX]] = [(by_x0, by_p, by_u)]
    unknown: list[tuple[MX, MX, MX]] = []
    x = x0
    for k in range(1, n):
        x, first, slopes, moved = interval(x, z0, p, u[:, k], grid[k - 1], grid[k])
        before, column = state[-1], (MX(nx, nu * k), MX(nx, nu * (n - 1 - k)))
        if k == 1:
            unknown.append(_chained(first, before, (MX(nz, nu * k), MX(nz, nu * (n - 2))), nx, np_))
        unknown.append(_chained(moved, before, (MX(nz, nu * k), MX(nz, nu * (n - 1 - k))), nx, np_))
        state.append(_chained(slopes, before, column, nx, np_))
    blocks = []
    for rows, size in ((state, nx), (unknown, nz)):
        to_x0, to_p, to_u = (ca.vertcat(*block) for block in zip(*rows, strict=True))
        blocks += [to_x0, MX(size * n, nz), to_p, to_u]
    arguments = {"x0": x0, "z0": z0, "p": p, "u": u}
    results = {"out_xf": MX.sym("out_xf", nx, n), "out_zf": MX.sym("out_zf", nz, n)}
    return ca.Function(
        "jac_integrator",
        [*arguments.values(), *results.values()],
        blocks,
        [*arguments, *results],
        [f"jac_{of}_{by}" for of in ("xf", "zf") for by in arguments],
    )


def _chained(
    slopes: MX, before: tuple[MX, MX, MX], around: tuple[MX, MX], nx: int, np_: int
) -> tuple[MX, MX, MX]:
    """Return derivatives with respect to start, p and all inputs, from those over one interval."""
    by_x, by_p, by_u = ca.horzsplit(slopes, [0, nx, nx + np_, slopes.size2()])
    own = ca.horzcat(around[0], by_u, around[1])
    return by_x @ before[0], by_x @ before[1] + by_p, by_x @ before[2] + own


def _compiled(problem: Problem, solver: Solver) -> ca.Function:
    """Return `interval(x, z, p, u, begin, end) -> (x, Z at the begin, S, Z)`, see `variational`."""
    dae = problem.dae
    name, method, settings = Dop853.name, dop853_method(), (0.0, 0.0, np.inf)
    if isinstance(solver, FixedStep):
        name, method = solver.name, fixed_step_method(solver.tableau)
        settings = (0.0, 0.0, solver.step(problem))
    elif isinstance(solver, AdaptiveSolver):
        settings = (*solver.tolerance.pair, np.inf)
    path = explicit_library(variational_rhs(dae), f"variational {name}", method)
    run, _ = explicit_function(path, 2)
    arguments = x, z, p, u, begin, end = _arguments(dae)
    own = ca.vertcat(p, 2, 0, 1, *settings, ca.DM.ones(run.size1_in("x0")), begin, end)
    inputs = {"u": u} if dae.inputs else {}
    found = run(x0=_start(dae, x), z0=_guess(dae, z), p=own, **inputs)
    unknown = found["zf"]
    results = _results(dae, found["xf"][:, 1], unknown[:, 0], unknown[:, 1])
    return ca.Function("interval", arguments, results)


def _interpreted(problem: Problem, solver: Solver) -> ca.Function:
    """Return what `_compiled` does."""
    dae = problem.dae
    assert isinstance(solver, AdaptiveSolver)  # fixed steps are differentiated by CasADi
    rhs = variational_rhs(dae)
    stiff = solver.uses_jacobian and rhs.numel_in(1) <= FEW_EQUATIONS
    s, every = MX.sym("s"), MX.sym("x", rhs.numel_in(1))
    arguments = x, z, p, u, begin, end = _arguments(dae)
    own = MX.sym("own", z.numel() + p.numel() + u.numel() + 2)
    guess, numbers, inputs, span = ca.vertsplit(
        own, np.cumsum([0, z.numel(), p.numel(), u.numel(), 2]).tolist()
    )
    rates, _ = rhs(span[0] + span[1] * s, every, _guess(dae, guess), inputs, numbers)
    system = {"t": s, "x": every, "p": own, "ode": span[1] * rates}
    options = COMMON | tolerances(solver)
    run = ca.integrator("run", "rosenbrock" if stiff else "erk", system, 0, 1, options)
    start = _start(dae, x)
    last = run(x0=start, p=ca.vertcat(z, p, u, begin, end - begin))["xf"]
    unknown = [rhs(t, at, _guess(dae, z), u, p)[1] for t, at in ((begin, start), (end, last))]
    return ca.Function("interval", arguments, _results(dae, last, *unknown))


def _arguments(dae: Dae) -> list[MX]:
    sizes = {"x": dae.x, "z": dae.z, "p": dae.p, "u": dae.u, "begin": dae.t, "end": dae.t}
    return [MX.sym(name, symbol.numel()) for name, symbol in sizes.items()]


def _start(dae: Dae, x: MX) -> MX:
    """Return x beside its derivatives at the begin of an interval."""
    nx, nq = dae.x.numel(), directions(dae)
    return ca.vertcat(x, ca.vec(ca.horzcat(ca.DM.eye(nx), ca.DM.zeros(nx, nq - nx))))


def _guess(dae: Dae, z: MX) -> MX:
    return ca.vertcat(z, ca.DM.zeros(dae.z.numel() * directions(dae)))


def _results(dae: Dae, last: MX, before: MX, after: MX) -> list[MX]:
    nx, nz, nq = dae.x.numel(), dae.z.numel(), directions(dae)
    moved = [ca.reshape(unknown[nz:], nz, nq) for unknown in (before, after)]
    return [last[:nx], moved[0], ca.reshape(last[nx:], nx, nq), moved[1]]
