"""What a run is apart from its numbers, settled once for the runs that differ in these only."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.compiler import where_compilers_are
from cosim.errors import UsageError
from cosim.integrate.engine import Problem
from cosim.integrate.families.explicit import Dop853
from cosim.integrate.run.outputs import all_columns, recorded_columns, recording
from cosim.integrate.run.worthwhile import Choice, settled
from cosim.integrate.solver import Solver
from cosim.integrate.solvers import NUMBERS, chosen_solver
from cosim.integrate.tightened import tightened
from cosim.memo import kept_per_thread
from cosim.model.inputs import InputSeries
from cosim.model.time_grid import checked_grid, time_grid
from cosim.model.values import number
from cosim.trajectory import Column


class Times(NamedTuple):
    """Output times as they are asked for; see `simulate`."""

    start: float = 0.0
    stop: float | None = None
    interval: float | Vector | None = None

    def grid(self, dae: Dae) -> Vector:
        """Return them, s, (n,).

        Raises:
            ParameterError: A time is not finite, or they are not increasing.
        """
        if isinstance(self.interval, np.ndarray):
            return checked_grid(self.interval)
        start = number("run", "start_time", self.start)
        return time_grid(
            start,
            start + dae.experiment.stop_time if self.stop is None else self.stop,
            dae.experiment.output_interval if self.interval is None else self.interval,
            numbers=len(all_columns(dae)),
        )


class Asked(NamedTuple):
    """What is asked of a run, as `simulate` is given it and not yet checked."""

    outputs: tuple[str, ...] | None
    times: Times
    solver: str | Solver | None
    numbers: tuple[float | None, ...]  # as `NUMBERS` names them
    inputs: InputSeries | None
    compiled: bool | None
    project: bool


@dataclass(frozen=True)
class Plan:
    """What a run does whatever its numbers are.

    Attributes:
        problem: What is integrated.
        solver: By what.
        inner: The same with the tolerance that it takes to get there; see `tightened`.
        choice: Whether it is compiled; None where that depends on the runs before.
        columns: What is recorded.
        places: Of these among `all_columns`.
    """

    problem: Problem
    solver: Solver
    inner: Solver
    choice: Choice | None
    columns: tuple[Column, ...]
    places: tuple[int, ...]


def plan(dae: Dae, asked: Asked) -> Plan:
    """Return the plan of a run; the thread's latest ones are kept.

    Raises:
        UnknownName, ParameterError, UsageError, MissingTool: See `simulate`.
    """
    times: Any = asked.times.interval
    own = times.tobytes() if isinstance(times, np.ndarray) else b""
    still = asked._replace(times=asked.times._replace(interval=None)) if own else asked
    kinds = tuple(map(type, (*still, *still.times, *still.numbers)))  # True is not 1 here
    if own and not (times.ndim == 1 and times.dtype == np.float64):
        return _plan(dae, asked)
    try:
        hash(still)
    except TypeError:  # and refused below
        return _plan(dae, asked)
    return _kept_plan(dae, still, own, kinds, where_compilers_are())


@kept_per_thread(16)
def _kept_plan(
    dae: Dae, still: Asked, own: bytes, _kinds: tuple[type, ...], _compilers: tuple[str, ...]
) -> Plan:
    times = still.times._replace(interval=np.frombuffer(own)) if own else still.times
    return _plan(dae, still._replace(times=times))


def _plan(dae: Dae, asked: Asked) -> Plan:
    dae, names = recording(dae, asked.outputs)
    grid = asked.times.grid(dae)
    compiled = asked.compiled
    if not isinstance(compiled, bool | None):
        raise UsageError.of_type(f"{dae.full_name}: compiled", compiled, "True, False or None")
    solver = Dop853.name if asked.project and asked.solver is None else asked.solver
    numbers = dict(zip(NUMBERS, asked.numbers, strict=True))
    chosen = chosen_solver(dae, solver, projected=asked.project, **numbers)
    choice = settled(dae, chosen) if compiled is None else Choice(compiled)
    at_once = choice is None or choice.compiled
    problem = Problem(
        dae, grid.tobytes(), asked.inputs, at_once, sensitivities=False, project=asked.project
    )
    inner = tightened(chosen) if asked.solver is None else chosen
    return Plan(problem, chosen, inner, choice, *recorded_columns(dae, names))
