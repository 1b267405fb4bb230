"""The bare function of CasADi's integrator API, and what to call it with."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import casadi as ca
from casadi import MX
from numpy.typing import ArrayLike

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.errors import UsageError
from cosim.integrate import initial_values
from cosim.integrate.derivatives import MOST_JACOBIAN_NUMBERS, jacobian_of_run, size_of_jacobian
from cosim.integrate.engine import Engine, Problem
from cosim.integrate.families.fixed_step import FixedStep
from cosim.integrate.nominal import Nominal, in_nominal_values
from cosim.integrate.run.worthwhile import worthwhile
from cosim.integrate.solver import AdaptiveSolver, Solver
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
    derivatives: bool | None = None,
) -> ca.Function:
    """Return the bare function of CasADi's integrator API, to embed, map or differentiate.

    Args:
        dae: The model.
        grid: Increasing output times, s, the start first, (n,).
        solver, relative_tolerance, absolute_tolerance: See `simulate`.
        compiled: Whether to compile the equations. When None, small ones are, and large ones where
            the library is there already or one run would pay for it: nobody knows how many follow.
        step_size: Largest step of a solver with fixed ones, s; the model's output interval when
            None. Steps end at every output time.
        derivatives: Whether the function is to have derivatives, which takes some preparation and,
            where compiled, a library of their own. When None, they are left out where the Jacobian
            of the run would have more than 3 million numbers.

    Returns:
        `(x0, z0, p, u) -> (xf, zf)` with one column per time of the grid, in the order of `dae.x`,
        `dae.z`, `dae.p`, `dae.u`. What is not given is 0: see `start_vectors`. `u` has one column
        per time, too, (nu, n): each holds on the way to its time, the first one is of no effect. A
        single column holds throughout. Forward and reverse derivatives are those of the solution,
        to the tolerance of the solver, or those of the very steps where these are fixed. Second
        derivatives exist for fixed steps with `compiled=False` only.

    Raises:
        ParameterError: The grid is not increasing or not finite.
        UsageError: Derivatives are asked for of so long a grid; and see `simulate`.
        UnknownName, MissingTool: See `simulate`.

    Example:
        >>> import cosim
        >>> dae = cosim.load("crank_shaft")
        >>> run = integrator(dae, [0.0, 0.5, 1.0], solver="erk", compiled=False)
        >>> run(**cosim.start_vectors(dae))["xf"].shape
        (2, 3)
    """
    times = checked_grid(grid)
    chosen = chosen_solver(dae, solver, relative_tolerance, absolute_tolerance, step_size)
    if isinstance(chosen, FixedStep) and chosen.step_size is None:
        chosen = replace(chosen, step_size=dae.experiment.output_interval)
    nominal = Nominal.declared(dae) if isinstance(chosen, AdaptiveSolver) else Nominal.none(dae)

    def problem_of(compiled: bool) -> Problem:
        own = isinstance(chosen, FixedStep) and not compiled
        return Problem(dae, times.tobytes(), None, compiled, sensitivities=own, piecewise=True)

    def engine(compiled: bool) -> Engine:
        return engine_of(in_nominal_values(problem_of(compiled), chosen, nominal)[0], chosen)

    if compiled is None:
        compiled = worthwhile(dae, chosen, len(times), lambda: engine(True)).compiled
    problem, built = problem_of(compiled), engine(compiled)
    own = problem.sensitivities  # CasADi's are those of the very steps
    _, divided = in_nominal_values(problem, chosen, nominal)
    size = size_of_jacobian(dae, len(times))
    if own or derivatives is False or (derivatives is None and size > MOST_JACOBIAN_NUMBERS):
        return _bare_function(dae, built, divided, len(times), {})
    if size > MOST_JACOBIAN_NUMBERS:
        raise UsageError(
            f"{dae.full_name}: derivatives over {len(times)} output times are {size:.0e} numbers; "
            "give fewer times, or chain runs"
        )
    jacobian = jacobian_of_run(problem, chosen)
    options = {"custom_jacobian": jacobian, "jac_penalty": 0.0, "never_inline": True}
    options |= {"enable_forward": False, "enable_reverse": False, "ad_weight_sp": -1.0}
    return _bare_function(dae, built, divided, len(times), options)


def _bare_function(
    dae: Dae, built: Engine, nominal: Nominal, n: int, options: dict[str, Any]
) -> ca.Function:
    x0, z0, p = (
        MX.sym(name, symbol.numel())
        for name, symbol in (("x0", dae.x), ("z0", dae.z), ("p", dae.p))
    )
    u = MX.sym("u", dae.u.numel(), n)
    run, extended = built.functions
    parameters = p if extended is None else extended(p)
    inputs = {"u": u} if dae.inputs else {}  # CasADi maps over columns of nothing
    x, z = ca.DM(nominal.x), ca.DM(nominal.z)
    result = run(x0=x0 / x, z0=z0 / z, p=parameters, **inputs)
    names = ["x0", "z0", "p", "u"]
    unscaled = [ca.densify(result[name]) for name in ("xf", "zf")]
    columns = [rows * ca.repmat(size, 1, n) for rows, size in zip(unscaled, (x, z), strict=True)]
    return ca.Function("integrator", [x0, z0, p, u], columns, names, ["xf", "zf"], options)


def start_vectors(dae: Dae, start_values: Mapping[str, float] | None = None) -> dict[str, Vector]:
    """Return consistent `x0`, `z0`, `p`, `u` to call an `integrator` with.

    Raises:
        UnknownName, ParameterError, InitialConditionError: See `simulate`.

    Example:
        >>> import cosim
        >>> start_vectors(cosim.load("crank_shaft"), {"omega": 10.0})["x0"]
        array([ 0., 10.])
    """
    values = assign(dae, start_values)
    x0 = initial_values.start_values(dae, 0.0, values)
    return {
        "x0": x0,
        "z0": initial_values.algebraic_values(dae, 0.0, x0, values),
        "p": values.p,
        "u": values.u,
    }
