"""An FMU on the bench: instances started by the letter, read and driven by value references."""

import ctypes
import mmap
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from math import inf
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from cosim.arrays import Vector
from cosim.errors import FmuError
from cosim.fmi.archive import DESCRIPTION
from cosim.fmi.check.finding import Finding
from cosim.fmi.check.parsed import Described, Description, parse
from cosim.fmi.run.arrays import Access, with_elements
from cosim.fmi.run.description import Interface, by_name, read_description
from cosim.fmi.run.instance import access_to, enter_continuous_time, instantiated
from cosim.fmi.run.python_master import run_in_python
from cosim.fmi.run.request import FmuRequest
from cosim.fmi.run.typed_values import is_number

MOST_NAMES = 5  # in one finding
MEMORY_GROWTH = 2**19  # bytes; what is less does not count
_VISITS, _FOR_VISITS = 3, 1 / 24  # states within a run; share of all time
_POINTS = 211.3  # output times of a run: few of them are those of an event
_MEMORY = Path("/proc/self/statm")


class Note(str):
    """A remark of a trial that is no finding."""


Trial = Callable[["Bench", str], Iterator[Finding | Note]]


def memory_in_use() -> int:
    """Return the memory of this process, bytes; 0 where it is not known, but on Linux."""
    pages = _MEMORY.read_text().split()[1] if _MEMORY.exists() else "0"
    return int(pages) * mmap.PAGESIZE


def altered(variable: Described, value: float, share: float) -> float:
    """Return a value raised by a share of its size, within the bounds of the variable."""
    least = float(variable.texts.get("min", "-inf"))
    most = float(variable.texts.get("max", "inf"))
    return min(max(value + share * (abs(value) or variable.nominal), least), most)


class Skipped(Exception):
    """A trial that this FMU does not allow or need; the message says why."""

    @classmethod
    def when(cls, condition: object, why: str) -> None:
        """Raise it if a condition holds."""
        if condition:
            raise cls(why)


def reject_lateness(end: float) -> None:
    """Skip a trial whose time is up; `end` is by `monotonic`, s."""
    Skipped.when(monotonic() > end, "it takes more time than there is; --timeout gives more")


