"""`OpenSystem`: parts that are begun, advanced to one time after the other, and closed."""

import ctypes
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self, TypeVar

import numpy as np

from cosim.arrays import Vector
from cosim.coupling.c_structures import PartOfC, SystemOfC, coupling_library
from cosim.coupling.opened_part import OpenedPart, explained
from cosim.coupling.own_steps import OwnSteps
from cosim.coupling.settings import Method, Settings
from cosim.coupling.wiring import Wiring
from cosim.fmi.run.c_structures import Ending
from cosim.fmi.run.description import by_name, nominal_of
from cosim.fmi.run.typed_values import start_number
from cosim.model.times import one_time

_Result = TypeVar("_Result")
_ANY_SIZE = 1e300  # of texts, which do not grow


@dataclass(frozen=True)
class Rows:
    """What a run records.

    Attributes:
        times: Of outputs, s.
        columns: Names of variables by part.
        tables: Their values by part, (times, variables).
    """

    times: Vector
    columns: Mapping[str, Sequence[str]]
    tables: Mapping[str, Vector]

    @classmethod
    def of(cls, times: Vector, columns: Mapping[str, Sequence[str]]) -> Self:
        """Return empty rows."""
        tables = {n: np.full((len(times), len(names)), np.nan) for n, names in columns.items()}
        return cls(times, columns, tables)


