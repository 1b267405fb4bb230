"""Inputs of a run over time, and runs whose inputs jump: one from each jump to the next.

No step reaches across a jump, and each piece has the values on its own side of it, so that every
method keeps its order.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.errors import InitialConditionError, UnknownName, UsageError
from cosim.integrate.engine import Counts, Problem
from cosim.integrate.initial_values import algebraic_values
from cosim.integrate.run.attempts import Start, integrated
from cosim.integrate.run.call import Reached
from cosim.integrate.solver import Solver
from cosim.memo import kept_per_thread
from cosim.model.inputs import InputSeries
from cosim.model.values import Values


def integrated_by_pieces(problem: Problem, solver: Solver, start: Start) -> tuple[Reached, str]:
    """Integrate over the grid of a problem like `integrated`, piece by piece where inputs jump.

    At an output time with a jump, algebraic unknowns are those after it.

    Raises:
        CosimError: See `simulate`.
    """
    pieces = pieces_of(problem)
    found, notes = list[Reached](), list[str]()
    for piece in pieces:
        if found:
            try:
                start = _after_jump(piece, found[-1].states[:, -1], start.values)
            except InitialConditionError:
                reason = f"no solution after the jump of an input at {piece.grid[0]:g} s"
                found[-1] = replace(found[-1], reason=reason)
                break
        reached, note = integrated(piece, solver, start)
        found.append(reached)
        notes.append(note)
        if reached.states.shape[1] < len(piece.grid):
            break
    told = "; ".join(filter(None, dict.fromkeys(notes)))
    return (found[0] if len(pieces) == 1 else _joined(problem, pieces, found)), told


@kept_per_thread(16)
def pieces_of(problem: Problem) -> tuple[Problem, ...]:
    """Return the problems between jumps, whose grids end there; the problem itself without any."""
    if problem.inputs is None or not problem.inputs.jumps.size:
        return (problem,)
    grid = problem.grid
    series = problem.inputs.with_jumps_at(grid)
    found = list[Problem]()
    ends = series.jumps[(series.jumps > grid[0]) & (series.jumps < grid[-1])]
    for begin, end in pairwise([grid[0], *ends, grid[-1]]):
        times = np.array([begin, *grid[(grid > begin) & (grid < end)], end])
        inputs = series.around(float(begin))
        found.append(replace(problem, times=times.tobytes(), inputs=inputs))
    return tuple(found)


def _after_jump(problem: Problem, x: Vector, values: Values) -> Start:
    dae, begin = problem.dae, problem.grid[:1]
    values = replace(values, u=input_values(dae, begin, values, problem.inputs)[:, 0])
    return Start(x, algebraic_values(dae, float(begin[0]), x, values), values)


def _joined(problem: Problem, pieces: Sequence[Problem], found: Sequence[Reached]) -> Reached:
    """Return what pieces reached as one run; where two meet, the later one counts."""
    rows = list[tuple[Vector, Vector]]()
    for number, (piece, reached) in enumerate(zip(pieces, found, strict=False), start=1):
        times = piece.grid[: reached.states.shape[1]]
        wanted = np.isin(times, problem.grid)
        if number < len(found) and found[number].states.shape[1]:
            wanted[-1] = False
        rows.append((reached.states[:, wanted], reached.algebraics[:, wanted]))
    states, algebraics = (np.hstack(columns) for columns in zip(*rows, strict=True))
    last = found[-1]
    took = sum(reached.solve_time for reached in found)
    return Reached(states, algebraics, _summed(found), last.reason, took)


def _summed(found: Sequence[Reached]) -> Counts:
    def total(numbers: Iterable[int | None]) -> int | None:
        known = [number for number in numbers if number is not None]
        return sum(known) if len(known) == len(found) else None

    every = [reached.counts for reached in found]
    return Counts(
        total(counts.steps for counts in every),
        total(counts.rhs_calls for counts in every),
        total(counts.jacobian_calls for counts in every),
        every[-1].cause,
    )


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
    for name, row in zip(inputs.names, inputs.with_jumps_at(grid).at(grid), strict=True):
        if name not in known:
            raise UnknownName.among(dae.full_name, "input", name, known)
        table[known.index(name)] = row
    return table
