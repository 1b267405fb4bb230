"""A DAE's equations as CasADi functions, as the solvers of road one call them."""

from itertools import compress
from typing import Any, Protocol

import casadi as ca
import numpy as np
from casadi import MX

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.directional_jacobian import (
    derivative_along,
    has_long_jacobian,
    jacobian_in_a_loop,
)
from cosim.memo import kept_per_thread

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


@kept_per_thread(16)
def equations(dae: Dae, *, sensitivities: bool = True) -> ca.Function:
    """Return `dae(t, x, z, u, p) -> (ode, alg)`.

    Without `sensitivities` it has derivatives with respect to x and z only, which is all that an
    integration needs: a third to a half of the code.
    """
    known = [sensitivities, True, True, sensitivities, sensitivities]
    return _equations_function(dae, dae.p, dae.ode, dae.alg, known)


@kept_per_thread(16)
def driven_equations(dae: Dae) -> ca.Function:
    """Return `dae(t, x, z, u, p) -> (ode, alg)` with derivatives but for p: what time changes."""
    return _equations_function(dae, dae.p, dae.ode, dae.alg, [True, True, True, True, False])


@kept_per_thread(16)
def prepared(dae: Dae, *, sensitivities: bool = False) -> tuple[ca.Function, ca.Function]:
    """Return `dae(t, x, z, u, c) -> (ode, alg)` and `p -> c`.

    c are the parameters and all that depends on nothing else: calculated once, not in every step.
    Without `sensitivities`, `dae` has no derivatives with respect to c.
    """
    rows, symbols, values = ca.extract_parametric(ca.vertcat(dae.ode, dae.alg), dae.p)
    nx = dae.x.numel()
    rates = [True, True, True, True, sensitivities]
    c = ca.vertcat(dae.p, *symbols)
    function = _equations_function(dae, c, rows[:nx], rows[nx:], rates)
    return function, ca.Function("constants", [dae.p], [ca.vertcat(dae.p, *values)], {"cse": True})


@kept_per_thread(16)
def is_large(dae: Dae) -> bool:
    """Tell whether the formulas of the Jacobian are too long to be written out."""
    unknowns = ca.vertcat(dae.x, dae.u, dae.z)
    return has_long_jacobian(dae.arguments, ca.vertcat(dae.ode, dae.alg), unknowns)


def inputs_at(dae: Dae, inputs: Series | None, t: MX, u: MX) -> MX:
    """Return the inputs at a time: those of the series, and the constants for the others."""
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
    """Return symbols for `t, x, z, u, p` of a model, of the sizes of its own."""
    return [MX.sym(n, s.numel()) for n, s in zip(CALL, dae.arguments, strict=True)]


def symbols_of(function: ca.Function) -> list[MX]:
    """Return symbols for `t, x, z, u, p` of a function of these."""
    return [MX.sym(name, function.sparsity_in(i)) for i, name in enumerate(CALL)]


def _equations_function(
    dae: Dae, p: ca.SX, ode: ca.SX, alg: ca.SX, differentiable: list[bool]
) -> ca.Function:
    """Return the equations; of an argument that is not differentiable, CasADi takes the derivatives
    for 0 without a word: only where nobody asks for them."""
    options: dict[str, Any] = {"cse": True, "is_diff_in": differentiable}
    symbols = [dae.t, dae.x, dae.z, dae.u, p]
    if not all(differentiable):
        options |= _jacobian_in_a_loop(symbols, (ode, alg), differentiable)
    return ca.Function("dae", symbols, [ode, alg], CALL, ["ode", "alg"], options)


def _jacobian_in_a_loop(
    symbols: list[ca.SX], laws: tuple[ca.SX, ca.SX], differentiable: list[bool]
) -> dict[str, Any]:
    """Return the options of a function whose Jacobian would be too long to be written out."""
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
