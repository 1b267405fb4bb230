"""`Linearization`: the linear system x' = A x + B u, y = C x + D u near a state, and its modes."""

import cmath
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from cosim.arrays import Truths, Vector
from cosim.errors import naming_arguments_of
from cosim.files import write_atomically
from cosim.study.linearize.spectrum import Spectrum, blocks, rate_sizes, without_influence
from cosim.text import csv_text


@dataclass(frozen=True)
class Mode:
    """An eigenvalue and the states that take part in its motion.

    Attributes:
        value: Eigenvalue, 1/s; of a discrete map, the factor of the motion in one period.
        states: States that take part in the motion.
        error: Estimated error of the eigenvalue from rounding.
        period: Period of the discrete map, s; None for x' = A x.
    """

    value: complex
    states: tuple[str, ...]
    error: float = 0.0
    period: float | None = None

    @property
    def exponent(self) -> complex:
        """Exponent of the motion, 1/s: the eigenvalue, or the logarithm of the factor."""
        if self.period is None:
            return self.value
        return cmath.log(self.value) / self.period if self.value else complex(-math.inf)

    @property
    def growth(self) -> float:
        """Positive if the motion grows: the real part, or the size of the factor minus 1."""
        return float(growth(self.value, self.period))

    @property
    def frequency(self) -> float:
        """Angular frequency of the oscillation, rad/s; 0 for a real eigenvalue."""
        return abs(self.exponent.imag)

    @property
    def damping(self) -> float:
        """Damping ratio: 1 decays without oscillation, 0 oscillates undamped, below 0 grows."""
        size = abs(self.exponent)
        if math.isinf(size):
            return 1.0
        return -self.exponent.real / size if size else 0.0

    def row(self) -> dict[str, Any]:
        """Return the mode as a row of a table."""
        size = {} if self.period is None else {"size": abs(self.value)}
        return {
            "real": self.value.real,
            "imaginary": self.value.imag,
            **size,
            "damping": self.damping,
            "states": " ".join(self.states),
        }


def growth(value: Any, period: float | None) -> Any:
    """Return how fast motions grow, from eigenvalues; negative if they decay."""
    return value.real if period is None else abs(value) - 1


