"""`SystemSession`: a session of a coupled system, whose parts the compiled master advances."""

import ctypes
import hashlib
import uuid
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import cached_property, lru_cache
from operator import attrgetter
from typing import Any, NoReturn
from weakref import finalize

import numpy as np
from numpy.typing import ArrayLike

from cosim.arrays import Vector
from cosim.coupling.c_structures import coupling_library
from cosim.coupling.co_simulation import DEFAULT_ACCURACY
from cosim.coupling.connectors import Connector, End
from cosim.coupling.failures import failure, sliding, violations
from cosim.coupling.failures import notes_of as coupling_notes
from cosim.coupling.opened_part import OpenedPart, explained
from cosim.coupling.own_steps import is_multiple
from cosim.coupling.settings import Settings
from cosim.coupling.system import System
from cosim.coupling.values import target, values_of
from cosim.errors import FmuError, ParameterError, UsageError
from cosim.fmi.run.c_structures import Ending
from cosim.fmi.run.description import by_name
from cosim.fmi.run.instance import access_to, why_it_ended
from cosim.fmi.run.typed_values import NUMERIC, is_number
from cosim.host.signals import interruptible
from cosim.model.times import reject_span
from cosim.model.values import listed
from cosim.session.calls import FATAL, WARNING, PreparedCalls
from cosim.session.clock import Clock, is_beyond
from cosim.session.life import Life, Phase
from cosim.session.linearizer import LinearSystem
from cosim.session.part_states import PartStates
from cosim.session.saved import ClockFacts, notes_of, packed, take_notes, unpacked
from cosim.session.values import LARGEST, finite, may_change, not_settable, sequence_by_name
from cosim.text import one_note
from cosim.trajectory import Event


