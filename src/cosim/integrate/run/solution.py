"""From a problem and its numbers to everything observable on the grid."""

from dataclasses import dataclass, replace
from math import isfinite

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.integrate.diagnosis.crossing import RankLoss, rank_losses, watching_rank
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
        failed: Whether that was the solver's doing.
        invalid: Where the run leaves what its model, or its fixed step, is good for.
        note: What was done that was not asked for; empty where nothing was.
        rank_loss: The first position that it crosses in which constraints lose rank.
        rank: How far they are from that at the last good time, 1 at best; infinite where nobody
            looks.
    """

    grid: Vector
    table: Vector
    last: tuple[Vector, Vector]
    counts: Counts
    solve_time: float | None
    reason: str
    failed: bool
    invalid: tuple[Breach, ...]
    note: str
    rank_loss: RankLoss | None = None
    rank: float = np.inf


def solve(
    problem: Problem, solver: Solver, values: Values, on_invalid: str, places: tuple[int, ...]
) -> Solution:
    """Settle where a run begins, integrate, and evaluate what it records.

    Args:
        problem: What is integrated.
        solver: By what.
        values: Its numbers.
        on_invalid: See `simulate`.
        places: What is recorded, among `all_columns`.

    Raises:
        CosimError: See `simulate`.
    """
    u = input_values(problem.dae, problem.grid, values, problem.inputs)
    start = _settled(problem, values, u)
    motion = _moved(problem, solver, start, looking=on_invalid != "ignore")
    return _recorded(problem, motion, u, places, on_invalid)


@dataclass(frozen=True)
class _Motion:
    """States and algebraic unknowns, (nx, n) and (nz, n), and how they came about; see `Solution`.

    Those of the latter are guesses, which the equations decide on.
    """

    start: Start
    states: Vector
    guesses: Vector
    counts: Counts
    solve_time: float | None
    reason: str = ""
    note: str = ""
    invalid: tuple[Breach, ...] = ()


def _settled(problem: Problem, values: Values, u: Vector) -> Start:
    """Return where a run begins, with its inputs there."""
    dae, begin = problem.dae, float(problem.grid[0])
    first = Values(values.x, values.p, u[:, 0])
    x0 = start_values(dae, begin, first)
    return Start(x0, algebraic_values(dae, begin, x0, first), first)


def _moved(problem: Problem, solver: Solver, start: Start, *, looking: bool) -> _Motion:
    """Integrate from the start; a model without states, or one time, stays there."""
    n = len(problem.grid)
    if n == 1 or not problem.dae.states:
        states, guesses = (np.tile(row[:, None], n) for row in (start.x, start.z))
        return _Motion(start, states, guesses, Counts(), None)
    found, note = integrated_by_pieces(problem, solver, start)
    reason, invalid = found.reason, list[Breach]()
    if looking and isinstance(solver, FixedStep) and not reason:
        invalid, reason = _step_check(problem, solver, found.states, start)
    taken = found.counts, found.solve_time, reason, note, tuple(invalid)
    return _Motion(start, found.states, found.algebraics, *taken)


def _recorded(
    problem: Problem, motion: _Motion, u: Vector, places: tuple[int, ...], on_invalid: str
) -> Solution:
    """Evaluate what is recorded, up to where it has no number or, if asked, is invalid."""
    dae, grid, reason = problem.dae, problem.grid, motion.reason
    n = motion.states.shape[1]
    limits = on_invalid != "ignore"
    watched = watching_rank(dae) if limits and not problem.project else dae
    ranked = watched is not dae
    solved = Solved(grid[:n], motion.states, motion.guesses, u[:, :n], motion.start.values.p)
    seen = observe(
        watched, solved, places, limits=limits, margins=ranked, compiled=problem.compiled
    )
    seen.table.setflags(write=False)  # nobody has to copy it
    if seen.lost < n:
        n, name = seen.lost, _not_finite(dae, solved, seen, places)
        reason = reason or f"{name} is not finite at {grid[n]:g} s"
    found = list(motion.invalid)
    rank_loss = _first_rank_loss(dae, solved, seen, n) if ranked else None
    if limits:
        found += breaches(dae, grid[:n], seen.left[: len(dae.limits)])
        if rank_loss is not None:
            found.append(rank_loss.told(grid))
        found.sort()
        if found and on_invalid == "stop":
            n, reason = found[0]
    rank = float(seen.margins[n - 1, -1]) if ranked and n else np.inf
    last = (motion.states[:, n - 1], seen.unknowns[n - 1]) if n else (np.empty(0), np.empty(0))
    return Solution(
        grid, seen.table[:n], last, motion.counts, motion.solve_time, reason, bool(motion.reason),
        tuple(found), motion.note, rank_loss, rank,
    )  # fmt: skip


def _not_finite(dae: Dae, solved: Solved, seen: Observed, places: tuple[int, ...]) -> str:
    """Return the name of the first variable that has no number at the first such time."""
    row = np.concatenate((solved.states[:, seen.lost], seen.unknowns[seen.lost]))
    numbers = dict(enumerate(row.tolist())) | dict(
        zip(places, seen.table[seen.lost].tolist(), strict=True)
    )
    place = min(place for place, value in numbers.items() if not isfinite(value))
    return all_columns(dae)[place].name


def _first_rank_loss(dae: Dae, solved: Solved, seen: Observed, n: int) -> RankLoss | None:
    """Return where constraints lose rank before the time at position n."""
    time, states, unknowns = solved.time[:n], solved.states[:, :n], seen.unknowns[:n].T
    rank = seen.margins[:n, -1]
    return next(rank_losses(dae, time, states, unknowns, solved.u, solved.p, rank), None)


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
