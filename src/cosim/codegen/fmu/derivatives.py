"""Analytic directional and adjoint derivatives of a DAE's equations, for C code.

Algebraic unknowns and implicit start values follow the implicit function theorem.
"""

from collections.abc import Mapping
from typing import NamedTuple

import casadi as ca
from casadi import MX, SX

from casadi_models.dae import Dae, StartRule
from casadi_models.dae.expressions import implicit_change, linear_solution
from cosim.codegen.functions import Laws, derivative_along, is_large, jacobian_in_a_loop
from cosim.codegen.initialization import knowns
from cosim.memo import cached_per_thread


class Formulas(NamedTuple):
    """Expressions of t, x, z, u, p and of seeds.

    Attributes:
        name: Of the function that evaluates them.
        seeds: Symbols.
        results: The expressions.
    """

    name: str
    seeds: list[SX]
    results: list[SX]

    @property
    def named(self) -> Mapping[str, SX]:
        """The seeds and the expressions by names of their own."""
        columns = [*self.seeds, *self.results]
        return {f"{self.name}_{i}": column for i, column in enumerate(columns)}

    def expressions(self, dae: Dae, laws: Laws | None) -> tuple[list[SX], list[SX]]:
        """Return the symbols and the expressions; of laws, with their constants for p."""
        if laws is None:
            return [*dae.arguments, *self.seeds], self.results
        columns, count = [laws.others[name] for name in self.named], len(self.seeds)
        return [*laws.arguments, *columns[:count]], columns[count:]

    def function(self, dae: Dae, laws: Laws | None) -> ca.Function:
        """Return the same as a function."""
        return ca.Function(self.name, *self.expressions(dae, laws), {"cse": True})


def sensitivity_formulas(dae: Dae, *, adjoint: bool) -> Mapping[str, SX]:
    """Return the expressions of `sensitivity_functions` that share constants; none if large."""
    if is_large(dae):
        return {}
    formulas = [*_directional_formulas(dae, looped=False), _jacobian_formulas(dae)]
    if adjoint:
        formulas += _adjoint_formulas(dae)
    return {name: result for each in formulas for name, result in each.named.items()}


def sensitivity_functions(laws: Laws, *, adjoint: bool) -> list[ca.Function]:
    """Return the derivative functions that fmu/runtime/equations.h declares."""
    dae = laws.dae
    constants = None if is_large(dae) else laws
    return [
        directional_function(dae, constants),
        jacobian_function(dae, constants),
        start_directional_function(dae),
        *([adjoint_function(dae, constants)] if adjoint else []),
    ]


@cached_per_thread(4)
def _directional_formulas(dae: Dae, *, looped: bool) -> tuple[Formulas, Formulas]:
    """Return what `implicit_change` takes for z, and the derivatives along all seeds."""
    known = [dae.x, dae.u, dae.p, dae.t]
    seeds = [SX.sym("seed", symbol.numel()) for symbol in known]
    seed_z = SX.sym("seed_z", dae.z.numel())
    variables, seed = ca.vertcat(*known), ca.vertcat(*seeds)
    change = ca.jtimes(dae.balanced, variables, seed)
    implicit = Formulas("along", seeds, [ca.jacobian(dae.balanced, dae.z), change])
    variables, seed = ca.vertcat(variables, dae.z), ca.vertcat(seed, seed_z)
    along = [ca.jtimes(e, variables, seed) for e in (dae.ode, dae.outputs)[looped:]]
    return implicit, Formulas("along_all", [*seeds, seed_z], along)


def directional_function(dae: Dae, laws: Laws | None = None) -> ca.Function:
    """Return `model_directional(t, x, z, u, p, seed_x, seed_u, seed_p, seed_t)`.

    Its results are the derivatives of dx/dt, z and the outputs along the seeds. Those of a large
    model share one derivative of the laws with `jacobian_function`.

    Args:
        laws: Whose constants it takes for p; not of a large model.
    """
    looped = is_large(dae)
    of_z, of_all = _directional_formulas(dae, looped=looped)
    symbols, (slopes, change) = of_z.expressions(dae, laws)
    implicit, explicit = implicit_change(symbols, slopes, change), of_all.function(dae, laws)
    arguments = [argument_like(symbol) for symbol in symbols]
    count = len(dae.arguments)
    sens_z = implicit(*arguments)
    *sens_ode, sens_outputs = explicit.call([*arguments, sens_z])
    if looped:
        seed_x, seed_u, seed_p, seed_t = arguments[count:]
        moved = ca.vertcat(seed_x, seed_u, sens_z, seed_p, seed_t)
        sens_ode = [_along_laws(dae)(ca.vertcat(*arguments[:count]), moved)[: dae.x.numel()]]
    return ca.Function("model_directional", arguments, [*sens_ode, sens_z, sens_outputs])


@cached_per_thread(4)
def _jacobian_formulas(dae: Dae) -> Formulas:
    known = ca.vertcat(dae.x, dae.u)
    blocks = [ca.jacobian(e, v) for e in (dae.ode, dae.balanced) for v in (known, dae.z)]
    return Formulas("blocks", [], blocks)


