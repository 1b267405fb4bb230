"""fmpy's instance of an unpacked FMU: created, initialized, and with errors that say why."""

import ctypes
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from enum import StrEnum
from functools import cache, lru_cache
from itertools import count
from math import inf
from operator import attrgetter
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from cosim.errors import FmuError, SecurityError, UnknownName
from cosim.fmi.archive import DESCRIPTION, flat_names
from cosim.fmi.run.arrays import Access, Element
from cosim.fmi.run.typed_values import reject_beyond_bounds
from cosim.host.temporary import loads_no_library
from cosim.text import Violation, described, sentence


class Interface(StrEnum):
    """An interface of the FMI: who integrates."""

    MODEL_EXCHANGE = "ModelExchange"  # the importer
    CO_SIMULATION = "CoSimulation"  # the solver in the FMU


INTERFACES = tuple(Interface)
_MOST_LETTERS = 200  # of a library's name; file systems take 255
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
_LEFT = re.compile(r": invalid from (\S+) s: (.+)$")  # of these, too
_METHODS_OF_FMI_2 = {  # of fmpy, by their names in FMI 3
    "getContinuousStateDerivatives": "getDerivatives",
    "getFloat64": "getReal",
    "getOutputDerivatives": "getRealOutputDerivatives",
    "setFloat64": "setReal",
    "updateDiscreteStates": "newDiscreteStates",
}
_OK, _FATAL = 0, 4  # a status after which no function of the FMU may be called


def is_second(description: Any) -> bool:
    """Tell whether a file is of FMI 2."""
    return str(description.fmiVersion).startswith("2")


def asks_for_inputs(description: Any) -> bool:
    """Tell whether an FMU asks for cubic inputs within its communication steps (FMI 3.0)."""
    return getattr(description.coSimulation, "recommendedIntermediateInputSmoothness", 0) >= 3


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


def read_description(folder: Path, name: object) -> Any:
    """Return fmpy's model description of an unpacked FMU.

    An FMU that this package exported with structured names has two names for a variable: the flat
    one, which every backend uses, and the structured one as its alias.

    Raises:
        FmuError: The description cannot be read, or is of another version than FMI 2 and 3.
    """
    from fmpy.model_description import VariableAlias, read_model_description

    try:
        description = read_model_description(str(folder), validate=False)
        root = ET.parse(folder / DESCRIPTION).getroot()
        names = flat_names(root)
    except Exception as error:
        reason = described(error)
        raise FmuError(f"{name}: modelDescription.xml cannot be read: {reason}") from error
    if str(description.fmiVersion).startswith("1"):
        raise FmuError(f"{name} is of FMI 1.0, which cannot be run; export it as FMI 2.0 or 3.0")
    for variable in description.modelVariables:
        if variable.name in names:
            variable.aliases = [VariableAlias(name=variable.name)]
            variable.name = names[variable.name]
    _drop_inverse_display_units(description, root)
    _read_overlooked(description, root)
    if not is_second(description):  # fmpy does not read the flag of FMI 3
        for kind in (description.modelExchange, description.coSimulation):
            for element in root.iterfind(type(kind).__name__):
                flag = element.get("providesDirectionalDerivatives")
                kind.providesDirectionalDerivative = flag in ("true", "1")
    return description


def _drop_inverse_display_units(description: Any, root: ET.Element) -> None:
    """Remove the display units that are reciprocals, for which fmpy has no attribute."""
    for unit, element in zip(
        description.unitDefinitions, root.iterfind("UnitDefinitions/Unit"), strict=True
    ):
        inverse = {
            display.get("name")
            for display in element.iterfind("DisplayUnit")
            if display.get("inverse") in ("true", "1")
        }
        unit.displayUnits = [d for d in unit.displayUnits if d.name not in inverse]


def _read_overlooked(description: Any, root: ET.Element) -> None:
    """Read what fmpy overlooks: `relativeQuantity` and the bounds of unsigned integers."""
    elements = {e.get("name"): (e, *e[:1]) for e in root.iterfind("ModelVariables/*")}
    for variable in description.modelVariables:
        own = elements.get(variable.name, ())
        if any(e.get("relativeQuantity") in ("true", "1") for e in own):
            variable.relativeQuantity = True
        if own and variable.type.startswith("UInt"):
            variable.min, variable.max = (own[0].get(end) for end in ("min", "max"))


def choose_interface(
    folder: Path, description: Any, requested: str | None, name: object
) -> Interface:
    """Return the requested interface, or by default co-simulation if the FMU has it.

    Raises:
        UnknownName: There is no such interface in the FMI.
        FmuError: The FMU does not have it, or no binary for this machine, or none can be
            loaded from the folder.
        SecurityError: The library's name leads out of its folder.
    """
    if requested is not None and requested not in INTERFACES:
        raise UnknownName.among("cosim", "interface", requested, INTERFACES)
    has = {
        Interface.MODEL_EXCHANGE: description.modelExchange,
        Interface.CO_SIMULATION: description.coSimulation,
    }
    default = Interface.CO_SIMULATION if description.coSimulation else Interface.MODEL_EXCHANGE
    kind = Interface(requested) if requested else default
    if not has[kind]:
        other = next((offered for offered in INTERFACES if has[offered]), None)
        if other is None:
            raise FmuError(
                f"{name} offers scheduled execution only; export it for model exchange or "
                "co-simulation"
            )
        raise FmuError(f"{name} has no {kind} interface; it has {other}")
    _find_library(folder, description, has[kind].modelIdentifier, name)
    if loads_no_library(folder):
        raise FmuError(
            f"{name} was unpacked in {folder.parent}, on a file system mounted noexec, from which "
            "no binary can be loaded; set TMPDIR to another folder"
        )
    return kind


