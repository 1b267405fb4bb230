"""`integrate`: from one event to the next, through jumps of inputs and events of the model.

Between events the solver integrates the frozen equations (see `casadi_models.dae.hybrid`). Where a
relation leaves its mode is located on the motion of the solver; what happens at that instant is the
matter of the kernel (`integrate.kernel`), and the solver starts afresh.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from casadi_models.dae.hybrid import Hybrid, input_rates
from cosim.arrays import Vector
from cosim.codegen.terms import pulse_times
from cosim.errors import InitialConditionError, SolverError, UsageError
from cosim.host.progress import doing
from cosim.host.signals import interrupt_noticed
from cosim.integrate.call import INTERRUPTED, Reached
from cosim.integrate.engine import Counts, Problem
from cosim.integrate.families.fixed_step import FixedStep
from cosim.integrate.growth import Continuation, followed_growth
from cosim.integrate.initial_values import algebraic_values, input_values
from cosim.integrate.kernel import Kernel, Outcome, Reason, reject
from cosim.integrate.location import Piece, located, located_at_end, with_input_rates, with_slopes
from cosim.integrate.modes import Instant, Passed, blended, hybrid, sliding, watch
from cosim.integrate.motion import EventRecord, Motion
from cosim.integrate.nominal import InitialState, scaled_call
from cosim.integrate.passed_over import attentive, with_conditions, with_note_on_steps
from cosim.integrate.places import finer_grid
from cosim.integrate.saltation import crossed, slid_derivatives
from cosim.integrate.window import Window
from cosim.model.growth import Closer
from cosim.model.inputs import InputSeries
from cosim.model.solver import AdaptiveSolver, Solver
from cosim.model.values import Values, own_sizes
from cosim.text import Ending, EndKind, moment

_MOST_INSTANTS = 2_000_000  # of a run, which take about 6 GB


def integrate(problem: Problem, solver: Solver, start: InitialState) -> Motion:
    """Integrate over the grid of a problem, from each event to the next.

    No step extends over a jump of an input or an event, and each piece uses the inputs and modes
    on its own side, which preserves the order of every method. Values at an event are those after.
    Where short changes may violate validity conditions, the motion has rows between those of the
    grid.

    Raises:
        UsageError, ParameterError, MissingTool: See `engine_of`.
        SolverError: An event has no consistent result.
    """
    problem, start = with_input_rates(problem, start)
    system = hybrid(problem.dae)
    breaks = problem.inputs is not None and problem.inputs.breaks.size
    smooth = problem.dae if system is None else system.dae
    span = float(problem.grid[0]), float(problem.grid[-1])
    pulses, none = np.empty(0), np.empty(0)
    takes_ends = problem.compiled and solver.takes_times
    if isinstance(solver, FixedStep):  # the others are repeated where they pass over changes
        pulses = pulse_times(smooth, start.values.p, *span, solver.step(problem))

    def attempt(closer: Closer | None, grid: Vector, ends: Vector) -> Motion:
        every = np.union1d(pulses, ends)
        taken, stops = (every, none) if takes_ends else (none, every)
        own = replace(problem, times=grid.tobytes(), ends=taken.tobytes())
        if closer and closer.until < grid[-1]:
            stops = np.union1d(stops, closer.until)
        if system is not None or breaks or len(stops):
            no_events = Hybrid(problem.dae, (), (), ())
            return _Course(own, system or no_events, solver, start, stops, closer).run()
        found = scaled_call(_with_shares(own, closer), solver, start)
        u = input_values(problem.dae, grid, start.values, problem.inputs)
        n = found.states.shape[1]
        columns = found.states, found.algebraics, u[:, :n], start.values.p
        return Motion(problem.dae, grid[:n], *columns, found.counts, found.reason, found.solve_time)

    if not isinstance(solver, AdaptiveSolver):
        motion = attempt(None, problem.grid, np.empty(0))
        return with_note_on_steps(motion)
    return followed_growth(
        lambda closer: attentive(
            partial(attempt, closer),
            problem.grid,
            max(solver.tolerance.pair),
            with_conditions(problem.dae),
        ),
        lambda closer, steps: attempt(
            closer, np.unique(finer_grid(problem.grid, steps)), np.empty(0)
        ),
        None if system is None else continuation(problem, solver, start),
        solver,
    )


def continuation(problem: Problem, solver: Solver, start: InitialState) -> Continuation:
    """Return what goes on with a hybrid model from other states.

    Args:
        problem, solver: What is integrated.
        start: Where the run began, with its parameters and inputs.
    """
    problem, start = with_input_rates(problem, start)
    system = hybrid(problem.dae)
    assert system is not None

    def go_on(times: Vector, x: Vector, z: Vector) -> Motion:
        own = replace(problem, times=times.tobytes())
        return _Course(own, system, solver, replace(start, x=x, z=z), np.empty(0), None).run()

    return go_on


def _with_shares(problem: Problem, closer: Closer | None) -> Problem:
    """Return a problem with the absolute tolerances of the first part of a run."""
    if closer is None:
        return problem
    nx = problem.dae.x.numel()
    return replace(problem, shares=tuple(np.broadcast_to(closer.shares, nx).tolist()))


def records_of(system: Hybrid, passed: Sequence[Passed], first: int = 0) -> list[EventRecord]:
    """Return the events of instants, or the relations of the equations that switch there.

    Args:
        system: Frozen equations.
        passed: The instants.
        first: Position of the first of them in the run.
    """
    found = list[EventRecord]()
    for place, (before, after, events, zero) in enumerate(passed, first):
        names = [system.events[i].name for i in events]
        if not names:
            laws = (i for i in sorted(zero | before.switched(after)) if system.in_laws[i])
            names = list(filter(None, [", ".join(map(system.described, laws))]))
        found += [EventRecord(after.t, name, before.x, after.x, place) for name in names]
    return found


class _Target(NamedTuple):
    """The end of a piece, s, and whether inputs jump or come to rest there."""

    time: float
    has_other_inputs: bool


class _Course:
    """A run of a hybrid model on its way over the grid."""

    def __init__(
        self,
        problem: Problem,
        system: Hybrid,
        solver: Solver,
        start: InitialState,
        stops: Vector,
        closer: Closer | None,
    ) -> None:
        self.problem, self.system, self.solver, self.closer = problem, system, solver, closer
        self.dae, self.grid = problem.dae, problem.grid
        self.values, self.began = start.values, start.x
        self.series = problem.inputs and problem.inputs.with_jumps_at(self.grid)
        rates = {name: self.dae.inputs[i].name for name, i in input_rates(self.dae).items()}
        self.rated = self.series and self.series.with_rates(rates)
        self.stops = stops  # further ends of pieces
        n = len(self.grid)
        sizes = len(start.x), len(start.z), len(system.dae.inputs)
        self.states, self.algebraics, self.u = (np.empty((n, size)) for size in sizes)
        self.next = 0  # row of the grid to be written
        self.reached = list[Reached]()
        self.events = list[EventRecord]()
        self.instants = list[tuple[Instant, Instant]]()
        watches = not system.relations or (problem.compiled and solver.watches)
        # where an input rests is found from the states that the last event has left
        self.passes_time = watches and not (self.series and system.resting)
        self.window = Window(self.grid, looks=bool(system.of_states) and not watches)
        self.stop, self.slides = "", False
        t = float(self.grid[0])
        modes = np.ones(len(system.relations))
        self.at = self._with_inputs(
            Instant(t, start.x, start.z, start.values.u, start.values.u, modes)
        )
        self.kernel: Kernel | None = None
        if system.relations or system.events:
            self._begin()
        self._write(self.at.t)
        self.at = slid_derivatives(self.system, self.at, self.values.p, frozenset())

    def _begin(self) -> None:
        """Find the modes of the start, and let all happen that happens there."""
        span = float(self.grid[-1] - self.grid[0])
        sizes = own_sizes(self.system.dae, self.began)
        self.kernel = Kernel(self.system, self.values.p, sizes, span, float(self.grid[-1]))
        ending = self.kernel.begin(self.at)
        if ending.reason is Reason.STOPPED:
            event = self.system.events[ending.part]
            raise UsageError(
                f"{self.dae.full_name}: {event.name} '{event.message}' is true at the start "
                "already; give a condition that becomes true later"
            )
        reject(self.system, self.at.t, ending, "")
        self.at = self.kernel.after(self.at)
        if self.system.events:
            self._switch(self.at)
        else:
            self.kernel.plan(self.at)

    def run(self) -> Motion:
        """Run to the end of the grid, or to an event that ends the run."""
        with doing("events", self._done):
            reason = self._all()
        n = self.next
        time = self.grid[:n]
        columns = [self.states[:n], self.algebraics[:n], self.u[:n]]
        if self.stop and (not n or time[-1] < self.at.t):
            time = np.append(time, self.at.t)
            last = self.at.x, self.at.z, np.concatenate((self.at.u, self.at.modes))
            columns = [np.vstack(pair) for pair in zip(columns, last, strict=True)]
        states, algebraics, u = (column.T for column in columns)
        return Motion(
            (blended(self.system) if self.slides else self.system).dae,
            time,
            states,
            algebraics,
            u,
            self.values.p,
            Counts.total([reached.counts for reached in self.reached]),
            reason,
            sum(reached.solve_time for reached in self.reached),
            self.events,
            self.stop,
            self.instants,
        )

    def _done(self) -> float:
        """Return the share of the run that is done, 0 to 1."""
        begin, end = self.grid[[0, -1]].tolist()
        passed = begin if self.kernel is None else self.kernel.switching.last_event
        return float((max(self.at.t, passed) - begin) / (end - begin))

    def _all(self) -> Ending:
        """Integrate from event to event.

        Returns:
            Why the run stopped early; empty if it did not, or an event ended it.
        """
        reason = Ending()
        while self.next < len(self.grid) and not self.stop and not reason:
            try:
                reason = self._advance()
                most = min(self.problem.most_instants, _MOST_INSTANTS)
                if len(self.instants) > most:
                    what = f"more than {most:,} instants with events"
                    reason = Ending(what, EndKind.EVENT, "stop earlier, or see what makes so many")
            except KeyboardInterrupt:  # what was computed is shown
                interrupt_noticed()
                reason = INTERRUPTED
            except InitialConditionError:
                when = moment(self.at.t, 6)
                reason = Ending(f"no solution after the jump of an input at {when} s")
            except SolverError as error:
                reason = error.ending
        return reason

    def _advance(self) -> Ending:
        """Integrate to the end of a window, or to the first event in it.

        Returns:
            Why the solver stopped early; empty if it did not.
        """
        series = self._followed()
        piece, target = self._piece_to(self._target(series), series)
        self._pass(piece)
        found = None if piece.reason == INTERRUPTED else located(piece)
        if found is not None:
            self._accept(piece, found.at.t)
            before = self.at.modes
            self._switch(found.at, found.first)
            self.window.switch(self.at.t, before, self.at.modes)
            return Ending()
        if not piece.reason:
            self._arrive(piece, target)
            return Ending()
        self._accept(piece, np.inf)
        final = piece.reason == INTERRUPTED or piece.reason.kind is EndKind.STIFF
        if final or len(piece.times) < 2:
            return piece.reason
        self.at = piece.at_end()
        self.window.restart()
        return Ending()  # a fresh start may succeed

    def _arrive(self, piece: Piece, target: _Target) -> None:
        """Go on from the end of a piece without an event in it; let happen what is due there."""
        arrived = piece.at_end()
        self._accept(piece, arrived.t)
        piece.let_go()
        self.window.widen()
        if target.has_other_inputs:
            self._switch(self._with_inputs(arrived))
        elif arrived.t == self._next_due():
            self._switch(arrived)
        elif last_event := located_at_end(piece):
            self._switch(last_event.at, last_event.first)
        else:
            self.at = self._with_inputs(arrived)
            self._write(arrived.t)

    def _target(self, series: InputSeries | None) -> _Target:
        """Return the end of the next piece: what comes first, or the end of the window."""
        due = np.inf if self.passes_time else self._next_due()
        ends = series.breaks if series else np.empty(0), self.stops
        later = (times[times.searchsorted(self.at.t, "right") :] for times in ends)
        jump, stop = (float(times[0]) if len(times) else np.inf for times in later)
        time = min(due, jump, stop, self.window.end(self.at.t))
        return _Target(time, time == jump)

    def _piece_to(self, target: _Target, series: InputSeries | None) -> tuple[Piece, _Target]:
        """Integrate to a target, or to where inputs rest at a threshold before; return both."""
        at, grid = self.at, self.grid
        rest = self._next_rest(at, series, target.time)
        left = None if self.kernel is None else self.kernel.switching.numbers.copy()
        while True:
            if self.kernel is not None:  # an event has moved a threshold, or the piece was too long
                self.kernel.switching.numbers[:] = left
            if rest <= target.time:
                target = _Target(rest, has_other_inputs=True)
            rows = grid[self.next :][grid[self.next :] < target.time]
            piece = self._piece(np.array([at.t, *rows[rows > at.t], target.time]))
            if self.window.is_refined(piece):
                nearer = self.window.end(at.t)
                target = target if target.time <= nearer else _Target(nearer, False)
                continue
            rest = self._rest_after(piece.passed, series, target.time)
            if self.kernel is None or piece.reason == INTERRUPTED or rest >= target.time:
                return piece, target

    def _next_due(self) -> float:
        """Return the next time event, s; where an input jumps or a row is, but for rounding."""
        due = np.inf if self.kernel is None else self.kernel.due
        for times in (self.series.breaks if self.series else np.empty(0), self.grid):
            k = int(times.searchsorted(due))
            for time in times[max(k - 1, 0) : k + 1].tolist():
                largest = max(abs(time), abs(self.grid[0]))  # on the way
                if self.at.t < time and abs(due - time) <= 8 * np.spacing(largest):
                    return float(time)
        return due

    def _next_rest(self, at: Instant, series: InputSeries | None, end: float) -> float:
        """Return the next sample at which a relation of inputs becomes 0 and rests, s, to an end.

        As nothing moves the relation from there on, it has the value of its operator.
        """
        which = list(self.system.resting)
        if series is None or not which:
            return np.inf
        begin, stop = series.time.searchsorted((at.t, end), "right")
        times = np.concatenate(([at.t], series.time[begin : stop + 1], [series.time[-1] + 1]))
        u, _ = with_slopes(self.dae, series.around(at.t), at.inputs, times)
        x, z = (np.tile(row, (len(times), 1)) for row in (at.x, at.z))
        seen = watch(self.system, times, (x, z, u, 0 * u), self.values.p, closely=False)
        values = seen.arguments[:, which]
        boundaries = np.where(np.array(self.system.floors)[which], np.round(values), 0)
        moves = np.diff(values, axis=0) != 0
        rests = (values == boundaries)[1:-1] & moves[:-1] & ~moves[1:]
        found = times[1:-1][rests.any(axis=1)]
        return float(found[0]) if found.size else np.inf

    def _rest_after(
        self, passed: Sequence[Passed], series: InputSeries | None, end: float
    ) -> float:
        """Return the first such sample after events of a piece that have moved such a relation."""
        if series is None or not self.system.resting:
            return np.inf
        states, inputs = self.system.resting_on
        for before, after, *_ in passed:
            moved = (before.x != after.x)[states].any()
            moved |= (before.inputs != after.inputs)[inputs].any()
            if moved and (rest := self._next_rest(after, series, end)) < end:
                return rest
        return np.inf

    def _followed(self) -> InputSeries | None:
        """Return the input series, with rates where states slide along inputs."""
        along = any(self.system.of_input[i] for i in self.at.sliding)
        return self.rated if along else self.series

    def _piece(self, times: Vector) -> Piece:
        """Integrate from the present instant over some times."""
        own = sliding(self.system, self.at.sliding)
        self.slides |= bool(own.sliding)
        series = self._followed()
        inputs = series and series.around(float(times[0]))
        if inputs and not np.ptp(inputs.values, axis=0).any():
            inputs = None  # it rests: code that is compiled without it serves all values
        problem = replace(
            self.problem,
            dae=own.dae,
            inputs=inputs,
            times=self.window.with_looks(times).tobytes(),
            most_steps=self.window.most_steps,
        )
        if self.closer and self.at.t < self.closer.until:
            problem = _with_shares(problem, self.closer)
        known = self.at, self.began, self.values.p, self.kernel
        piece = Piece(self.system, own, problem, self.solver, *known)
        self.reached.append(piece.reached)
        return piece

    def _pass(self, piece: Piece) -> None:
        """Record the events that the solver went through, and the rows before the last of them."""
        passed = piece.passed
        if passed:
            self._record(passed)
            self.at = passed[-1].after
        self._accept(piece, self.at.t, len(passed))

    def _switch(self, at: Instant, first: int = -1) -> None:
        """Let all happen that happens at an instant.

        Args:
            at: The instant just before, with the inputs just after it.
            first: The relation that was located there; -1 for none.
        """
        if self.kernel is None:
            self.at = at
            values = Values(at.x, self.values.p, at.u)
            self.at = replace(at, z=algebraic_values(self.dae, at.t, at.x, values))
            self._write(at.t)
            return
        if self.dae.derived:
            slid = self.at.sliding if (at.u == self.at.u).all() else frozenset[int]()
            self.at, happened = crossed(self.kernel, self.values.p, at, first, slid)
        else:
            happened = self.kernel.happen(at, first)
            self.at = self.kernel.after(at)
        switched = happened.zero | at.switched(self.at)
        instant = Passed(at, self.at, happened.events, happened.zero)
        self._record([instant])
        self._end(happened.ending, switched)
        if happened.replan:
            self.kernel.plan(self.at)
        self._write(self.at.t)

    def _record(self, passed: Sequence[Passed]) -> None:
        """Record instants, and the events at them."""
        first = len(self.instants)
        self.instants += [(instant.before, instant.after) for instant in passed]
        self.events += records_of(self.system, passed, first)

    def _end(self, ending: Outcome, switched: Iterable[int]) -> None:
        """End the run if an event does so; raise the error of an instant without a result."""
        if ending.reason is Reason.STOPPED:
            self.stop = self.system.events[ending.part].message
        names = ", ".join(self.system.described(i) for i in sorted(switched))
        reject(self.system, self.at.t, ending, names or "an event")

    def _with_inputs(self, at: Instant) -> Instant:
        """Return an instant with the inputs just after it."""
        series = self.series and self.series.around(at.t)
        (u,), (du,) = with_slopes(self.dae, series, self.values.u, np.array([at.t]))
        return replace(at, u=u, du=du)

    def _accept(self, piece: Piece, end: float, events: int = 0) -> None:
        """Write the rows of a piece before a time, with the modes between its first `events`."""
        last = min(end, np.nextafter(piece.times[-1], np.inf)) if len(piece.times) else -np.inf
        rows = slice(self.next, int(self.grid.searchsorted(last)))
        if rows.start >= rows.stop:
            return
        times = self.grid[rows]
        places = piece.times.searchsorted(times)
        self.states[rows], self.u[rows] = piece.x[places], piece.u[places]
        own = self.u[rows, self.u.shape[1] - len(piece.begin.modes) :]
        if events:
            before = [passed.before for passed in piece.passed[:events]]
            following = np.searchsorted([at.t for at in before], times, "right")
            own[:] = np.array([at.modes for at in before])[following]
        elif piece.own.sliding:
            own[:, piece.own.sliding] = piece.seen.solved[places]
        self.algebraics[rows] = piece.z[places, : self.algebraics.shape[1]]
        self.next = rows.stop

    def _write(self, t: float) -> None:
        """Write the row at the present instant, if the grid has it."""
        if self.next < len(self.grid) and self.grid[self.next] == t:
            self.states[self.next], self.algebraics[self.next] = self.at.x, self.at.z
            self.u[self.next] = np.concatenate((self.at.u, self.at.modes))
            self.next += 1
