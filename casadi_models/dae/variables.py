"""What is known of a variable and of a run besides the equations."""

import re
from dataclasses import dataclass
from enum import Enum
from math import inf, isfinite
from numbers import Real
from typing import TypedDict

from casadi_models.units import convert, represented

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


@dataclass(frozen=True)
class ModeNames:
    """What the modes are called in which a state takes part.

    Attributes:
        state: Name of the state.
        oscillating: Names of the pairs of complex eigenvalues, the slowest oscillation first.
        real: Names of the real eigenvalues, the largest first.
    """

    state: str
    oscillating: tuple[str, ...] = ()
    real: tuple[str, ...] = ()


class Start(Enum):
    """How a start value comes about."""

    EXACT = "exact"  # given, and the user may change it
    CALCULATED = "calculated"  # follows from other starts and parameters
    GUESS = "guess"  # where the solution for an algebraic unknown begins


@dataclass(frozen=True)
class Variable:
    """A named quantity; all numbers in `unit`.

    Attributes:
        name: Letters, digits and _; begins with a letter. In a coupled system, two such names
            with a point: "part.variable".
        unit, display_unit: Names in `UNITS` of one kind; the display unit may be None.
        meaning: What it is, in a few words.
        start: None exactly where the start is calculated.
        start_kind: Whether the start is given, calculated or a guess.
        nominal: Typical size, by which errors are scaled; positive.
        minimum, maximum: Bounds that the start respects.
        foreign_unit: Whether only its author knows the unit, which then counts with factor 1.
        own_meaning: Why it may differ from what other formulations of the system give this name;
            empty where it means the same.

    Raises:
        ValueError: One of these is missing, of the wrong type or contradicts another.
    """

    name: str
    unit: str
    meaning: str
    start: float | None = None
    start_kind: Start = Start.EXACT
    display_unit: str | None = None
    nominal: float = 1.0
    minimum: float = -inf
    maximum: float = inf
    own_meaning: str = ""
    foreign_unit: bool = False

    def __post_init__(self) -> None:
        if not (isinstance(self.name, str) and all(map(is_name, self.name.split(".")))):
            raise ValueError(
                f"{represented(self.name)} cannot name a variable: use letters, digits and _"
            )
        if self.name == "time":
            raise ValueError(
                "'time' cannot name a variable: it is the independent one; choose another"
            )
        if not self.foreign_unit:
            shown = self.unit if self.display_unit is None else self.display_unit
            try:
                convert(1.0, self.unit, shown)
            except ValueError as error:
                raise ValueError(f"{self.name}: {error}") from error
        if not (isinstance(self.meaning, str) and self.meaning.strip()):
            raise ValueError(f"{self.name}: the meaning is missing; describe it in a few words")
        if not isinstance(self.own_meaning, str):
            raise ValueError(
                f"{self.name}: own_meaning {represented(self.own_meaning)} is not a text"
            )
        if not isinstance(self.start_kind, Start):
            raise ValueError(
                f"{self.name}: start_kind {represented(self.start_kind)} is not a Start"
            )
        self._settle_start()
        for fact in ("nominal", "minimum", "maximum"):
            object.__setattr__(self, fact, number(getattr(self, fact), f"{self.name}: {fact}"))
        if not (isfinite(self.nominal) and self.nominal > 0):
            raise ValueError(f"{self.name}: nominal {self.nominal} is not a positive number")
        if not self.minimum <= self.maximum:
            raise ValueError(f"{self.name}: bounds {self.minimum}..{self.maximum} are empty")
        if self.start is not None and not self.minimum <= self.start <= self.maximum:
            raise ValueError(
                f"{self.name}: start {self.start} is not within {self.minimum}..{self.maximum}"
            )

    def _settle_start(self) -> None:
        if self.start_kind is Start.CALCULATED:
            if self.start is not None:
                raise ValueError(f"{self.name}: start {self.start} is given, but calculated")
            return
        start = number(self.start, f"{self.name}: start")
        if not isfinite(start):
            raise ValueError(f"{self.name}: start {start} is not finite; give a finite number")
        object.__setattr__(self, "start", start)


class Facts(TypedDict, total=False):
    """What a declaration may add to name, unit, start and meaning; see `Variable`."""

    display_unit: str
    nominal: float
    minimum: float
    maximum: float
    own_meaning: str
    foreign_unit: bool


@dataclass(frozen=True)
class Experiment:
    """The run that a model is shown with; from 0 to `stop_time`.

    Attributes:
        stop_time, output_interval: s.
        reference_tolerance: Relative tolerance at which independent solvers agree to within 1e-6 of
            nominal values; smaller where the motion multiplies what a solver is wrong by.
    """

    stop_time: float
    output_interval: float = 0.01
    reference_tolerance: float = 1e-10

    def __post_init__(self) -> None:
        for fact in ("stop_time", "output_interval", "reference_tolerance"):
            value = number(getattr(self, fact), fact)
            if not (isfinite(value) and value > 0):
                what = "number" if fact == "reference_tolerance" else "time"
                raise ValueError(
                    f"{fact} {value}{' s' * (what == 'time')} is not a positive {what}"
                )
            object.__setattr__(self, fact, value)


def number(value: object, what: str) -> float:
    """Return a real number as float.

    Raises:
        ValueError: It is none (a bool, text, a symbol, nothing) or too large for a float.
    """
    if not isinstance(value, Real) or isinstance(value, bool):
        raise ValueError(f"{what} is {represented(value)}; give a number")
    try:
        return float(value)
    except OverflowError:
        raise ValueError(f"{what} is too large for a float") from None


def is_name(name: object) -> bool:
    """Return whether this may name a model, a formulation or a variable in C, XML and Python."""
    return isinstance(name, str) and _NAME.fullmatch(name) is not None