@dataclass(frozen=True)
class Bench:
    """An unpacked FMU.

    Attributes:
        folder: Where it lies.
        name: What its user calls it.
        timeout: Wall time for all trials, s.
    """

    folder: Path
    name: str
    timeout: float

    @property
    def second(self) -> bool:
        """Whether it is of FMI 2.0."""
        return self.described.version == "2"

    @cached_property
    def fmpy(self) -> Any:
        """Description as fmpy reads it."""
        return read_description(self.folder, self.name)

    @cached_property
    def described(self) -> Description:
        """Description as the checks read it."""
        return parse((self.folder / DESCRIPTION).read_bytes())

    def single(self, variable: Described) -> bool:
        """Return whether a variable is one number of double precision."""
        return variable.kind in ("Real", "Float64") and not variable.shape

    def reals(self, causality: str, variability: str = "") -> list[Described]:
        """Return the variables of one kind that are real numbers."""
        every = (v for v in self.described.variables if v.causality == causality)
        return [v for v in every if variability in ("", v.variability) and self.single(v)]

    def numbers(self, *kinds: str) -> list[Any]:
        """Return outputs of some types, or all that are numbers, and the time; of arrays elements.

        Those of clocks are left out, as they have values at ticks only.
        """
        known = with_elements(self.fmpy).modelVariables
        shown = [v for v in known if v.causality in ("output", "independent") and is_number(v)]
        return [v for v in shown if not v.clocks and (not kinds or v.type in kinds)]

    def states(self) -> tuple[tuple[Described, Described], ...]:
        """Return every state with its derivative, in the order of the model structure.

        Raises:
            Skipped: There is none, or arrays are among them.
        """
        every = self.described.variables
        rates = [every[u.position] for u in self.described.sections["Derivatives"]]
        pairs = tuple((every[r.derivative_of or 0], r) for r in rates)
        Skipped.when(not pairs, "it has no continuous states")
        if not all(self.single(v) for pair in pairs for v in pair):
            raise Skipped("its states are arrays")
        return pairs

    def experiment(self, name: str) -> float | None:
        """Return a number of the default experiment."""
        found = self.described.root.find("DefaultExperiment")
        text = None if found is None else found.get(name)
        return None if text is None else float(text)

    @property
    def tolerance(self) -> float:
        """Relative tolerance of the default experiment; 1e-6 if it names none."""
        return self.experiment("tolerance") or 1e-6

    def offers(self, kind: str, *names: str) -> bool:
        """Return whether an interface has one of these capabilities."""
        attributes = self.described.interfaces[kind]
        return any(attributes.get(name) in ("true", "1") for name in names)

    def internal_step(self, kind: str) -> float:
        """Return the fixed size of the steps of the solver inside, s; 0 if none is declared."""
        return float(self.described.interfaces[kind].get("fixedInternalStepSize", "0"))

    def step_size(self, kind: str) -> float:
        """Return the size of communication steps that the file names, s; 0.01 if it does not."""
        return self.internal_step(kind) or self.experiment("stepSize") or 0.01

    def output_interval(self, kind: str) -> float:
        """Return the distance of the output times of a whole run, s."""
        fixed = kind == "CoSimulation" and not self.offers(
            kind, "canHandleVariableCommunicationStepSize"
        )
        return self.step_size(kind) if fixed else self.span / _POINTS

    def step_count(self, size: float) -> int:
        """Return how many steps of a size, s, fit into the run, but for rounding."""
        return int(self.span / size * (1 + 1e-9))

    @contextmanager
    def session(self, kind: str, **callback: Any) -> Iterator["Session"]:
        """Yield an instance, not yet initialized; `callback` is that of `instantiated`."""
        with instantiated(self.folder, self.fmpy, kind, self.name, **callback) as (instance, _):
            yield Session(self, kind, instance)

    @contextmanager
    def started(
        self, kind: str, start_time: float | None = None, **callback: Any
    ) -> Iterator["Session"]:
        """Yield an instance that is initialized; see `session` and `Session.start`."""
        with self.session(kind, **callback) as session:
            session.start(start_time=start_time)
            yield session

    def run(
        self,
        kind: Interface,
        recorded: Sequence[Described],
        tolerance: float,
        size: float,
        end: float,
        watch: Callable[[Any], None] | None = None,
    ) -> tuple[Vector, Vector]:
        """Run the default experiment, in model exchange under CVODE.

        Args:
            kind: Interface.
            recorded: What to return.
            tolerance: Relative one.
            size: Distance of the output times, s.
            end: When to give up, by `monotonic`, s.
            watch: Gets the instance before.

        Returns:
            Times, s, (n,), and values, (n, recorded).

        Raises:
            Skipped: The time is up.
        """
        known = by_name(self.fmpy)
        variables = tuple(known[variable.name] for variable in recorded)
        stop = self.start + size * self.step_count(size)
        times = (self.start, stop, size)
        request = FmuRequest(self.fmpy, kind, {}, *times, variables, tolerance=tolerance)

        def limited(call: Callable[..., Any]) -> Callable[..., Any]:
            def until_end(*arguments: Any) -> Any:
                reject_lateness(end)
                return call(*arguments)

            return until_end

        with instantiated(self.folder, self.fmpy, kind, self.name) as (instance, _):
            name = "doStep" if kind is Interface.CO_SIMULATION else "getContinuousStateDerivatives"
            setattr(instance, name, limited(getattr(instance, name)))
            if watch:
                watch(instance)
            found = run_in_python(instance, request)
            instance.terminate()
        return found.times, found.rows

    @property
    def start(self) -> float:
        """Start of the default experiment, s."""
        return self.experiment("startTime") or 0.0

    @property
    def span(self) -> float:
        """Length of the default experiment, s."""
        stop = self.experiment("stopTime")
        return 1.0 if stop is None else stop - self.start

    @cached_property
    def visited(self) -> list[tuple[float, Vector]]:
        """Times, s, and states, (n,), within its default experiment; empty if it cannot run."""
        with suppress(Exception):
            states = [state for state, _ in self.states()]
            end = monotonic() + _FOR_VISITS * self.timeout
            size = self.span / (_VISITS + 1)
            times, rows = self.run(Interface.MODEL_EXCHANGE, states, self.tolerance, size, end)
            return list(zip(times[1 : _VISITS + 1].tolist(), rows[1 : _VISITS + 1], strict=True))
        return []

    @cached_property
    def has_events(self) -> bool:
        """Whether it may have events: what co-simulation alone never denies."""
        if "ModelExchange" not in self.described.interfaces or self.fmpy.numberOfEventIndicators:
            return True
        with self.started("ModelExchange") as session:
            return session.next_event < self.start + self.span


