"""fmpy's instance of an unpacked FMU: created, initialized, and with errors that say why."""

import ctypes
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from itertools import count
from math import inf
from operator import attrgetter
from pathlib import Path
from typing import Any

from cosim.errors import FmuError
from cosim.fmi.run.arrays import Access, Element, Layout
from cosim.fmi.run.description import Interface, abilities_of, by_name, is_second
from cosim.fmi.run.typed_values import reject_beyond_bounds
from cosim.text import Violation, sentence

_OF_CVODE = re.compile(r"CVode error \(code -?\d+\) in module \w+, function \S+: ")
_TOO_MANY_STEPS = "mxstep steps taken"  # CVODE's words
_FEWER_STEPS = (
    "try closer output times, a looser relative tolerance, or co-simulation, which uses the FMU's "
    "own solver"
)
_END_OF_RUN = re.compile(r"the run ends at \S+ s: (.+)$")
_ENDED_WITHIN_A_STEP = re.compile(r"came no further than \S+$")  # no message says why
_CLOSER = "a singularity, or more steps than one call allows: closer output times allow more"
_MOST_UPDATES = 1000  # of discrete states at one instant
_MESSAGES = 3  # of an FMU's log, in an error
_EVENT = re.compile(r": at (\S+) s: (.+)$")  # of FMUs that were exported here
_SLIDES = re.compile(r": from \S+ s on, '(.+)' stays 0 by (.+)$")
_LEAPS = re.compile(r": at (\S+) s, (.+) jumps over a short change of the equations \('(.+)'\)")
_PASSED = re.compile(
    r": (\S+ moves a short change.+|a change of .+ is short with.+"
    r"|'.+' switches at \S+ s and returns within.+)$"
)
_LEFT = re.compile(r": invalid from (\S+) s: (.+)$")  # of these, too
_METHODS_OF_FMI_2 = {  # of fmpy, by their names in FMI 3
    "getContinuousStateDerivatives": "getDerivatives",
    "getFloat64": "getReal",
    "getOutputDerivatives": "getRealOutputDerivatives",
    "setFloat64": "setReal",
    "updateDiscreteStates": "newDiscreteStates",
}
_OK, _FATAL = 0, 4  # a status after which no function of the FMU may be called


def initialize(
    instance: Any, description: Any, values: Mapping[str, float], **experiment: float | None
) -> None:
    """Set start values and leave initialization mode, in the order of `fmpy.simulate_fmu`.

    Args: See `begin_initialization`.
    """
    begin_initialization(instance, description, values, **experiment)
    instance.exitInitializationMode()


def begin_initialization(
    instance: Any, description: Any, values: Mapping[str, float], **experiment: float | None
) -> None:
    """Set start values and enter initialization mode, in the order of `fmpy.simulate_fmu`.

    Args:
        experiment: `startTime`, `stopTime` [s], `tolerance`.
    """
    from fmpy.simulation import (
        apply_start_values,
        settable_in_initialization_mode,
        settable_in_instantiated,
    )

    known, second = by_name(description), is_second(description)
    kinds: dict[str, dict[str, Any]] = {"element": {}, "structuralParameter": {}, "": {}}
    for name, value in values.items():
        kind = "element" if isinstance(known[name], Element) else known[name].causality
        kinds[kind if kind in kinds else ""][name] = value
    elements, structural, left = kinds.values()
    if structural:
        try:
            instance.enterConfigurationMode()
            apply_start_values(instance, description, structural)
            instance.exitConfigurationMode()
        except Exception as error:
            sizes = ", ".join(f"{name} = {value}" for name, value in structural.items())
            raise FmuError(f"the FMU rejects {sizes} in configuration mode") from error
    if second:
        instance.setupExperiment(**experiment)
    left = apply_start_values(instance, description, left, settable=settable_in_instantiated)
    instance.enterInitializationMode(**{} if second else experiment)
    apply_start_values(instance, description, left, settable=settable_in_initialization_mode)
    if elements:
        variables = [known[name] for name in elements]
        access_to(variables, instance, description).set([*elements.values()])
    for name, value in values.items():
        reject_beyond_bounds(known[name], value)


