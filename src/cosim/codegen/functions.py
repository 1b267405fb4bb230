"""A DAE's equations as CasADi functions, as the solvers of road one call them."""

from typing import Any, Protocol

import casadi as ca
from casadi import MX

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.memo import kept_per_thread

CALL = ["t", "x", "z", "u", "p"]


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
    return ca.Function("dae", symbols, [ode, alg], CALL, ["ode", "alg"], options)
