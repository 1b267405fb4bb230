"""From a problem and its numbers to everything observable on the grid."""

from dataclasses import dataclass, replace
from math import isfinite
from time import perf_counter

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.functions import equations
from cosim.errors import UnknownName, UsageError
from cosim.integrate.call import INTERRUPTED, Reached, call
from cosim.integrate.engine import Counts, Engine, Problem
from cosim.integrate.families.fixed_step import FixedStep
from cosim.integrate.initial_values import algebraic_values, start_values
from cosim.integrate.outputs import Observed, Solved, all_columns, observe
from cosim.integrate.solver import Solver
from cosim.integrate.solvers import engine_of
from cosim.integrate.validity import Breach, breaches, too_coarse
from cosim.model.inputs import InputSeries
from cosim.model.values import Values

Numbers = tuple[Vector, Vector, Vector, Vector]  # start of x, guess of z, p, u


@dataclass(frozen=True)
class Solution:
    """Rows of everything observable up to the last good time of a grid, and why it ended.

    Attributes:
        grid: Output times that were wanted, s, (n,).
        table: What is recorded, one row per time that was reached.
        last: States, and algebraic unknowns, at the last of these times; empty without one.
        counts: What the solver took.
        solve_time: What it took, s; None where there was nothing to integrate.
        reason: Why it ended early; empty where it did not.
        invalid: Where the run leaves what its model, or its fixed step, is good for.
        note: What was done that was not asked for; empty where nothing was.
    """

    grid: Vector
    table: Vector
    last: tuple[Vector, Vector]
    counts: Counts
    solve_time: float | None
    reason: str
    invalid: tuple[Breach, ...]
    note: str


def solve(
    problem: Problem, solver: Solver, values: Values, on_invalid: str, places: tuple[int, ...]
) -> Solution:
    """Integrate, and evaluate what a run records: `places` among `all_columns`.

    Raises:
        CosimError: See `simulate`.
    """
    dae, grid = problem.dae, problem.grid
    x0 = start_values(dae, values)
    u = input_values(dae, grid, values, problem.inputs)
    z0 = algebraic_values(dae, grid[0], x0, replace(values, u=u[:, 0]))
    counts, solve_time = Counts(), None
    reason, note, found = "", "", list[Breach]()
    if len(grid) > 1 and dae.states:
        engine = engine_of(problem, solver)
        ready = perf_counter()
        numbers = (x0, z0, values.p, values.u)
        reached = _reached(engine, numbers, dae, grid[0], replace(values, u=u[:, 0]))
        failed = reached.reason not in ("", INTERRUPTED)
        lenient = engine.fallback(reached.reason) if failed and engine.fallback else None
        if lenient is not None:
            other = _reached(lenient, numbers, dae, grid[0], replace(values, u=u[:, 0]))
            if not other.reason:
                note = f"without errors of algebraic unknowns, with which: {reached.reason}"
                reached = other
        counts, solve_time = reached.counts, perf_counter() - ready
        states, guesses, reason = reached.states, reached.algebraics, reached.reason
        if isinstance(solver, FixedStep) and not reason and on_invalid != "ignore":
            found, reason = _step_check(problem, solver, states, z0, values)
    else:
        states, guesses = (np.tile(start[:, None], len(grid)) for start in (x0, z0))
    n = states.shape[1]
    solved = Solved(grid[:n], states, guesses, u[:, :n], values.p)
    limits = on_invalid != "ignore"
    seen = observe(dae, solved, places, limits=limits, compiled=problem.compiled)
    if seen.lost < n:
        n, name = seen.lost, _not_finite(dae, solved, seen, places)
        reason = reason or f"{name} is not finite at {grid[n]:g} s"
    if limits:
        found = sorted([*found, *breaches(dae, grid[:n], seen.left)])
        if found and on_invalid == "stop":
            n, reason = found[0]
    last = (states[:, n - 1], seen.unknowns[n - 1]) if n else (np.empty(0), np.empty(0))
    return Solution(grid, seen.table[:n], last, counts, solve_time, reason, tuple(found), note)


def _not_finite(dae: Dae, solved: Solved, seen: Observed, places: tuple[int, ...]) -> str:
    """Return the name of the first variable that has no number at the first such time."""
    row = np.concatenate((solved.states[:, seen.lost], seen.unknowns[seen.lost]))
    numbers = dict(enumerate(row.tolist())) | dict(
        zip(places, seen.table[seen.lost].tolist(), strict=True)
    )
    place = min(place for place, value in numbers.items() if not isfinite(value))
    return all_columns(dae)[place].name


def input_values(dae: Dae, grid: Vector, values: Values, inputs: InputSeries | None) -> Vector:
    """Return every input at the output times, (nu, n); (nu, 1) where all are constant.

    Raises:
        UnknownName: A series is of no input of the model.
    """
    if not isinstance(inputs, InputSeries | None):
        raise UsageError.of_type(f"{dae.full_name}: inputs", inputs, "what read_inputs returns")
    if inputs is None:
        return values.u[:, None]
    table = np.tile(values.u[:, None], len(grid))
    known = [variable.name for variable in dae.inputs]
    for name, row in zip(inputs.names, inputs.at(grid), strict=True):
        if name not in known:
            raise UnknownName.among(dae.full_name, "input", name, known)
        table[known.index(name)] = row
    return table


def _reached(engine: Engine, numbers: Numbers, dae: Dae, t: float, values: Values) -> Reached:
    """Call an engine, once more where it fails at a start that is consistent."""
    reached = call(engine, *numbers)
    if engine.restart is not None and not _started(reached):
        x0, z0, *_ = numbers
        reached = call(engine.restart(_slopes(dae, t, x0, z0, values)), *numbers)
    return reached


def _started(reached: Reached) -> bool:
    return reached.states.shape[1] > 0 or reached.reason in ("", INTERRUPTED)


def _slopes(dae: Dae, t: float, x: Vector, z: Vector, values: Values) -> Vector:
    """Return dx/dt at a consistent state, (nx,)."""
    ode, _ = equations(dae)(t, x, z, values.u, values.p)
    return np.array(ode).ravel()


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
