"""Table of solvers, and the choice of a solver by name, by tolerance, or by default."""

from dataclasses import replace
from typing import cast

import casadi as ca

from casadi_models.dae import Dae
from cosim.codegen.compiler import find_compiler
from cosim.errors import UnknownName, UsageError
from cosim.integrate.engine import Engine, Integrating, Problem
from cosim.integrate.families.casadi_rk import Erk, Rosenbrock
from cosim.integrate.families.explicit import Dop853
from cosim.integrate.families.fixed_step import FixedStep, Ode8, Rk4
from cosim.integrate.families.sundials import Cvodes, CvodesAdams, Idas
from cosim.memo import cached_per_thread
from cosim.model.request import RunRequest
from cosim.model.solver import LIMITS, AdaptiveSolver, Goal, Solver, Tolerance
from cosim.model.times import reject_rounded

SOLVERS: dict[str, type[Solver]] = {
    solver.name: solver
    for solver in (Cvodes, CvodesAdams, Idas, Erk, Rosenbrock, Rk4, Ode8, Dop853)
}

# MATLAB's names; ode15s stands for the default solver of a model
ALIASES = {"ode45": Erk.name, "ode113": CvodesAdams.name, "ode4": Rk4.name}
STIFF_DEFAULT = "ode15s"

# CVODES and IDAS are BDF methods: they control the error of each step, and these errors add up. In
# the examples (docs/examples.md), the error at a tolerance of 1e-10 is 1e-10 to 1.8e-7; with a
# thirtieth of the tolerance it is at most 5.1e-9, for 1.6 times the steps (median).
_UNCHANGED_FROM = 1e-8  # relative tolerances from here on are not changed
_LARGEST_FACTOR = 30.0  # by which a smaller tolerance is divided
_SMALLEST_TOLERANCE = 3e-12  # relative; both solvers reach it
_MOST_INTERVALS = 10  # that a step spans if the equations contain time
_LEAST_STEPS = 50  # of a run, in that case
_FACTOR_POWER = 0.75  # exponent of the tolerance: the factor is 30 at 1e-10


def solver_named(dae: Dae, name: str) -> type[Solver]:
    """Return the class of a solver by name or alias.

    Raises:
        UnknownName: There is no such solver.
    """
    if name == STIFF_DEFAULT:
        return Idas if dae.algebraics else Cvodes
    found = SOLVERS.get(ALIASES.get(name, name))
    if found is None:
        raise UnknownName.among("cosim", "solver", name, SOLVERS)
    return found


def requested_solver(
    dae: Dae,
    solver: str | Solver | None = None,
    relative_tolerance: float | None = None,
    absolute_tolerance: float | None = None,
    step_size: float | None = None,
    max_step: float | None = None,
) -> Solver | Tolerance | None:
    """Return a solver with the requested numbers.

    Returns:
        The solver; the tolerance of the model's default solver if no solver is named; None if
        no argument is set.

    Raises:
        UnknownName: There is no such solver.
        UsageError: The solver does not have one of these numbers.
        ParameterError: A number is out of its range.
    """
    numbers = relative_tolerance, absolute_tolerance, max_step, step_size
    named = zip((*LIMITS, "step_size"), numbers, strict=True)
    given = {name: value for name, value in named if value is not None}
    if isinstance(solver, Solver):
        if given:
            raise UsageError(
                f"{dae.full_name}: {' and '.join(given)} cannot be combined with the solver "
                f"{solver}; write them into {type(solver).__name__}(...)"
            )
        return solver
    if not isinstance(solver, str | None):
        raise UnknownName.among("cosim", "solver", str(solver), SOLVERS)
    found = None if solver is None else solver_named(dae, solver)
    if found is not None and issubclass(found, FixedStep):
        for name in LIMITS:
            if name in given:
                raise UsageError(f"{found.name} has no error control; leave {name} out")
    elif "step_size" in given:
        fixed = " or ".join(name for name, other in SOLVERS.items() if not other.adaptive)
        name = default_solver(dae, Tolerance()).name if found is None else found.name
        raise UsageError(f"{name} chooses its own steps; leave step_size out or use {fixed}")
    if found is not None:
        return found(**given)
    if not given:
        return None
    return Tolerance(**{name.removesuffix("_tolerance"): value for name, value in given.items()})


def default_solver(dae: Dae, tolerance: Tolerance, *, projected: bool = False) -> Solver:
    """Return CVODES for an ODE, IDAS for a DAE, DOP853 if steps are projected."""
    kind = Dop853 if projected else Idas if dae.algebraics else Cvodes
    return kind(**tolerance.numbers)