def _find_library(folder: Path, description: Any, identifier: str, name: object) -> None:
    import fmpy

    if not (identifier.isascii() and identifier.isidentifier()):
        shown = sentence(identifier)
        raise SecurityError(f"{name}: modelIdentifier '{shown}' is no C name; do not use it")
    if len(identifier) > _MOST_LETTERS:
        raise FmuError(f"{name}: its modelIdentifier has {len(identifier)} letters; do not use it")
    own = fmpy.platform if is_second(description) else fmpy.platform_tuple
    if (folder / "binaries" / own / f"{identifier}{fmpy.sharedLibraryExtension}").is_file():
        return
    others = sorted(path.name for path in (folder / "binaries").glob("*") if path.is_dir())
    has = f"only for {', '.join(others)}" if others else "for no platform"
    if str(description.generationTool).startswith("cosim"):
        remedy = "export it with --platform"
    elif not others and (folder / "sources").is_dir():
        remedy = "compile its sources, e.g. with fmpy compile"
    else:
        remedy = "run it there, or ask its author for one for this platform"
    raise FmuError(f"{name} has a binary {has}, none for {own}; {remedy}")


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
    log, events, violations = list[str](), list[tuple[float, str]](), Violations()

    def collect(*arguments: Any) -> None:
        """Keep the message, the last argument in every version of the FMI, unless all is well."""
        *_, status, _category, text = arguments
        words = text.decode(errors="replace") if isinstance(text, bytes) else str(text)
        if status != _OK:
            log.append(words)
            if left := _LEFT.search(words):
                violations.note(Violation(float(left[1]), left[2]))
        elif event := _EVENT.search(words):
            events.append((float(event[1]), event[2]))

    def explained(error: Exception) -> FmuError:
        reason = _OF_CVODE.sub("CVODE: ", str(error)).removesuffix(".") or type(error).__name__
        last = log[-_MESSAGES:]
        advice = [_FEWER_STEPS] if _TOO_MANY_STEPS in reason else []
        if last and _ENDED_WITHIN_A_STEP.search(last[-1]):
            advice.append(_CLOSER)
        reasons = dict.fromkeys(map(sentence, (reason, *violations[:1], *last, *advice)))
        return FmuError(f"{name}: {'; '.join(reasons)}")

    key = next(_KEYS)
    with ExitStack() as afterwards:
        _LOGS[key] = collect
        afterwards.callback(_LOGS.pop, key)
        try:
            instance = _instance(folder, description, Interface(kind), key, **callback)
        except Exception as error:
            raise explained(error) from error
        afterwards.callback(instance.freeInstance)
        instance.logged_events, instance.log_texts = events, log
        instance.violations = violations
        yield instance, explained


class Violations(list[Violation]):
    """What an instance has logged about validity conditions.

    Attributes:
        counter: Has in `violations` how many are left, where a master takes steps back.
    """

    counter: Any = None

    def note(self, one: Violation) -> None:
        """Add one."""
        if self.counter is not None:
            del self[self.counter.violations :]
            self.counter.violations += 1
        self.append(one)


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

    exchange = kind is Interface.MODEL_EXCHANGE
    abilities = description.modelExchange if exchange else description.coSimulation
    instance = _checked_class(is_second(description), exchange)(
        guid=description.guid,
        modelIdentifier=abilities.modelIdentifier,
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
            if error.status != fmi2.fmi2Discard or not self.getBooleanStatus(fmi2.fmi2Terminated):
                raise
            return False, True, True, self.getRealStatus(fmi2.fmi2LastSuccessfulTime)
        return False, False, False, time + size

    def method_of_fmi_3(self: Any, name: str) -> Any:
        if name not in _METHODS_OF_FMI_2:
            raise AttributeError(name)
        return getattr(self, _METHODS_OF_FMI_2[name])

    methods = {"_call": checked_call, "freeInstance": free}
    if second:
        methods |= {"doStep": step_as_in_fmi_3, "__getattr__": method_of_fmi_3}
    bases = (base,) if sys.platform == "win32" else (base, _staying_class())
    return type(name, bases, methods)  # fmpy reads the version from the name


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


def getter_name(variable: Any, description: Any) -> str:
    """Return the type in the name of the function that gets a variable's value."""
    if variable.type == "Enumeration":
        return "Integer" if is_second(description) else "Int64"
    return str(variable.type)


def access_to(variables: Sequence[Any], instance: Any, description: Any) -> Access:
    """Return what gets and sets variables of an instance."""
    return Access(instance, [getter_name(v, description) for v in variables], variables)


def may_be_set(variable: Any) -> bool:
    """Tell whether a start value can be set; an approximate one is only an initial guess."""
    if variable.start is None or variable.variability == "constant":
        return False
    return variable.causality == "input" or variable.initial in ("exact", None)


def unit_of(variable: Any) -> str | None:
    """Return the unit of a variable or of its type; None if it has none."""
    declared = variable.declaredType
    return variable.unit or (declared.unit if declared else None)


@lru_cache(8)
def by_name(description: Any) -> Mapping[str, Any]:
    """Return the variables by name, and by their other names."""
    variables = {variable.name: variable for variable in description.modelVariables}
    aliases = {a.name: v for v in variables.values() for a in getattr(v, "aliases", ())}
    return aliases | variables
