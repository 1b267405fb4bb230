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
    return _function(dae, dae.p, dae.ode, dae.alg, sensitivities)


@kept_per_thread(16)
def prepared(dae: Dae) -> tuple[ca.Function, ca.Function]:
    """Return `dae(t, x, z, u, c) -> (ode, alg)` and `p -> c`.

    c are the parameters and all that depends on nothing else: calculated once, not in every step.
    """
    rows, symbols, values = ca.extract_parametric(ca.vertcat(dae.ode, dae.alg), dae.p)
    nx = dae.x.numel()
    c = ca.vertcat(dae.p, *symbols)
    function = _function(dae, c, rows[:nx], rows[nx:], sensitivities=False)
    return function, ca.Function("constants", [dae.p], [ca.vertcat(dae.p, *values)], {"cse": True})


def driven(dae: Dae, inputs: Series | None, t: MX, u: MX) -> MX:
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


def _function(dae: Dae, p: ca.SX, ode: ca.SX, alg: ca.SX, sensitivities: bool) -> ca.Function:
    options: dict[str, Any] = {"cse": True}
    if not sensitivities:
        options["is_diff_in"] = [False, True, True, False, False]
    symbols = [dae.t, dae.x, dae.z, dae.u, p]
    return ca.Function("dae", symbols, [ode, alg], CALL, ["ode", "alg"], options)