class OpenSystem:
    """A run of coupled parts, which whoever opens it closes.

    Args:
        wiring: Its parts, which begin a new run, and their connections.
        values: Start values by part, by variable.
        settings: How to simulate.
        rows: What to record.
        steps: Of parts that take steps of one length.
        tolerance, of_parts: Of the coupling, and of the solvers of the parts.
        refinement: Factor of the usual first and longest macro steps.
        ends: Whether the run ends at the stop time of the settings, which otherwise only tells
            how long runs usually are.
        called: Shows the place of the part that is being called.

    Attributes:
        steps: Of parts that take steps of one length.
        c: The `System` of the C code, with its answers.
        parts: Its parts.
        jumps: Which output times lie at jumps, (times,).
        lowest, highest: Of the inputs in the first half of the run, and in all of it, (2, inputs).
        sizes: Of the inputs, (inputs,).

    Raises:
        FmuError: A part rejects its start values.
    """

    def __init__(
        self,
        wiring: Wiring,
        values: Mapping[str, Mapping[str, float]],
        settings: Settings,
        rows: Rows,
        steps: OwnSteps,
        *,
        tolerance: float,
        of_parts: float,
        refinement: float = 1.0,
        ends: bool = True,
        called: ctypes.c_longlong,
    ) -> None:
        self._wiring, self._called, self.steps = wiring, called, steps
        start, stop = settings.start, settings.stop
        experiment = {"startTime": start, "stopTime": stop if ends else None}

        def begin(part: OpenedPart) -> None:
            part.start(values.get(part.name, {}), scale=stop, tolerance=of_parts, **experiment)

        self.each(begin)
        self.jumps = np.zeros(len(rows.times), dtype=bool)
        self.parts, self._alive = self._structures(rows, steps.of_parts)
        nominals = [*map(nominal_of, wiring.variables)]  # of the inputs
        scale = np.array([*(value or 1.0 for value in nominals), 1.0])
        grows = np.array([*(value is None for value in nominals), False], dtype=np.int64)
        texts = [v.type == "String" for v in wiring.variables]
        self.sizes = np.where(texts, _ANY_SIZE, scale[:-1])
        reached = np.full((2, 2, len(wiring.inputs)), [[[np.inf]], [[-np.inf]]])
        self.lowest, self.highest = reached
        guess = np.array([*map(start_number, wiring.variables), 0.0])
        everything = np.ones_like(wiring.feeds)  # a start value may follow from any input
        self._alive += [scale, grows, reached, guess, everything, rows]
        self.c = SystemOfC(
            parts=self.parts,
            n_parts=len(wiring.parts),
            inputs=len(wiring.inputs),
            outputs=len(wiring.feeds),
            source=wiring.source.ctypes.data,
            factor=wiring.factor.ctypes.data,
            offset=wiring.offset.ctypes.data,
            held=wiring.held.ctypes.data,
            feeds=everything.ctypes.data,
            u=guess.ctypes.data,
            scale=scale.ctypes.data,
            grows=grows.ctypes.data,
            times=rows.times.ctypes.data,
            points=len(rows.times),
            start=start,
            stop=stop,
            ends=ends,
            macro_step=settings.macro_step or 0.0,
            tolerance=tolerance,
            quantum=steps.quantum,
            refinement=refinement,
            method=list(Method).index(settings.method),
            threads=settings.threads,
            lowest=self.lowest.ctypes.data,
            highest=self.highest.ctypes.data,
            at_jumps=self.jumps.ctypes.data,
            called=ctypes.addressof(called),
        )

    def close(self) -> None:
        """Free what the run needs; the instances of the parts stay."""
        coupling_library().close_coupled(ctypes.byref(self.c))

    def each(self, task: Callable[[OpenedPart], _Result]) -> list[_Result]:
        """Return the results of a task for each part, which is noted as the one that is called.

        Raises:
            FmuError: The task failed; names the part.
        """
        found = list[_Result]()
        for place, part in enumerate(self._wiring.parts.values()):
            self._called.value = place
            with explained(self._wiring.system, part):
                found.append(task(part))
        return found

    @property
    def is_open(self) -> bool:
        """Whether it has begun, even if that failed, and is not closed."""
        return bool(self.c.coupling)

    @property
    def is_done(self) -> bool:
        """Whether the last call has done what it was to do; otherwise `c` tells why not."""
        return bool(self.c.how == Ending.DONE)

    @property
    def end(self) -> float:
        """Where a part has ended the run, maybe within a macro step, s; else the present time."""
        ended = self.c.how == Ending.ENDED_BY_FMU
        reached = max(self.c.time, self.parts[self.c.part].reached if ended else -np.inf)
        return float(self.c.time if one_time(reached, self.c.time, self.c.start) else reached)

    def begin(self) -> None:
        """Settle the start, and take the parts out of initialization mode; see `is_done`."""
        library = coupling_library()
        library.settle_coupled(ctypes.byref(self.c))
        if not self.is_done:
            return
        self.each(OpenedPart.leave_initialization)
        for place, part in zip(self.parts, self._wiring.parts.values(), strict=True):
            place.call = ctypes.pointer(part.functions)
        self.c.feeds = self._wiring.feeds.ctypes.data
        library.open_coupled(ctypes.byref(self.c))

    def advance(self, goal: float) -> None:
        """Go on to a time, s; the answers are in `c`."""
        self.c.goal = goal
        coupling_library().advance_coupled(ctypes.byref(self.c))

    def lost_state(self) -> str:
        """Return which state of a part is not finite; empty if none is or can be read."""
        found = self.each(lambda part: part.lost_state())
        for name, state in zip(self._wiring.parts, found, strict=True):
            if state:
                return f"part '{name}': its state {state} is not finite"
        return ""

    def numbers(self, place: Vector | None, *, back: bool = False) -> int:
        """Copy the numbers with which the next macro step begins to a place, or back from there.

        Returns:
            How many they are.
        """
        address = None if place is None else place.ctypes.data
        return int(coupling_library().numbers_of_coupled(ctypes.byref(self.c), address, back))

    def _structures(self, rows: Rows, own_step: Mapping[str, float]) -> tuple[Any, list[Any]]:
        """Return the parts for the C code, and what must live as long as they."""
        wiring = self._wiring
        parts, alive = (PartOfC * len(wiring.parts))(), list[Any]()
        for place, (name, part) in zip(parts, wiring.parts.items(), strict=True):
            moving = part.moving_inputs, part.moving_outputs
            references = [
                np.array([v.valueReference for v in variables] + [0], dtype=np.uint32)
                for variables in moving
            ]
            alive += references
            known = by_name(part.description)
            variables = [known[variable] for variable in rows.columns[name]]
            place.call = ctypes.pointer(part.functions)
            place.recording = ctypes.pointer(part.calls.recording(variables, rows.tables[name]))
            place.given = ctypes.pointer(part.given.structure)
            place.shown = ctypes.pointer(part.shown.structure)
            place.steady = ctypes.pointer(part.steady.structure)
            place.moving_inputs, place.moving_outputs = map(len, moving)
            place.turn = wiring.turns.index(name)
            place.inputs, place.outputs = len(part.inputs), len(part.outputs)
            place.input_references, place.output_references = (r.ctypes.data for r in references)
            place.order, place.rates = int(part.order), part.rates
            place.rolls_back, place.directional = part.rolls_back, part.directional
            place.event_mode, place.reached = part.event_mode, -np.inf
            part.instance.logged.violations.counter = place
            place.own_step = own_step.get(name, 0.0)
        return parts, alive
