"""`prepare`: the plan of a run, cached by everything but its numeric values."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_models.dae import Dae
from casadi_models.dae.events import Event
from cosim.codegen.casadi_library import sources_beside
from cosim.codegen.compiler import has_compiler, where_compilers_are
from cosim.errors import UsageError
from cosim.integrate.engine import Problem
from cosim.integrate.families.fixed_step import FixedStep
from cosim.integrate.modes import hybrid
from cosim.integrate.outputs import all_columns, recorded_columns, watching
from cosim.integrate.solvers import chosen_solver
from cosim.integrate.validity import times_between
from cosim.memo import cached_per_thread
from cosim.model import formula
from cosim.model.driving import names_of
from cosim.model.inputs import InputSeries
from cosim.model.request import DriftControl, OnInvalid, Policy, RunRequest
from cosim.model.solver import Goal, Solver, Tolerance
from cosim.model.times import Times
from cosim.trajectory import Column

STOP_WHEN = "stop_when"  # name of the event
LARGE = 5000  # operations of dx/dt and the algebraic equations; more take long to compile


class Compilation(NamedTuple):
    """Whether equations are compiled, and if not, why; an empty note reports nothing."""

    compiled: bool
    note: str = ""


@dataclass(frozen=True)
class Prepared:
    """The plan of a run, without its numeric values.

    Attributes:
        problem: The equations and the times at which they are integrated.
        solver: The solver with the requested numbers.
        inner: The same solver with the tolerance that it runs with; see `chosen_solver`.
        note: Why the equations are not compiled; empty if there is nothing to report.
        on_invalid: What happens if a validity condition is violated; see `Policy`.
        columns: The recorded variables.
        places: Positions of the recorded variables among `all_columns`.
        rows: Positions of the recorded times among the problem's times; all when None.
    """

    problem: Problem
    solver: Solver
    inner: Solver
    note: str
    on_invalid: OnInvalid
    columns: tuple[Column, ...]
    places: tuple[int, ...]
    rows: NDArray[np.intp] | None

    @property
    def checks_validity(self) -> bool:
        """Whether the run is checked: validity conditions, fixed steps, singular configurations."""
        return self.on_invalid is not OnInvalid.IGNORE


def prepare(request: RunRequest) -> Prepared:
    """Return the plan of a run; equal requests share it, whatever their values.

    Raises:
        UsageError: The solver cannot integrate the model.
        ParameterError: The output times do not increase, or no memory holds the results.
        MissingTool: $CC names a compiler that does not exist.
    """
    return _prepared(
        request.dae,
        request.times,
        request.outputs,
        request.inputs,
        request.solver,
        request.policy,
        where_compilers_are(),
    )


@cached_per_thread(16)
def _prepared(
    dae: Dae,
    times: Times,
    outputs: tuple[str, ...] | None,
    inputs: InputSeries | None,
    solver: Solver | Tolerance | Goal | None,
    policy: Policy,
    _compilers: tuple[str, ...],
) -> Prepared:
    dae = controlled(dae, policy.drift_control)
    if policy.stop_when is not None:
        dae = stopping(dae, policy.stop_when)
    names = dae.observed if outputs is None else outputs
    dae = dae if outputs is None else watching(dae, outputs)
    chosen, inner = chosen_solver(dae, solver, projected=policy.projects)
    if times.own and isinstance(chosen, FixedStep) and chosen.step_size is None:
        # output times of the user's own are no steps: the distance of two of them may be any
        chosen = inner = replace(chosen, step_size=dae.experiment.output_interval)
    output_times = times.grid(dae, len(all_columns(dae)))
    if policy.stop_when is not None and len(output_times) < 2:
        raise UsageError(
            f"{dae.full_name}: stop_when '{policy.stop_when}' needs two or more output times, but "
            f"{output_times[0]:g} s is the only one; give a later stop_time"
        )
    grid = output_times
    watched = policy.on_invalid is not OnInvalid.IGNORE and not policy.projects
    if isinstance(chosen, FixedStep):  # at the ends of its steps
        if watched and chosen.step_size is not None:
            grid = times_between(dae, output_times, chosen.step_size)
    elif watched or hybrid(dae):
        grid = times_between(dae, output_times)
    recorded = times.requested if times.own else output_times
    rows = None if len(recorded) == len(grid) else np.searchsorted(grid, recorded)
    compilation = compilation_of(dae, chosen, policy.compiled)
    problem = Problem(
        dae,
        grid.tobytes(),
        inputs,
        compilation.compiled,
        sensitivities=False,
        project=policy.projects,
    )
    columns, places = recorded_columns(dae, names)
    return Prepared(
        problem, chosen, inner, compilation.note, policy.on_invalid, columns, places, rows
    )


@cached_per_thread(8)
def stopping(dae: Dae, condition: str) -> Dae:
    """Return the model with an event that ends the run when a condition becomes true.

    Args:
        dae: The model.
        condition: Comparisons of time and variables with `and` and `or`.

    Raises:
        ParameterError: The condition is malformed.
        UnknownName: A name in it does not exist.
    """
    symbols = names_of(dae)
    groups = (dae.z, dae.algebraics), (dae.u, dae.inputs), (dae.outputs, dae.output_variables)
    for column, variables in groups:
        symbols |= {v.name: s for v, s in zip(variables, ca.vertsplit(column), strict=True)}
    units = {variable.name: variable.unit for variable in dae.variables}
    holds = formula.condition(f"{dae.full_name}: stop_when", condition, symbols, units)
    event = Event(STOP_WHEN, holds, (), ca.SX(0, 1), message=condition)
    return replace(dae, events=(*dae.events, event))


def compilation_of(dae: Dae, solver: Solver, requested: bool | None = None) -> Compilation:
    """Return whether the equations are compiled: as requested, else if the model is small.

    Args:
        dae: The model.
        solver: The solver that integrates it.
        requested: True, False, or None for "if the model is small".

    Raises:
        MissingTool: $CC names a compiler that does not exist.
    """
    if requested is not None:
        return Compilation(requested)
    if not has_compiler():
        return Compilation(
            False, 'interpreted: there is no C compiler; bring one: pip install "cosim-rigid[zig]"'
        )
    if solver.compiled_only:
        return Compilation(True)
    if reason := _without_code(dae):
        return Compilation(False, f"interpreted: {reason}")
    operations = _operations(dae)
    if operations <= LARGE:
        return Compilation(True)
    return Compilation(
        False,
        f"interpreted: the model has {operations} operations, and more than {LARGE} take long to "
        "compile; to compile them, give compiled=True",
    )


@cached_per_thread(64)
def _without_code(dae: Dae) -> str:
    """Return which external library of the model has no C code; empty if there is none."""
    try:
        sources_beside(ca.Function("laws", dae.arguments, [dae.ode, dae.alg, dae.outputs]))
    except UsageError as error:
        return str(error)
    return ""


@cached_per_thread(64)
def _operations(dae: Dae) -> int:
    return int(ca.Function("laws", dae.arguments, [dae.ode, dae.alg]).n_instructions())


def controllable(dae: Dae, control: DriftControl) -> bool:
    """Return whether a drift control can be applied to a model."""
    try:
        controlled(dae, control)
    except UsageError:
        return False
    return True


def controlled(dae: Dae, control: DriftControl | None) -> Dae:
    """Return the model with the Baumgarte stabilization rate that a drift control requires.

    Raises:
        UsageError: The drift control cannot be applied to the model.
    """
    if control is None:
        return dae
    if control is DriftControl.BAUMGARTE:
        if dae.closing is None or not dae.closing.rate:
            raise UsageError(
                f"{dae.full_name} has no Baumgarte stabilization rate; leave drift_control out"
            )
        return dae
    if control is DriftControl.PROJECTION and not dae.invariants:
        raise UsageError(
            f"{dae.full_name} satisfies its constraints exactly: there is nothing to project; "
            "leave drift_control out"
        )
    return dae if dae.closing is None else _undamped(dae)


@cached_per_thread(16)
def _undamped(dae: Dae) -> Dae:
    return dae.closing_at(0.0)
