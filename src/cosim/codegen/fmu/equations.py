"""Generated C code of an FMU's equations."""

import re
from collections.abc import Iterable, Sequence
from itertools import accumulate
from math import log2
from typing import Any

import casadi as ca
from casadi import MX, SX

from casadi_models.dae import Dae
from casadi_models.dae.hybrid import Hybrid
from casadi_models.dae.time_bounds import Enclosures, limit_enclosures
from cosim.codegen.casadi_library import add_integrator, sources_beside
from cosim.codegen.casadi_patches import patched
from cosim.codegen.fmu.derivatives import argument_like, sensitivity_formulas, sensitivity_functions
from cosim.codegen.fmu.solver import DOP853, ERK, FIXED_STEPS, LOOK_STEPS, most_steps, uses_dop853
from cosim.codegen.functions import CALL, Laws, driven_equations, hoisted, is_large
from cosim.codegen.hybrid_laws import law_functions
from cosim.codegen.initialization import knowns, prepared_algebraic, projection_step, start_function
from cosim.codegen.runge_kutta.tableau import Tableau
from cosim.memo import cached_per_thread

_CSE = {"cse": True}
LARGEST_SHARE = 5.0  # operations of the detector relative to those of the equations


@cached_per_thread(16)
def has_rank(dae: Dae) -> bool:
    """Tell whether the FMU of a model detects singular configurations.

    It does if multipliers enforce the constraints, the constraints are invariants of the motion,
    the model has the output `constraint_condition`, and that output is not too expensive, as it is
    with many loops.
    """
    if not (dae.states and dae.invariants and dae.has_conditioned_multipliers):
        return False
    distance = ca.Function("f", dae.arguments, [dae.distance_from_singularity], _CSE)
    return distance.n_instructions() <= LARGEST_SHARE * max(1, dae.operations())


def _rank_columns(dae: Dae) -> tuple[SX, SX]:
    """Return the distance from a singular configuration and its rate; empty without a detector."""
    if not has_rank(dae):
        return SX(0, 1), SX(0, 1)
    distance = dae.distance_from_singularity
    return distance, ca.jtimes(distance, ca.vertcat(dae.x, dae.t), ca.vertcat(dae.ode, 1))


def _rank_functions(laws: Laws) -> list[ca.Function]:
    """Return the functions that fmu/runtime/equations.h declares if HAS_RANK is 1, else none."""
    dae = laws.dae
    if not has_rank(dae):
        return []
    projection = projection_step(dae, dae.p.numel())
    known = [argument_like(symbol) for symbol in knowns(dae)]
    return [
        _plain_function(laws, "model_rank", laws.others["rank"]),
        _plain_function(laws, "model_rank_rate", laws.others["rank_rate"]),
        ca.Function("model_project", known, projection.call(known)),
    ]


@cached_per_thread(16)
def bounded_limits(dae: Dae, system: Hybrid | None) -> Enclosures:
    """Return the bounds of the margins of a model's limits over a part of a step."""
    return limit_enclosures(dae, len(system.relations) if system else 0)


@cached_per_thread(16)
def fmu_laws(dae: Dae, system: Hybrid | None, *, derivatives: bool, adjoint: bool) -> Laws:
    """Return the laws of a model with the constants that its FMU calculates once.

    Args:
        dae, system: The model as exported, and its events.
        derivatives, adjoint: See `model_functions`.
    """
    bounds = bounded_limits(dae, system)
    rank, rank_rate = _rank_columns(dae)
    columns = {"outputs": dae.outputs, "margins": dae.margins, "rank": rank, "rank_rate": rank_rate}
    if bounds.relations:
        columns["limits"] = bounds.low[::2]
        columns |= {"slowest": bounds.low[1::2], "fastest": bounds.high[1::2]}
    if derivatives:
        columns |= sensitivity_formulas(dae, adjoint=adjoint)
    return hoisted(dae, **columns)


