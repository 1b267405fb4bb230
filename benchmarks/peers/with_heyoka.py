"""heyoka: Taylor's method, the derivatives compiled from its own symbolic expressions."""

from collections.abc import Callable, Iterator

import casadi as ca
import heyoka as hy
import numpy as np
import walk
from entries import Evaluation, Run, Solver
from problem import Problem

from casadi_models.dae import Dae

PACKAGES = ("heyoka",)
hy.llvm_state.set_diskcache_enabled(False)  # preparation includes compilation


def solvers(problem: Problem) -> Iterator[Solver]:
    variables, results = _expressions(problem)
    system = list(zip(variables, results, strict=True))
    x0, grid = problem.start["x0"], problem.grid

    def prepare(tolerance: float, compact: bool = True) -> Run:
        solver = hy.taylor_adaptive(system, x0, tol=tolerance, compact_mode=compact)

        def run() -> np.ndarray:
            solver.time = grid[0]
            solver.state[:] = x0
            return solver.propagate_grid(grid)[-1]

        return run

    # order and steps are the same in both modes; the other mode needs up to a minute of compilation
    yield Solver("heyoka", prepare, lambda tolerance: prepare(tolerance, False), tightest=1e-15)
    yield Solver("heyoka, compact mode", prepare, tightest=1e-15)


def evaluations(problem: Problem) -> Iterator[Evaluation]:
    variables, results = _expressions(problem)
    function = hy.cfunc(results, variables)
    x = np.ascontiguousarray(problem.states.T)
    dx, one, result = np.empty_like(x), x[:, 0].copy(), np.empty(len(x))
    yield Evaluation("heyoka cfunc", lambda: function(x, outputs=dx), x.shape[1])
    yield Evaluation("heyoka cfunc", lambda: function(one, outputs=result), one=True)


def stepper(
    dae: Dae, x0: np.ndarray, p: np.ndarray, shown: list[int], *, tolerance: float, step: float
) -> Callable[[list[float]], list[float]]:
    """Return what sets all inputs, advances by a step, s, and returns some states, by position.

    Args:
        dae: An explicit model.
        x0, p: Start and parameters, (nx,) and (np,).
        shown: Positions of the states.
        tolerance: Of the integration.
        step: s.
    """
    law = ca.densify(ca.substitute(dae.ode, dae.p, ca.DM(p)))
    function = ca.Function("f", [dae.t, ca.vertcat(dae.x, dae.u)], [law], {"cse": True})
    rhs = walk.build(function, "rhs", {name: getattr(hy, name) for name in walk.FUNCTIONS})
    variables = hy.make_vars(*(f"x{i}" for i in range(len(x0))))
    inputs = [hy.par[i] for i in range(len(dae.inputs))]
    results = [hy.expression(0.0) + result for result in rhs(hy.time, [*variables, *inputs])]
    system = list(zip(variables, results, strict=True))
    solver = hy.taylor_adaptive(system, x0, tol=tolerance, compact_mode=False)
    state, pars = solver.state, solver.pars

    def advance(values: list[float]) -> list[float]:
        pars[:] = values
        solver.propagate_for(step)
        return [state[i] for i in shown]

    return advance


def final_derivatives(
    dae: Dae, x0: np.ndarray, p: np.ndarray, slopes: np.ndarray, span: float
) -> Callable[[float], Run]:
    """Return what makes, for a tolerance, the run to d(final state)/d(parameters), (nx, np).

    heyoka's own variational equations, all parameters at once; in its compact mode, as the other
    one does not end for so many equations.

    Args:
        dae: An explicit model.
        x0, p: Start and parameters, (nx,) and (np,).
        slopes: d(start)/d(parameters), (nx, np).
        span: s.
    """
    nx, number = slopes.shape
    inputs = [v.start for v in dae.inputs]
    law = ca.densify(ca.substitute(dae.ode, dae.u, ca.DM(inputs)))
    function = ca.Function("f", [dae.t, ca.vertcat(dae.x, dae.p)], [law])
    rhs = walk.build(function, "rhs", {name: getattr(hy, name) for name in walk.FUNCTIONS})
    variables = hy.make_vars(*(f"x{i}" for i in range(nx)))
    parameters = [hy.par[i] for i in range(number)]
    results = [hy.expression(0.0) + result for result in rhs(hy.time, [*variables, *parameters])]
    system = hy.var_ode_sys(list(zip(variables, results, strict=True)), parameters, order=1)
    start = np.concatenate((x0, slopes.ravel()))  # a state's derivatives stand together

    def prepare(tolerance: float) -> Run:
        solver = hy.taylor_adaptive(system, start, tol=tolerance, compact_mode=True, pars=p)

        def run() -> np.ndarray:
            solver.time = 0.0
            solver.state[:] = start
            solver.propagate_until(span)
            return solver.state[nx:].reshape(nx, number).copy()

        return run

    return prepare


def _expressions(problem: Problem) -> tuple[list[hy.expression], list[hy.expression]]:
    variables = hy.make_vars(*(f"x{i}" for i in range(problem.size)))
    rhs = problem.python({name: getattr(hy, name) for name in walk.FUNCTIONS})
    return variables, [hy.expression(0.0) + result for result in rhs(hy.time, variables)]
