"""`integrator`: a function in CasADi's integrator API, with derivatives of the solution.

Of a model with events, CasADi calls back to `integrate`, once for the function and once per column
of its Jacobian, in which the model is integrated together with its derivatives along one argument.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any
from warnings import warn

import casadi as ca
import numpy as np
from casadi import MX
from numpy.typing import ArrayLike

from casadi_models.dae import Dae
from casadi_models.dae.expressions import linear_solution
from casadi_models.dae.variational import variational
from cosim.arrays import Vector
from cosim.codegen.functions import CALL, balanced_equations, symbols_like
from cosim.codegen.initialization import algebraic_function
from cosim.codegen.landmarks import landmarks
from cosim.codegen.runge_kutta.explicit_library import (
    dop853_method,
    explicit_function,
    explicit_library,
    fixed_step_method,
)
from cosim.codegen.terms import pulse_times
from cosim.errors import SolverError, UsageError
from cosim.integrate.engine import Engine, Problem
from cosim.integrate.events import integrate
from cosim.integrate.families.explicit import Dop853
from cosim.integrate.families.fixed_step import FixedStep
from cosim.integrate.families.plugin import COMMON, tolerances
from cosim.integrate.initial_values import algebraic_values, consistent_values
from cosim.integrate.modes import hybrid
from cosim.integrate.nominal import InitialState, Nominal, in_nominal_values, power
from cosim.integrate.preparation import compilation_of
from cosim.integrate.solvers import chosen_solver, engine_of, requested_solver
from cosim.integrate.validity import times_between
from cosim.memo import cached_per_thread
from cosim.model.catalogue import model_of
from cosim.model.inputs import InputSeries
from cosim.model.solver import AdaptiveSolver, Solver
from cosim.model.times import checked_grid
from cosim.model.values import Values, assign


def directions(dae: Dae) -> int:
    """Return the number of derivatives of each unknown: with respect to x0, p and u."""
    return int(dae.x.numel() + dae.p.numel() + dae.u.numel())


@cached_per_thread(16)
def variational_rhs(dae: Dae) -> ca.Function:
    """Return the variational equations `rhs(t, X, Z, u, p) -> (dX/dt, Z)`.

    X = (x, S) with the sensitivities S = dx/d(x0, p, u), and Z = (z, dz/d(x0, p, u)), stacked. Of
    the argument Z, only z is used, as initial guess.
    """
    nx, nz, nq = dae.x.numel(), dae.z.numel(), directions(dae)
    t, _, _, u, p = symbols_like(dae)
    every, guess = MX.sym("x", nx * (1 + nq)), MX.sym("z", nz * (1 + nq))
    x, slopes = every[:nx], ca.reshape(every[nx:], nx, nq)
    z = algebraic_function(dae)(t, x, guess[:nz], u, p)
    function = balanced_equations(dae)
    ode, alg = function(t, x, z, u, p)
    by = function.jacobian()(t, x, z, u, p, ode, alg)
    ode_by, alg_by = dict(zip(CALL, by[:5], strict=True)), dict(zip(CALL, by[5:], strict=True))
    none = MX(nx, nx)
    rates = ode_by["x"] @ slopes + ca.horzcat(none, ode_by["p"], ode_by["u"])
    direct = ca.horzcat(MX(nz, nx), alg_by["p"], alg_by["u"])
    dz = -linear_solution(alg_by["z"], alg_by["x"] @ slopes + direct)
    rates += ode_by["z"] @ dz
    stacked = [ca.vertcat(ode, ca.vec(rates)), ca.vertcat(z, ca.vec(dz))]
    dense = [ca.densify(column) for column in stacked]
    return ca.Function("rhs", [t, every, guess, u, p], dense)


MOST_JACOBIAN_NUMBERS = 3_000_000  # in the Jacobian of a whole run
FEW_EQUATIONS = 150  # up to which an interpreted implicit method is fast enough


def jacobian_of_run(problem: Problem, solver: Solver, nominal: Nominal) -> ca.Function:
    """Return the Jacobian of an integrator's function for CasADi's option `custom_jacobian`.

    Errors of the derivatives are measured by nominal values, too: `nominal` has those of the
    states, and a parameter or an input has its own value. If compiled, the variational equations
    are integrated with the same fixed steps, or by `dop853` at the tolerances of an adaptive
    solver. If interpreted, they are integrated by `erk`, or by `rosenbrock` if the solver is
    implicit and there are few equations.
    """
    dae, grid = problem.dae, problem.grid
    sizes = _sizes(dae, nominal)
    interval = (_compiled if problem.compiled else _interpreted)(problem, solver, sizes)
    nx, nz, n = dae.x.numel(), dae.z.numel(), len(grid)
    np_, nu = dae.p.numel(), dae.u.numel()
    x0, z0, p = MX.sym("x0", nx), MX.sym("z0", nz), MX.sym("p", np_)
    u = MX.sym("u", nu, n)
    state = [(MX.eye(nx), MX(nx, np_), MX(nx, nu * n))]
    unknown = list[tuple[MX, MX, MX]]()
    x = x0
    for k in range(1, n):
        x, first, slopes, dz = interval(x, z0, p, u[:, k], grid[k - 1], grid[k])
        unknown += [_chained(part, state[-1], k) for part in ((first, dz) if k == 1 else (dz,))]
        state.append(_chained(slopes, state[-1], k))
    blocks = []
    for rows, size in ((state, nx), (unknown, nz)):
        to_x0, to_p, to_u = (ca.vertcat(*block) for block in zip(*rows, strict=True))
        blocks += [to_x0, MX(size * n, nz), to_p, to_u]
    arguments = {"x0": x0, "z0": z0, "p": p, "u": u}
    results = {"out_xf": MX.sym("out_xf", nx, n), "out_zf": MX.sym("out_zf", nz, n)}
    return ca.Function(
        "jac_integrator",
        [*arguments.values(), *results.values()],
        blocks,
        [*arguments, *results],
        [f"jac_{of}_{by}" for of in ("xf", "zf") for by in arguments],
    )


def _chained(slopes: MX, before: tuple[MX, MX, MX], k: int) -> tuple[MX, MX, MX]:
    """Return derivatives with respect to x0, p and all inputs from those over the k-th interval."""
    nx, np_, every = (block.size2() for block in before)
    by_x, by_p, by_u = ca.horzsplit(slopes, [0, nx, nx + np_, slopes.size2()])
    rows, nu = by_u.shape
    inputs = ca.horzcat(MX(rows, nu * k), by_u, MX(rows, every - nu * (k + 1)))
    return by_x @ before[0], by_x @ before[1] + by_p, by_x @ before[2] + inputs


def _sizes(dae: Dae, nominal: Nominal) -> ca.DM:
    """Return what errors of x and its derivatives are measured by, stacked."""
    x, given = np.array(nominal.x), (*dae.parameters, *dae.inputs)
    moved = np.append(x, [power(abs(v.start or 0.0) or v.nominal) for v in given])
    return ca.DM(np.concatenate((x, np.outer(1 / moved, x).ravel())))


def _compiled(problem: Problem, solver: Solver, sizes: ca.DM) -> ca.Function:
    """Return `interval(x, z, p, u, begin, end) -> (x, dz at the start, S, dz)` as compiled code.

    See `variational_rhs`: S are derivatives of x, dz those of z; and `_sizes`.
    """
    dae = problem.dae
    name, method, settings = Dop853.name, dop853_method(), (0.0, 0.0, np.inf)
    if isinstance(solver, FixedStep):
        name, method = solver.name, fixed_step_method(solver.tableau)
        settings = (0.0, 0.0, solver.step(problem))
    elif isinstance(solver, AdaptiveSolver):
        settings = (*solver.tolerance.pair, solver.max_step or np.inf)
    path = explicit_library(variational_rhs(dae), f"variational {name}", method)
    run, _ = explicit_function(path, 2)
    arguments = x, z, p, u, begin, end = _arguments(dae)
    own = ca.vertcat(p, 2, 0, 1, *settings, sizes, begin, end)
    inputs = {"u": u} if dae.inputs else {}
    found = run(x0=_start(dae, x), z0=_guess(dae, z), p=own, **inputs)
    unknown = found["zf"]
    results = _results(dae, found["xf"][:, 1], unknown[:, 0], unknown[:, 1])
    return ca.Function(_LINEAR, arguments, results, _BY_JACOBIAN | {"enable_jacobian": False})


def _interpreted(problem: Problem, solver: Solver, sizes: ca.DM) -> ca.Function:
    """Return the function `interval` of `_compiled` for interpreted equations."""
    dae = problem.dae
    assert isinstance(solver, AdaptiveSolver)  # CasADi differentiates fixed steps
    rhs = variational_rhs(dae)
    stiff = solver.uses_jacobian and rhs.numel_in(1) <= FEW_EQUATIONS
    s, every = MX.sym("s"), MX.sym("x", rhs.numel_in(1))
    arguments = x, z, p, u, begin, end = _arguments(dae)
    own = MX.sym("own", z.numel() + p.numel() + u.numel() + 2)
    guess, numbers, inputs, span = ca.vertsplit(
        own, np.cumsum([0, z.numel(), p.numel(), u.numel(), 2]).tolist()
    )
    rates, _ = rhs(span[0] + span[1] * s, sizes * every, _guess(dae, guess), inputs, numbers)
    system = {"t": s, "x": every, "p": own, "ode": span[1] * rates / sizes}
    options = COMMON | tolerances(solver)
    if solver.max_step is not None:  # of each interval, whose length is 1
        options["max_step_size"] = solver.max_step / float(np.diff(problem.grid).max())
    run = ca.integrator("run", "rosenbrock" if stiff else "erk", system, 0, 1, options)
    start = _start(dae, x)
    last = sizes * run(x0=start / sizes, p=ca.vertcat(z, p, u, begin, end - begin))["xf"]
    unknown = [rhs(t, at, _guess(dae, z), u, p)[1] for t, at in ((begin, start), (end, last))]
    return ca.Function("interval", arguments, _results(dae, last, *unknown))


def _arguments(dae: Dae) -> list[MX]:
    sizes = {"x": dae.x, "z": dae.z, "p": dae.p, "u": dae.u, "begin": dae.t, "end": dae.t}
    return [MX.sym(name, symbol.numel()) for name, symbol in sizes.items()]


def _start(dae: Dae, x: MX) -> MX:
    """Return x and its derivatives at the start of an interval, stacked."""
    nx, nq = dae.x.numel(), directions(dae)
    return ca.vertcat(x, ca.vec(ca.horzcat(ca.DM.eye(nx), ca.DM.zeros(nx, nq - nx))))


def _guess(dae: Dae, z: MX) -> MX:
    return ca.vertcat(z, ca.DM.zeros(dae.z.numel() * directions(dae)))


def _results(dae: Dae, last: MX, before: MX, after: MX) -> list[MX]:
    nx, nz, nq = dae.x.numel(), dae.z.numel(), directions(dae)
    dz = [ca.reshape(unknown[nz:], nz, nq) for unknown in (before, after)]
    return [last[:nx], dz[0], ca.reshape(last[nx:], nx, nq), dz[1]]


_ARGUMENTS = ["x0", "z0", "p", "u"]
# Options of a function whose derivatives all follow from its Jacobian
_BY_JACOBIAN: dict[str, Any] = {"enable_forward": False, "enable_reverse": False}
_BY_JACOBIAN |= {"never_inline": True, "jac_penalty": 0.0, "ad_weight_sp": -1.0}
# CasADi ends its message on second derivatives by the name of the function that has none
_LINEAR = "first_derivatives_so_set_hessian_approximation_to_limited_memory"
_ALIVE = list[ca.Callback]()  # CasADi's expressions do not keep the Python part of a function
_Shapes = Sequence[tuple[int, int]]
_Compute = Callable[[Vector, Vector, Vector], Sequence[Vector]]
_variational = cached_per_thread(8)(variational)


class _Called(ca.Callback):
    """A CasADi function of x0, z0, p, u and more, whose results Python computes from x0, p, u."""

    def __init__(self, name: str, given: _Shapes, results: _Shapes, compute: _Compute) -> None:
        super().__init__()
        self.given, self.results, self.compute = given, results, compute
        _ALIVE.append(self)
        self.construct(name, {})

    def get_n_in(self) -> int:
        return len(self.given)

    def get_n_out(self) -> int:
        return len(self.results)

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(*self.given[i])

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(*self.results[i])

    def eval(self, arguments: Sequence[ca.DM]) -> Sequence[Vector]:
        x, _, p, u = (np.array(argument) for argument in arguments[:4])
        return self.compute(x.ravel(), p.ravel(), u)


@dataclass(frozen=True)
class _HybridRuns:
    """Runs of a model with events over output times, s, (n,), by a solver."""

    dae: Dae
    times: Vector
    solver: Solver
    compiled: bool

    def ends(self, x: Vector, p: Vector, u: Vector, model: Dae | None = None) -> list[Vector]:
        """Return states and algebraic unknowns at the output times, (nx, n) and (nz, n).

        Args:
            x: Start values, (nx,).
            p: Parameters.
            u: Inputs, one column for each interval that ends at an output time, (nu, n).
            model: Runs in place of `dae`, with the same events.

        Raises:
            SolverError: A run fails, or ends before the last time.
        """
        dae, times, grid = model or self.dae, self.times, times_between(self.dae, self.times)
        held, inputs = u[:, 1:], None
        changes = 1 + np.flatnonzero((np.diff(held) != 0).any(axis=0))
        if len(changes):
            begins = np.append(0, changes)
            time = np.append(np.repeat(times[begins], 2)[1:], times[-1])
            names = tuple(variable.name for variable in dae.inputs)
            inputs = InputSeries(names, time, np.repeat(held[:, begins], 2, axis=1).T)
        values = Values(x, p, held[:, 0])
        start = InitialState(x, algebraic_values(dae, grid[0], x, values), values)
        problem = Problem(dae, grid.tobytes(), inputs, self.compiled, sensitivities=False)
        found = integrate(problem, self.solver, start)
        if found.reason or (found.stop and found.time[-1] < grid[-1]):
            reason = found.reason or f"'{found.stop}' ends it at {found.time[-1]:g} s"
            raise SolverError(f"{self.dae.full_name}: a run to {grid[-1]:g} s fails: {reason}")
        rows = np.searchsorted(found.time, times)
        for k, i in zip(changes, rows[changes], strict=True):  # at the end of the interval before
            values = Values(x, p, np.append(held[:, k - 1], found.u[len(held) :, i]))
            z = algebraic_values(found.dae, float(times[k]), found.states[:, i], values)
            found.algebraics[:, i] = z
        return [found.states[:, rows], found.algebraics[:, rows]]

    def slopes(self, x: Vector, p: Vector, u: Vector) -> list[Vector]:
        """Return the derivatives of `ends` by x, the unknowns, p and u, block by block."""
        dae, n = self.dae, len(self.times)
        nx, nz = dae.x.numel(), dae.z.numel()
        own = np.concatenate((x, p, u.T.ravel()))
        nominal = [v.nominal for v in (*dae.states, *dae.parameters, *dae.inputs * n)]
        columns = list[Vector]()
        for along in np.diag(np.maximum(np.abs(own), nominal)):  # far above absolute tolerances
            by_x, by_p, by_u = np.split(along, np.cumsum([len(x), len(p)]))
            moved = np.concatenate((u, by_u.reshape(n, -1).T))
            both = np.append(x, by_x), np.append(p, by_p)
            states, unknowns = self.ends(*both, moved, _variational(dae))
            rates = np.concatenate((states[nx:].T.ravel(), unknowns[nz:].T.ravel()))
            columns.append(rates / along.sum())
        blocks = list[Vector]()
        for rows in np.split(np.transpose(columns), [n * len(x)]):
            by_x, by_p, by_u = np.split(rows, np.cumsum([len(x), len(p)]), axis=1)
            blocks += [by_x, np.zeros((len(rows), nz)), by_p, by_u]
        return blocks


def _hybrid_function(
    dae: Dae, times: Vector, solver: Solver, compiled: bool, derivatives: bool
) -> ca.Function:
    """Return a function like that of `integrator`, for a model with events; z0 has no effect."""
    runs = _HybridRuns(dae, times, solver, compiled)
    n, nx, nz = len(times), dae.x.numel(), dae.z.numel()
    inner = [(nx, 1), (nz, 1), (dae.p.numel(), 1), (dae.u.numel(), n)]
    outer, jacobian = [(nx, n), (nz, n)], None
    given = [MX.sym(name, *shape) for name, shape in zip(_ARGUMENTS, inner, strict=True)]
    if derivatives:
        blocks = [(k * n, rows * columns) for k in (nx, nz) for rows, columns in inner]
        called = _Called(_LINEAR, [*inner, *outer], blocks, runs.slopes)
        symbols = called.mx_in()
        jacobian = ca.Function("jac_integrator", symbols, called.call(symbols))
    return _with_jacobian(given, _Called("run", inner, outer, runs.ends).call(given), jacobian)


def integrator(
    dae: Dae | str,
    grid: ArrayLike,
    *,
    solver: str | Solver | None = None,
    relative_tolerance: float | None = None,
    absolute_tolerance: float | None = None,
    step_size: float | None = None,
    compiled: bool | None = None,
    derivatives: bool | None = None,
) -> ca.Function:
    """Return a function in CasADi's integrator API, to embed, map or differentiate.

    Args:
        dae: The model, or its name.
        grid: Increasing output times, s, (n,); the first is the start of the run.
        solver, relative_tolerance, absolute_tolerance: See `simulate`.
        compiled: Whether the equations are compiled; small models are when None.
        step_size: Largest step of a solver with fixed steps, s; the model's output interval when
            None. Steps end at every output time.
        derivatives: Whether the function has derivatives, which take time to build and, if
            compiled, a second library. When None, they are omitted if the Jacobian of the run
            would have more than 3 million elements.

    Returns:
        `(x0, z0, p, u) -> (xf, zf)` with one column per time of the grid, in the order of `dae.x`,
        `dae.z`, `dae.p`, `dae.u`, SI units. An omitted argument is 0; `start_vectors` returns
        consistent ones. `u` has one column per time, (nu, n): each applies to the interval that
        ends at its time, so that the first has no effect. A single column applies to all
        intervals. Forward and reverse derivatives are those of the solution, to the tolerance of
        the solver, or those of the steps if these are fixed. Second derivatives exist with
        `compiled=False`, without events. Of a model with events, CasADi calls back to Python.

    Raises:
        ParameterError: The grid is not increasing or not finite.
        UsageError: Derivatives are requested for too long a grid; also see `simulate`.
        UnknownName, MissingTool: See `simulate`.

    Example:
        >>> import cosim
        >>> dae = cosim.load("crank_shaft")
        >>> run = integrator(dae, [0.0, 0.5, 1.0], solver="erk", compiled=False)
        >>> run(**cosim.start_vectors(dae))["xf"].shape
        (2, 3)
    """
    dae = model_of("integrator", dae)
    times = checked_grid(grid)
    requested = requested_solver(dae, solver, relative_tolerance, absolute_tolerance, step_size)
    has_events = hybrid(dae) is not None
    if not has_events:
        _warn_of_short_changes(dae, times)
    chosen, _ = chosen_solver(dae, requested)
    if isinstance(chosen, FixedStep) and chosen.step_size is None:
        chosen = replace(chosen, step_size=dae.experiment.output_interval)
    nominal = Nominal.none(dae)
    if isinstance(chosen, AdaptiveSolver):  # of the model's own initial values
        own = np.array(dae.x_start), np.zeros(len(dae.algebraics))
        nominal = Nominal.declared(dae).from_start(dae, *own, chosen.tolerance.pair[1])

    compiled = compilation_of(dae, chosen, compiled).compiled
    # only then, derivatives are those of the steps
    by_casadi = isinstance(chosen, FixedStep) and not compiled and not has_events
    known = dae.x.numel() + dae.p.numel() + len(times) * dae.u.numel()
    size = len(times) * (dae.x.numel() + dae.z.numel()) * known  # elements of the Jacobian of a run
    if derivatives and not by_casadi and size > MOST_JACOBIAN_NUMBERS:
        raise UsageError(
            f"{dae.full_name}: derivatives at {len(times)} output times are {size:.0e} numbers; "
            "give fewer times, or chain several integrators"
        )
    derivatives = size <= MOST_JACOBIAN_NUMBERS if derivatives is None else derivatives
    if has_events:
        return _hybrid_function(dae, times, chosen, compiled, derivatives)
    problem = Problem(dae, times.tobytes(), None, compiled, sensitivities=by_casadi, piecewise=True)
    scaled, sizes = in_nominal_values(problem, chosen, nominal)
    built = engine_of(scaled, chosen)
    jacobian = None
    if derivatives and not by_casadi:
        jacobian = jacobian_of_run(problem, chosen, nominal)
    return _bare_function(dae, built, sizes, len(times), jacobian)


def _warn_of_short_changes(dae: Dae, times: Vector) -> None:
    """Warn of terms of a model without events that change within a part of a step."""
    pulses = pulse_times(dae, assign(dae, {}).p, float(times[0]), float(times[-1]))
    places = {"time": f"from {pulses[0]:.6g} to {pulses[-1]:.6g} s"} if len(pulses) else {}
    states = [name for name in landmarks(dae).moving if name != "time"]
    places |= dict.fromkeys(states[:1], "in a small part of its way")
    for name, place in places.items():
        warn(
            f"{dae.full_name}: a term of {name} changes {place}, which CasADi's integrators may "
            "step over; divide the grid there into several integrators, or use cosim.simulate",
            stacklevel=4,
        )


def _bare_function(
    dae: Dae, built: Engine, nominal: Nominal, n: int, jacobian: ca.Function | None
) -> ca.Function:
    x0, z0 = MX.sym("x0", dae.x.numel()), MX.sym("z0", dae.z.numel())
    p, u = MX.sym("p", dae.p.numel()), MX.sym("u", dae.u.numel(), n)
    run, extended = built.functions
    parameters = p if extended is None else extended(p)
    held = ca.horzcat(u[:, min(1, n - 1)], u[:, 1:])  # the first column has no effect
    inputs = {"u": held} if dae.inputs else {}  # CasADi cannot map over empty columns
    x, z = ca.DM(nominal.x), ca.DM(nominal.z)
    result = run(x0=x0 / x, z0=z0 / z, p=parameters, **inputs)
    unscaled = [ca.densify(result[name]) for name in ("xf", "zf")]
    columns = [rows * ca.repmat(size, 1, n) for rows, size in zip(unscaled, (x, z), strict=True)]
    return _with_jacobian([x0, z0, p, u], columns, jacobian)


def _with_jacobian(
    given: Sequence[MX], results: Sequence[MX], jacobian: ca.Function | None
) -> ca.Function:
    """Return the function of an integrator; all its derivatives follow from a Jacobian, if any."""
    what = "integrator", given, results, _ARGUMENTS, ["xf", "zf"]
    if jacobian is None:
        return ca.Function(*what)
    options: dict[str, Any] = {"custom_jacobian": jacobian}
    inner = ca.Function(*what, options | _BY_JACOBIAN)
    options["always_inline"] = True  # `factory` keeps the options of this one without its Jacobian
    return ca.Function("integrator", given, inner.call(given), *what[3:], options)


def start_vectors(
    dae: Dae | str, start_values: Mapping[str, float] | None = None
) -> dict[str, Vector]:
    """Return consistent arguments `x0`, `z0`, `p`, `u` of an `integrator`, SI units.

    Raises:
        UnknownName, ParameterError, InitialConditionError: See `simulate`.

    Example:
        >>> import cosim
        >>> start_vectors(cosim.load("crank_shaft"), {"omega": 10.0})["x0"]
        array([ 0., 10.])
    """
    dae = model_of("start_vectors", dae)
    values = assign(dae, start_values)
    x0, z0 = consistent_values(dae, 0.0, values)
    return {"x0": x0, "z0": z0, "p": values.p, "u": values.u}