def model_functions(
    laws: Laws, system: Hybrid | None, warnings: SX, *, derivatives: bool, adjoint: bool
) -> tuple[ca.Function, ...]:
    """Return the functions that fmu/runtime/equations.h declares, but for the solver's step.

    Args:
        laws: Those of `fmu_laws`, with the same derivatives.
        system: The events of the model.
        warnings: Expressions of parameters, which tell where they are not positive, (n, 1).
        derivatives, adjoint: Whether to include directional and adjoint derivatives.
    """
    dae, p = laws.dae, argument_like(laws.dae.p)
    return (
        ca.Function("model_constants", [p], [laws.constants(p)]),
        start_function(dae),
        prepared_algebraic(laws),
        _plain_function(laws, "model_ode", laws.ode),
        _plain_function(laws, "model_outputs", laws.others["outputs"], laws.others["margins"]),
        *_rank_functions(laws),
        *(sensitivity_functions(laws, adjoint=adjoint) if derivatives else []),
        *(law_functions(system) if system else []),
        *([ca.Function("model_warnings", [dae.p], [warnings])] if warnings.numel() else []),
        *_limit_functions(laws, bounded_limits(dae, system)),
    )


def _limit_functions(laws: Laws, bounds: Enclosures) -> list[ca.Function]:
    """Return the bounds of margins, and of their rates, which are seldom needed."""
    if not bounds.relations:
        return []
    given = [laws.dae.t, *bounds.given, laws.dae.u, laws.c]
    rates = [laws.others["slowest"], laws.others["fastest"]]
    return [
        ca.Function("model_limits", given, [laws.others["limits"]], _CSE),
        ca.Function("model_limit_rates", given, rates, _CSE),
    ]


def generated_code(
    laws: Laws, identifier: str, functions: Iterable[ca.Function], solver: str, *, has_events: bool
) -> str:
    """Return the C code of functions and of the solver's step.

    Args:
        laws: Those of the model as exported.
        identifier: C name of the model.
        functions: Those of `model_functions`.
        solver: Solver for co-simulation.
        has_events: Whether steps must be short enough to locate events.
    """
    dae = laws.dae
    prefix = re.sub("__+", "_", f"{identifier}_equations")  # CasADi takes one _ at a time
    generator = ca.CodeGenerator(prefix, {"with_header": False, "indent": 1})
    for function in functions:
        generator.add(function)
    if solver in FIXED_STEPS:
        generator.add(fixed_step(laws, FIXED_STEPS[solver]))
    elif not uses_dop853(dae, solver):
        add_integrator(generator, solver_step(laws, solver, has_events=has_events))
    code = str(generator.dump())
    if not dae.states or solver == DOP853 or solver in FIXED_STEPS:
        return code
    given = "arg[2][2]"
    code = patched(code, "run_time_tolerances", relative=given, absolute=f"0.01 * {given}")
    if solver != ERK:  # which solves no linear equations
        code = patched(code, "underflow")
    return patched(code, "differential_errors") if dae.algebraics else code


def embedded_sources(dae: Dae) -> dict[str, str]:
    """Return the C code of the external functions that a model calls, by file name.

    Raises:
        UsageError: C code is missing.
    """
    laws = [dae.ode, dae.alg, dae.outputs, dae.margins]
    return sources_beside(ca.Function("laws", dae.arguments, laws), start_function(dae))


def _plain_function(laws: Laws, name: str, *expressions: SX) -> ca.Function:
    names = ["value", "margins"][: len(expressions)]
    return ca.Function(name, laws.arguments, [*expressions], CALL, names, _CSE)


