"""`variational`: a DAE with the derivatives of everything along a direction of its parameters.

With x' = f(t, x, z, p) and 0 = g(t, x, z, p), the derivatives s and w of x and z along a direction
q of the parameters follow the variational equations

    s' = f_x s + f_z w + f_p q,    0 = g_x s + g_z w + g_p q
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import casadi as ca
from casadi import SX

from casadi_models.dae.expressions import applied, operations, replayed
from casadi_models.dae.frozen import Dae
from casadi_models.dae.variables import Start, Variable


def derivative(name: str) -> str:
    """Return the name of the derivative of a variable."""
    return f"derivative_of_{name}"


def direction(name: str) -> str:
    """Return the name of the component of the direction along a parameter or an input."""
    return f"direction_of_{name}"


def variational(dae: Dae) -> Dae:
    """Return the DAE together with the derivatives of everything along a direction.

    The variables of the model come first, then the `derivative` of each. Each parameter and input
    has a component of the `direction`, 0 by default. The initial values of the derivatives are 0
    by default.
    """
    (s, w, by_u, by_p) = (
        SX.sym(n, v.numel()) for n, v in zip("swuq", (dae.x, dae.z, dae.u, dae.p), strict=True)
    )
    rows = _with_branches(ca.vertcat(dae.ode, dae.alg, dae.outputs))
    symbols = ca.vertcat(dae.x, dae.z, dae.u, dae.p)
    moved = ca.densify(ca.jtimes(rows, symbols, ca.vertcat(s, w, by_u, by_p)))
    nx, nz = dae.x.numel(), dae.z.numel()
    ode, alg, outputs = ca.vertsplit(moved, [0, nx, nx + nz, rows.numel()])
    return replace(
        dae,
        x=ca.vertcat(dae.x, s),
        z=ca.vertcat(dae.z, w),
        u=ca.vertcat(dae.u, by_u),
        p=ca.vertcat(dae.p, by_p),
        ode=ca.vertcat(dae.ode, ode),
        alg=ca.vertcat(dae.alg, alg),
        outputs=ca.vertcat(dae.outputs, outputs),
        states=dae.states + _derived(dae.states, derivative, Start.EXACT),
        algebraics=dae.algebraics + _derived(dae.algebraics, derivative, Start.GUESS),
        inputs=dae.inputs + _derived(dae.inputs, direction, Start.EXACT),
        parameters=dae.parameters + _derived(dae.parameters, direction, Start.EXACT),
        output_variables=dae.output_variables
        + _derived(dae.output_variables, derivative, Start.CALCULATED),
        x_start=dae.x_start + (0.0,) * nx,
        invariants=(),
        closing=None,
        monitors=(),
        derived=nx,
    )


def _with_branches(column: SX) -> SX:
    """Return a column with branches for `fmin` and `fmax`.

    CasADi's derivative of these, (b <= a) / ((b <= a) + (a <= b)), has two comparisons, and no
    value where an event changes one before the other.
    """
    used = operations(column)
    if used.isdisjoint({ca.OP_FMIN, ca.OP_FMAX}) or ca.OP_CALL in used:
        return column

    def operation(code: int, terms: list[SX]) -> SX:
        if code not in (ca.OP_FMIN, ca.OP_FMAX):
            return applied(code, terms)
        a, b = terms
        return ca.if_else(a < b if code == ca.OP_FMIN else b < a, a, b)

    return ca.vertcat(SX(0, 1), *replayed(column, lambda leaf: leaf, operation))


def _derived(
    variables: Sequence[Variable], name: Callable[[str], str], kind: Start
) -> tuple[Variable, ...]:
    return tuple(
        Variable(
            name(variable.name),
            variable.unit if variable.unit != "rad" else "1",  # no angle, whatever its size
            f"{name('this').replace('_', ' ')}: {variable.meaning}",
            start=None if kind is Start.CALCULATED else 0.0,
            start_kind=kind,
            nominal=variable.nominal,
            foreign_unit=variable.foreign_unit,
        )
        for variable in variables
    )
