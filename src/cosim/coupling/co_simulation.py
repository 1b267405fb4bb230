"""Co-simulation of coupled FMUs by the compiled master of fmu/master/coupling.h."""

import ctypes
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from casadi_models.dae.coupled import Connection
from cosim.arrays import Truths
from cosim.coupling import estimate, failures
from cosim.coupling.c_structures import coupling_library
from cosim.coupling.merged import sides_of
from cosim.coupling.open_system import OpenSystem, Rows
from cosim.coupling.opened_part import Ability, OpenedPart
from cosim.coupling.own_steps import own_steps
from cosim.coupling.settings import Method, Settings
from cosim.coupling.stability import Ranges, reject_instability, sliding_part
from cosim.coupling.wiring import Wiring
from cosim.errors import Interrupted, SolverError
from cosim.fmi.run.c_structures import Ending
from cosim.fmi.run.description import by_name
from cosim.fmi.run.instance import invalidity, why_it_ended
from cosim.fmi.run.request import column_of, numeric_names, rounding
from cosim.host.last_call import noted_calls
from cosim.host.progress import doing
from cosim.host.signals import interruptible
from cosim.model.times import one_time, time_grid
from cosim.series.samples import below
from cosim.text import moment, one_note
from cosim.trajectory import Column, Event, Trajectory

DEFAULT_ACCURACY = 1e-6  # if neither accuracy nor macro step is given
_TOLERANCE = 1e-10  # of the parts' solvers, with a given macro step
_FIRST = 0.25  # tolerance of the first run, of the accuracy; with more, a third run is usual
_TIGHTER, _OF_PARTS = 1 / 16, 0.01  # of the last; of the coupling's
_COARSE = 1e-2  # accuracy of the first run where noise cannot be measured
_TIGHTEST = 1e-13


@dataclass(frozen=True)
class _Task:
    """A checked request.

    Attributes:
        settings: How to simulate.
        values: Start values by part, by variable.
        columns: Names of the recorded variables by part.
        called: Shows the place of the part that is being called.
        end: Where a part ends the run, s.
    """

    settings: Settings
    values: Mapping[str, Mapping[str, float]]
    columns: Mapping[str, list[str]]
    called: ctypes.c_longlong
    end: float = np.inf


