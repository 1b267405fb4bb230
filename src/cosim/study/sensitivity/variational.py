"""The variational equation of a DAE, as a DAE: how everything moves when its numbers do.

With x' = f(t, x, z, p) and 0 = g(t, x, z, p), the derivatives s and w of x and z along a direction
q of the parameters follow

    s' = f_x s + f_z w + f_p q,    0 = g_x s + g_z w + g_p q

so that a solver of the whole controls their error as it controls that of x. The direction is one
more parameter: one compiled model serves every derivative, and many of them run side by side.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae, Start, Variable
from cosim.arrays import Vector
from cosim.codegen.functions import symbols_like
from cosim.codegen.initialization import start_function
from cosim.memo import kept_per_thread
from cosim.model.values import Values


@dataclass(frozen=True)
class SensitivityTarget:
    """What is differentiated by: a parameter, a constant input, or the start of a state.

    Attributes:
        variable: It.
        kind: "parameter", "input" or "state".
        row: Its place among those.
        size: Of its own value or, where that is zero, its nominal value.
    """

    variable: Variable
    kind: str
    row: int
    size: float

    @classmethod
    def of(cls, dae: Dae, name: str) -> "SensitivityTarget | None":
        """Return the target of that name; None where the DAE has no such variable."""
        kinds = {"parameter": dae.parameters, "input": dae.inputs, "state": dae.states}
        for kind, variables in kinds.items():
            for row, variable in enumerate(variables):
                if variable.name == name:
                    return cls(variable, kind, row, abs(variable.start or 0.0) or variable.nominal)
        return None


def derivative(name: str) -> str:
    """Return the name of the derivative of a variable."""
    return f"derivative_of_{name}"


def direction(name: str) -> str:
    """Return the name of the component of a parameter or an input in the direction."""
    return f"direction_of_{name}"


@kept_per_thread(8)
def variational(dae: Dae) -> Dae:
    """Return the DAE together with the derivatives of everything along a direction.

    Its variables come first, then the `derivative` of each; `direction` names what parameters and
    inputs it has one for, 0 until it is set. The starts of the derivatives are 0 and must be given,
    see `start_slopes`.
    """
    (s, w, by_u, by_p) = (
        SX.sym(n, v.numel()) for n, v in zip("swuq", (dae.x, dae.z, dae.u, dae.p), strict=True)
    )
    rows = ca.vertcat(dae.ode, dae.alg, dae.outputs)
    symbols = ca.vertcat(dae.x, dae.z, dae.u, dae.p)
    moved = ca.densify(ca.jtimes(rows, symbols, ca.vertcat(s, w, by_u, by_p)))
    nx, nz = dae.x.numel(), dae.z.numel()
    ode, alg, outputs = ca.vertsplit(moved, [0, nx, nx + nz, rows.numel()])
    return replace(
        dae,
        x=ca.vertcat(dae.x, s),
        z=ca.vertcat(dae.z, w),
        p=ca.vertcat(dae.p, by_u, by_p),
        ode=ca.vertcat(dae.ode, ode),
        alg=ca.vertcat(dae.alg, alg),
        outputs=ca.vertcat(dae.outputs, outputs),
        states=dae.states + _derived(dae.states, derivative, Start.EXACT),
        algebraics=dae.algebraics + _derived(dae.algebraics, derivative, Start.GUESS),
        parameters=dae.parameters
        + _derived((*dae.inputs, *dae.parameters), direction, Start.EXACT),
        output_variables=dae.output_variables
        + _derived(dae.output_variables, derivative, Start.CALCULATED),
        x_start=dae.x_start + (0.0,) * nx,
        invariants=(),
        closing=None,
        monitors=(),
    )


def start_slopes(
    dae: Dae, t: float, values: Values, targets: Sequence[SensitivityTarget]
) -> Vector:
    """Return the derivatives of the start of every state at t [s], calculated ones included.

    They are multiplied by the size of their target; (nx, k).
    """
    blocks = _start_jacobians(dae)(t, values.x, values.u, values.p)
    columns = dict(zip(("state", "input", "parameter"), map(np.array, blocks), strict=True))
    chosen = [target.size * columns[target.kind][:, target.row] for target in targets]
    return np.column_stack(chosen)


@kept_per_thread(8)
def _start_jacobians(dae: Dae) -> ca.Function:
    t, x, _, u, p = symbols_like(dae)
    start, _ = start_function(dae)(t, x, u, p)
    blocks = [ca.densify(ca.jacobian(start, symbol)) for symbol in (x, u, p)]
    return ca.Function("start_jacobians", [t, x, u, p], blocks)


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
        )
        for variable in variables
    )