def update_discrete_states(instance: Any) -> tuple[bool, float]:
    """Update the discrete states until they no longer change.

    Returns:
        Whether the FMU ends the run, and the time of its next event, s; infinity for no event.
    """
    for _ in range(_MOST_UPDATES):
        needed, ends, _, _, defined, time = instance.updateDiscreteStates()
        if ends or not needed:
            break
    else:
        raise FmuError(f"its discrete states still change after {_MOST_UPDATES} updates")
    return bool(ends), float(time) if defined else inf


def enter_continuous_time(instance: Any) -> float:
    """Take an FMU for model exchange through its first events to continuous-time mode.

    Returns:
        The time of its next event, s; infinity for no event.

    Raises:
        FmuError: It ends the run.
    """
    ends, next_event = update_discrete_states(instance)
    if ends:
        raise FmuError("Model requested termination during initial event update.")
    instance.enterContinuousTimeMode()
    return next_event


@contextmanager
def instantiated(
    folder: Path, description: Any, kind: str, name: object, **callback: Any
) -> Iterator[tuple[Any, Callable[[Exception], FmuError]]]:
    """Yield fmpy's instance of an unpacked FMU, and a function that adds the FMU's log to an error.

    Args:
        callback: For co-simulation of FMI 3, `intermediateUpdate`, the address of a C function, and
            `requiredIntermediateVariables`, value references.

    Raises:
        FmuError: The library cannot be loaded, or rejects the instantiation.
    """
    logged = Logged()

    def explained(error: Exception) -> FmuError:
        reason = _OF_CVODE.sub("CVODE: ", str(error)).removesuffix(".") or type(error).__name__
        last = logged.texts[-_MESSAGES:]
        advice = [_FEWER_STEPS] if _TOO_MANY_STEPS in reason else []
        if last and _ENDED_WITHIN_A_STEP.search(last[-1]):
            advice.append(_CLOSER)
        reasons = dict.fromkeys(map(sentence, (reason, *logged.violations[:1], *last, *advice)))
        return FmuError(f"{name}: {'; '.join(reasons)}".replace(f"{folder}{os.sep}", ""))

    key = next(_KEYS)
    with ExitStack() as afterwards:
        _LOGS[key] = logged.note
        afterwards.callback(_LOGS.pop, key)
        try:
            instance = _instance(folder, description, Interface(kind), key, **callback)
        except Exception as error:
            needs = abilities_of(description, kind).needsExecutionTool
            tool = f"; it needs {description.generationTool or 'its tool'} to run" if needs else ""
            raise explained(FmuError(f"{error}{tool}")) from error
        afterwards.callback(instance.freeInstance)
        instance.logged = logged
        yield instance, explained


class Violations(list[Violation]):
    """What an instance has logged about validity conditions.

    Attributes:
        counter: Has in `violations` how many are left, where a master takes steps back.
    """

    counter: Any = None

    @property
    def counted(self) -> Sequence[Violation]:
        """Those that are left."""
        return self if self.counter is None else self[: self.counter.violations]

    def note(self, one: Violation) -> None:
        """Add one."""
        if self.counter is not None:
            del self[self.counter.violations :]
            self.counter.violations += 1
        self.append(one)


