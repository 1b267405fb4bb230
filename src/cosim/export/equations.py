"""C code of a DAE's equations, under the names that the runtime calls.

Every function follows CasADi's calling convention; fmu/runtime/equations.h declares them.
"""

import casadi as ca
from casadi import MX, SX

from casadi_models.dae import Dae
from cosim.consistent import algebraic_function, start_function
from cosim.generated import run_time_tolerances

_CALL = ["t", "x", "z", "u", "p"]


def equations_code(dae: Dae) -> str:
    """Return the generated C code of everything that the runtime calls."""
    generator = ca.CodeGenerator("equations", {"with_header": False, "indent": 1})
    for function in (
        start_function(dae),
        algebraic_function(dae),
        _plain(dae, "model_ode", dae.ode),
        _plain(dae, "model_outputs", dae.outputs),
        directional_function(dae),
        adjoint_function(dae),
        step_function(dae),
    ):
        generator.add(function)
    return run_time_tolerances(str(generator.dump()), "arg[2][2]", "0.01 * arg[2][2]")


def _plain(dae: Dae, name: str, expression: SX) -> ca.Function:
    symbols = [dae.t, dae.x, dae.z, dae.u, dae.p]
    return ca.Function(name, symbols, [expression], _CALL, ["value"], {"cse": True})


def directional_function(dae: Dae) -> ca.Function:
    """Return `model_directional(t, x, z, u, p, seed_x, seed_u, seed_p)`.

    Its results are the derivatives of dx/dt, z and the outputs along the seeds, the algebraic
    unknowns following the implicit function theorem.
    """
    known = [dae.x, dae.u, dae.p]
    seeds = [SX.sym(f"seed_{n}", v.numel()) for n, v in zip("xup", known, strict=True)]
    along_known = ca.vertcat(*seeds)
    seed_z = SX.sym("seed_z", dae.z.numel())
    call = [dae.t, dae.x, dae.z, dae.u, dae.p]
    everything = ca.vertcat(*known)
    alg = ca.jtimes(dae.alg, everything, along_known)
    slope = ca.jacobian(dae.alg, dae.z)
    implicit = ca.Function("implicit", [*call, *seeds], [slope, -alg], {"cse": True})
    along = ca.vertcat(along_known, seed_z)
    variables = ca.vertcat(everything, dae.z)
    explicit = ca.Function(
        "explicit",
        [*call, *seeds, seed_z],
        [ca.jtimes(e, variables, along) for e in (dae.ode, dae.outputs)],
        {"cse": True},
    )
    arguments = [_like(s) for s in (*call, *seeds)]
    matrix, right = implicit(*arguments)
    sens_z = ca.solve(matrix, right, "qr") if dae.algebraics else MX(0, 1)
    sens_ode, sens_outputs = explicit(*arguments, sens_z)
    return ca.Function("model_directional", arguments, [sens_ode, sens_z, sens_outputs])


def adjoint_function(dae: Dae) -> ca.Function:
    """Return `model_adjoint(t, x, z, u, p, seed_dx, seed_z, seed_y)`.

    Its results are the gradients of the seeded sum with respect to states, inputs, parameters.
    """
    call = [dae.t, dae.x, dae.z, dae.u, dae.p]
    results = [dae.ode, dae.z, dae.outputs]
    seeds = [SX.sym(f"seed_{n}", r.numel()) for n, r in zip(("dx", "z", "y"), results, strict=True)]
    weight = SX.sym("weight", dae.z.numel())
    seeded = ca.vertcat(dae.ode, dae.outputs)
    seed = ca.vertcat(seeds[0], seeds[2])
    on_z = ca.jtimes(seeded, dae.z, seed, True) + seeds[1]
    slope = ca.jacobian(dae.alg, dae.z)
    implicit = ca.Function("implicit_adj", [*call, *seeds], [slope.T, -on_z], {"cse": True})
    explicit = ca.Function(
        "explicit_adj",
        [*call, *seeds, weight],
        [
            ca.jtimes(ca.vertcat(seeded, dae.alg), v, ca.vertcat(seed, weight), True)
            for v in (dae.x, dae.u, dae.p)
        ],
        {"cse": True},
    )
    arguments = [_like(s) for s in (*call, *seeds)]
    matrix, right = implicit(*arguments)
    solved = ca.solve(matrix, right, "qr") if dae.algebraics else MX(0, 1)
    gradients = list(explicit(*arguments, solved))
    return ca.Function("model_adjoint", arguments, gradients)


def step_function(dae: Dae) -> ca.Function:
    """Return `model_step(x, z, q, ...) -> (x_end, z_end, ...)`, the co-simulation solver.

    q = (t0, h, relative tolerance, u0, du, p): integrates over h with inputs u0 + s du, s from 0 to
    1, by CasADi's `erk`, or `rosenbrock` where there are algebraic unknowns.
    """
    s = SX.sym("s")
    t0, h, rtol = SX.sym("t0"), SX.sym("h"), SX.sym("rtol")
    u0, du = SX.sym("u0", dae.u.numel()), SX.sym("du", dae.u.numel())
    ode, alg = ca.substitute([dae.ode, dae.alg], [dae.t, dae.u], [t0 + s * h, u0 + s * du])
    problem = {
        "t": s,
        "x": dae.x,
        "z": dae.z,
        "p": ca.vertcat(t0, h, rtol, u0, du, dae.p),
        "ode": h * ode,
        "alg": alg,
    }
    plugin = "rosenbrock" if dae.algebraics else "erk"
    options = {"show_eval_warnings": False}
    return ca.integrator("model_step", plugin, problem, 0.0, [1.0], options)


def _like(symbol: SX) -> MX:
    return MX.sym("argument", symbol.sparsity())
