"""A run up to where a condition becomes true, located in time to the accuracy of its solver."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from casadi_models.dae import Dae, Start, Variable
from cosim.arrays import Vector
from cosim.errors import SolverError, UsageError
from cosim.integrate.run.run_stats import RunStats
from cosim.memo import kept_per_thread
from cosim.model.driving import names_of
from cosim.model.formula import margin
from cosim.trajectory import Trajectory

MARGIN = "stop_when"  # name of the recorded margin, positive where the condition holds
_PARTS = 32  # of the bracket, in each repetition
_NARROW = 4e-15  # relative width of the bracket at the end
_MOST_REPETITIONS = 16

Solve = Callable[[Dae, Vector, Sequence[str]], Trajectory]


def run_until(
    dae: Dae, condition: str, solve: Solve, grid: Vector, names: Sequence[str]
) -> Trajectory:
    """Run until a condition becomes true; to the end of the grid where it never does.

    The condition is looked at on the output times: one that becomes true and false again between
    two of them is not seen. The interval in which it becomes true is then divided, and the run
    repeated with these output times, until the interval is as narrow as double precision allows:
    no other steps are taken, so that the time is as accurate as the states.

    Args:
        dae: The model.
        condition: Comparisons of time, states, outputs and parameters with `and` and `or`.
        solve: Runs a model on output times and records names.
        grid: Output times of the whole run, s, (n,).
        names: What to record.

    Returns:
        The run up to the stop, which is its last output; `stats["stop"]` says where and why,
        `stats["stop_time"]` when, s.

    Raises:
        UsageError: The condition is true at the start, which may be the only time.
        CosimError: It is no condition, or the run fails before it is true.
    """
    if len(grid) < 2:
        raise UsageError(
            f"{dae.full_name}: stop_when '{condition}' needs a run, but {grid[0]:g} s is the only "
            "output time; give more"
        )
    watched = _watching(dae, condition)
    recorded = [*dict.fromkeys([*names, MARGIN])]
    try:
        run = solve(watched, grid, recorded)
    except SolverError as error:
        if not isinstance(error.partial, Trajectory) or not (error.partial[MARGIN] > 0).any():
            raise
        run = error.partial  # it failed later
    holds = np.flatnonzero(run[MARGIN] > 0)
    if not holds.size:
        return run.select(names)
    first = int(holds[0])
    if first == 0:
        raise UsageError(
            f"{dae.full_name}: stop_when '{condition}' is true at the start already; give one "
            "that becomes true"
        )
    before, end = grid[:first], float(grid[first])  # where every repetition ends: same steps
    bracket = float(grid[first - 1]), end
    for _ in range(_MOST_REPETITIONS):
        low, high = bracket
        if high - low <= _NARROW * max(1.0, abs(high)):
            break
        inner = np.linspace(low, high, _PARTS + 1)
        run = solve(watched, np.unique(np.concatenate((before, inner, [end]))), recorded)
        holds = np.flatnonzero(run[MARGIN] > 0)
        if not holds.size:  # by rounding; it does at the end of the bracket
            break
        at = int(holds[0])
        bracket = float(run.time[at - 1]), float(run.time[at])
    stop = bracket[1]
    rows = [*range(first), int(np.flatnonzero(run.time == stop)[0])]
    assert isinstance(run.stats, RunStats)
    stats = replace(run.stats, stop=f"{condition} from {stop:.12g} s on", stop_time=stop)
    run = replace(run, time=run.time[rows], values=run.values[rows], stats=stats, status="complete")
    return run.select(names)


@kept_per_thread(8)
def _watching(dae: Dae, condition: str) -> Dae:
    """Return the model with the margin of a condition as a further output."""
    symbols = names_of(dae)
    for column, variables in ((dae.z, dae.algebraics), (dae.u, dae.inputs)):
        symbols |= {v.name: s for v, s in zip(variables, ca.vertsplit(column), strict=True)}
    rows = ca.vertsplit(dae.outputs)
    symbols |= {v.name: s for v, s in zip(dae.output_variables, rows, strict=True)}
    found = margin(f"{dae.full_name}: stop_when", condition, symbols)
    variable = Variable(MARGIN, "1", f"positive where {condition}", start_kind=Start.CALCULATED)
    return replace(
        dae,
        outputs=ca.densify(ca.vertcat(dae.outputs, found)),
        output_variables=(*dae.output_variables, variable),
        observed=(*dae.observed, MARGIN),
    )
