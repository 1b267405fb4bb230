"""Runs of a model with events in blocks: one call of compiled code for many runs.

The code goes through all that is usual: the start, events, time events. Any other run (a relation
slides, an event ends it, it fails, it is stiff) is left to `run`, which also computes the same bits
for the others by the same solver.
"""

import ctypes
from dataclasses import replace
from functools import partial
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from casadi_models.dae.hybrid import Hybrid
from cosim.arrays import Truths, Vector
from cosim.codegen.c_fields import fields
from cosim.codegen.runge_kutta.explicit_library import work_space
from cosim.errors import CompilerTimeout, InitialConditionError, SolverError
from cosim.host.progress import doing
from cosim.host.signals import interrupt_noticed, interruptible
from cosim.integrate.engine import Counts, room_for_events
from cosim.integrate.ensemble.ensemble import Row
from cosim.integrate.ensemble.lanes import nominal_sizes, within_bounds
from cosim.integrate.events import continuation, records_of
from cosim.integrate.families.explicit import Dop853, block_library
from cosim.integrate.growth import growth_in, may_grow
from cosim.integrate.initial_values import consistent_values
from cosim.integrate.modes import Passed, hybrid, passed_events, sliding
from cosim.integrate.motion import Motion
from cosim.integrate.nominal import InitialState
from cosim.integrate.passed_over import unquestioned, with_conditions
from cosim.integrate.preparation import Prepared, prepare
from cosim.integrate.run import Integrated, Recorded, evaluated, repeatable, run, trajectory_of
from cosim.model.many_values import ManyValues
from cosim.model.request import RunRequest
from cosim.model.values import Values, own_sizes
from cosim.text import EndKind
from cosim.trajectory import Trajectory

_NUMBERS = 500_000  # of the rows of a block
_MOST_TIMES = 10_000  # of a run; so many more are integrated in windows
_LEFT_ALONE, _COMPLETE, _NOT_BEGUN = 0, 1, 2  # codes of fmu/solvers/block.h
_ENDS_OF_MODELS = EndKind.EVENT, EndKind.INVALID


class _Block(ctypes.Structure):
    """`Block` of fmu/solvers/block.h."""

    _fields_ = fields("solvers/block.h", "Block")


def event_blocks(
    request: RunRequest, values: ManyValues, solver: Dop853 | None
) -> "EventBlocks | None":
    """Return the runs of a request in blocks; None if these cannot be so.

    Args:
        request: The request of all runs; its values are ignored.
        values: The values of each run.
        solver: The solver of the blocks; None if there is none.

    Raises:
        UsageError, ParameterError, MissingTool: See `prepare`.
    """
    alone = prepare(request)
    problem, system = alone.problem, hybrid(alone.problem.dae)
    given_otherwise = {rule.variable.name for rule in problem.dae.start_outputs} & {*values.given}
    if (
        solver is None
        or system is None
        or not problem.compiled
        or problem.project
        or problem.inputs is not None
        or request.policy.record_events
        or given_otherwise
        or not 2 <= len(problem.grid) <= _MOST_TIMES
        or not problem.dae.states
        or problem.dae.derived
    ):
        return None
    try:
        own = replace(request, solver=solver)
        return EventBlocks(own, prepare(own), solver, system, values)
    except CompilerTimeout:  # the usual solver can interpret the equations
        if solver != alone.inner:
            return None
        raise


def _starts(prepared: Prepared, values: ManyValues) -> tuple[Vector, Vector, Truths]:
    """Return initial states and unknowns of some runs, and which runs have them."""
    dae, t = prepared.problem.dae, float(prepared.problem.grid[0])
    x, z = values.x.copy(), np.empty((len(values), len(dae.algebraics)))
    if not (dae.start_rules or dae.algebraics):
        return x, z, within_bounds(dae, x)
    begins = np.ones(len(values), dtype=bool)
    for i in range(len(values)):
        try:
            own = Values(values.x[i], values.p[i], values.u[i])
            x[i], z[i] = consistent_values(dae, t, own)
        except InitialConditionError:
            begins[i] = False
    return x, z, begins


