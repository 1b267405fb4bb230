"""The way across positions where constraints lose rank, for runs whose solver nobody named.

There the equations have no solution, and IDAS ends or leaves along another branch of motion. Steps
of dop853 that are projected onto the constraints pass such a position between two of their stages.
Which branch they go on along is not in the equations. So such a run is taken only with what tells
that it is the right one: its speeds go on, which nothing but an impulse could change, and a run
with another tolerance arrives at the same.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.errors import SolverError
from cosim.integrate.diagnosis.crossing import close_times, rank_losses
from cosim.integrate.engine import Problem
from cosim.integrate.families.explicit import Dop853
from cosim.integrate.run.pieces import input_values
from cosim.integrate.run.run_stats import RunStats
from cosim.integrate.run.solution import Solution
from cosim.integrate.solver import AdaptiveSolver, Solver
from cosim.model.inputs import InputSeries
from cosim.model.rank import LOST, MONITOR, watches_rank
from cosim.model.values import Values
from cosim.trajectory import Trajectory

AGREEMENT = 100.0  # tolerances, of a state's size, that two runs may be apart
FARTHEST = 1e-2  # of a state's size, however loose the tolerance
SMOOTH = 1e-3  # of its size, that a state may be off where it was heading
TIGHTER = tuple(10 ** (-k / 4) for k in range(14))  # of the tolerance, one after the other
TIGHTEST = 1e-13  # relative tolerance; beyond, rounding is all that one sees
_WAY = 5  # outputs up to a position, or behind it, that tell where a state is heading
_FEWEST = 3
POOR = 0.5  # distance from a loss of rank, below which a solver may have failed of one

Again = Callable[..., Trajectory]


class _Crossed(NamedTuple):
    """What speaks for a run.

    Attributes:
        states: In their sizes, (nx, n); not a number where an output is too near to a position.
        when: The positions in which its constraints lose rank, s.
        jump: The largest of a state in its size at these.
    """

    states: Vector
    when: tuple[float, ...]
    jump: float

    def distance(self, other: "_Crossed") -> float:
        """Return how far apart two runs are, in the states' sizes."""
        return float(np.nanmax(np.abs(self.states - other.states)))


def across(
    problem: Problem,
    solver: Solver,
    values: Values,
    first: Solution,
    again: Again,
    outputs: Sequence[str] | None,
) -> Trajectory | None:
    """Return a run that passes positions in which constraints lose rank; None where none does.

    Args:
        problem, solver, values: What has been run.
        first: What came of it.
        again: Runs the model as it was given, with its numbers; takes what `simulate` does.
        outputs: What is recorded.

    Raises:
        SolverError: There is no such way, or nothing tells that it is right.
        CosimError: Steps cannot be projected here; see `simulate`.
    """
    if not isinstance(solver, AdaptiveSolver):
        return None
    dae, grid, asked = problem.dae, problem.grid, solver.relative_tolerance
    lost = first.rank_loss or (first.failed and first.rank < POOR)
    if not (lost and dae.invariants and watches_rank(dae) and asked):
        return None
    at = first.rank_loss.position if first.rank_loss else len(first.table) - 1
    ended = float(grid[max(at - 1, 0)]), float(grid[min(at + 2, len(grid) - 1)])

    def projected(tolerance: float, **options: Any) -> Trajectory:
        absolute = solver.absolute_tolerance
        if absolute is not None:
            absolute *= tolerance / asked
        way = Dop853(relative_tolerance=tolerance, absolute_tolerance=absolute)
        return again(solver=way, drift_control="projection", **options)

    def judged(tolerance: float) -> _Crossed:
        names = [*(v.name for v in (*dae.states, *dae.algebraics)), MONITOR]
        run = projected(tolerance, output_interval=close_times(dae, grid), outputs=names)
        return _crossed(dae, run, values, problem.inputs)

    when = first.rank_loss.when if first.rank_loss else grid[at]
    for tolerance, evidence in _passing(judged, asked, ended):
        with suppress(SolverError):  # it may end where an output is too near to a position
            run = projected(tolerance, output_interval=grid, outputs=outputs)
            assert isinstance(run.stats, RunStats)
            note = (
                f"constraints lose rank near {when:.4g} s, where {solver.name} ends or may leave "
                f"its branch; taken instead: {Dop853.name} with projection at rtol "
                f"{tolerance:.1g}, {evidence}"
            )
            notes = "; ".join(filter(None, (note, run.stats.note)))
            return replace(run, stats=replace(run.stats, note=notes))
    raise SolverError("its outputs are too near to such positions")


