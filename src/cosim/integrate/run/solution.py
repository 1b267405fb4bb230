"""From a problem and its numbers to everything observable on the grid."""

from dataclasses import dataclass, replace
from math import isfinite

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.integrate.diagnosis.crossing import crossings, watching_rank
from cosim.integrate.diagnosis.validity import Breach, breaches, too_coarse
from cosim.integrate.engine import Counts, Problem
from cosim.integrate.families.fixed_step import FixedStep
from cosim.integrate.initial_values import algebraic_values, start_values
from cosim.integrate.run.attempts import Start
from cosim.integrate.run.call import INTERRUPTED
from cosim.integrate.run.outputs import Observed, Solved, all_columns, observe
from cosim.integrate.run.pieces import input_values, integrated_by_pieces
from cosim.integrate.solver import Solver
from cosim.model.values import Values


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
        start = Start(x0, z0, replace(values, u=u[:, 0]))
        reached, note = integrated_by_pieces(problem, solver, start)
        counts, solve_time = reached.counts, reached.solve_time
        states, guesses, reason = reached.states, reached.algebraics, reached.reason
        if isinstance(solver, FixedStep) and not reason and on_invalid != "ignore":
            found, reason = _step_check(problem, solver, states, start)
    else:
        states, guesses = (np.tile(start[:, None], len(grid)) for start in (x0, z0))
    n = states.shape[1]
    limits = on_invalid != "ignore"
    watched = watching_rank(dae) if limits and not problem.project else dae
    ranked = watched is not dae
    solved = Solved(grid[:n], states, guesses, u[:, :n], values.p)
    compiled = problem.compiled
    seen = observe(watched, solved, places, limits=limits, margins=ranked, compiled=compiled)
    if seen.lost < n:
        n, name = seen.lost, _not_finite(dae, solved, seen, places)
        reason = reason or f"{name} is not finite at {grid[n]:g} s"
    if limits:
        found += breaches(dae, grid[:n], seen.left[: len(dae.limits)])
        if ranked:
            found += _crossings(dae, solved, seen, n)
        found.sort()
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


def _crossings(dae: Dae, solved: Solved, seen: Observed, n: int) -> list[Breach]:
    """Return where constraints lose rank before the time at position n."""
    u = np.broadcast_to(solved.u, (len(solved.u), len(solved.time)))[:, :n]
    unknowns, rank = seen.unknowns[:n].T, seen.margins[:n, -1]
    return crossings(dae, solved.time[:n], solved.states[:, :n], unknowns, u, solved.p, rank)


def _step_check(
    problem: Problem, solver: FixedStep, states: Vector, start: Start
) -> tuple[list[Breach], str]:
    """Repeat a run of fixed steps with half of them; say where the states part.

    Returns:
        What is found, and whether that was interrupted (then nothing is).
    """
    step = solver.step(problem)
    finer, _ = integrated_by_pieces(problem, replace(solver, step_size=step / 2), start)
    if finer.reason == INTERRUPTED:
        return [], INTERRUPTED
    return too_coarse(problem.dae, problem.grid, states, finer.states, step), ""
