"""Co-simulation of coupled FMUs by the compiled master of fmu/master/coupling.h."""

import ctypes
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_models.dae.coupled import Connection
from cosim.arrays import Truths, Vector
from cosim.coupling.c_structures import PartOfC, SystemOfC, coupling_library
from cosim.coupling.estimate import OF_A_RUN, changes, estimated_error, reject_noise
from cosim.coupling.failures import (
    EndlessEvents,
    Wiring,
    as_models,
    endless_part,
    failure,
    notes_of,
    violations,
)
from cosim.coupling.opened_part import Ability, OpenedPart, explained
from cosim.coupling.own_steps import own_steps
from cosim.coupling.settings import Method, Settings
from cosim.coupling.stability import Ranges, reject_instability
from cosim.errors import Interrupted, SolverError
from cosim.fmi.run.c_structures import Ending
from cosim.fmi.run.instance import by_name, invalidity, why_it_ended
from cosim.fmi.run.request import column_of, lost_state, numeric_names, rounding
from cosim.fmi.run.typed_values import is_continuous, start_number
from cosim.host.last_call import noted_calls
from cosim.host.progress import doing
from cosim.host.signals import interruptible
from cosim.model.times import time_grid
from cosim.trajectory import Column, Event, Trajectory

_ACCURACY = 1e-6  # if neither accuracy nor macro step is given
_TOLERANCE = 1e-10  # of the parts' solvers, with a given macro step
_FIRST = 0.25  # tolerance of the first run, of the accuracy; with more, a third run is usual
_TIGHTER, _OF_PARTS = 1 / 16, 0.01  # of the last; of the coupling's
_COARSE = 1e-2  # accuracy of the first run where noise cannot be measured
_TIGHTEST = 1e-13
_ANY_SIZE = 1e300  # of texts, which do not grow


@dataclass(frozen=True)
class _Task:
    """A checked request.

    Attributes:
        settings: How to simulate.
        values: Start values by part, by variable.
        columns: Names of the recorded variables by part.
        called: Shows the place of the part that is being called.
    """

    settings: Settings
    values: Mapping[str, Mapping[str, float]]
    columns: Mapping[str, list[str]]
    called: ctypes.c_longlong


