"""The linear system x' = A x + B u, y = C x + D u near a state, and its modes."""

import os
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cosim.arrays import Vector
from cosim.files import write_atomically
from cosim.text.tables import csv_text

NOTHING = 1e-12  # of the largest entry, in nominal values: what is smaller couples nothing


@dataclass(frozen=True)
class Mode:
    """An eigenvalue, 1/s, and the states that move in it."""

    value: complex
    states: tuple[str, ...]

    @property
    def frequency(self) -> float:
        """Of the oscillation, rad/s; 0 where it does not oscillate."""
        return abs(self.value.imag)

    @property
    def damping(self) -> float:
        """Damping ratio: 1 decays without oscillation, 0 neither, below 0 grows."""
        size = abs(self.value)
        return -self.value.real / size if size else 0.0

    def row(self) -> dict[str, Any]:
        """Return plain values, for tables."""
        return {
            "real": self.value.real,
            "imaginary": self.value.imag,
            "damping": self.damping,
            "states": " ".join(self.states),
        }


@dataclass(frozen=True, eq=False)  # arrays have no single truth value
class Linearization:
    """A, B, C, D of a model near a state, in SI units.

    Attributes:
        model: `MODEL/FORMULATION`, or the name in an FMU.
        states, inputs, outputs: Names, in the order of rows and columns.
        A, B, C, D: x' = A x + B u, y = C x + D u, of what is small; algebraic unknowns eliminated.
        time: s.
        x, u, y: Where; x' is `rates`.
        rates: Of the states there.
        nominal: Of the states.
        point: What that state is, in words.
        cyclic: States that influence nothing but such states: they may go on in a steady motion.
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
    cyclic: tuple[str, ...] = field(default=())

    @property
    def unsteadiness(self) -> float:
        """Largest rate of a state that is not cyclic, in nominal values per second."""
        kept = [i for i, name in enumerate(self.states) if name not in self.cyclic]
        return float(np.abs(self.rates[kept] / self.nominal[kept]).max(initial=0.0))

    @property
    def pattern(self) -> Vector:
        """Which entries of A couple states, true or false."""
        scaled = np.abs(self.A * self.nominal / self.nominal[:, None])
        pattern: Vector = scaled > NOTHING * scaled.max(initial=0.0)
        return pattern

    @property
    def modes(self) -> tuple[Mode, ...]:
        """Every eigenvalue of A, the largest real part first."""
        return modes(self, blocks(self.pattern))

    @property
    def eigenvalues(self) -> Vector:
        """Eigenvalues of A, 1/s, in the order of `modes`."""
        return np.array([mode.value for mode in self.modes])

    def rows(self) -> list[dict[str, Any]]:
        """Return the matrices as rows of a table: what is derived, then each state and input."""
        both = np.block([[self.A, self.B], [self.C, self.D]])
        names = (*(f"{name}_dot" for name in self.states), *self.outputs)
        knowns = (*self.states, *self.inputs)
        return [
            {"of": name, **dict(zip(knowns, map(float, row), strict=True))}
            for name, row in zip(names, both, strict=True)
        ]

    def to_csv(self, target: str | os.PathLike[str]) -> None:
        """Write the matrices with 17 digits, a row for each derivative and output.

        Raises:
            ExportError: The file cannot be written.
        """
        write_atomically(target, csv_text(self.rows(), digits=17).encode())

    def __str__(self) -> str:
        return f"{self.model} at {self.point}: {len(self.states)} states, {self.steadiness}"

    @property
    def steadiness(self) -> str:
        """Whether the motion there is steady, in words."""
        moving = [
            name
            for name, rate in zip(self.states, self.rates / self.nominal, strict=True)
            if name in self.cyclic and abs(rate) > 1e-9
        ]
        if self.unsteadiness > 1e-6:
            worst = max(
                (i for i, name in enumerate(self.states) if name not in self.cyclic),
                key=lambda i: abs(self.rates[i] / self.nominal[i]),
            )
            return (
                f"not steady: {self.states[worst]} changes by {self.rates[worst]:.3g} per second; "
                "the eigenvalues are those of this moment"
            )
        return f"steady, {', '.join(moving)} going on" if moving else "at rest"


def blocks(pattern: Vector) -> tuple[tuple[int, ...], ...]:
    """Return the groups of states that act on each other, both ways, directly or through others.

    The eigenvalues of A are those of its diagonal blocks of these groups.
    """
    n = len(pattern)
    reach = np.eye(n, dtype=bool) | (np.asarray(pattern) != 0)
    for k in range(n):
        reach |= np.outer(reach[:, k], reach[k, :])
    both = reach & reach.T
    return tuple(dict.fromkeys(tuple(map(int, np.flatnonzero(row))) for row in both))


def modes(linear: Linearization, groups: tuple[tuple[int, ...], ...]) -> tuple[Mode, ...]:
    """Return the eigenvalues of the diagonal blocks of A, the largest real part first."""
    found = []
    for group in groups:
        block = linear.A[np.ix_(group, group)]
        if len(group) == 1:
            block = block * linear.pattern[np.ix_(group, group)]
        names = tuple(linear.states[i] for i in group)
        found += [Mode(complex(value), names) for value in np.linalg.eigvals(block)]
    return tuple(sorted(found, key=lambda mode: (-mode.value.real, -mode.value.imag)))
