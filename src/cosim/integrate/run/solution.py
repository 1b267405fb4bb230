"""From a problem and its numbers to everything observable on the grid."""

from dataclasses import dataclass, replace

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.errors import UnknownName, UsageError
from cosim.integrate.diagnosis.crossing import crossings, watching_rank
from cosim.integrate.diagnosis.validity import Breach, breaches, too_coarse
from cosim.integrate.engine import Counts, Engine, Problem
from cosim.integrate.families.fixed_step import FixedStep
from cosim.integrate.initial_values import algebraic_values, start_values
from cosim.integrate.run.attempts import Start, integrated
from cosim.integrate.run.call import INTERRUPTED, call
from cosim.integrate.run.outputs import all_columns, observe
from cosim.integrate.solver import Solver
from cosim.integrate.solvers import engine_of
from cosim.model.inputs import InputSeries
from cosim.model.values import Values


@dataclass(frozen=True)
class Solution:
    """Rows of everything observable up to the last good time of a grid, and why it ended.

    Attributes:
        grid: Output times that were wanted, s, (n,).
        table: What `all_columns` names, one row per time that was reached.
        counts: What the solver took.
        solve_time: What it took, s; None where there was nothing to integrate.
        reason: Why it ended early; empty where it did not.
        invalid: Where the run leaves what its model, or its fixed step, is good for.
        note: What was done that was not asked for; empty where nothing was.
    """

    grid: Vector
    table: Vector
    counts: Counts
    solve_time: float | None
    reason: str
    invalid: tuple[Breach, ...]
    note: str


def solve(problem: Problem, solver: Solver, values: Values, on_invalid: str) -> Solution:
    """Integrate, and evaluate what a run records.

    Raises:
        CosimError: See `simulate`.
    """
    dae, grid = problem.dae, problem.grid
    x0 = start_values(dae, values)
    u = input_values(dae, grid, values, problem.inputs)
    z0 = algebraic_values(dae, grid[0], x0, replace(values, u=u[:, 0]))
    states, guesses = (np.tile(start[:, None], len(grid)) for start in (x0, z0))
    counts, solve_time = Counts(), None
    reason, note, found = "", "", list[Breach]()
    if len(grid) > 1 and dae.states:
        start = Start(x0, z0, replace(values, u=u[:, 0]))
        reached, note = integrated(problem, solver, start)
        counts, solve_time = reached.counts, reached.solve_time
        states, guesses, reason = reached.states, reached.algebraics, reached.reason
        if isinstance(solver, FixedStep) and not reason and on_invalid != "ignore":
            found, reason = _step_check(problem, solver, states, z0, values)
    n = states.shape[1]
    watched = dae if problem.project or on_invalid == "ignore" else watching_rank(dae)
    u = u[:, :n]
    table, margins = observe(watched, grid[:n], states, guesses, u, values.p, problem.compiled)
    bad = np.flatnonzero(~np.isfinite(table).all(axis=1))
    if bad.size:
        n = int(bad[0])
        name = all_columns(dae)[int(np.argmin(np.isfinite(table[n])))].name
        reason = reason or f"{name} is not finite at {grid[n]:g} s"
    if on_invalid != "ignore":
        margins = margins[:n]
        found += breaches(dae, grid[:n], margins[:, : len(dae.limits)])
        if watched is not dae:
            found += _crossings(dae, grid[:n], table[:n], u[:, :n], values.p, margins[:, -1])
        found.sort()
        if found and on_invalid == "stop":
            n, reason = found[0]
    return Solution(grid, table[:n], counts, solve_time, reason, tuple(found), note)


def input_values(dae: Dae, grid: Vector, values: Values, inputs: InputSeries | None) -> Vector:
    """Return every input at the output times, (nu, n).

    Raises:
        UnknownName: A series is of no input of the model.
    """
    table = np.tile(values.u[:, None], len(grid))
    if not isinstance(inputs, InputSeries | None):
        raise UsageError.of_type(f"{dae.full_name}: inputs", inputs, "what read_inputs returns")
    if inputs is not None:
        known = [variable.name for variable in dae.inputs]
        for name, row in zip(inputs.names, inputs.at(grid), strict=True):
            if name not in known:
                raise UnknownName.among(dae.full_name, "input", name, known)
            table[known.index(name)] = row
    return table


def _crossings(
    dae: Dae, grid: Vector, table: Vector, u: Vector, p: Vector, rank: Vector
) -> list[Breach]:
    nx, nz = len(dae.states), len(dae.algebraics)
    return crossings(dae, grid, table[:, :nx].T, table[:, nx : nx + nz].T, u, p, rank)


def _step_check(
    problem: Problem, solver: FixedStep, states: Vector, z0: Vector, values: Values
) -> tuple[list[Breach], str]:
    """Repeat a run of fixed steps with half of them; say where the states part.

    Returns:
        What is found, and whether that was interrupted (then nothing is).
    """
    step = solver.step(problem)
    engine: Engine = engine_of(problem, replace(solver, step_size=step / 2))
    finer = call(engine, states[:, 0], z0, values.p, values.u)
    if finer.reason == INTERRUPTED:
        return [], INTERRUPTED
    return too_coarse(problem.dae, problem.grid, states, finer.states, step), ""
