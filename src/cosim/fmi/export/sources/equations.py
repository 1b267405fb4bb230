"""C code of a DAE's equations, under the names that the runtime calls.

Every function follows CasADi's calling convention; fmu/runtime/equations.h declares them.
"""

import re
from itertools import accumulate
from math import log2

import casadi as ca
from casadi import MX, SX

from casadi_models.dae import Dae
from cosim.codegen.casadi_patches import differential_errors, run_time_tolerances
from cosim.codegen.externals import add_integrator, sources_beside
from cosim.codegen.functions import CALL, driven_equations, is_large
from cosim.codegen.initialization import algebraic_function, start_function
from cosim.fmi.export.solver_choice import DOP853, uses_dop853
from cosim.fmi.export.sources.rank import rank_functions
from cosim.fmi.export.sources.sensitivities import argument_like, sensitivity_functions
from cosim.fmi.export.sources.work import most_steps


def equations_code(dae: Dae, identifier: str, fmi: int, solver: str) -> str:
    """Return the generated C code of everything that the runtime calls.

    Args:
        dae: The model.
        identifier: What its inner names begin with.
        fmi: Version of FMI; FMI 3.0 has adjoint derivatives.
        solver: Of `CO_SIMULATION_SOLVERS`.
    """
    prefix = re.sub("__+", "_", f"{identifier}_equations")  # CasADi takes one _ at a time
    generator = ca.CodeGenerator(prefix, {"with_header": False, "indent": 1})
    for function in (
        start_function(dae),
        algebraic_function(dae),
        _plain_function(dae, "model_ode", dae.ode),
        _plain_function(dae, "model_outputs", dae.outputs, dae.margins),
        *rank_functions(dae),
        *sensitivity_functions(dae, adjoint=fmi == 3),
    ):
        generator.add(function)
    if not uses_dop853(dae, solver):
        add_integrator(generator, solver_step(dae, solver))
    code = str(generator.dump())
    if not dae.states or solver == DOP853:
        return code
    code = run_time_tolerances(code, "arg[2][2]", "0.01 * arg[2][2]")
    return differential_errors(code) if dae.algebraics else code


def embedded_sources(dae: Dae) -> dict[str, str]:
    """Return the C code of the libraries that a model calls, by file name; {} where it does not.

    Raises:
        UsageError: C code is not at hand.
    """
    laws = [dae.ode, dae.alg, dae.outputs, dae.margins]
    return sources_beside(ca.Function("laws", dae.arguments, laws), start_function(dae))


def _plain_function(dae: Dae, name: str, *expressions: SX) -> ca.Function:
    names = ["value", "margins"][: len(expressions)]
    return ca.Function(name, dae.arguments, [*expressions], CALL, names, {"cse": True})


def solver_step(dae: Dae, plugin: str) -> ca.Function:
    """Return `model_step(x, z, q) -> (x_end, z_end)`, the co-simulation solver.

    q = (t0, h, relative tolerance, u0, du, p): integrates over h with inputs u0 + s du, s from 0 to
    1, by CasADi's `erk` or `rosenbrock`. The states are scaled by their nominal values, so that one
    tolerance fits all of them.
    """
    x, z = argument_like(dae.x), argument_like(dae.z)
    parameters = MX.sym("q", 3 + 2 * dae.u.numel() + dae.p.numel())
    if not dae.states:  # nothing moves, and CasADi integrates nothing
        return ca.Function("model_step", [x, z, parameters], [x, z])
    # a power of two: scaling there and back changes no bit
    scale = ca.DM([2.0 ** round(log2(state.nominal)) for state in dae.states])
    problem = (_called if is_large(dae) else _written_out)(dae, scale)
    options = {"show_eval_warnings": False, "max_num_steps": most_steps(dae, plugin)}
    run = ca.integrator("run", plugin, problem, 0.0, [1.0], options)
    end = run(x0=x / scale, z0=z, p=parameters)
    return ca.Function("model_step", [x, z, parameters], [scale * end["xf"], end["zf"]])


def _written_out(dae: Dae, scale: ca.DM) -> dict[str, SX]:
    """Return what `solver_step` integrates as formulas, of which CasADi forms the Jacobian's."""
    s, scaled = SX.sym("s"), SX.sym("scaled", dae.x.numel())
    t0, h, rtol = SX.sym("t0"), SX.sym("h"), SX.sym("rtol")
    u0, du = SX.sym("u0", dae.u.numel()), SX.sym("du", dae.u.numel())
    q = ca.vertcat(t0, h, rtol, u0, du, dae.p)
    moving = [t0 + s * h, u0 + s * du, scale * scaled]
    ode, alg = ca.substitute([dae.ode, dae.alg], [dae.t, dae.u, dae.x], moving)
    return {"t": s, "x": scaled, "z": dae.z, "p": q, "ode": h * ode / scale, "alg": alg}


def _called(dae: Dae, scale: ca.DM) -> dict[str, MX]:
    """Return the same as a call of the equations, whose Jacobian is a loop over directions."""
    s, scaled, z = MX.sym("s"), MX.sym("scaled", dae.x.numel()), MX.sym("z", dae.z.numel())
    sizes = (1, 1, 1, dae.u.numel(), dae.u.numel(), dae.p.numel())
    q = MX.sym("q", sum(sizes))
    t0, h, _, u0, du, p = ca.vertsplit(q, [0, *accumulate(sizes)])
    ode, alg = driven_equations(dae)(t0 + s * h, scale * scaled, z, u0 + s * du, p)
    return {"t": s, "x": scaled, "z": z, "p": q, "ode": h * ode / scale, "alg": alg}