@dataclass
class Session:
    """A live instance.

    Attributes:
        bench: Its FMU.
        kind: ModelExchange or CoSimulation.
        instance: Of fmpy.
        time: How far it has come, s.
        next_event: In model exchange the time of its next event as it starts, s.
    """

    bench: Bench
    kind: str
    instance: Any
    time: float = 0.0
    next_event: float = inf

    def enter(self, stop_time: float | None = None, start_time: float | None = None) -> None:
        """Enter initialization mode; `start_time`, s, is that of the experiment if None."""
        self.time = self.bench.start if start_time is None else start_time
        times = {"startTime": self.time, "stopTime": stop_time}
        if self.bench.second:
            self.instance.setupExperiment(**times)
            self.instance.enterInitializationMode()
        else:
            self.instance.enterInitializationMode(**times)

    def start(self, stop_time: float | None = None, start_time: float | None = None) -> None:
        """Initialize, and in model exchange go on to continuous-time mode."""
        self.enter(stop_time, start_time)
        self.instance.exitInitializationMode()
        if self.kind == "ModelExchange":
            self.next_event = enter_continuous_time(self.instance)

    def access(self, variables: Sequence[Any]) -> Access:
        """Return access to variables as fmpy describes them."""
        return access_to(variables, self.instance, self.bench.fmpy)

    def values(self, variables: Sequence[Described]) -> Vector:
        """Return values of real variables, (n,)."""
        references = [int(v.reference) for v in variables]
        found = self.instance.getFloat64(references) if references else []
        return np.array(found, dtype=float)

    def put(self, variable: Described, value: float) -> None:
        """Set a real variable."""
        self.instance.setFloat64([int(variable.reference)], [value])

    def put_all(self, variables: Sequence[Described], values: Sequence[float] | Vector) -> None:
        """Set real variables."""
        for variable, value in zip(variables, values, strict=True):
            self.put(variable, float(value))

    def put_states(self, values: Vector) -> None:
        """Set the continuous states, (n,)."""
        self.instance.setContinuousStates((ctypes.c_double * len(values))(*values), len(values))

    def all_of(self, function: str, size: int) -> Vector:
        """Return what a function gives for all states or event indicators, (size,)."""
        found = (ctypes.c_double * size)()
        if size:
            getattr(self.instance, function)(found, size)
        return np.array(found)

    def slopes(self, unknowns: Sequence[Described], known: Described) -> Vector:
        """Return directional derivatives of unknowns to one known, (n,)."""
        references = [int(v.reference) for v in unknowns]
        found = self.instance.getDirectionalDerivative(references, [int(known.reference)], [2.0])
        return np.array(found, dtype=float) / 2

    def steps(self, size: float, most: int) -> Iterator[float]:
        """Make communication steps of one size, s; yield the time after each, their sum."""
        for _ in range(most):
            _, ends, *_ = self.instance.doStep(self.time, size)
            if ends:
                return
            self.time += size
            self.instance.logged.events.clear()  # no memory of the FMU's
            self.instance.logged.texts.clear()
            yield self.time

    def instantiate_bare(self, *, logger: bool) -> None:
        """Instantiate anew without the callbacks that importers need not pass, nor with a log.

        Args:
            logger: Pass a logger, which FMI 2.0 does not expressly allow to be missing.
        """
        from fmpy import fmi2, fmi3

        instance = self.instance
        if self.bench.second:
            instance.fmi2FreeInstance(instance.component)
            usual = fmi2.defaultCallbacks
            bare = fmi2.fmi2CallbackFunctions(componentEnvironment=None)
            if logger:  # fmpy's own needs an environment
                instance.quiet = fmi2.fmi2CallbackLoggerTYPE(lambda *_message: None)
                bare.logger = instance.quiet
            if not self.bench.offers(self.kind, "canNotUseMemoryManagementFunctions"):
                bare.allocateMemory, bare.freeMemory = usual.allocateMemory, usual.freeMemory
            instance.instantiate(callbacks=bare, loggingOn=False)
            return
        instance.fmi3FreeInstance(instance.component)
        place = str(self.bench.folder / "resources") + os.sep
        words = (word.encode() for word in (instance.instanceName, instance.guid, place))
        off, log = fmi3.fmi3Boolean(False), fmi3.fmi3LogMessageCallback()
        if self.kind == "CoSimulation":
            update = fmi3.fmi3IntermediateUpdateCallback()
            made = instance.fmi3InstantiateCoSimulation(
                *words, off, off, off, off, None, 0, None, log, update
            )
        else:
            made = instance.fmi3InstantiateModelExchange(*words, off, off, None, log)
        instance.component = made
        if not made:
            raise FmuError("it does not instantiate")
