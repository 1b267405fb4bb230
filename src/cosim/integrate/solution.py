"""`solve`: integrate a prepared run for given values and evaluate what it records."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.integrate.call import INTERRUPTED
from cosim.integrate.engine import Counts, Problem
from cosim.integrate.events import integrate
from cosim.integrate.families.fixed_step import FixedStep
from cosim.integrate.initial_values import consistent_values, input_values
from cosim.integrate.modes import hybrid
from cosim.integrate.motion import EventRecord, Motion
from cosim.integrate.nominal import InitialState
from cosim.integrate.outputs import Observed, Solved, all_columns, observe
from cosim.integrate.preparation import Prepared
from cosim.integrate.validity import (
    PROJECTION,
    Breach,
    breaches,
    first_singular_configuration,
    too_coarse,
    with_singularity_margin,
)
from cosim.model.request import OnInvalid
from cosim.model.values import Values
from cosim.trajectory import Event

# Reciprocal condition number of the constraints below which a solver may have failed of it
_NEARLY_SINGULAR = 0.5


@dataclass(frozen=True)
class Solution:
    """Recorded values up to the last valid output time, and why the run stopped early.

    Attributes:
        time: Output times up to that one, s, (n,).
        table: Recorded values, SI, one row per time.
        counts: Steps and calls of the solver.
        solve_time: Time of the solver, s; None if there was nothing to integrate.
        reason: Why the run stopped early; empty if it did not.
        invalid: Violated validity conditions of the model or of the fixed step, with their times.
        invalid_from: Time from which one is violated, s; None if none is.
        reached: The last good time, s, which may lie after the last output; None without one.
        events: Events in their order, with all that is recorded and the states on both sides.
        stop: Message of the event that ended the run; empty if it ran to its end.
    """

    time: Vector
    table: Vector
    counts: Counts
    solve_time: float | None
    reason: str
    invalid: tuple[str, ...]
    invalid_from: float | None
    reached: float | None
    events: tuple[Event, ...] = ()
    stop: str = ""


def solve(prepared: Prepared, numbers: Values) -> Solution:
    """Compute the initial values, integrate, and evaluate the recorded variables.

    Raises:
        InitialConditionError: The initial values contradict the constraints.
        UsageError, ParameterError, MissingTool: See `engine_of`.
    """
    start = _initial_state(prepared.problem, numbers)
    motion, invalid = _integrated(prepared, start)
    return _recorded(prepared, motion, start.values.p, invalid)


def _initial_state(problem: Problem, numbers: Values) -> InitialState:
    dae, begin = problem.dae, float(problem.grid[0])
    u = input_values(dae, problem.grid[:1], numbers, problem.inputs)
    first = replace(numbers, u=u[:, 0])
    return InitialState(*consistent_values(dae, begin, first), first)


def _integrated(prepared: Prepared, start: InitialState) -> tuple[Motion, list[Breach]]:
    """Integrate; without states, or with a single time, repeat the initial values instead.

    Returns:
        The motion, and where fixed steps are too long for it.
    """
    problem, solver = prepared.problem, prepared.inner
    n = len(problem.grid)
    if n == 1 or not (problem.dae.states or hybrid(problem.dae)):
        states, guesses = (np.tile(row[:, None], n) for row in (start.x, start.z))
        u = input_values(problem.dae, problem.grid, start.values, problem.inputs)
        return Motion(problem.dae, problem.grid, states, guesses, u, Counts()), []
    found = integrate(problem, solver, start)
    invalid = list[Breach]()
    if prepared.checks_validity and isinstance(solver, FixedStep) and not found.reason:
        invalid, found.reason = _step_check(problem, solver, found, start)
    return found, invalid


def _recorded(prepared: Prepared, motion: Motion, p: Vector, invalid: Sequence[Breach]) -> Solution:
    """Evaluate the recorded variables while they are finite and, if requested, valid."""
    problem, reason = prepared.problem, motion.reason
    dae, grid, n = motion.dae, motion.time, motion.states.shape[1]
    checked = prepared.checks_validity
    watched = with_singularity_margin(dae) if checked and not problem.project else dae
    watches_singularity = watched is not dae
    solved = Solved(grid[:n], motion.states, motion.algebraics, motion.u, p)
    seen = observe(
        watched,
        solved,
        prepared.places,
        limits=checked,
        margins=watches_singularity,
        compiled=problem.compiled,
    )
    seen.table.setflags(write=False)  # a result need not copy it
    if seen.first_not_finite < n:
        n, name = seen.first_not_finite, _not_finite(dae, solved, seen, prepared.places)
        reason = reason or f"{name} is not finite at {grid[n]:g} s"
    found = list(invalid)
    if watches_singularity:
        singular = first_singular_configuration(dae, solved, seen, n)
        if singular is not None and dae.has_conditioned_multipliers:
            n, reason = singular
        elif singular is not None:  # an explicit formulation goes on, with a warning
            found.append(Breach(*singular))
    if checked:
        found += breaches(dae, grid[:n], seen.first_invalid[: len(dae.limits)])
        found.sort()
        if found and prepared.on_invalid is OnInvalid.STOP and found[0].position < n:
            n, reason = found[0]
    projectable = watches_singularity and dae.has_conditioned_multipliers and dae.invariants
    failed = n > 0 and motion.reason not in ("", INTERRUPTED)
    if failed and projectable and seen.margins[n - 1, -1] < _NEARLY_SINGULAR:
        near = f"a singular configuration near {grid[n - 1]:.4g} s may be the cause"
        reason = f"{reason}; {near}: {PROJECTION}"
    events, stop = motion.events, motion.stop
    if n < motion.states.shape[1]:  # what happened after the last good row is not a result
        events, stop = [e for e in events if n and e.time <= grid[n - 1]], ""
    rows: slice | NDArray[np.intp] = slice(0, n)
    if prepared.rows is not None:
        recorded = prepared.rows[prepared.rows < n]
        rows = np.union1d(recorded, [n - 1]) if stop else recorded
    table = seen.table[rows]
    table.setflags(write=False)  # a Trajectory need not copy it
    return Solution(
        grid[rows],
        table,
        motion.counts,
        motion.solve_time,
        reason,
        tuple(breach.text for breach in found),
        float(grid[found[0].position]) if found else None,
        float(grid[n - 1]) if n else None,
        tuple(_both_sides(prepared, motion, p, events)) if events else (),
        stop,
    )


def _both_sides(
    prepared: Prepared, motion: Motion, p: Vector, events: Sequence[EventRecord]
) -> Iterator[Event]:
    """Yield events with all that is recorded, and the states, before and after each."""
    every = [side for pair in motion.instants for side in pair]
    x, z = (np.array(rows).T for rows in ([side.x for side in every], [side.z for side in every]))
    u = np.array([np.concatenate((side.u, side.modes)) for side in every]).T
    solved = Solved(np.array([side.t for side in every]), x, z, u, p)
    seen = observe(motion.dae, solved, prepared.places, limits=False, margins=False, compiled=False)
    names = [c.name for c in prepared.columns] + [v.name for v in prepared.problem.dae.states]
    rows, sides = 2 * np.array([event.instant for event in events]), list[list[list[float]]]()
    for i, states in enumerate(([e.before for e in events], [e.after for e in events])):
        sides.append(np.hstack((seen.table[rows + i], np.array(states))).tolist())
    for event, *pair in zip(events, *sides, strict=True):
        yield Event(
            float(event.time), event.name, *(dict(zip(names, row, strict=True)) for row in pair)
        )


def _not_finite(dae: Dae, solved: Solved, seen: Observed, places: tuple[int, ...]) -> str:
    """Return the name of the first variable that is not finite at the first such time."""
    row = np.concatenate(
        (solved.states[:, seen.first_not_finite], seen.unknowns[seen.first_not_finite])
    )
    numbers = dict(enumerate(row.tolist())) | dict(
        zip(places, seen.table[seen.first_not_finite].tolist(), strict=True)
    )
    place = min(place for place, value in numbers.items() if not isfinite(value))
    return all_columns(dae)[place].name


def _step_check(
    problem: Problem, solver: FixedStep, found: Motion, start: InitialState
) -> tuple[list[Breach], str]:
    """Check the error of fixed steps by a second run with half the step.

    Returns:
        Where the two runs differ too much, and `INTERRUPTED` if Ctrl-C ended the second run.
    """
    step = solver.step(problem)
    finer = integrate(problem, replace(solver, step_size=step / 2), start)
    if finer.reason == INTERRUPTED:
        return [], INTERRUPTED
    n = min(found.states.shape[1], finer.states.shape[1])
    grid, states = found.time[:n], (found.states[:, :n], finer.states[:, :n])
    return too_coarse(problem.dae, grid, *states, step), ""
