"""Variants of a request for comparison: another solver, formulation or backend."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

from cosim.backend import Backend
from cosim.errors import UnknownName
from cosim.integrate.solvers import SOLVERS, requested_solver, solver_named
from cosim.model.catalogue import formulations, loaded, no_such_output, observable
from cosim.model.request import RunRequest
from cosim.model.solver import AdaptiveSolver, Goal, Solver


def variant(request: RunRequest, name: str) -> tuple[RunRequest, Backend]:
    """Return the same run by another backend, solver or formulation, for comparison.

    Args:
        name: A backend, a solver, or a formulation of the model.

    Raises:
        UnknownName: It is none of them, or that formulation lacks an output.
    """
    if name in SOLVERS:
        return with_solver(request, name), Backend.NATIVE
    others = other_formulations(request)
    if name in others:
        return in_formulation(request, others[name]), Backend.NATIVE
    if name in tuple(Backend):
        has_goal = isinstance(request.solver, Goal)
        return replace(request, solver=None) if has_goal else request, Backend(name)
    known = (*Backend, *SOLVERS, *others)
    kind = "backend, solver or formulation"
    raise UnknownName.among(request.dae.full_name, kind, name, known)


def with_solver(request: RunRequest, name: str) -> RunRequest:
    """Return a request with another solver; tolerances are retained, a goal is dropped.

    Raises:
        UnknownName: There is no such solver.
    """
    kind = solver_named(request.dae, name)
    tolerance = request.tolerance
    if tolerance is None or not issubclass(kind, AdaptiveSolver):
        step = getattr(request.solver, "step_size", None) if not kind.adaptive else None
        return replace(request, solver=requested_solver(request.dae, name, step_size=step))
    return replace(request, solver=kind(**tolerance.numbers))


def in_formulation(request: RunRequest, model: str) -> RunRequest:
    """Return a request with another formulation of its model.

    If the solver cannot integrate that formulation, the default replaces it.

    Raises:
        UnknownName: The formulation lacks an output of the request, or a value that it sets.
    """
    dae, solver = loaded(model), request.solver
    for name in request.outputs or ():
        if name not in observable(dae):
            raise no_such_output(dae, name)
    exact = {v.name for v in (*dae.states, *dae.parameters, *dae.inputs) if v.start is not None}
    exact |= {rule.variable.name for rule in dae.start_outputs}
    for name in request.values:
        if name not in exact:
            raise UnknownName(f"{model} has no settable value '{name}', which the request sets")
    if dae.algebraics and isinstance(solver, Solver) and not solver.solves_dae:
        solver = request.tolerance
    return replace(request, dae=dae, solver=solver)


def fitting_formulations(request: RunRequest) -> Iterator[RunRequest]:
    """Yield a request in its own formulation, then in every other one that fits it.

    A formulation does not fit if it lacks an output of the request or a value that it sets.
    """
    yield request
    for name in other_formulations(request).values():
        with suppress(UnknownName):
            yield in_formulation(request, name)


def other_formulations(request: RunRequest) -> dict[str, str]:
    """Return `MODEL/FORMULATION` of the model's other formulations, by formulation."""
    try:
        every = formulations(request.dae.name)
    except UnknownName:  # a user's own model
        return {}
    return {e.partition("/")[2]: e for e in every if e != request.dae.full_name}