class SystemSession(Life):
    """A coupled system with FMUs as parts that stays alive; open one with `cosim.open`.

    It has the methods of `Session`. Variables are called `part.variable`, or by the name of a
    connector of the whole system; values are in their own units. Each `advance` ends a macro step.

    Attributes:
        name: Of the system.
        inputs, outputs: Names of the inputs that nothing drives, and of what a run records.
        states: None that are known.

    Example:
        >>> import cosim
        >>> file = cosim.export_fmu(cosim.load("crank_shaft"), "shaft.fmu")
        >>> with cosim.open(cosim.couple({"shaft": file}, {})) as session:
        ...     events = session.advance(to=1.0)  # from 50 rad/s at 10 rad/s2
        ...     round(session["shaft.omega"], 6)
        60.0
    """

    states: tuple[str, ...] = ()

    def __init__(
        self, system: System, values: Mapping[str, Any], settings: Settings, *, ends: bool
    ) -> None:
        super().__init__(system.name, values)
        self._system, self._settings, self._ends = system, settings, ends
        self._instances = system.instances()
        self._stack.callback(self._instances.close)
        finalize(self, self._stack.close)  # when Python ends, before what parts free themselves
        self._begun = self._stack.enter_context(ExitStack())  # freed before the instances
        self._called = ctypes.c_longlong(-1)
        self._connectors: Mapping[str, Connector] = system.connectors
        self._driven = system.driven
        entries = [c for c in self._connectors.values() if c.is_input and not c.is_text]
        behind = {end.variable for connector in entries for end in connector.ends}
        own = [
            (part, v.name)
            for part, item in system.parts.items()
            for v in item.variables.values()
            if v.is_input and NUMERIC.fullmatch(v.type)
        ]
        outside = [c.name for c in entries if all(end.variable in own for end in c.ends)]
        left = [".".join(one) for one in own if one not in self._driven | behind]
        self.inputs = (*outside, *left)
        shown = [c.name for c in self._connectors.values() if c.shows]
        self.outputs = (*(".".join(one) for one in self._instances.recorded), *shown)
        self._begin_at(self._start_values)

    def identity(self) -> bytes:
        """Return what tells the session from those whose states it cannot take."""
        facts = [
            f"{name} {part.description.guid} {part.description.modelName}"
            for name, part in self._instances.parts.items()
        ]
        one, system = self._settings, self._system
        accuracy = one.macro_step or one.accuracy or DEFAULT_ACCURACY
        settings = one.macro_step, accuracy, one.tolerance, one.method, dict(system.unused)
        text = "\n".join([*facts, f"{system.connections} {settings}"])
        return hashlib.sha256(text.encode()).digest()[:16]

    def _begin_at(self, given: Mapping[str, Any], start: float | None = None) -> None:
        values, settings = self.checked(given), self._settings
        if start is not None:
            stop = settings.stop if self._ends else settings.stop - settings.start + start
            settings = replace(settings, start=start, stop=stop)
            reject_span(start, stop, f"{self.name}: ")
        self._phase = Phase.FAILED
        self._begun.close()
        for name in ("_states", "_saver"):
            vars(self).pop(name, None)
        self._selection = lru_cache(LARGEST)(self._prepared)
        with self._system.naming_files():
            run = self._instances.opened(settings, values, self._called, ends=self._ends)
            self._run = self._begun.enter_context(closing(run))
            self._clock = Clock(settings.start, settings.start)
            with interruptible(coupling_library()) as interrupts:
                run.begin()
        self._answer(interrupts)

    def checked(self, values: Mapping[str, Any]) -> dict[str, dict[str, float]]:
        """Return start values by part and variable, checked."""
        return self._system.values_of_parts(values)

    def copy(self) -> "SystemSession":
        """Return another session in the present state; see `Session.copy`.

        Raises:
            FmuError: A part cannot write its state as bytes, or allows one instance only.
        """
        self._require()  # before its states are read
        abilities = (part.abilities for part in self._instances.parts.values())
        self._reject_copy(abilities, serializes=self._states.serializes)
        other = SystemSession(self._system, self._start_values, self._settings, ends=self._ends)
        other.restore(self.save())
        return other

    @property
    def invalid(self) -> str | None:
        """The first validity condition that a step violated, and since when; None if none did."""
        found = violations(self._instances.wiring)
        return min(found, key=attrgetter("time"), default=None)

    @property
    def note(self) -> str:
        """That the error of the coupling has no estimate, and what is known to limit it."""
        wiring, part = self._instances.wiring, self._instances.sticking_part()
        known = "the error of the coupling is not estimated: no second run checks the macro steps"
        slides = sliding(wiring, part) if part else None
        return one_note(known, *coupling_notes(self._run.c, wiring), slides)

    def advance(self, step: float | None = None, *, to: float | None = None) -> tuple[Event, ...]:
        """Integrate with constant inputs; see `Session.advance`."""
        self._require()
        goal = self._clock.target(self.name, step, to)
        if goal == self.time:
            return ()
        self._reject_goal(goal)
        for part in self._instances.parts.values():
            part.instance.logged.texts.clear()
        with interruptible(coupling_library()) as interrupts:
            self._run.advance(goal)
        self._answer(interrupts)
        if self._phase is Phase.ENDED:
            self._clock.now = float(self._run.c.time)
        else:
            if lost := self._run.lost_state():
                self._phase = Phase.FAILED
                raise FmuError(f"{self.name}: {lost} at {goal:.12g} s")
            self._clock.reach(goal, step)
        found = self._instances.events()
        for part in self._instances.parts.values():
            part.instance.logged.events.clear()
        return found

    def _reject_goal(self, goal: float) -> None:
        start, stop = self._run.c.start, self._settings.stop
        if self._ends and is_beyond(self.time, goal, stop):
            raise ParameterError(
                f"{self.name}: {goal:.12g} s is after the stop time {stop:.12g} s; open the "
                "session with a later one"
            )
        for name, step in self._run.steps.of_parts.items():
            if not is_multiple(goal - start, step):
                raise ParameterError(
                    f"{self.name}: {goal:.12g} s is no multiple of {step:g} s after the start, "
                    f"the only step of part '{name}'"
                )

    def _answer(self, interrupts: Sequence[int]) -> None:
        """Take the answer of the C code: it goes on, has ended the run, or failed."""
        answer = self._run.c
        if interrupts or answer.how == Ending.INTERRUPTED:
            self._phase = Phase.FAILED
            raise KeyboardInterrupt
        if answer.how == Ending.DONE:
            self._phase = Phase.RUNNING
            return
        parts = self._instances.parts
        if answer.how == Ending.ENDED_BY_FMU:
            name = list(parts)[answer.part]
            self._phase = Phase.ENDED
            self._reason = f"{why_it_ended(parts[name].instance.logged.texts)} (part '{name}')"
            return
        self._phase = Phase.FAILED
        raise FmuError(f"{self.name}: {failure(answer, self._instances.wiring)}")

    def set(
        self, values: Mapping[str, float | str] | ArrayLike | None = None, /, **named: float | str
    ) -> None:
        """Set inputs that nothing drives, or tunable parameters; see `Session.set`."""
        self._require()
        if values is not None:
            named = {**sequence_by_name(self.name, self.inputs, values), **named}
        plain = values_of(self._system.parts, named, self._connectors)
        for key in plain:
            if key in self._driven:
                raise UsageError(f"{self.name}: {'.'.join(key)} is connected and cannot be set")
            if not may_change(self._variable(*key)):
                raise not_settable(self.name, ".".join(key), self.inputs)
        by_part: dict[str, dict[str, Any]] = {}
        for (part, name), value in plain.items():
            by_part.setdefault(part, {})[name] = value
        if by_part:
            self._change(by_part)

    def present(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values that `set` would replace, exactly, to be set again."""
        self._require()
        found = dict[str, Any]()
        for name, one in values_of(self._system.parts, values, self._connectors):
            part = self._instances.parts[name]
            access = access_to([self._variable(name, one)], part.instance, part.description)
            with explained(self.name, part):
                (found[f"{name}.{one}"],) = access.get()
        return found

    def _variable(self, part: str, name: str) -> Any:
        return by_name(self._instances.parts[part].description)[name]

    def _change(self, by_part: Mapping[str, Mapping[str, Any]]) -> None:
        library, place = coupling_library(), ctypes.byref(self._run.c)
        library.begin_changes(place)
        self._answer(())
        try:
            with ExitStack() as undoing:
                for name, values in by_part.items():
                    part = self._instances.parts[name]
                    variables = [self._variable(name, one) for one in values]
                    access = access_to(variables, part.instance, part.description)
                    with explained(self.name, part):
                        undoing.callback(access.set, access.get())
                        access.set([*values.values()])
                undoing.pop_all()  # no part has rejected its values
        finally:
            library.end_changes(place)
            self._answer(())

    def get(self, names: Sequence[str] | None = None) -> Vector:
        """Return values; see `Session.get`."""
        if self._phase is not Phase.RUNNING and self._phase is not Phase.ENDED:
            self._require()
        chosen = self.outputs if names is None else listed(f"{self.name}: get", names)
        groups, factors, offsets = self._selection(chosen)
        row = np.empty(len(chosen))
        for part, group, columns in groups:
            if (status := group.get()) > WARNING:
                self._reject_status(part, group.getter, status)
            row[columns] = group.buffer[group.places]
        return finite(self.name, chosen, factors * row + offsets, self.time)

    def _reject_status(self, part: OpenedPart, function: str, status: int) -> NoReturn:
        from fmpy.fmi1 import FMICallException

        part.instance.fatal.value |= status == FATAL
        with explained(self.name, part):
            raise FMICallException(function=function, status=status)

    def _prepared(self, names: tuple[str, ...]) -> tuple[list[Any], Vector, Vector]:
        """Return what reads variables: calls of each part with their columns, factors, offsets."""
        ends = [self._behind(name) for name in names]
        by_part: dict[str, list[int]] = {}
        for column, end in enumerate(ends):
            by_part.setdefault(end.variable[0], []).append(column)
        found = []
        for name, columns in by_part.items():
            part = self._instances.parts[name]
            calls = PreparedCalls(part.instance, part.description)
            variables = [self._variable(*ends[column].variable) for column in columns]
            for group in calls.groups(variables):
                found.append((part, group, [columns[place] for place in group.columns]))
        factors, offsets = ([end[kind] for end in ends] for kind in (1, 2))
        return found, np.array(factors), np.array(offsets)

    def _behind(self, name: str) -> End:
        """Return the variable of a part behind a name."""
        connector = self._connectors.get(name)
        if connector is not None and connector.shows:
            return connector.ends[0]
        _, ends, *_ = target(self._system.parts, self._connectors, name)
        if len(ends) != 1 or not is_number(self._variable(*ends[0].variable)):
            raise UsageError(f"{self.name}: {name} is not a single number")
        variable, factor, offset = ends[0]
        if factor == 0:
            raise UsageError(
                f"{self.name}: {name} has no influence on {'.'.join(variable)}, which does not "
                "tell it; read that instead"
            )
        return End(variable, 1 / factor, -offset / factor)

    @cached_property
    def _states(self) -> PartStates:
        found = PartStates(self.name, self._instances.parts)
        self._begun.callback(found.free)
        return found

    @cached_property
    def _saver(self) -> bytes:
        return self.identity() if self._states.serializes else uuid.uuid4().bytes

    def save(self) -> bytes:
        """Return the state of all parts and of the master; see `Session.save`.

        It holds for sessions of the same system with the same settings; if a part does not write
        its state as bytes, for this session until its reset.
        """
        self._require()
        numbers = np.empty(self._run.numbers(None))
        self._run.numbers(numbers)
        content = numbers.tobytes() + self._states.save()
        notes = notes_of([part.instance for part in self._instances.parts.values()])
        return packed(self._saver, self._clock.facts, notes, content, has_sum=False)

    def restore(self, saved: bytes) -> None:
        """Go back, or forward, to a saved state; see `Session.restore`."""
        clock, notes, length = self.checked_state(saved)
        self._phase = Phase.FAILED
        size = 8 * self._run.numbers(None)
        self._states.restore(saved[size:length])
        self._run.numbers(np.frombuffer(saved[:size]).copy(), back=True)
        self._clock.facts = clock
        take_notes([part.instance for part in self._instances.parts.values()], notes)
        self._answer(())

    def checked_state(self, saved: bytes) -> tuple[ClockFacts, bytes, int]:
        """Return clock, notes and size of a saved state; see `Session.checked_state`."""
        self._reject_closed()
        owner, clock, notes, size = unpacked(self.name, saved, has_sum=False)
        if not self._run.is_open:
            raise FmuError(f"{self.name}: the session has not begun; begin again with reset")
        for name, part in self._instances.parts.items():
            if part.instance.fatal.value:
                raise FmuError(
                    f"{self.name}: part '{name}' has reported a fatal error; begin again with reset"
                )
        if owner != self._saver:
            raise UsageError(
                f"{self.name}: these bytes were saved by another session or system, or with "
                "another macro_step, method, accuracy or tolerance"
            )
        return clock, notes, size

    def linearize(self, outputs: Sequence[str] | None = None) -> LinearSystem:
        """Reject the linearization of a system whose parts are FMUs."""
        self._require()
        raise UsageError(
            f"{self.name} has FMUs as parts, whose equations are not known as one model; linearize "
            "each of them in a session of its own"
        )