class EventBlocks:
    """Runs of a model with events, by position, computed a block at a time.

    Args:
        request: The request of all runs; its values are ignored.
        prepared: Its plan.
        solver: The solver of that.
        system: The frozen equations.
        values: The values of each run.
    """

    def __init__(
        self,
        request: RunRequest,
        prepared: Prepared,
        solver: Dop853,
        system: Hybrid,
        values: ManyValues,
    ) -> None:
        self._request = request
        self._prepared = prepared
        self.solver = solver
        self._tolerance = solver.tolerance
        self._system = system
        self._values = values
        self._in_laws = np.array(system.in_laws, dtype=bool)
        self._library, self._constants = block_library(sliding(system, frozenset()))
        self._work = work_space(self._library)
        dae, n = system.dae, len(prepared.problem.grid)
        per_run = n * (dae.x.numel() + dae.z.numel() + dae.u.numel())
        self._size = max(1, _NUMBERS // per_run)
        self._records = room_for_events(system)
        self._next = 0  # the first run that no block holds yet
        self._interrupted = False
        self._ready = dict[int, Row]()
        self._left = set[int]()  # runs in which something else happens

    def take(self, position: int) -> Row | None:
        """Return a run; None if it is left to `run`. Runs are taken in their order.

        Raises:
            KeyboardInterrupt: Ctrl-C, before this run was complete.
        """
        while position >= self._next and not self._interrupted:
            self._ready.clear()
            self._left.clear()
            self._compute(position)
        if position >= self._next:
            interrupt_noticed()
            raise KeyboardInterrupt
        if position in self._left and self.solver.leaves_stiff:
            return self._alone(position)
        return self._ready.pop(position, None)

    def _alone(self, position: int) -> Row | None:
        """Return a run by `run` with the solver of the blocks; None if that fails.

        Raises:
            SolverError: The model ends the run, which no other solver changes.
        """
        try:
            found = run(replace(self._request, values=self._own(position)))
        except SolverError as error:
            if error.ending.kind in _ENDS_OF_MODELS:
                raise
            return None
        except (InitialConditionError, CompilerTimeout):
            return None
        time = self._prepared.problem.grid
        if self._prepared.rows is not None:
            time = time[self._prepared.rows]
        return Row.of(found, time)

    def _own(self, position: int) -> dict[str, float]:
        return {name: float(column[position]) for name, column in self._values.given.items()}

    def _compute(self, first: int) -> None:
        """Compute a block of runs, from the first one on."""
        self._next = min(first + self._size, len(self._values))
        possible = [i for i in range(first, self._next) if i not in self._values.refused]
        some = self._values.select(np.array(possible, dtype=np.int64))
        x, z, begins = _starts(self._prepared, some)
        going = np.array(possible)[begins].tolist()
        if not going:
            return
        x, z, u, p = (table[begins] for table in (x, z, some.u, some.p))
        began = perf_counter()
        rows, report = self._call(x, z, u, p)
        done = np.flatnonzero(report[:, 0] != _NOT_BEGUN)
        if len(done) < len(going) or self._interrupted:
            self._next = going[min(len(done), len(going) - 1)]
        time = (perf_counter() - began) / max(1, len(done))
        ends = report[:, 3].astype(int).cumsum()
        self._left = {going[k] for k in np.flatnonzero(report[: len(done), 0] == _LEFT_ALONE)}
        dae, grid = self._system.dae, self._prepared.problem.grid
        for k in np.flatnonzero(report[: len(done), 0] == _COMPLETE).tolist():
            counts = Counts(int(report[k, 1]), int(report[k, 2]), 0)
            states, unknowns, inputs = (table[k].T for table in rows)
            motion = Motion(dae, grid, states, unknowns, inputs, p[k], counts, solve_time=time)
            events = self._records[ends[k] - int(report[k, 3]) : ends[k]]
            found = self._finished(going[k], motion, Values(x[k], p[k], u[k]), events)
            if found is None:
                self._left.add(going[k])
            else:
                self._ready[going[k]] = found

    def _call(self, x: Vector, z: Vector, u: Vector, p: Vector) -> tuple[list[Vector], Vector]:
        """Return states, unknowns and inputs, (runs, times, ...), and the report of each run."""
        system, solver, grid = self._system, self.solver, self._prepared.problem.grid
        dae, runs, n = self._prepared.problem.dae, len(x), len(grid)
        constants = np.ascontiguousarray(np.array(self._constants(p.T)).T)
        modes = np.ones((runs, len(system.relations)))
        sizes = x.shape[1], z.shape[1], system.dae.u.numel()
        rows: list[Vector] = [np.empty((runs, n, size)) for size in sizes]
        report = np.full((runs, 4), float(_NOT_BEGUN))
        given = (x, z, np.hstack((u, modes)), constants, nominal_sizes(dae, x, solver.tolerance))
        arrays = (grid, *given, own_sizes(dae, x), *rows, self._records, report)
        block = _Block(
            *(runs, n, len(self._records), solver.leaves_stiff),
            *(*self._tolerance.pair, solver.max_step or np.inf, float(grid[-1] - grid[0])),
            *(array.ctypes.data for array in arrays),
        )

        def done() -> float:
            return float((report[:, 0] != _NOT_BEGUN).mean())

        with interruptible(self._library) as interrupts, doing("runs with events", done):
            self._library.cosim_block(ctypes.byref(block), *self._work)
        self._interrupted = bool(interrupts)
        return rows, report

    def _finished(
        self, position: int, motion: Motion, values: Values, events: NDArray[np.void]
    ) -> Row | None:
        """Return a run from its motion and its instants; None if it is left to `run`."""
        known = unquestioned(motion, with_conditions(self._prepared.problem.dae))
        if known is None:
            return None
        if may_grow(known, self._tolerance):
            sides = [(each.before, each.after) for each in _passed(values, events)]
            begin = InitialState(motion.states[:, 0], motion.algebraics[:, 0], values)
            go_on = continuation(self._prepared.problem, self.solver, begin)
            if growth_in(replace(known, instants=sides), self._tolerance, go_on) is not None:
                return None
        try:
            motion, recorded, reason = evaluated(self._prepared, Integrated(known, _needed))
        except _RowsNeeded:
            return None
        if reason:
            return None
        none = np.empty((0, 0))  # results of many runs hold the motion, but not its columns
        short = replace(motion, time=none, states=none, algebraics=none, u=none)
        make = partial(self._trajectory, position, short, recorded, values, events.copy())
        switched = (events["before"]["modes"] != events["after"]["modes"]) | (events["zero"] > 0)
        happened = events["order"].any() or switched[:, self._in_laws].any()
        return Row(
            recorded.table,
            motion.counts.steps or 0,
            motion.counts.rhs_calls or 0,
            recorded.invalid[0].reason if recorded.invalid else None,
            recorded.note,
            make if happened else None,
        )

    def _trajectory(
        self,
        position: int,
        motion: Motion,
        recorded: Recorded,
        values: Values,
        events: NDArray[np.void],
    ) -> Trajectory:
        passed = _passed(values, events)
        instants = [(instant.before, instant.after) for instant in passed]
        motion = replace(motion, events=records_of(self._system, passed), instants=instants)
        times = motion.solve_time or 0.0, 0.0
        found = trajectory_of(self._prepared, motion, recorded, values, times)
        request = replace(self._request, values=self._own(position))
        alone = self._values.select(np.array([position]))
        again = partial(_block_of_one, alone, self.solver, found)
        return repeatable(found, request, self._prepared, again)


def _passed(values: Values, events: NDArray[np.void]) -> list[Passed]:
    """Return the events of a run with constant inputs."""
    inputs = np.tile(values.u, (len(events), 1))
    return passed_events(events, (inputs, np.zeros_like(inputs)))


class _RowsNeeded(Exception):
    """Rows of a motion do not tell whether it violates a validity condition."""


def _needed(_: Vector) -> Motion:
    raise _RowsNeeded


def _block_of_one(
    values: ManyValues, solver: Dop853, known: Trajectory, request: RunRequest
) -> Trajectory:
    """Return a known run at the output times of a request."""
    blocks = event_blocks(request, values, solver)
    row = None if blocks is None else blocks.take(0)
    if row is None:
        return run(request)
    return replace(known, time=request.times.requested, values=row.values)
