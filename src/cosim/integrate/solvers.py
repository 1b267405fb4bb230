"""The solvers of road one by name."""

from casadi_models.dae import Dae
from cosim.codegen.compiler import find_compiler
from cosim.errors import UnknownName, UsageError
from cosim.integrate.engine import Engine, Problem
from cosim.integrate.families.casadi_rk import Erk, Rosenbrock
from cosim.integrate.families.explicit import Dop853
from cosim.integrate.families.fixed_step import FixedStep, Ode8, Rk4
from cosim.integrate.families.sundials import Cvodes, CvodesAdams, Idas
from cosim.integrate.solver import Solver, Tolerance
from cosim.memo import kept_per_thread
from cosim.model.values import A_DAE

NUMBERS = ("relative_tolerance", "absolute_tolerance", "step_size")
SOLVERS: dict[str, type[Solver]] = {
    solver.name: solver
    for solver in (
        Cvodes,
        CvodesAdams,
        Idas,
        Erk,
        Rosenbrock,
        Rk4,
        Ode8,
        Dop853,
    )
}


# MATLAB's names; ode15s is what a model's own default does
ALIASES = {"ode45": "erk", "ode113": "cvodes_adams", "ode4": "rk4"}
STIFF_DEFAULT = "ode15s"


def solver_name(dae: Dae, name: str) -> str:
    """Return the name of a solver for itself or an alias."""
    if name == STIFF_DEFAULT:
        return Idas.name if dae.algebraics else Cvodes.name
    return ALIASES.get(name, name)


def solver_class(dae: Dae, solver: str | Solver | None, *, projected: bool = False) -> type[Solver]:
    """Return the class of a solver: CVODES for an ODE, IDAS for a DAE when None.

    Args:
        dae: The model.
        solver: A solver, or the name of one.
        projected: Whether its steps are to be projected. Fixed steps take algebraic unknowns then:
            without error control, drift would be all that one sees of them.

    Raises:
        UnknownName: There is no such solver.
        UsageError: It cannot integrate algebraic unknowns, or this is no model.
    """
    if not isinstance(dae, Dae):
        raise UsageError.of_type("a solver", dae, A_DAE)
    default = Idas if dae.algebraics else Cvodes
    if isinstance(solver, str):
        solver = solver_name(dae, solver)
    if isinstance(solver, Solver):
        found = type(solver)
    elif solver is None:
        found = default
    elif isinstance(solver, str) and solver in SOLVERS:
        found = SOLVERS[solver]
    else:
        raise UnknownName.among("cosim", "solver", str(solver), SOLVERS)
    if dae.algebraics and not (found.solves_dae or (projected and found.projects)):
        able = " or ".join(key for key, value in SOLVERS.items() if value.solves_dae)
        also = ", or drift control by projection" if found.projects and dae.invariants else ""
        raise UsageError(
            f"{dae.full_name} has algebraic unknowns, which {found.name} cannot integrate; "
            f"use {able}{also}"
        )
    return found


def chosen_solver(
    dae: Dae,
    solver: str | Solver | None = None,
    relative_tolerance: float | None = None,
    absolute_tolerance: float | None = None,
    step_size: float | None = None,
    *,
    projected: bool = False,
) -> Solver:
    """Return a solver as a value: itself, or what a name and its numbers stand for.

    Raises:
        UnknownName, UsageError: See `solver_class`; or the numbers are not those of the solver.
        ParameterError: A number is out of its range.
    """
    found = solver_class(dae, solver, projected=projected)
    numbers = (relative_tolerance, absolute_tolerance, step_size)
    given = {k: v for k, v in zip(NUMBERS, numbers, strict=True) if v is not None}
    if isinstance(solver, Solver):
        if given:
            raise UsageError(
                f"{dae.full_name}: {' and '.join(given)} given beside {solver}; write them into "
                f"{found.__name__}(...)"
            )
        return solver
    if issubclass(found, FixedStep):
        Tolerance(given.pop("relative_tolerance", Tolerance().relative))  # of no use to it
        if "absolute_tolerance" in given:
            raise UsageError(f"{found.name} has no error control; leave absolute_tolerance out")
    elif "step_size" in given:
        fixed = " or ".join(name for name, other in SOLVERS.items() if not other.adaptive)
        raise UsageError(f"{found.name} chooses its own steps; leave step_size out or use {fixed}")
    return found(**given)


@kept_per_thread(32)
def engine_of(problem: Problem, solver: Solver) -> Engine:
    """Return the engine of a solver for a problem; the thread's latest ones are kept.

    Raises:
        UsageError, ParameterError, MissingTool: See `Solver.engine`.
    """
    if problem.project and not (solver.projects and problem.compiled):
        able = ", ".join(name for name, other in SOLVERS.items() if other.projects)
        raise UsageError(
            f"{solver.name} does not project its steps; {able} do, compiled: use one of them, or "
            "another drift control"
        )
    if solver.compiled_only and not problem.compiled:
        find_compiler()  # says what is missing
        raise UsageError(
            f"{solver.name} exists as compiled code only; use erk for interpreted runs"
        )
    return solver.engine(problem)