class CoSimulation:
    """The FMUs of a system, open for several runs.

    Args:
        name: Of the system.
        files: FMUs by part.
        wires: What drives what.
        unused: Abilities of parts that are not used, by part.
        unknown: Parts whose equations are not known.

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
    ) -> None:
        self.name = name
        self._open, self._turns = ExitStack(), list(files)
        self.parts = dict[str, OpenedPart]()
        sources, inputs = list[tuple[str, str]](), list[tuple[str, str]]()
        driven = {wire.input: wire for wire in wires}
        callback = ctypes.cast(coupling_library().give_inputs, ctypes.c_void_p).value or 0
        for part, path in sorted(files.items()):  # in any order of the parts the same bits
            own = {wire.input[1] for wire in wires if wire.input[0] == part}
            outputs = {wire.output[1] for wire in wires if wire.output[0] == part}
            without = unused.get(part, ())
            self.parts[part] = opened = OpenedPart(part, path, own, outputs, callback, without)
            self._open.callback(opened.close)
            sources += [(part, variable.name) for variable in opened.outputs]
            inputs += [(part, variable.name) for variable in opened.inputs]
        wires, self._inputs = [driven[one] for one in inputs], inputs
        self._wiring = Wiring(self.parts, self._inputs, [w.output for w in wires], unknown)
        self._source = np.array([sources.index(wire.output) for wire in wires], dtype=np.int64)
        self._factor = np.array([wire.factor for wire in wires])
        self._offset = np.array([wire.offset for wire in wires])
        driving = [v for opened in self.parts.values() for v in opened.outputs]
        self._held = np.array(  # and one more, so that it is not empty
            [
                not (is_continuous(v) and is_continuous(driving[source]))
                for v, source in zip(self._input_variables, self._source, strict=True)
            ]
            + [False],
            dtype=np.int64,
        )
        self._feeds = np.zeros((len(sources), len(wires)), dtype=np.int64)
        row = column = 0
        for opened in self.parts.values():
            block = opened.feeds()
            end, right = row + block.shape[0], column + block.shape[1]
            self._feeds[row:end, column:right] = block
            row, column = end, right

    @property
    def _input_variables(self) -> list[Any]:
        """The connected inputs of all parts."""
        return [v for opened in self.parts.values() for v in opened.inputs]

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

            def given(step: float) -> tuple[Trajectory, Truths, Ranges]:
                own = replace(task, settings=replace(settings, macro_step=step))
                return self._once(own, OF_A_RUN * of_parts, of_parts)

            step = settings.macro_step
            run, _, ranges = (self._accurate(task), None, None) if step is None else given(step)
            run = replace(run, stats={**run.stats, "wall_time": perf_counter() - began})
            if ranges:
                inputs = [".".join(name) for name in self._inputs]
                reject_instability(run, ranges, inputs, lambda shorter: given(shorter)[2])
        return run

    def _accurate(self, task: _Task) -> Trajectory:
        """Tighten the tolerance of the coupling until two runs in succession agree."""
        settings = task.settings
        accuracy = settings.accuracy or _ACCURACY
        last, steps, ratio, before, jumps_before = None, 0, 1.0, 0.0, np.empty(0, dtype=bool)
        # where a part falls short of order 4, the estimate may miss what it does within a step
        smooth = set(self.orders(settings.method).values()) == {"cubic inputs"}
        first = max(_FIRST * accuracy, 2 * _TIGHTEST)
        fixed = [name for name, part in self.parts.items() if not part.rolls_back]
        # their noise shows by tighter runs that differ more; no two runs take the same steps
        tolerance = coarsest = max(first, _FIRST * _COARSE) if fixed else first
        while True:
            of_parts = settings.tolerance or min(max(_OF_PARTS * tolerance, _TIGHTEST), 1e-4)
            try:
                run, jumps, _ = self._once(task, tolerance, of_parts, tolerance / coarsest)
            except SolverError as error:
                if last is None or isinstance(error, EndlessEvents):
                    raise
                reason = str(error).removeprefix(f"{self.name}: ")
                raise SolverError(
                    f"{self.name}: the coupling does not reach the accuracy {accuracy:g}: {reason}",
                    partial=last,
                ) from error
            if "forced_steps" in run.stats:
                return self._forced(run, settings.accuracy)
            steps += run.stats["macro_steps"]
            tighter, sizes = _TIGHTER, np.array([column.nominal for column in run.columns])
            rounding = self._rounding(run, sizes, accuracy)
            if last is not None:
                change = changes(run, last, jumps | jumps_before) / sizes
                most = float(change.max())
                reject_noise(run, fixed, accuracy, before, most)
                ordered = smooth and not run.events
                estimate = estimated_error(most, before, ratio, accuracy, of_parts, ordered=ordered)
                estimate += rounding
                of = run.columns[int(change.argmax())].name
                found = {"accuracy": accuracy, "error_estimate": estimate, "error_estimate_of": of}
                run = replace(run, stats={**run.stats, **found, "all_macro_steps": steps})
                if estimate <= accuracy:
                    return run
                if before or not fixed:
                    tighter = min(_TIGHTER, accuracy / estimate / 2)
                before = most
                if tolerance <= _TIGHTEST:
                    break
            last, jumps_before = run, jumps
            ahead = (first, _TIGHTEST / _TIGHTER, _TIGHTEST)  # the last confirms the one before
            least = next(one for one in ahead if one < tolerance or one == _TIGHTEST)
            ratio = max(tighter, least / tolerance)
            tolerance = max(tolerance * tighter, least)
        raise SolverError(
            f"{self.name}: the coupling does not reach the accuracy {accuracy:g}: the last two "
            f"runs differ by {estimate:.2g} ({of}); allow a larger error, or give macro_step",
            partial=run,
        )

    def _rounding(self, run: Trajectory, sizes: Vector, accuracy: float) -> float:
        """Return the largest rounding of a run, in nominal values.

        Raises:
            SolverError: It is above the accuracy.
        """
        moves = np.ptp(run.values, axis=0) > 0
        every = np.finfo(float).eps * np.where(moves, np.abs(run.values).max(axis=0), 0) / sizes
        rounding = float(every.max(initial=0.0))
        if rounding > accuracy:
            raise SolverError(
                f"{self.name}: the coupling does not reach the accuracy {accuracy:g}: double "
                f"precision carries {run.columns[int(every.argmax())].name} to {rounding:.1g} "
                "nominal values only; allow a larger error, or give macro_step",
                partial=run,
            )
        return rounding

    def _forced(self, run: Trajectory, accuracy: float | None) -> Trajectory:
        """Return a run whose macro steps could not be as short as its tolerance wants them.

        Raises:
            SolverError: An accuracy is required.
        """
        forced, every = run.stats["forced_steps"], run.stats["macro_steps"]
        fixed = (n for n, part in self.parts.items() if part.internal_step or not part.any_step)
        reason = (
            f"the steps of {', '.join(fixed)} have a fixed length, which is too long in {forced} "
            f"of {every} macro steps"
        )
        if accuracy is None:
            return replace(run, stats={**run.stats, "note": reason})
        raise SolverError(
            f"{self.name}: the coupling does not reach the accuracy {accuracy:g}: {reason}; allow "
            "a larger error, or give macro_step",
            partial=run,
        )

    def _called(self, called: ctypes.c_longlong) -> Iterator[tuple[str, OpenedPart]]:
        """Yield the parts by name, each noted as the one that is called, and named in errors."""
        for place, (name, part) in enumerate(self.parts.items()):
            called.value = place
            with explained(self.name, part):
                yield name, part

    def _once(
        self, task: _Task, tolerance: float, of_parts: float, share: float = 1.0
    ) -> tuple[Trajectory, Truths, Ranges]:
        """Simulate once; return the run, which output times lie at jumps, (times,), and ranges.

        Args:
            task: What to simulate.
            tolerance, of_parts: Of the coupling, and of the solvers of the parts.
            share: Of the first run's tolerance; the first and the longest macro steps follow it.
        """
        settings, columns = task.settings, task.columns
        experiment = {"startTime": settings.start, "stopTime": settings.stop}
        experiment["tolerance"] = of_parts
        for name, part in self._called(task.called):
            part.start(task.values[name], **experiment)
        times = time_grid(settings.start, settings.stop, settings.interval)
        jumps = np.zeros(len(times), dtype=bool)
        tables = {n: np.full((len(times), len(columns[n])), np.nan) for n in self.parts}
        length = settings.stop - settings.start
        lengths = (settings.macro_step, settings.interval, length)
        default = settings.accuracy is None
        steps = own_steps(self.name, self.parts, *lengths, share, at_internal_steps=default)
        parts, held = self._structures(columns, tables, steps.of_parts)
        scale, grows = self._scales()
        texts = [v.type == "String" for v in self._input_variables]
        sizes = np.where(texts, _ANY_SIZE, scale[:-1])
        reached = np.full((2, 2, len(self._inputs)), [[[np.inf]], [[-np.inf]]])
        guess = np.array([*map(start_number, self._input_variables), 0.0])
        system = SystemOfC(
            parts=parts,
            n_parts=len(self.parts),
            inputs=len(self._inputs),
            outputs=len(self._feeds),
            source=self._source.ctypes.data,
            factor=self._factor.ctypes.data,
            offset=self._offset.ctypes.data,
            held=self._held.ctypes.data,
            u=guess.ctypes.data,
            scale=scale.ctypes.data,
            grows=grows.ctypes.data,
            times=times.ctypes.data,
            points=len(times),
            start=settings.start,
            stop=settings.stop,
            macro_step=settings.macro_step or 0.0,
            tolerance=tolerance,
            quantum=steps.quantum,
            refinement=share**0.25,
            method=list(Method).index(settings.method),
            threads=settings.threads,
            lowest=reached[0].ctypes.data,
            highest=reached[1].ctypes.data,
            at_jumps=jumps.ctypes.data,
            called=ctypes.addressof(task.called),
        )
        library, everything = coupling_library(), np.ones_like(self._feeds)
        system.feeds = everything.ctypes.data  # a start value may follow from any input

        def done() -> float:
            return float((system.time - settings.start) / length)

        with doing("solving", done), interruptible(library) as interrupts:
            library.settle_coupled(ctypes.byref(system))
            if system.how == Ending.DONE:
                for _, part in self._called(task.called):
                    part.leave_initialization()
                for place, part in zip(parts, self.parts.values(), strict=True):
                    place.call = ctypes.pointer(part.functions)
                system.feeds = self._feeds.ctypes.data
                library.run_coupled(ctypes.byref(system))
        del held
        run = self._result(system, settings, times, tables, columns, parts, bool(interrupts))
        lost = {n: lost_state(p.instance, p.description) for n, p in self._called(task.called)}
        for name, state in lost.items():
            if state:
                why = f"part '{name}': its state {state} is not finite at the end of the run"
                run = replace(run, status=f"stopped: {why}")
                raise SolverError(f"{self.name}: {why}", partial=run)
        return run, jumps, Ranges(reached[0], reached[1], sizes, float(system.mismatch))

    def _result(
        self,
        system: SystemOfC,
        settings: Settings,
        grid: Vector,
        tables: Mapping[str, Vector],
        columns: Mapping[str, list[str]],
        parts: Any,
        interrupted: bool,
    ) -> Trajectory:
        rows = int(system.rows)
        times = np.minimum(grid[:rows], system.time)
        shown = [
            _column(f"{name}.{v}", v, self.parts[name].description)
            for name, wanted in columns.items()
            for v in wanted
        ]
        stats: dict[str, Any] = {
            "solver": f"co-simulation, {settings.method}",
            "macro_steps": int(system.macro_steps),
            "rejected_steps": int(system.rejected),
            "iterations": int(system.iterations),
            "part_steps": {n: int(parts[list(self.parts).index(n)].steps) for n in self._turns},
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
            why = why_it_ended(self.parts[name].instance.log_texts)
            stats |= {"stop": f"{why} (part '{name}') from {system.time:.12g} s on"}
            stats |= {"stop_time": float(system.time)}
        stats |= invalidity(violations(self._wiring, parts))
        run = Trajectory(
            self.name,
            times,
            tuple(shown),
            np.hstack([np.zeros((rows, 0)), *(tables[n][:rows] for n in columns)]),
            stats,
            status="complete",
            events=self._events(),
        )
        recorded = [by_name(self.parts[n].description)[v] for n in columns for v in columns[n]]
        notes = [*notes_of(system, self._wiring), *filter(None, [rounding(recorded, run)])]
        if notes:
            stats["note"] = "; ".join(notes)
        if interrupted or system.how == Ending.INTERRUPTED:
            run = replace(run, status=f"stopped after {system.time:g} s: interrupted")
            raise Interrupted(f"{self.name}: interrupted", partial=run)
        why = ""
        if system.how not in (Ending.DONE, Ending.ENDED_BY_FMU):
            why = failure(system, self._wiring, columns, tables, grid)
            run = replace(run, status=f"stopped: {why}")
        part = endless_part(system, self._wiring, why) if why or settings.macro_step else None
        if part:
            if not why:
                remedy = as_models(self._wiring)
                notes += [f"an event of part '{part}' repeats itself at one instant{remedy}"]
                run = replace(run, stats={**run.stats, "note": "; ".join(notes)})
            if why or settings.merges:
                raise EndlessEvents(f"{self.name}: {why}", run, part)
        if why:
            raise SolverError(f"{self.name}: {why}", partial=run)
        return run

    def _events(self) -> tuple[Event, ...]:
        """Return what the parts have logged, unless they may have gone back behind it."""
        if not all(part.rolls_back for part in self.parts.values()):
            return ()
        logged = [
            (time, f"{name}: {event}")
            for name, part in self.parts.items()
            if part.event_mode
            for time, event in part.instance.logged_events
        ]
        return tuple(Event(time, name, {}, {}) for time, name in sorted(logged))

    def orders(self, method: Method) -> dict[str, str]:
        """Return how the inputs of each part move within a macro step, in words."""
        if method in (Method.JACOBI, Method.GAUSS_SEIDEL):
            return dict.fromkeys(self._turns, "constant inputs")
        found = {}
        for name, part in ((name, self.parts[name]) for name in self._turns):
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
            return {n: [v for part, v in outputs if part == n] for n in self._turns}
        found = {}
        for name in self._turns:
            part = self.parts[name]
            own = [v for v in part.description.modelVariables if v.causality == "output"]
            found[name] = list(dict.fromkeys(numeric_names([*own, *part.inputs])))
        return found

    def _structures(
        self,
        columns: Mapping[str, list[str]],
        tables: Mapping[str, Vector],
        own_step: Mapping[str, float],
    ) -> tuple[Any, list[Any]]:
        """Return the parts for the C code, and what must live as long as they."""
        parts, held = (PartOfC * len(self.parts))(), list[Any]()
        for place, (name, part) in zip(parts, self.parts.items(), strict=True):
            moving = part.moving_inputs, part.moving_outputs
            references = [
                np.array([v.valueReference for v in variables] + [0], dtype=np.uint32)
                for variables in moving
            ]
            held += references
            known = by_name(part.description)
            variables = [known[variable] for variable in columns[name]]
            place.call = ctypes.pointer(part.functions)
            place.recording = ctypes.pointer(part.calls.recording(variables, tables[name]))
            place.given = ctypes.pointer(part.given.structure)
            place.shown = ctypes.pointer(part.shown.structure)
            place.moving_inputs, place.moving_outputs = map(len, moving)
            place.turn = self._turns.index(name)
            place.inputs, place.outputs = len(part.inputs), len(part.outputs)
            place.input_references, place.output_references = (r.ctypes.data for r in references)
            place.order, place.rates = int(part.order), part.rates
            place.rolls_back, place.directional = part.rolls_back, part.directional
            place.event_mode = part.event_mode
            part.instance.violations.counter = place
            place.own_step = own_step.get(name, 0.0)
        return parts, held

    def _scales(self) -> tuple[Vector, NDArray[np.int64]]:
        """Return the sizes of the inputs, and whether they grow as their FMU declares none."""
        variables = self._input_variables
        scale = np.array([float(v.nominal or 1.0) for v in variables] + [1.0])
        return scale, np.array([v.nominal is None for v in variables] + [False], dtype=np.int64)


@lru_cache(1024)
def _column(name: str, variable: str, description: Any) -> Column:
    return replace(column_of(by_name(description)[variable], description), name=name)