@naming_arguments_of
@dataclass(frozen=True, eq=False)  # arrays have no single truth value
class Linearization:
    """A, B, C, D of a model near a state, in SI units.

    With samples or with coefficients that are periodic in time, A and B are those of the discrete
    map x(t + period) = A x(t) + B u, with inputs that are constant for a period.

    Attributes:
        model: `MODEL/FORMULATION`, or the name in an FMU.
        states, inputs, outputs: Names, in the order of rows and columns.
        A, B, C, D: Matrices of x' = A x + B u, or of the discrete map, and of y = C x + D u for
            small deviations; algebraic unknowns are eliminated.
        time: Time of the state, s.
        x, u, y: States, inputs and outputs about which the model is linearized.
        rates: Derivatives of the states there; with a period, their mean over it.
        nominal: Nominal values of the states.
        point: Description of the state, e.g. "0.5 s of a run".
        influence: Whether a rate depends on a state, by the structure of the equations and beyond
            rounding, (states, states).
        noise: What rounding leaves open in A, (states, states).
        period: Period of the discrete map, s; None for x' = A x.
        cyclic: States that influence only each other: they may move on in a steady motion.
    """

    model: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    A: Vector
    B: Vector
    C: Vector
    D: Vector
    time: float
    x: Vector
    u: Vector
    y: Vector
    rates: Vector
    nominal: Vector
    point: str
    influence: Truths
    noise: Vector
    period: float | None = None
    cyclic: tuple[str, ...] = ()

    @classmethod
    def from_jacobian(
        cls, jacobian: Vector, *, depends: Truths, noise: Vector, **facts: Any
    ) -> "Linearization":
        """Return the linear system of d(rates, outputs) / d(states, inputs).

        Args:
            jacobian: The derivatives, rows and columns in the order of the names.
            depends: Whether a rate depends on a state, by the structure of the equations.
            noise: What rounding leaves open in the derivatives of the rates by the states.
            facts: All other attributes but the matrices, `influence` and `cyclic`.
        """
        states = facts["states"]
        n = len(states)
        A = jacobian[:n, :n]
        cyclic = without_influence(depends)
        return cls(
            A=A,
            B=jacobian[:n, n:],
            C=jacobian[n:, :n],
            D=jacobian[n:, n:],
            influence=depends & (np.abs(A) > noise),
            noise=noise,
            cyclic=tuple(states[i] for i in cyclic),
            **facts,
        )

    @cached_property
    def _relative_rates(self) -> Vector:
        """Rates relative to those that a nominal value of a state makes; changes in a period."""
        rates = np.abs(self.rates) / self.nominal
        if self.period is not None:
            return rates * self.period
        with np.errstate(divide="ignore", invalid="ignore"):
            found = rates / rate_sizes(self.A / self.nominal[:, None], self.nominal)
        return np.where(rates, found, 0.0)

    @property
    def unsteadiness(self) -> float:
        """Largest rate of the states that are not cyclic, relative to those by nominal values."""
        resting = [i for i, name in enumerate(self.states) if name not in self.cyclic]
        return float(self._relative_rates[resting].max(initial=0.0))

    @property
    def is_steady(self) -> bool:
        """Whether all states but the cyclic ones are at rest."""
        return self.unsteadiness <= 1e-6

    def spectrum(self, group: Sequence[int], influence: Truths | None = None) -> Spectrum:
        """Return the eigenvalues of the block of a group of states.

        Args:
            group: Indices of the states.
            influence: Which entries of A are not zero; those of this system when None.
        """
        block = np.ix_(group, group)
        known = (self.influence if influence is None else influence)[block]
        if self.period is not None:  # every state of a map has its own factor
            known = known | np.eye(len(group), dtype=bool)
        return Spectrum.of(np.where(known, self.A[block], 0.0), known * self.noise[block])

    @property
    def modes(self) -> tuple[Mode, ...]:
        """Eigenvalues of A with their states, the one that grows fastest first.

        They are those of its diagonal blocks of the states that influence each other.
        """
        found = list[Mode]()
        for group in blocks(self.influence):
            names, own = tuple(self.states[i] for i in group), self.spectrum(group)
            for value, error in zip(own.values, own.errors, strict=True):
                found.append(Mode(complex(value), names, float(error), self.period))
        return tuple(sorted(found, key=lambda mode: (-mode.growth, -mode.value.imag)))

    @property
    def undecided(self) -> tuple[Mode, ...]:
        """Modes of which rounding leaves open whether they grow or decay."""
        return tuple(mode for mode in self.modes if 0 < abs(mode.growth) <= mode.error)

    @property
    def eigenvalues(self) -> Vector:
        """Eigenvalues of A in the order of `modes`: 1/s, or the factors of one period."""
        return np.array([mode.value for mode in self.modes])

    def rows(self) -> list[dict[str, Any]]:
        """Return the matrices as a table: a row for each rate (or next value) and each output."""
        both = np.block([[self.A, self.B], [self.C, self.D]])
        suffix = "_dot" if self.period is None else "_next"
        names = (*(f"{name}{suffix}" for name in self.states), *self.outputs)
        knowns = (*self.states, *self.inputs)
        return [
            {"of": name, **dict(zip(knowns, map(float, row), strict=True))}
            for name, row in zip(names, both, strict=True)
        ]

    def to_csv(self, target: str | os.PathLike[str]) -> None:
        """Write the matrices, a row for each derivative and output.

        Raises:
            ExportError: The file cannot be written.
        """
        write_atomically(target, csv_text(self.rows()).encode())

    def __repr__(self) -> str:
        every = "" if self.period is None else f", a discrete map per {self.period:g} s"
        return f"{self.model} at {self.point}: {len(self.states)} states, {self.steadiness}{every}"

    @property
    def steadiness(self) -> str:
        """Sentence that says whether the motion is steady, and which states move on."""
        own = dict(zip(self.states, self._relative_rates.tolist(), strict=True))
        if not self.is_steady:
            name = max((name for name in own if name not in self.cyclic), key=own.__getitem__)
            rate = self.rates[self.states.index(name)]
            if self.period is not None:
                change = f"{name} changes by {rate * self.period:.3g} in one period"
                return f"not periodic: {change}; the eigenvalues hold for this period"
            change = f"{name} changes by {rate:.3g} per second"
            return f"not steady: {change}; the eigenvalues hold for this instant"
        if moving := [name for name in self.cyclic if own[name] > 1e-9]:
            return f"steady, moving on: {', '.join(moving)}"
        return "at rest" if self.period is None else "periodic"