def _passing(
    judged: Callable[[float], _Crossed], asked: float, ended: tuple[float, float]
) -> Iterator[tuple[float, str]]:
    """Yield relative tolerances with which a run passes, and what speaks for it.

    Args:
        judged: Looks at a projected run of a relative tolerance.
        asked: The one that is asked for.
        ended: Between which times the usual solver gave up, or crossed a position, s.

    Raises:
        SolverError: No run arrives, or nothing tells that it is right.
    """
    arrived, why, smooth = False, "no run arrives", list[_Crossed]()
    for tolerance in (factor * asked for factor in TIGHTER):
        if tolerance < min(asked, TIGHTEST):
            break
        try:
            now = judged(tolerance)
        except SolverError:  # it ends at a position, which other steps may pass
            continue
        if not any(ended[0] <= when <= ended[1] for when in now.when):
            raise SolverError(f"no constraints lose rank from {ended[0]:g} to {ended[1]:g} s")
        if not now.jump <= SMOOTH:
            why = f"a state is {now.jump:.1g} of its size off its way"
            continue
        apart = min((now.distance(other) for other in smooth), default=np.inf)
        if apart <= min(AGREEMENT * asked, FARTHEST):
            arrived = True
            yield tolerance, _evidence(now, apart)
        why = "no second run arrives"
        if smooth:
            why = f"runs of two tolerances differ by {apart:.1g} of a state's size"
        smooth.append(now)
    if not arrived:
        raise SolverError(why)


def _evidence(run: _Crossed, apart: float) -> str:
    n = len(run.when)
    where = f"{n} such position{'s' * (n > 1)}"
    return (
        f"with which speeds go on at {where} (to {run.jump:.0e}) and another tolerance arrives at "
        f"the same (to {apart:.0e})"
    )


def _crossed(dae: Dae, run: Trajectory, values: Values, inputs: InputSeries | None) -> _Crossed:
    """Look at a run where its constraints lose rank."""
    states, unknowns = (np.array([run[v.name] for v in of]) for of in (dae.states, dae.algebraics))
    u, rank = input_values(dae, run.time, values, inputs), 1 / run[MONITOR]
    losses = rank_losses(dae, run.time, states, unknowns, u, values.p, rank)
    when = tuple(loss.when for loss in losses)
    nominal = np.array([[variable.nominal] for variable in dae.states])
    states = states / np.maximum(nominal, np.abs(states).max(axis=1, keepdims=True))
    good = rank * LOST > 1
    jumps = [_jump(run.time[good], states[:, good], at) for at in when]
    return _Crossed(np.where(good, states, np.nan), when, max(jumps, default=0.0))


def _jump(time: Vector, states: Vector, when: float) -> float:
    """Return how far states are off where they were heading before and behind a position.

    Where a branch is left, speeds change at once, and what extends the one side misses the other.

    Args:
        time: Output times, s, (n,).
        states: There, in their sizes, (nx, n).
        when: The position, s.

    Returns:
        The miss of the better side; infinite where there are too few outputs to extend.
    """
    k = int(np.searchsorted(time, when))
    before, behind = np.arange(max(0, k - _WAY), k), np.arange(k, min(len(time), k + _WAY))
    misses = [
        np.abs(_extended(time[own], states[:, own], time[other]) - states[:, other]).max()
        for own, other in ((before, behind[:2]), (behind, before[-2:]))
        if len(own) >= _FEWEST and len(other)
    ]
    return float(min(misses, default=np.inf))


def _extended(time: Vector, values: Vector, at: Vector) -> Vector:
    """Return polynomials through values, (m, n) at n times, at other times."""
    scaled = (time - time[0]) / (time[-1] - time[0])
    powers = np.vander(scaled)
    coefficients = np.linalg.solve(powers, values.T)
    found: Vector = np.vander((at - time[0]) / (time[-1] - time[0]), len(time)) @ coefficients
    return found.T