class CoSimulation:
    """The FMUs of a system, open for several runs.

    Args:
        name: Of the system.
        files: FMUs by part.
        wires: What drives what.
        unused: Abilities of parts that are not used, by part.
        unknown: Parts whose equations are not known.
        sticking: Models with relations that may stay at 0 by what other parts do: whether all of
            these can merge.

    Raises:
        FmuError: A file cannot be loaded.
    """

    def __init__(
        self,
        name: str,
        files: Mapping[str, Path],
        wires: Sequence[Connection],
        unused: Mapping[str, Sequence[Ability]],
        unknown: Sequence[str] = (),
        sticking: Mapping[str, bool] | None = None,
    ) -> None:
        self.name, self._sticking = name, dict(sticking or {})
        self._open = ExitStack()
        self.parts = dict[str, OpenedPart]()
        callback = ctypes.cast(coupling_library().give_inputs, ctypes.c_void_p).value or 0
        for part, path in sorted(files.items()):
            own = {wire.input[1] for wire in wires if wire.input[0] == part}
            outputs = {wire.output[1] for wire in wires if wire.output[0] == part}
            without = unused.get(part, ())
            self.parts[part] = opened = OpenedPart(part, path, own, outputs, callback, without)
            self._open.callback(opened.close)
        self.wiring = Wiring(name, self.parts, list(files), wires, unknown)

    def close(self) -> None:
        """Free all instances."""
        self._open.close()

    def run(
        self,
        settings: Settings,
        values: Mapping[str, Mapping[str, float]],
        outputs: Sequence[tuple[str, str]] | None,
    ) -> Trajectory:
        """Simulate; see `System.simulate`.

        Args:
            settings: How.
            values: Start values by part, by variable.
            outputs: What to record; all outputs and connected inputs when None.
        """
        began = perf_counter()
        with noted_calls(list(self.parts)) as called:
            task = _Task(settings, values, self._columns(outputs), called)
            of_parts = settings.tolerance or _TOLERANCE

            @cache
            def given(step: float, merges: bool) -> tuple[Trajectory, Truths, Ranges]:
                own = replace(task, settings=replace(settings, macro_step=step, merges=merges))
                return self._once(own, estimate.OF_A_RUN * of_parts, of_parts)

            step, merges, part = settings.macro_step, settings.merges, None
            if step is None:
                run, ranges = self._accurate(task), None
            else:
                run, _, ranges = given(step, merges)
                part = self.sticking_part() or sliding_part(
                    ranges, lambda share: given(share * step, True)[2]
                )
            slides = failures.sliding(self.wiring, part) if part else None
            if part and merges:
                raise failures.EndlessEvents(f"{self.name}: {slides}", run, part)
            small = below(run.columns, run.values, run.stats.get("accuracy", 0.0))
            notes = one_note(run.stats.get("note"), small, slides)
            stats = {**run.stats, "wall_time": perf_counter() - began}
            run = replace(run, stats=stats | ({"note": notes} if notes else {}))
            if ranges:
                inputs = [".".join(name) for name in self.wiring.inputs]
                reject_instability(run, ranges, inputs, lambda shorter: given(shorter, merges)[2])
        return run

    def sticking_part(self) -> str | None:
        """Return a part with a relation that has stayed 0 by parts that feel it; None without."""
        wires, parts = self.wiring.connections, self.parts.items()
        slides = (
            (name, inputs) for name, p in parts for inputs in p.instance.logged.sliding.values()
        )
        return next((n for n, inputs in slides if len(sides_of(wires, n, inputs)) > 1), None)

    def opened(
        self,
        settings: Settings,
        values: Mapping[str, Mapping[str, float]],
        called: ctypes.c_longlong,
        *,
        ends: bool,
    ) -> OpenSystem:
        """Return a run that records nothing and is still to begin.

        Where an accuracy chooses the macro steps, their tolerance is that of the second run of
        `System.simulate`, and no further run checks it.

        Args:
            settings: How to simulate.
            values: Start values by part, by variable.
            called: Shows the place of the part that is being called.
            ends: Whether the run ends at the stop time.
        """
        if settings.macro_step is None:
            accuracy = settings.accuracy or DEFAULT_ACCURACY
            tolerance = max(_FIRST * _TIGHTER * accuracy, _TIGHTEST)
            of_parts = settings.tolerance or _tolerance_of_parts(tolerance)
        else:
            of_parts = settings.tolerance or _TOLERANCE
            tolerance = estimate.OF_A_RUN * of_parts
        lengths = (settings.macro_step, settings.interval, None)
        return OpenSystem(
            self.wiring,
            values,
            settings,
            Rows.of(np.array([settings.start]), dict.fromkeys(self.parts, ())),
            own_steps(self.name, self.parts, *lengths, 1.0, at_internal_steps=False),
            tolerance=tolerance,
            of_parts=of_parts,
            ends=ends,
            called=called,
        )

    def _accurate(self, task: _Task) -> Trajectory:
        """Tighten the tolerance of the coupling until two runs in succession agree."""
        settings = task.settings
        accuracy = settings.accuracy or DEFAULT_ACCURACY
        last, steps, ratio, before, jumps_before = None, 0, 1.0, 0.0, np.empty(0, dtype=bool)
        # where a part falls short of order 4, the estimate may miss what it does within a step
        smooth = set(self.orders(settings.method).values()) == {"cubic inputs"}
        first = max(_FIRST * accuracy, 2 * _TIGHTEST)
        fixed = [name for name, part in self.parts.items() if not part.rolls_back]
        few, may = partial(self._in_few_steps, task), self._may_round()
        span = settings.stop - settings.start
        noise = estimate.noise_by_restarts(few, span, may & bool(fixed)) / 2
        # their noise shows by tighter runs that differ more; no two runs take the same steps
        tolerance = coarsest = max(first, _FIRST * _COARSE) if fixed else first
        while True:
            of_parts = settings.tolerance or _tolerance_of_parts(tolerance)
            try:
                run, jumps, ranges = self._once(task, tolerance, of_parts, tolerance / coarsest)
            except SolverError as error:
                if last is None or isinstance(error, failures.EndlessEvents):
                    raise
                reason = str(error).removeprefix(f"{self.name}: ")
                raise SolverError(
                    f"{self.name}: the coupling does not reach the accuracy {accuracy:g}: {reason}",
                    partial=last,
                ) from error
            if "forced_steps" in run.stats:
                return _unless_required(run, settings.accuracy)
            steps += run.stats["macro_steps"]
            tighter, sizes = _TIGHTER, np.array([column.nominal for column in run.columns])
            unseen = estimate.rounding_of(run, sizes, accuracy) + noise * run.stats["macro_steps"]
            if last is not None:
                change = estimate.changes(run, last, jumps | jumps_before) / sizes
                most = float(change.max())
                of = run.columns[int(change.argmax())].name
                least = self._least(ordered=smooth)
                # events that are found by chance may differ more with any tolerance
                known = 0.0 if least == estimate.BY_CHANCE else before
                estimate.reject_noise(run, fixed, accuracy, known, most, of, unseen)
                total = estimate.estimated_error(
                    most, before, ratio, accuracy, of_parts, least=least
                )
                total += unseen
                found = {"accuracy": accuracy, "error_estimate": total, "error_estimate_of": of}
                run = replace(run, stats={**run.stats, **found, "all_macro_steps": steps})
                if total <= accuracy:
                    still = estimate.frozen_motion(
                        run, self.wiring.sources, ranges, may, partial(few, span), accuracy - total
                    )
                    return replace(run, stats={**run.stats, "error_estimate": total + still})
                if before or not fixed:
                    tighter = min(_TIGHTER, accuracy / total / 2)
                before = most
                if tolerance <= _TIGHTEST:
                    break
            last, jumps_before = run, jumps
            ahead = (first, _TIGHTEST / _TIGHTER, _TIGHTEST)  # the last confirms the one before
            least = next(one for one in ahead if one < tolerance or one == _TIGHTEST)
            ratio = max(tighter, least / tolerance)
            tolerance = max(tolerance * tighter, least)
        raise estimate.unreached(run, accuracy, f"the last two runs differ by {total:.2g} ({of})")

    def _least(self, *, ordered: bool) -> float:
        """Return how much of the error a smaller tolerance leaves at least, after a run."""
        parts = self.parts.values()
        switched = [p for p in parts if p.instance.logged.events]
        if any(p.holds_inputs for p in parts if p.event_mode or p in switched):
            return estimate.BY_CHANCE
        ending = any(p.event_mode and p.description.numberOfEventIndicators for p in parts)
        if ending and not all(p.rolls_back for p in parts):  # no step can end earlier
            return estimate.BY_CHANCE
        return 0.0 if ordered and not switched else estimate.UNKNOWN

    def _may_round(self) -> Truths:
        """Return whether each input is driven by a continuous output of a foreign part."""
        own = [self.parts[name].is_own for name, _ in self.wiring.sources]
        may: Truths = ~np.array(own, dtype=bool) & (self.wiring.held[:-1] == 0)
        return may

    def _in_few_steps(self, task: _Task, span: float, steps: int) -> Ranges:
        """Return the ranges of the inputs in a few steps from the start with constant inputs."""
        length, stop = span / steps, task.settings.start + span
        settings = replace(task.settings, macro_step=length, interval=length, accuracy=None)
        held = replace(task, settings=replace(settings, method=Method.JACOBI, stop=stop))
        return self._once(held, _TOLERANCE, _TOLERANCE)[2]

    def _once(
        self, task: _Task, tolerance: float, of_parts: float, share: float = 1.0
    ) -> tuple[Trajectory, Truths, Ranges]:
        """Simulate once; return the run, which output times lie at jumps, (times,), and ranges.

        Args:
            task: What to simulate.
            tolerance, of_parts: Of the coupling, and of the solvers of the parts.
            share: Of the first run's tolerance; the first and the longest macro steps follow it.
        """
        settings = task.settings
        times = time_grid(settings.start, settings.stop, settings.interval)
        if task.end < settings.stop:
            after = (times > task.end) | one_time(times, task.end, settings.start)
            times[int(np.argmax(after))] = task.end
        rows = Rows.of(times, task.columns)
        span = settings.stop - settings.start
        lengths = (settings.macro_step, settings.interval, span)
        default = settings.accuracy is None
        steps = own_steps(self.name, self.parts, *lengths, share, at_internal_steps=default)
        system = OpenSystem(
            self.wiring,
            task.values,
            settings,
            rows,
            steps,
            tolerance=tolerance,
            of_parts=of_parts,
            refinement=share**0.25,
            called=task.called,
        )

        def done() -> float:
            return float((system.c.time - settings.start) / span)

        with (
            closing(system),
            doing("solving", done),
            interruptible(coupling_library()) as interrupts,
        ):
            system.begin()
            for goal in sorted({min(task.end, settings.stop), settings.stop}):
                if system.is_done:
                    system.advance(goal)
        # a part has ended the run within a macro step: another run has one that ends there
        if system.c.time < system.end < task.end and not (steps.quantum or steps.of_parts):
            return self._once(replace(task, end=system.end), tolerance, of_parts, share)
        run = self._result(system, settings, rows, bool(interrupts))
        if lost := system.lost_state():
            why = f"{lost} at the end of the run"
            run = replace(run, status=f"stopped: {why}")
            raise SolverError(f"{self.name}: {why}", partial=run)
        reached = system.lowest, system.highest, system.sizes, float(system.c.mismatch)
        switching = {*self._sticking, *self.wiring.unknown}
        repeats = failures.repeats(self.wiring, switching, settings.macro_step or 0.0)
        return run, system.jumps, Ranges(*reached, repeats)

    def _result(
        self, opened: OpenSystem, settings: Settings, recorded: Rows, interrupted: bool
    ) -> Trajectory:
        system, parts, columns = opened.c, opened.parts, recorded.columns
        rows = int(system.rows)
        times = np.minimum(recorded.times[:rows], system.time)
        shown = [
            _column(f"{name}.{v}", v, self.parts[name].description)
            for name, wanted in columns.items()
            for v in wanted
        ]
        steps = {n: int(part.steps) for n, part in zip(self.parts, parts, strict=True)}
        stats: dict[str, Any] = {
            "solver": f"co-simulation, {settings.method}",
            "macro_steps": int(system.macro_steps),
            "rejected_steps": int(system.rejected),
            "iterations": int(system.iterations),
            "part_steps": {n: steps[n] for n in self.wiring.turns},
            "order": self.orders(settings.method),
        }
        if system.quantum and system.forced:
            stats["forced_steps"] = int(system.forced)
        if settings.macro_step is not None:
            stats["macro_step"] = settings.macro_step
            if settings.method in (Method.EXTRAPOLATED, Method.ITERATED):
                stats["interface_error"] = float(max(system.interface_error, system.coarse))
        if system.how == Ending.ENDED_BY_FMU:
            name = list(self.parts)[system.part]
            why = why_it_ended(self.parts[name].instance.logged.texts)
            stats |= {"stop": f"{why} (part '{name}') from {opened.end:.12g} s on"}
            stats |= {"stop_time": opened.end}
        stats |= invalidity(failures.violations(self.wiring))
        run = Trajectory(
            self.name,
            times,
            tuple(shown),
            np.hstack([np.zeros((rows, 0)), *(recorded.tables[n][:rows] for n in columns)]),
            stats,
            status="complete",
            events=self.events(),
        )
        variables = [by_name(self.parts[n].description)[v] for n in columns for v in columns[n]]
        notes = [*failures.notes_of(system, self.wiring), *filter(None, [rounding(variables, run)])]
        if notes:
            stats["note"] = "; ".join(notes)
        if interrupted or system.how == Ending.INTERRUPTED:
            run = replace(run, status=f"stopped after {moment(system.time, 6)} s: interrupted")
            raise Interrupted(f"{self.name}: interrupted", partial=run)
        why = ""
        if system.how not in (Ending.DONE, Ending.ENDED_BY_FMU):
            why = failures.failure(system, self.wiring, recorded)
            run = replace(run, status=f"stopped: {why}")
        may_be_endless = why or settings.macro_step
        part = failures.endless_part(system, self.wiring, why) if may_be_endless else None
        if part:
            remedy = failures.as_models(self.wiring)
            why += "" if not why or remedy in why else remedy
            if not why:
                repeated = f"an event of part '{part}' repeats itself at one instant{remedy}"
                run = replace(run, stats={**run.stats, "note": one_note(*notes, repeated)})
            if why or settings.merges:
                raise failures.EndlessEvents(f"{self.name}: {why}", run, part)
        if why:
            raise SolverError(f"{self.name}: {why}", partial=run)
        return run

    def events(self) -> tuple[Event, ...]:
        """Return what the parts have logged, unless they may have gone back behind it."""
        if not all(part.rolls_back for part in self.parts.values()):
            return ()
        logged = [
            (time, f"{name}: {event}")
            for name, part in self.parts.items()
            if part.event_mode and not part.holds_inputs
            for time, event in part.instance.logged.events
        ]
        return tuple(Event(time, name, {}, {}) for time, name in sorted(logged))

    def orders(self, method: Method) -> dict[str, str]:
        """Return how the inputs of each part move within a macro step, in words."""
        if method in (Method.JACOBI, Method.GAUSS_SEIDEL):
            return dict.fromkeys(self.wiring.turns, "constant inputs")
        found = {}
        for name, part in ((name, self.parts[name]) for name in self.wiring.turns):
            words = [f"{part.order.name.lower()} inputs"]
            if not part.rates and part.outputs:
                words.append("output derivatives from values")
            if part.event_mode:
                words.append("events end macro steps")
            if method is Method.ITERATED and not part.rolls_back:
                words.append("one step without repetition: it cannot restore its state")
            found[name] = ", ".join(words)
        return found

    @property
    def recorded(self) -> list[tuple[str, str]]:
        """What a run records by default: all outputs and connected inputs, by part and name."""
        return [(part, name) for part, names in self._columns(None).items() for name in names]

    def _columns(self, outputs: Sequence[tuple[str, str]] | None) -> dict[str, list[str]]:
        if outputs is not None:
            return {n: [v for part, v in outputs if part == n] for n in self.wiring.turns}
        found = {}
        for name in self.wiring.turns:
            part = self.parts[name]
            own = [v for v in part.description.modelVariables if v.causality == "output"]
            found[name] = list(dict.fromkeys(numeric_names([*own, *part.inputs])))
        return found


def _tolerance_of_parts(tolerance: float) -> float:
    """Return the tolerance of the parts' solvers for one of the coupling."""
    return min(max(_OF_PARTS * tolerance, _TIGHTEST), 1e-4)


def _unless_required(run: Trajectory, accuracy: float | None) -> Trajectory:
    """Return a run that notes what keeps it from its tolerance; an error if that is required."""
    if accuracy is None:
        return run
    raise estimate.unreached(run, accuracy, run.stats["note"])


@lru_cache(1024)
def _column(name: str, variable: str, description: Any) -> Column:
    return replace(column_of(by_name(description)[variable], description), name=name)