def with_largest_step(request: RunRequest) -> RunRequest:
    """Return a request in which a signal that begins late cannot be stepped over.

    While nothing moves, all error estimates are 0, and steps would grow without bound. If the
    equations contain time, or a series drives them, no step of an adaptive solver spans more than
    10 output intervals or a fiftieth of the run, unless the request sets `max_step`.

    Raises:
        ParameterError: `max_step` is within the rounding of times.
    """
    dae, solver = request.dae, request.solver or Tolerance()
    if not isinstance(solver, Tolerance | AdaptiveSolver):
        return request
    begin, end = request.times.span(dae)
    if solver.max_step is not None:
        reject_rounded("max_step", solver.max_step, begin, end)
        return request
    if end == begin or not is_driven(request):
        return request
    largest = min(_MOST_INTERVALS * request.times.mean_interval(dae), (end - begin) / _LEAST_STEPS)
    return replace(request, solver=replace(solver, max_step=largest))


def is_driven(request: RunRequest) -> bool:
    """Return whether the equations contain time explicitly, or a series drives them."""
    return request.inputs is not None or contains_time(request.dae)


@cached_per_thread(64)
def contains_time(dae: Dae) -> bool:
    """Return whether the equations contain time explicitly."""
    return bool(ca.depends_on(ca.vertcat(dae.ode, dae.alg), dae.t))


def chosen_solver(
    dae: Dae, solver: Solver | Tolerance | Goal | None, *, projected: bool = False
) -> tuple[Solver, Solver]:
    """Return the requested solver, and the same solver with the tolerance that it runs with.

    They differ if the default solver has a tight tolerance, which is read as the desired accuracy
    of the result.

    Args:
        dae: The model.
        solver: A solver, a tolerance, or None for the default; see `RunRequest`.
        projected: Whether steps are projected onto the constraints. Only then can methods of fixed
            steps, which have no error control, integrate algebraic unknowns.

    Raises:
        UsageError: The solver cannot integrate algebraic unknowns, or a goal was not resolved.
    """
    if isinstance(solver, Goal):
        raise UsageError(
            f"{dae.full_name}: an accuracy or a budget can choose the solver of a complete run "
            "only; give a solver and a tolerance"
        )
    if not isinstance(solver, Solver):
        found = default_solver(dae, solver or Tolerance(), projected=projected)
        return found, _tightened(found)
    if dae.algebraics and not (solver.solves_dae or (projected and solver.projects)):
        able = " or ".join(key for key, value in SOLVERS.items() if value.solves_dae)
        also = ", or drift control by projection" if solver.projects and dae.invariants else ""
        raise UsageError(
            f"{dae.full_name} has algebraic unknowns, which {solver.name} cannot integrate; "
            f"use {able}{also}"
        )
    return solver, solver


def _tightened(solver: Solver) -> Solver:
    """Return a default solver with the tolerance that reaches a desired accuracy of the result.

    A tolerance of 1e-8 or more stays as it is, and so does one with an absolute tolerance.
    """
    if not isinstance(solver, Cvodes | Idas) or solver.absolute_tolerance is not None:
        return solver
    desired = solver.relative_tolerance
    if not 0 < desired < _UNCHANGED_FROM:
        return solver
    inner = max(
        desired / min(_LARGEST_FACTOR, (_UNCHANGED_FROM / desired) ** _FACTOR_POWER),
        _SMALLEST_TOLERANCE,
    )
    return replace(solver, relative_tolerance=min(desired, inner))


@cached_per_thread(32)
def engine_of(problem: Problem, solver: Solver) -> Engine:
    """Return the engine of a solver for a problem; each thread caches the latest engines.

    Raises:
        UsageError: The solver does not support the problem.
        ParameterError: The step size would need too many steps.
        MissingTool: The equations must be compiled, and no compiler works.
    """
    if problem.project and not (solver.projects and problem.compiled):
        able = ", ".join(name for name, other in SOLVERS.items() if other.projects)
        raise UsageError(
            f"{solver.name} cannot project its steps here; use a compiled run with {able}, or "
            "another drift control"
        )
    if solver.compiled_only and not problem.compiled:
        find_compiler()  # raises if there is none
        raise UsageError(
            f"{solver.name} exists as compiled code only; use erk for interpreted runs"
        )
    return cast(Integrating, solver).engine(problem)
