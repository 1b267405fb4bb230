"""CasADi functions of a `Dae`: equations, outputs, and their Jacobians."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, compress
from typing import Any, Protocol

import casadi as ca
import numpy as np
from casadi import DM, MX, SX

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.memo import cached_per_thread

CALL = ["t", "x", "z", "u", "p"]
_LAWS = ["ode", "alg"]


class Series(Protocol):
    """Samples of some inputs over time; see `cosim.InputSeries`."""

    @property
    def names(self) -> tuple[str, ...]:
        """The inputs."""

    @property
    def time(self) -> Vector:
        """Sample times, s, (m,)."""

    @property
    def values(self) -> Vector:
        """One column per input, (m, len(names))."""


@dataclass(frozen=True, eq=False)
class Laws:
    """The equations of a model with constants for its parameters.

    Attributes:
        dae: The model.
        c: Symbols of the constants: the parameters, and after them all expressions of the laws
            that depend on parameters alone.
        ode, alg: dx/dt and the balanced residual of z, columns of t, x, z, u and c.
        others: Further expressions, by name, that share the constants.
        constants: `constants(p) -> c`.
    """

    dae: Dae
    c: SX
    ode: SX
    alg: SX
    others: Mapping[str, SX]
    constants: ca.Function

    @property
    def arguments(self) -> list[SX]:
        """`[t, x, z, u, c]`, the arguments of functions that are made of its expressions."""
        return [*self.dae.arguments[:-1], self.c]


@cached_per_thread(16)
def equations(dae: Dae, *, sensitivities: bool = True) -> ca.Function:
    """Return `dae(t, x, z, u, p) -> (ode, alg)`.

    Without `sensitivities` it has derivatives with respect to x and z only, which is sufficient
    for integration and reduces the code to between a third and a half.
    """
    known = [sensitivities, True, True, sensitivities, sensitivities]
    return _equations_function(dae.arguments, dae.ode, dae.alg, known)


@cached_per_thread(16)
def balanced_equations(dae: Dae) -> ca.Function:
    """Return the same with balanced algebraic equations and all derivatives."""
    return _equations_function(dae.arguments, dae.ode, dae.balanced, 5 * [True])


@cached_per_thread(16)
def prepared(dae: Dae, *, sensitivities: bool = False) -> tuple[ca.Function, ca.Function]:
    """Return `dae(t, x, z, u, c) -> (ode, alg)` and `p -> c`.

    c contains the parameters and all expressions that depend on them alone, which are calculated
    once instead of in every step. Without `sensitivities`, `dae` has no derivatives with c.
    """
    laws = hoisted_laws(dae)
    return driven_equations(laws, sensitivities=sensitivities), laws.constants


def driven_equations(laws: Laws, *, sensitivities: bool = False) -> ca.Function:
    """Return `dae(t, x, z, u, c) -> (ode, alg)` with derivatives with t, x, z and u."""
    rates = [True, True, True, True, sensitivities]
    return _equations_function(laws.arguments, laws.ode, laws.alg, rates)


@cached_per_thread(16)
def hoisted_laws(dae: Dae) -> Laws:
    """Return the equations with constants that are calculated once instead of in every step."""
    return hoisted(dae)


def hoisted(dae: Dae, **others: SX) -> Laws:
    """Return the same with further expressions, whose terms of parameters are constants, too."""
    every = [dae.ode, dae.balanced, *others.values()]
    column = ca.vertcat(*(SX(ca.Sparsity.dense(e.nnz()), e.nz[:]) for e in every))
    if others:  # what two of them have in common is one constant
        column = ca.cse(column)
    rows, c, constants = hoisted_rows(dae, column)
    ends = accumulate((e.nnz() for e in every), initial=0)
    parts = zip(every, ca.vertsplit(rows, [*ends]), strict=True)
    ode, alg, *rest = (SX(e.sparsity(), part) for e, part in parts)
    return Laws(dae, c, ode, alg, dict(zip(others, rest, strict=True)), constants)


def hoisted_rows(dae: Dae, rows: SX) -> tuple[SX, SX, ca.Function]:
    """Return a column as an expression of constants c, the symbols c, and `constants(p) -> c`."""
    rows, symbols, values = ca.extract_parametric(rows, dae.p)
    c = ca.vertcat(SX(0, 1), dae.p, *symbols)
    known = ca.densify(ca.vertcat(dae.p, *values))
    return rows, c, ca.Function("constants", [dae.p], [known], {"cse": True})


@cached_per_thread(16)
def is_large(dae: Dae) -> bool:
    """Tell whether the symbolic Jacobian of a model is too long for generated code."""
    unknowns = ca.vertcat(dae.x, dae.u, dae.z)
    return has_long_jacobian(dae.arguments, ca.vertcat(dae.ode, dae.balanced), unknowns)


def inputs_at(dae: Dae, inputs: Series | None, t: MX, u: MX) -> MX:
    """Return the inputs at a time: from the series, or else constant."""
    if inputs is None:
        return u
    clipped = ca.fmin(ca.fmax(t, inputs.time[0]), inputs.time[-1])
    rows = ca.vertsplit(u)
    for i, variable in enumerate(dae.inputs):
        if variable.name in inputs.names:
            samples = inputs.values[:, inputs.names.index(variable.name)]
            rows[i] = ca.interpolant("signal", "linear", [inputs.time], samples)(clipped)
    return ca.vertcat(*rows)


def symbols_like(dae: Dae) -> list[MX]:
    """Return symbols for `t, x, z, u, p` with the sizes of a model."""
    return [MX.sym(n, s.numel()) for n, s in zip(CALL, dae.arguments, strict=True)]


def symbols_of(function: ca.Function) -> list[MX]:
    """Return symbols for `t, x, z, u, p` with the sparsity of a function's inputs."""
    return [MX.sym(name, function.sparsity_in(i)) for i, name in enumerate(CALL)]