@dataclass(frozen=True)
class Logged:
    """What an instance has logged.

    Attributes:
        texts: Its messages, unless all is well.
        events: Times, s, and names of events.
        violations: Violations of validity conditions.
        sliding: The inputs by which relations stay 0, by these.
        leaps: When inputs have jumped over which short changes: time and relation, by the inputs.
        passed: What else tells that steps may have passed over changes.
    """

    texts: list[str] = field(default_factory=list)
    events: list[tuple[float, str]] = field(default_factory=list)
    violations: Violations = field(default_factory=Violations)
    sliding: dict[str, list[str]] = field(default_factory=dict)
    leaps: dict[str, tuple[str, str]] = field(default_factory=dict)
    passed: list[str] = field(default_factory=list)

    def note(self, *arguments: Any) -> None:
        """Keep a message, the last argument in every version of the FMI."""
        *_, status, _category, text = arguments
        words = text.decode(errors="replace") if isinstance(text, bytes) else str(text)
        if status != _OK:
            self.texts.append(words)
            if left := _LEFT.search(words):
                self.violations.note(Violation(float(left[1]), left[2]))
            elif leap := _LEAPS.search(words):
                self.leaps.setdefault(leap[2], (leap[1], leap[3]))
            elif passed := _PASSED.search(words):
                self.passed.append(passed[1])
        elif event := _EVENT.search(words):
            self.events.append((float(event[1]), event[2]))
        elif slides := _SLIDES.search(words):
            self.sliding[slides[1]] = slides[2].split(", ")

    def clear(self) -> None:
        """Forget all of it."""
        for own in vars(self).values():
            own.clear()


def invalidity(violations: Iterable[Violation]) -> dict[str, Any]:
    """Return the statistics of a run that tell the first violation of each condition."""
    first = dict[str, Violation]()
    for violation in sorted(violations, key=attrgetter("time")):
        first.setdefault(violation.what, violation)
    found = [*first.values()]
    return {"invalid": found, "invalid_from": found[0].time} if found else {}


def why_it_ended(texts: Sequence[str]) -> str:
    """Return why an FMU ended the run, by its log if it was exported here."""
    found = [match[1] for text in texts if (match := _END_OF_RUN.search(text))]
    return sentence(found[-1]) if found else "the FMU ends the run"


_KEYS, _LOGS = count(1), dict[int, Callable[..., None]]()  # what keeps the messages of an instance


def _log(environment: int | None, *message: Any) -> None:
    """Pass a message on; an FMU that does not say whose it is logs for the last instance."""
    collect = _LOGS.get(environment or 0) or next(reversed(_LOGS.values()), None)
    if collect:
        collect(*message)


@cache
def _logger() -> Any:
    """Return `_log` for C; fmpy passes the messages of all instances to the last one it knows."""
    from fmpy import fmi2

    return fmi2.fmi2CallbackLoggerTYPE(_log)


def _instance(folder: Path, description: Any, kind: Interface, key: int, **callback: Any) -> Any:
    """Return what `fmpy.instantiate_fmu` does, of a class that checks every status."""
    from fmpy import calloc, fmi2, free
    from fmpy.logging import addLoggerProxy

    instance = _checked_class(is_second(description), kind is Interface.MODEL_EXCHANGE)(
        guid=description.guid,
        modelIdentifier=abilities_of(description, kind).modelIdentifier,
        unzipDirectory=str(folder),
        instanceName=None,
    )
    instance.fatal = ctypes.c_longlong()
    if not is_second(description):
        instance.instantiate(loggingOn=True, logMessage=_LOGS[key], **callback)
        return instance
    callbacks = fmi2.fmi2CallbackFunctions()
    callbacks.logger, callbacks.componentEnvironment = _logger(), key
    callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(calloc)
    callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(free)
    addLoggerProxy(ctypes.byref(callbacks))
    instance.instantiate(callbacks=callbacks, loggingOn=True)
    return instance


def _load_functions(self: Any) -> None:
    """Load the functions of a library; fmpy finds out their types, once for a class."""
    if not self.known:
        super(type(self), self)._loadFunctions()
        self.known.update(self._functions)
    for name, same in self.known.items():
        own = self._functions[name] = getattr(self.dll, name)
        own.argnames, own.argtypes, own.restype = same.argnames, same.argtypes, same.restype


