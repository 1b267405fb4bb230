"""An FMU on the bench: instances started by the letter, read and driven by value references."""

import ctypes
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from cosim.arrays import Vector
from cosim.fmi.archive import DESCRIPTION
from cosim.fmi.check.parsed import Described, Description, parse
from cosim.fmi.run.instance import instantiated, read_description

_MOST_UPDATES = 100  # of discrete states at one time


class Skipped(Exception):
    """A trial that this FMU does not allow or need; the message says why."""


@dataclass(frozen=True)
class Bench:
    """An unpacked FMU.

    Attributes:
        folder: Where it lies.
        name: What its user calls it.
    """

    folder: Path
    name: str

    @cached_property
    def fmpy(self) -> Any:
        """Description as fmpy reads it."""
        return read_description(self.folder, self.name)

    @cached_property
    def described(self) -> Description:
        """Description as the checks read it."""
        return parse((self.folder / DESCRIPTION).read_bytes())

    @cached_property
    def arrays(self) -> frozenset[str]:
        """Value references of arrays."""
        listed = self.described.root.findall("ModelVariables/*")
        found = (e for e in listed if e.find("Dimension") is not None)
        return frozenset(e.get("valueReference", "") for e in found)

    def single(self, variable: Described) -> bool:
        """Tell whether a variable is one number of double precision."""
        return variable.kind in ("Real", "Float64") and variable.reference not in self.arrays

    def outputs(self) -> tuple[Described, ...]:
        """Return the outputs that are real numbers."""
        every = self.described.variables
        return tuple(v for v in every if v.causality == "output" and self.single(v))

    def states(self) -> tuple[tuple[Described, Described], ...]:
        """Return every state with its derivative, in the order of the model structure.

        Raises:
            Skipped: There is none, or arrays are among them.
        """
        every = self.described.variables
        rates = [every[u.position] for u in self.described.sections["Derivatives"]]
        pairs = tuple((every[r.derivative_of or 0], r) for r in rates)
        if not pairs:
            raise Skipped("it has no continuous states")
        if not all(self.single(v) for pair in pairs for v in pair):
            raise Skipped("its states are arrays")
        return pairs

    def experiment(self, name: str) -> float | None:
        """Return a number of the default experiment."""
        found = self.described.root.find("DefaultExperiment")
        text = None if found is None else found.get(name)
        return None if text is None else float(text)

    @contextmanager
    def session(self, kind: str) -> Iterator["Session"]:
        """Yield an instance, not yet initialized."""
        with instantiated(self.folder, self.fmpy, kind, self.name) as (instance, _):
            yield Session(self, kind, instance)


@dataclass(frozen=True)
class Session:
    """A live instance.

    Attributes:
        bench: Its FMU.
        kind: ModelExchange or CoSimulation.
        instance: Of fmpy.
    """

    bench: Bench
    kind: str
    instance: Any

    @property
    def start_time(self) -> float:
        """Where it begins, s."""
        return self.bench.experiment("startTime") or 0.0

    def enter(self) -> None:
        """Enter initialization mode."""
        if self.bench.described.version == "2":
            self.instance.setupExperiment(startTime=self.start_time)
            self.instance.enterInitializationMode()
        else:
            self.instance.enterInitializationMode(startTime=self.start_time)

    def start(self) -> None:
        """Initialize, and in model exchange go on to continuous-time mode."""
        self.enter()
        self.instance.exitInitializationMode()
        if self.kind == "CoSimulation":
            return
        second = self.bench.described.version == "2"
        update = self.instance.newDiscreteStates if second else self.instance.updateDiscreteStates
        for _ in range(_MOST_UPDATES):
            if not update()[0]:
                break
        self.instance.enterContinuousTimeMode()

    def values(self, variables: Sequence[Described]) -> Vector:
        """Return values of real variables, (n,)."""
        references = [int(v.reference) for v in variables]
        second = self.bench.described.version == "2"
        get = self.instance.getReal if second else self.instance.getFloat64
        return np.array(get(references) if references else [], dtype=float)

    def put(self, variable: Described, value: float) -> None:
        """Set a real variable."""
        second = self.bench.described.version == "2"
        put = self.instance.setReal if second else self.instance.setFloat64
        put([int(variable.reference)], [value])

    def put_states(self, values: Vector) -> None:
        """Set the continuous states, (n,)."""
        self.instance.setContinuousStates((ctypes.c_double * len(values))(*values), len(values))

    def slopes(self, unknowns: Sequence[Described], known: Described) -> Vector:
        """Return directional derivatives of unknowns to one known, (n,)."""
        references = [int(v.reference) for v in unknowns]
        found = self.instance.getDirectionalDerivative(references, [int(known.reference)], [1.0])
        return np.array(found, dtype=float)

    def steps(self, size: float, most: int, until: float = np.inf) -> Iterator[float]:
        """Make communication steps of one size, s; yield the time after each."""
        time = self.start_time
        for _ in range(most):
            if time + size > until:
                return
            result = self.instance.doStep(time, size)
            if isinstance(result, tuple) and result[1]:  # it asks to end the simulation
                return
            time += size
            yield time