def dense(function: ca.Function) -> ca.Function:
    """Return a function whose code writes zeros, too, for C that reads every entry of a result."""
    if all(function.sparsity_out(i).is_dense() for i in range(function.n_out())):
        return function
    symbols = function.mx_in()
    results = [ca.densify(result) for result in function.call(symbols)]
    return ca.Function(function.name(), symbols, results)


def _equations_function(
    symbols: list[SX], ode: SX, alg: SX, differentiable: list[bool]
) -> ca.Function:
    """Return the equations as a function.

    CasADi silently uses zero for derivatives with respect to an argument that is not marked as
    differentiable. Such an argument must not be differentiated.
    """
    options: dict[str, Any] = {"cse": True, "is_diff_in": differentiable}
    if not all(differentiable):
        options |= _jacobian_in_a_loop(symbols, (ode, alg), differentiable)
    return ca.Function("dae", symbols, [ode, alg], CALL, ["ode", "alg"], options)


def _jacobian_in_a_loop(
    symbols: list[ca.SX], laws: tuple[ca.SX, ca.SX], differentiable: list[bool]
) -> dict[str, Any]:
    """Return options that compute a long Jacobian in a loop; none where it is short."""
    column = ca.vertcat(*laws)
    unknowns = ca.vertcat(*compress(symbols, differentiable))
    if not has_long_jacobian(symbols, column, unknowns):
        return {}
    every = ca.vertcat(unknowns, *compress(symbols, (not each for each in differentiable)))
    along = derivative_along("along_laws", symbols, column, every)
    pattern = ca.jacobian_sparsity(column, unknowns)
    arguments = [MX.sym(name, s.numel()) for name, s in zip(CALL, symbols, strict=True)]
    whole = jacobian_in_a_loop("loop", along, pattern)(ca.vertcat(*arguments))
    rows = [0, *np.cumsum([law.numel() for law in laws])]
    columns = [0, *np.cumsum([s.numel() * d for s, d in zip(symbols, differentiable, strict=True)])]
    blocks = [
        whole[rows[i] : rows[i + 1], columns[j] : columns[j + 1]]
        if differentiable[j]
        else MX(laws[i].numel(), symbols[j].numel())
        for i in range(len(laws))
        for j in range(len(symbols))
    ]
    results = [
        MX.sym(f"out_{name}", ca.Sparsity(law.numel(), 1))
        for name, law in zip(_LAWS, laws, strict=True)
    ]
    jacobian = ca.Function(
        "jac_dae",
        [*arguments, *results],
        blocks,
        [*CALL, *(f"out_{name}" for name in _LAWS)],
        [f"jac_{law}_{name}" for law in _LAWS for name in CALL],
    )
    only = {"enable_forward": False, "enable_reverse": False}
    return {"custom_jacobian": jacobian, "jac_penalty": 0.0, "never_inline": True, **only}


MOST_OPERATIONS = 100_000  # of a symbolic Jacobian; compiling one takes 5 kB and 50 us


def has_long_jacobian(symbols: Sequence[SX], laws: SX, unknowns: SX) -> bool:
    """Tell whether the symbolic Jacobian of a column of laws is too long for generated code."""
    if not laws.numel() or not unknowns.numel():
        return False
    moved = {symbol.element_hash() for symbol in ca.vertsplit(unknowns)}
    resting = [each for each in ca.symvar(laws) if each.element_hash() not in moved]
    # what contains no unknown is not differentiated
    laws_left, constants, _ = ca.extract_parametric(laws, ca.vertcat(SX(0, 1), *resting))
    function = ca.Function("laws", [*symbols, *constants], [laws_left], {"cse": True})
    length = function.n_instructions()
    return bool(length * _groups(ca.jacobian_sparsity(laws, unknowns)).size2() > MOST_OPERATIONS)


def derivative_along(name: str, symbols: Sequence[SX], laws: SX, unknowns: SX) -> ca.Function:
    """Return `name(point, seed)`, the dense directional derivative of laws along a seed.

    Args:
        symbols: All symbols of the laws; `point` is their column.
        laws, unknowns: Columns of expressions and of symbols; `seed` has the size of `unknowns`.
    """
    seed = SX.sym("seed", unknowns.numel())
    along = ca.densify(ca.jtimes(laws, unknowns, seed))
    return ca.Function(name, [ca.vertcat(*symbols), seed], [along], {"cse": True})


def jacobian_in_a_loop(name: str, along: ca.Function, pattern: ca.Sparsity) -> ca.Function:
    """Return `name(point) -> jacobian`, sparse, as a loop over directional derivatives.

    Args:
        pattern: Sparsity of the Jacobian with respect to the first unknowns of `along`.
    """
    groups = _groups(pattern)
    members, of = (np.array(places, dtype=int) for places in groups.get_triplet())
    seeds = DM.zeros(along.numel_in(1), groups.size2())
    seeds[: groups.size1(), :] = DM(groups, 1)
    point = MX.sym("point", along.numel_in(0))
    every = along.map(f"{name}_every", "serial", groups.size2(), [0], [])(point, seeds)
    group = np.empty(pattern.size2(), dtype=int)
    group[members] = of
    rows, columns = (np.array(places, dtype=int) for places in pattern.get_triplet())
    # entry (i, j) of the Jacobian is entry i of the derivative along the group of column j
    entries = ca.vec(every)[(rows + pattern.size1() * group[columns]).tolist()]
    return ca.Function(name, [point], [MX(pattern, entries)])


def _groups(pattern: ca.Sparsity) -> ca.Sparsity:
    """Return groups of columns without a common row, (columns, groups)."""
    return pattern.uni_coloring(pattern.T)