@cache
def _checked_class(second: bool, exchange: bool) -> type:
    """Return fmpy's class of FMUs, which rejects unknown statuses and calls nothing after Fatal.

    That of FMI 2 has the methods of FMI 3.
    """
    from fmpy import fmi2, fmi3
    from fmpy.fmi1 import FMICallException

    name = f"FMU{2 if second else 3}{'Model' if exchange else 'Slave'}"
    base: Any = getattr(fmi2 if second else fmi3, name)

    def checked_call(self: Any, function: str, *arguments: Any) -> Any:
        try:
            result = base._call(self, function, *arguments)
        except FMICallException as error:
            self.fatal.value |= error.status == _FATAL
            raise
        if isinstance(result, int) and result < 0:
            raise FmuError(f"{function} returned {result}, which is no status of the FMI")
        return result

    def free(self: Any) -> None:
        if not self.fatal.value:
            base.freeInstance(self)

    def step_as_in_fmi_3(self: Any, time: float, size: float) -> tuple[bool, bool, bool, float]:
        """Return whether an event occurred, the run ends and the FMU returned early, and when."""
        try:
            base.doStep(self, time, size)
        except FMICallException as error:
            ends = False
            last = time
            with suppress(FMICallException):  # a file need not have these functions
                discards = error.status == fmi2.fmi2Discard
                ends = discards and self.getBooleanStatus(fmi2.fmi2Terminated)
                last = self.getRealStatus(fmi2.fmi2LastSuccessfulTime) if ends else time
            if not ends:
                raise
            return False, True, True, max(time, last)  # `time` if `last` is NaN
        return False, False, False, time + size

    def method_of_fmi_3(self: Any, name: str) -> Any:
        if name not in _METHODS_OF_FMI_2:
            raise AttributeError(name)
        return getattr(self, _METHODS_OF_FMI_2[name])

    of_second = {"doStep": step_as_in_fmi_3, "__getattr__": method_of_fmi_3}
    methods = {"_call": checked_call, "freeInstance": free, "_loadFunctions": _load_functions}
    members = {"known": {}, **methods, **(of_second if second else {})}
    bases = (base,) if sys.platform == "win32" else (base, _staying_class())
    return type(name, bases, members)  # fmpy reads the version from the name


@cache
def _staying_class() -> type:
    """Return a base that loads a library as fmpy's does, but in the current folder.

    All threads share that folder, so that others find no relative path while fmpy has changed it.
    Windows looks there for other libraries.
    """
    from fmpy import platform, sharedLibraryExtension
    from fmpy.fmi1 import _FMU

    def load(self: Any, **facts: Any) -> None:
        place = Path(facts["unzipDirectory"], "binaries", platform)
        usual = place / f"{facts['modelIdentifier']}{sharedLibraryExtension}"
        path = facts.pop("libraryPath", usual)
        vars(self).update({"fmiCallLogger": None, "requireFunctions": True, **facts})
        vars(self).update(_functions={}, component=None, callbacks=None)
        self.instanceName = facts.get("instanceName") or facts["modelIdentifier"]
        try:
            self.dll = ctypes.CDLL(str(Path(path).absolute()))
        except OSError as error:
            raise FmuError(f"Failed to load shared library {path}. {error}") from error
        self._loadFunctions()

    return type("Staying", (_FMU,), {"__init__": load})


def layouts_of(variables: Sequence[Any], description: Any) -> list[tuple[str, Layout, list[int]]]:
    """Return variables by the type in the name of their getter: its layout, and their places."""
    enumeration = "Integer" if is_second(description) else "Int64"
    found: dict[str, list[int]] = {}
    for place, variable in enumerate(variables):
        kind = enumeration if variable.type == "Enumeration" else str(variable.type)
        found.setdefault(kind, []).append(place)
    return [(kind, Layout.of([variables[i] for i in own]), own) for kind, own in found.items()]


def access_to(variables: Sequence[Any], instance: Any, description: Any) -> Access:
    """Return what gets and sets variables of an instance."""
    return Access(instance, layouts_of(variables, description))


def may_be_set(variable: Any) -> bool:
    """Tell whether a start value can be set; an approximate one is only an initial guess."""
    if variable.start is None or variable.variability == "constant":
        return False
    return variable.causality == "input" or variable.initial in ("exact", None)