def solver_step(laws: Laws, plugin: str, *, has_events: bool = False) -> ca.Function:
    """Return `model_step(x, z, q) -> (x_end, z_end)`, a step of the co-simulation solver.

    With q = (t0, h, relative tolerance, u0, u1, u2, u3, c), CasADi's `erk` or `rosenbrock`
    integrates over h with inputs u0 + u1 s + u2 s^2 + u3 s^3, s from 0 to 1. The states are scaled
    by their nominal values, so that one tolerance fits all of them. `has_events` limits the steps.
    """
    dae = laws.dae
    x, z = argument_like(dae.x), argument_like(dae.z)
    parameters, _ = _parameters(laws)
    if not dae.states:  # CasADi needs at least one state
        return ca.Function("model_step", [x, z, parameters], [x, z])
    # powers of two, so that scaling does not round
    scale = ca.DM([2.0 ** round(log2(state.nominal)) for state in dae.states])
    problem = (_called if is_large(dae) else _written_out)(laws, scale)
    most = LOOK_STEPS if has_events else most_steps(dae, plugin)
    options = {"show_eval_warnings": False, "max_num_steps": most}
    run = ca.integrator("run", plugin, problem, 0.0, [1.0], options)
    end = run(x0=x / scale, z0=z, p=parameters)
    return ca.Function("model_step", [x, z, parameters], [scale * end["xf"], end["zf"]])


def fixed_step(laws: Laws, method: Tableau) -> ca.Function:
    """Return `model_step(x, z, q) -> (x_end, z, slopes)`, a step of an explicit Runge-Kutta method.

    See `solver_step` for q; the slopes are those of its stages. The algebraic unknowns are solved
    for in every stage.
    """
    x, guess = argument_like(laws.dae.x), argument_like(laws.dae.z)
    q, (t0, h, _, *u, c) = _parameters(laws)
    law = ca.Function("law", laws.arguments, [laws.ode], _CSE)
    solve, z = prepared_algebraic(laws), guess
    slopes: list[MX] = []

    def slope(t: MX, state: MX) -> MX:
        nonlocal z
        inputs = _polynomial(u, (t - t0) / h)
        if laws.dae.algebraics:
            z = solve(t, state, z, inputs, c)
        slopes.append(law(t, state, z, inputs, c))
        return slopes[-1]

    end = x + method.change(slope, t0, x, h)
    return ca.Function("model_step", [x, guess, q], [end, z, ca.vertcat(*slopes)])


def _written_out(laws: Laws, scale: ca.DM) -> dict[str, SX]:
    """Return the problem of `solver_step` as formulas, which CasADi differentiates."""
    dae = laws.dae
    s, scaled = SX.sym("s"), SX.sym("scaled", dae.x.numel())
    t0, h, rtol = SX.sym("t0"), SX.sym("h"), SX.sym("rtol")
    u = [SX.sym(f"u{order}", dae.u.numel()) for order in range(4)]
    q = ca.vertcat(t0, h, rtol, *u, laws.c)
    moving = [t0 + s * h, _polynomial(u, s), scale * scaled]
    ode, alg = ca.substitute([laws.ode, laws.alg], [dae.t, dae.u, dae.x], moving)
    return {"t": s, "x": scaled, "z": dae.z, "p": q, "ode": h * ode / scale, "alg": alg}


def _called(laws: Laws, scale: ca.DM) -> dict[str, MX]:
    """Return the same problem as a call of the equations, whose Jacobian is a loop."""
    dae = laws.dae
    s, scaled, z = MX.sym("s"), MX.sym("scaled", dae.x.numel()), MX.sym("z", dae.z.numel())
    q, (t0, h, _, *u, c) = _parameters(laws)
    ode, alg = driven_equations(laws)(t0 + s * h, scale * scaled, z, _polynomial(u, s), c)
    return {"t": s, "x": scaled, "z": z, "p": q, "ode": h * ode / scale, "alg": alg}


def _parameters(laws: Laws) -> tuple[MX, list[MX]]:
    """Return q of `solver_step` as one symbol, and its parts."""
    sizes = (1, 1, 1, *4 * [laws.dae.u.numel()], laws.c.numel())
    q = MX.sym("q", sum(sizes))
    return q, ca.vertsplit(q, [0, *accumulate(sizes)])


def _polynomial(coefficients: Sequence[Any], s: Any) -> Any:
    u0, u1, u2, u3 = coefficients
    return u0 + s * (u1 + s * (u2 + s * u3))