@cached_per_thread(4)
def jacobian_function(dae: Dae, laws: Laws | None = None) -> ca.Function:
    """Return `model_jacobian(t, x, z, u, p)`: dense Jacobians of dx/dt and z with (x, u).

    That of a large model, whose formulas are too long, loops over directional derivatives.

    Args:
        laws: Whose constants it takes for p; not of a large model.
    """
    if is_large(dae):
        arguments = [argument_like(symbol) for symbol in dae.arguments]
        every, known = ca.vertcat(dae.ode, dae.balanced), ca.vertcat(dae.x, dae.u)
        pattern = ca.jacobian_sparsity(every, ca.vertcat(known, dae.z))
        looped = jacobian_in_a_loop("blocks", _along_laws(dae), pattern)
        whole, nx, n = looped(ca.vertcat(*arguments)), dae.x.numel(), known.numel()
        (ode_known, ode_z), (alg_known, alg_z) = ca.blocksplit(
            whole, [0, nx, whole.size1()], [0, n, whole.size2()]
        )
    else:
        written_out = _jacobian_formulas(dae).function(dae, laws)
        arguments = written_out.mx_in()
        ode_known, ode_z, alg_known, alg_z = written_out(*arguments)
    z_known = -linear_solution(alg_z, ca.densify(alg_known))
    total = ca.densify(ode_known + ode_z @ z_known)
    return ca.Function("model_jacobian", arguments, [total, z_known])


@cached_per_thread(4)
def _along_laws(dae: Dae) -> ca.Function:
    """Return the derivative of dx/dt and the algebraic equations along (x, u, z, p, t)."""
    laws, unknowns = (dae.ode, dae.balanced), (dae.x, dae.u, dae.z, dae.p, dae.t)
    columns = ca.vertcat(*laws), ca.vertcat(*unknowns)
    return derivative_along("along_laws", dae.arguments, *columns)


@cached_per_thread(4)
def _adjoint_formulas(dae: Dae) -> tuple[Formulas, Formulas]:
    """Return the linear equations for the weights of z's equations, and the gradients."""
    seeds = [SX.sym("seed", symbol.numel()) for symbol in (dae.ode, dae.z, dae.outputs)]
    weight = SX.sym("weight", dae.z.numel())
    explicit, seed = ca.vertcat(dae.ode, dae.outputs), ca.vertcat(seeds[0], seeds[2])
    on_z = ca.jtimes(explicit, dae.z, seed, True) + seeds[1]
    implicit = Formulas("back", seeds, [ca.jacobian(dae.balanced, dae.z), -on_z])
    everything, all_seeds = ca.vertcat(explicit, dae.balanced), ca.vertcat(seed, weight)
    gradients = [ca.jtimes(everything, v, all_seeds, True) for v in (dae.x, dae.u, dae.p, dae.t)]
    return implicit, Formulas("back_all", [*seeds, weight], gradients)


def adjoint_function(dae: Dae, laws: Laws | None = None) -> ca.Function:
    """Return `model_adjoint(t, x, z, u, p, seed_dx, seed_z, seed_y)`.

    Its results are the gradients of the seeded sum with respect to x, u, p, t.

    Args:
        laws: Whose constants it takes for p.
    """
    implicit, gradients = (formulas.function(dae, laws) for formulas in _adjoint_formulas(dae))
    arguments = implicit.mx_in()
    matrix, right = implicit(*arguments)
    solved = linear_solution(matrix, right, transposed=True)
    return ca.Function("model_adjoint", arguments, list(gradients(*arguments, solved)))


def start_directional_function(dae: Dae) -> ca.Function:
    """Return `model_start_directional(t, x, u, p, seed_x, seed_u, seed_p, seed_t)`.

    Its result is the derivative of the calculated start values along the seeds.
    """
    known = [argument_like(symbol) for symbol in knowns(dae)]
    seeds = [argument_like(symbol) for symbol in (dae.x, dae.u, dae.p, dae.t)]
    calculated = {row for rule in dae.start_rules for row in rule.states}
    rows = [MX(0) if i in calculated else seed for i, seed in enumerate(ca.vertsplit(seeds[0]))]
    for i, rule in enumerate(dae.start_rules):
        change = _rule_derivative(dae, rule, f"start_along_{i}")
        moved = change(*known, ca.vertcat(*rows), *seeds[1:])
        for row, value in zip(rule.states, ca.vertsplit(moved), strict=True):
            rows[row] = value
    every = ca.vertcat(MX(0, 1), *rows)
    return ca.Function("model_start_directional", [*known, *seeds], [every])


def _rule_derivative(dae: Dae, rule: StartRule, name: str) -> ca.Function:
    variables = (dae.x, dae.u, dae.p, dae.t)
    seeds = [SX.sym("seed", symbol.numel()) for symbol in variables]
    symbols = [*knowns(dae), *seeds]
    moved = ca.jtimes(rule.expression, ca.vertcat(*variables), ca.vertcat(*seeds))
    if rule.implicit:
        slopes = ca.jacobian(rule.expression, dae.x)[:, list(rule.states)]
        return implicit_change(symbols, slopes, moved)
    return ca.Function(name, symbols, [moved], {"cse": True})


def argument_like(symbol: SX) -> MX:
    """Return an MX symbol with the sparsity of an SX symbol."""
    return MX.sym("argument", symbol.sparsity())
