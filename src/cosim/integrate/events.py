"""`integrate`: from one event to the next, through jumps of inputs and events of the model.

Between events the solver integrates the frozen equations (see `casadi_models.dae.hybrid`). The
relations are looked at on a grid of times; where one leaves its mode, the time is located on the
motion of the solver, the modes and states after the event follow, and the solver starts afresh.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from casadi_models.dae import Dae
from casadi_models.dae.hybrid import Hybrid, input_rates
from casadi_models.dae.relations import COMPARISONS
from cosim.arrays import Vector
from cosim.codegen.initialization import law_of_knowns
from cosim.codegen.pulses import pulse_times
from cosim.errors import InitialConditionError, SolverError, UsageError
from cosim.integrate.call import INTERRUPTED, Evaluator, Reached
from cosim.integrate.engine import Counts, Problem
from cosim.integrate.families.fixed_step import FixedStep
from cosim.integrate.initial_values import algebraic_values, input_values
from cosim.integrate.location import Piece, located, next_of_time, with_input_rates, with_slopes
from cosim.integrate.modes import (
    MOST_ROUNDS,
    Instant,
    along,
    begun,
    blended,
    hybrid,
    moved,
    settled,
    shift,
    sliding,
)
from cosim.integrate.motion import EventRecord, Motion
from cosim.integrate.nominal import InitialState, scaled_call
from cosim.memo import cached_per_thread
from cosim.model.inputs import InputSeries
from cosim.model.solver import AdaptiveSolver, Solver
from cosim.model.values import Values

_FIRST_WINDOW = 32  # grid intervals that are integrated at once; doubled after each
_LEAST_WINDOW, _LEAST_WATCHED = 8, 1000  # after an event; if the solver ends at the next one
_STEPS_PER_LOOK, _MOST_LOOKS = 8, 100_000  # on average; in a piece
_ZENO = 1e-10  # distance of events, relative to the time (1 s or the run at least), of which ...
_MOST_CLOSE = 10  # ... so many in succession are no motion that can be followed, and ...
_IDLE = 4  # ... one at which nothing happens, but the error of the solver, is worth so many


def integrate(problem: Problem, solver: Solver, start: InitialState) -> Motion:
    """Integrate over the grid of a problem, from each event to the next.

    No step extends over a jump of an input or an event, and each piece uses the inputs and modes
    on its own side, which preserves the order of every method. Values at an event are those after.

    Raises:
        UsageError, ParameterError, MissingTool: See `engine_of`.
        SolverError: An event has no consistent result.
    """
    problem, start = with_input_rates(problem, start)
    system = hybrid(problem.dae)
    breaks = problem.inputs is not None and problem.inputs.breaks.size
    smooth = problem.dae if system is None else system.dae
    span = float(problem.grid[0]), float(problem.grid[-1])
    longest = solver.step(problem) if isinstance(solver, FixedStep) else span[1] - span[0]
    if isinstance(solver, AdaptiveSolver) and solver.max_step is not None:
        longest = min(longest, solver.max_step)
    pulses = pulse_times(smooth, start.values.p, *span, longest)
    if system is not None or breaks or len(pulses):
        no_events = Hybrid(problem.dae, (), (), ())
        return _Course(problem, system or no_events, solver, start, pulses).run()
    found = scaled_call(problem, solver, start)
    u = input_values(problem.dae, problem.grid, start.values, problem.inputs)
    n = found.states.shape[1]
    columns = found.states, found.algebraics, u[:, :n]
    return Motion(
        problem.dae, problem.grid[:n], *columns, found.counts, found.reason, found.solve_time
    )


@cached_per_thread(16)
def _rules(system: Hybrid) -> Evaluator:
    """Return a function of t, x, z, u, p: conditions of all events, and their new values."""
    return Evaluator(ca.Function("rules", system.dae.arguments, [*system.rules], {"cse": True}))


@cached_per_thread(16)
def _residuals(dae: Dae) -> tuple[Evaluator, ...]:
    """Return functions of t, x, u, p: the residuals of the invariants."""
    return tuple(
        Evaluator(law_of_knowns(dae, "residual", ca.densify(law.residual)))
        for law in dae.invariants
    )


class _Course:
    """A run of a hybrid model on its way over the grid."""

    def __init__(
        self, problem: Problem, system: Hybrid, solver: Solver, start: InitialState, pulses: Vector
    ) -> None:
        self.problem, self.system, self.solver = problem, system, solver
        self.dae, self.grid = problem.dae, problem.grid
        self.values, self.began = start.values, start.x
        self.series = problem.inputs and problem.inputs.with_jumps_at(self.grid)
        rates = {name: self.dae.inputs[i].name for name, i in input_rates(self.dae).items()}
        self.rated = self.series and self.series.with_rates(rates)
        self.pulses = pulses
        n = len(self.grid)
        sizes = len(start.x), len(start.z), len(system.dae.inputs)
        self.states, self.algebraics, self.u = (np.empty((n, size)) for size in sizes)
        self.next = 0  # row of the grid to be written
        self.reached = list[Reached]()
        self.events = list[EventRecord]()
        self.instants = list[tuple[Instant, Instant]]()
        self.close = 0  # events in succession that are close to each other
        watches = not system.relations or (problem.compiled and solver.watches)
        self.window = len(self.grid) if watches else _FIRST_WINDOW
        self.least_window = _LEAST_WATCHED if watches else _LEAST_WINDOW
        self.stop, self.slides, self.looks = "", False, 1  # looks per grid interval
        t = float(self.grid[0])
        modes = np.ones(len(system.relations))
        at = self._with_inputs(Instant(t, start.x, start.z, start.values.u, start.values.u, modes))
        self.at = begun(system, at, start.values.p) if system.relations else at
        conditions = self._conditions_at(self.at)
        for event, holds in zip(system.events, conditions, strict=True):
            if event.message and holds:
                raise UsageError(
                    f"{self.dae.full_name}: {event.name} '{event.message}' is true at the start "
                    "already; give a condition that becomes true later"
                )
        if system.events:
            begin = self.at
            self._happen(self._conditions_before(conditions))
            self.instants.append((begin, self.at))
        self._write(self.at.t)
        self._project(frozenset())

    def run(self) -> Motion:
        """Run to the end of the grid, or to an event that ends the run."""
        reason = ""
        while self.next < len(self.grid) and not self.stop and not reason:
            try:
                reason = self._advance()
            except InitialConditionError:
                reason = f"no solution after the jump of an input at {self.at.t:g} s"
            except SolverError as error:
                reason = str(error).removeprefix(f"{self.dae.full_name}: ")
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
            Counts.total([reached.counts for reached in self.reached]),
            reason,
            sum(reached.solve_time for reached in self.reached),
            self.events,
            self.stop,
            self.instants,
        )

    def _advance(self) -> str:
        """Integrate to the end of a window, or to the first event in it.

        Returns:
            Why the solver stopped early; empty if it did not.
        """
        at, grid = self.at, self.grid
        due, changing = next_of_time(self.system, at, self.values.p, float(grid[-1]))
        row = float(grid[grid.searchsorted(due) - 1])
        if changing and at.t < row and due - row <= 8 * np.spacing(abs(row)):
            due = row  # only rounding is between them
        series = self._followed()
        ends = series.breaks if series else np.empty(0), self.pulses
        later = (times[times.searchsorted(at.t, "right") :] for times in ends)
        jump, pulse = (float(times[0]) if len(times) else np.inf for times in later)
        end = min(due, jump, float(grid[-1]), pulse)
        last = min(self.next + min(self.window, _MOST_LOOKS // self.looks), len(grid) - 1)
        if grid[last] < end:
            end = float(grid[last])
        rows = grid[self.next :][grid[self.next :] < end]
        piece = self._piece(np.array([at.t, *rows[rows > at.t], end]))
        self._pass(piece)
        at = piece.begin
        found = None if piece.reason == INTERRUPTED else located(piece)
        if found is not None:
            event = found.at
            self._accept(piece, event.t)
            before = self._conditions_at(at)
            due_rows = 2 * int(np.searchsorted(piece.times, event.t)) // self.looks
            self.window = max(self.least_window, min(self.window, due_rows))
            self._switch(event, found.crossing, before)
            return ""
        if piece.reason:
            self._accept(piece, np.inf)
            if piece.reason == INTERRUPTED or len(piece.times) < 2:
                return piece.reason
            self.at, self.window = piece.at_end(), self.least_window
            return ""  # a fresh start may succeed
        self._accept(piece, end)
        self.window *= 2
        arrived = piece.at_end()
        before = self._conditions_at(at)
        if end in (due, jump):
            if end == jump:
                following = self._with_inputs(arrived)
                arrived = following.without_moved(arrived, self.system, self.values.p)
            crossing = changing if end == due else frozenset[int]()
            self._switch(replace(arrived, t=end), crossing, before)
        else:
            self.at = self._with_inputs(arrived)
            self._write(end)
        return ""

    def _followed(self) -> InputSeries | None:
        """Return the input series, with rates where states slide along inputs."""
        along = any(self.system.of_input[i] for i in self.at.sliding)
        return self.rated if along else self.series

    def _piece(self, times: Vector) -> Piece:
        """Integrate from the present instant over some times."""
        own = sliding(self.system, self.at.sliding)
        self.slides |= bool(own.sliding)
        series = self._followed()
        inputs, gaps = series and series.around(float(times[0])), np.diff(times)
        if inputs and not np.ptp(inputs.values, axis=0).any():
            inputs = None  # it rests: code that is compiled without it serves all values
        problem = replace(self.problem, dae=own.dae, inputs=inputs)
        while True:
            inner = times[:-1, None] + gaps[:, None] * np.arange(1, self.looks) / self.looks
            looks = np.sort(np.append(times, inner[gaps > gaps.max() / self.looks]))
            own_problem = replace(problem, times=looks.tobytes())
            start = self.at, self.began, self.values.p
            piece = Piece(self.system, own, own_problem, self.solver, *start)
            self.reached.append(piece.reached)
            steps = (piece.reached.counts.steps or 0) / len(looks)
            enough = steps <= _STEPS_PER_LOOK or piece.reached.watched or piece.reason
            if enough or not self.system.of_states:
                return piece
            self.looks = min(2 * int(steps * self.looks / _STEPS_PER_LOOK), _MOST_LOOKS)

    def _pass(self, piece: Piece) -> None:
        """Record the events that the solver went through, and the rows before the last of them."""
        done = 0
        try:
            for before, after, which in piece.passed:
                was, self.at, done = self.at.t, after, done + 1
                switched = () if which else before.zero | before.switched(after)
                self._record([self.system.events[i].name for i in which], switched, before.x)
                self.instants.append((before, after))
                self._reject_zeno(was)
        finally:
            self._accept(piece, self.at.t, done)

    def _switch(self, at: Instant, crossing: frozenset[int], before: Vector) -> None:
        """Apply an event: modes, assignments, and what follows from them at the same instant."""
        if not self.system.relations:
            self.at = at
            values = Values(at.x, self.values.p, at.u)
            self.at = replace(at, z=algebraic_values(self.dae, at.t, at.x, values))
            self._write(at.t)
            return
        begin, x, dt = at, at.x, 0.0
        if self.dae.derived:
            # where a mode at its edge ends sliding, rates are continuous, and so are derivatives
            at, dt = self._moved(at, crossing - self.at.sliding)
        left = crossing & at.sliding
        for i in left:  # its mode is at the edge
            modes = at.modes.copy()
            modes[i] = np.sign(modes[i])
            at = replace(at, modes=modes, sliding=at.sliding - {i})
        last, n = self.at, len(self.events)
        same = at.t - last.t <= 8 * np.spacing(abs(at.t))  # what crossed at the last event is at 0
        at = replace(at, zero=at.zero | crossing | (last.zero if same else frozenset()))
        self.at = settled(self.system, at, self.values.p, left)
        self._happen(before, crossing | begin.switched(self.at), x, dt)
        if dt:
            rates = self.at.watched(self.system, self.values.p).ode[0]
            self.at = replace(self.at, x=moved(self.at.x, self.dae.derived, rates, -dt))
        self._project(last.sliding if (at.u == last.u).all() else frozenset())
        self.instants.append((begin, self.at))
        self._reject_zeno(last.t, 1 if len(self.events) > n else _IDLE)
        self._write(self.at.t)

    def _moved(self, at: Instant, zero: Collection[int]) -> tuple[Instant, float]:
        """Return an instant with derivatives at the moving time of an event, and how it moves."""
        if not zero:
            return at, 0.0
        system, p, i = self.system, self.values.p, min(zero)
        seen = at.watched(system, p)
        u = np.concatenate((at.u, at.modes))
        change = along(system)(at.t, at.x, at.z, u, p, 0.0)[0]
        dt = shift(float(change[i]), float(seen.rates[0, i]))
        return replace(at, x=moved(at.x, self.dae.derived, seen.ode[0], dt)), dt

    def _project(self, before: frozenset[int]) -> None:
        """Let the derivatives of the states slide, too, with what did not slide before."""
        for i in sorted(self.at.sliding - before if self.dae.derived else ()):
            slid, modes = self.at, self.at.modes.copy()
            modes[i] = 1.0
            at, dt = self._moved(replace(slid, modes=modes, sliding=slid.sliding - {i}), {i})
            rates = slid.watched(self.system, self.values.p).ode[0]
            self.at = replace(slid, x=moved(at.x, self.dae.derived, rates, -dt))

    def _happen(
        self, before: Vector, switched: Iterable[int] = (), x: Vector | None = None, dt: float = 0.0
    ) -> None:
        """Let events happen whose conditions have risen, until none is left."""
        happened = list[str]()
        start = self.at.x if x is None else x
        for _ in range(MOST_ROUNDS):
            now = self._conditions_at(self.at)
            risen = [
                i
                for i, event in enumerate(self.system.events)
                if now[i] > before[i] and not (event.sampled and now[i] < 0)
            ]
            if not risen:
                break
            before = now
            happened += [self.system.events[i].name for i in risen]
            self.stop = next((m for i in risen if (m := self.system.events[i].message)), "")
            self.at = self._assigned(risen, dt)
            if self.stop:
                break
        else:
            raise SolverError(
                f"{self.dae.full_name}: '{happened[-1]}' happens again and again at "
                f"{self.at.t:.12g} s, more than {MOST_ROUNDS} times; let its assignments make its "
                "condition false"
            )
        self._record(happened, switched, start)

    def _record(self, happened: Sequence[str], switched: Iterable[int], before: Vector) -> None:
        """Record the events of an instant, or the relations of the equations that switch there."""
        if not happened:
            laws = (i for i in sorted(switched) if self.system.in_laws[i])
            happened = list(filter(None, [", ".join(map(self.system.described, laws))]))
        for name in happened:
            place = len(self.instants)
            self.events.append(EventRecord(self.at.t, name, before, self.at.x, place))

    def _assigned(self, which: Sequence[int], dt: float) -> Instant:
        """Return the instant after the assignments of some events, whose time moves by dt."""
        at, system, p = self.at, self.system, self.values.p
        u = np.concatenate((at.u, at.modes))
        _, new = _rules(system)(at.t, at.x, at.z, u, p)
        ends = np.cumsum([len(event.states) for event in system.events])
        x, nx, by = at.x.copy(), self.dae.derived, dict[int, str]()
        for i in which:
            states = np.array(system.events[i].states, dtype=int)
            rows = slice(ends[i] - len(states), ends[i])
            name = system.events[i].name
            for state in states[x[states] != new[rows]]:
                if other := by.get(state):
                    what = f"'{other}' and '{name}' give {self.dae.states[state].name}"
                    raise SolverError(
                        f"{self.dae.full_name}: {what} different values at {at.t:.12g} s; make "
                        "one event of them, or conditions that exclude each other"
                    )
            by |= dict.fromkeys(states.tolist(), name)
            x[states] = new[rows]
            if nx:
                x[nx + states] = along(system)(at.t, at.x, at.z, u, p, dt)[1][rows]
        if not np.isfinite(x).all():
            name = system.events[which[0]].name
            raise SolverError(
                f"{self.dae.full_name}: '{name}' gives a state no finite value at {at.t:.12g} s; "
                "assign a finite one"
            )
        self._reject_inconsistent(x, which)
        rates = at.watched(system, p).rates[0]
        at = replace(at, x=x).without_moved(at, system, p)
        return settled(system, at, p, frozenset(), np.abs(rates))

    def _reject_inconsistent(self, x: Vector, which: Sequence[int]) -> None:
        for invariant, law in zip(self.dae.invariants, _residuals(self.dae), strict=True):
            before, after = (
                np.abs(law(self.at.t, state, self.at.u, self.values.p)[0]).max()
                for state in (self.at.x, x)
            )
            if after > 1e-6 and after > 10 * before:
                name = self.system.events[which[0]].name
                raise SolverError(
                    f"{self.dae.full_name}: '{name}' at {self.at.t:.12g} s leaves states that "
                    f"violate: {invariant.meaning} (by {after:.2g}); assign consistent values"
                )

    def _reject_zeno(self, previous: float, weight: int = 1) -> None:
        t = self.at.t
        near = t - previous < _ZENO * max(min(1.0, self.grid[-1] - self.grid[0]), abs(t))
        self.close = self.close + weight if near else 0
        if self.close > _MOST_CLOSE:
            name = self.events[-1].name if self.events else "events"
            raise SolverError(
                f"{self.dae.full_name}: '{name}' happens ever faster before {t:.12g} s (Zeno); "
                "end the run before with a stop condition, or let the motion rest there"
            )

    def _conditions_at(self, at: Instant) -> Vector:
        if not self.system.events:
            return np.empty(0)
        u = np.concatenate((at.u, at.modes))
        return _rules(self.system)(at.t, at.x, at.z, u, self.values.p)[0]

    def _conditions_before(self, conditions: Vector) -> Vector:
        """Return the conditions before the start: at a boundary that of the value alone holds.

        Of samples it is their number: one is due at the start itself.
        """
        sampled = np.array([event.sampled for event in self.system.events], dtype=bool)
        seen, modes = self.at.watched(self.system, self.values.p).arguments[0], self.at.modes.copy()
        for i, relation in enumerate(self.system.relations):
            if seen[i] == 0 and relation.operation in COMPARISONS:
                modes[i] = relation.at_zero
        before = self._conditions_at(replace(self.at, modes=modes))
        if not sampled.any():
            return before
        near = np.abs(seen - np.round(seen)) <= 8 * np.spacing(np.abs(seen))
        due = near & np.array(self.system.floors, dtype=bool)
        earlier = replace(self.at, modes=np.where(due, np.round(seen) - 1, self.at.modes))
        return np.where(sampled, np.minimum(conditions, self._conditions_at(earlier)), before)

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
