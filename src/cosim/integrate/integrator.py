"""The bare function of CasADi's integrator API, and what to call it with."""

from collections.abc import Mapping

import casadi as ca
from casadi import MX
from numpy.typing import ArrayLike

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.compiler import has_compiler
from cosim.integrate import initial_values
from cosim.integrate.engine import Problem
from cosim.integrate.solver import Solver
from cosim.integrate.solvers import chosen_solver, engine_of
from cosim.model.time_grid import checked_grid
from cosim.model.values import assign


def integrator(
    dae: Dae,
    grid: ArrayLike,
    *,
    solver: str | Solver | None = None,
    relative_tolerance: float | None = None,
    absolute_tolerance: float | None = None,
    step_size: float | None = None,
    compiled: bool | None = None,
) -> ca.Function:
    """Return the bare function of CasADi's integrator API, to embed, map or differentiate.

    Args:
        dae: The model.
        grid: Increasing output times, s, the start first, (n,).
        solver, relative_tolerance, absolute_tolerance, step_size, compiled: See `simulate`.

    Returns:
        `(x0, z0, p, u, ...) -> (xf, zf, ...)` with one column per time of the grid, in the order
        of `dae.x`, `dae.z`, `dae.p`, `dae.u`. What is not given is 0: see `start_vectors`.
        Compiled `erk`, `rosenbrock`, `rk4` and `ode8` have no derivatives; pass `compiled=False`
        where an optimizer needs them.

    Raises:
        ParameterError: The grid is not increasing or not finite.
        UnknownName, UsageError, MissingTool: See `simulate`.
    """
    times = checked_grid(grid)
    chosen = chosen_solver(dae, solver, relative_tolerance, absolute_tolerance, step_size)
    compiled = has_compiler() if compiled is None else compiled
    built = engine_of(Problem(dae, times.tobytes(), compiled=compiled), chosen)
    if built.parameters is None:
        return built.function
    x0, z0, p, u = (
        MX.sym(n, v.numel()) for n, v in (("x0", dae.x), ("z0", dae.z), ("p", dae.p), ("u", dae.u))
    )
    result = built.function(x0=x0, z0=z0, p=built.parameters(p), u=u)
    names = ["x0", "z0", "p", "u"]
    return ca.Function(
        "integrator", [x0, z0, p, u], [result["xf"], result["zf"]], names, ["xf", "zf"]
    )


def start_vectors(dae: Dae, start_values: Mapping[str, float] | None = None) -> dict[str, Vector]:
    """Return consistent `x0`, `z0`, `p`, `u` to call an `integrator` with.

    Raises:
        UnknownName, ParameterError, InitialConditionError: See `simulate`.
    """
    values = assign(dae, start_values)
    x0 = initial_values.start_values(dae, values)
    return {
        "x0": x0,
        "z0": initial_values.algebraic_values(dae, 0.0, x0, values),
        "p": values.p,
        "u": values.u,
    }
