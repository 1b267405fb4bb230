"""`Linearization`: the linear system x' = A x + B u, y = C x + D u near a state, and its modes."""

import os
from dataclasses import dataclass
from typing import Any

import numpy as np

from cosim.arrays import Truths, Vector
from cosim.files import write_atomically
from cosim.text import csv_text

NEGLIGIBLE = 1e-12  # of the largest scaled entry of A; smaller entries couple no states


@dataclass(frozen=True)
class Mode:
    """An eigenvalue, 1/s, and the states that take part in its motion."""

    value: complex
    states: tuple[str, ...]

    @property
    def frequency(self) -> float:
        """Angular frequency of the oscillation, rad/s; 0 for a real eigenvalue."""
        return abs(self.value.imag)

    @property
    def damping(self) -> float:
        """Damping ratio: 1 decays without oscillation, 0 oscillates undamped, below 0 grows."""
        size = abs(self.value)
        return -self.value.real / size if size else 0.0

    def row(self) -> dict[str, Any]:
        """Return the mode as a row of a table."""
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
        A, B, C, D: Matrices of x' = A x + B u, y = C x + D u for small deviations; algebraic
            unknowns are eliminated.
        time: Time of the state, s.
        x, u, y: States, inputs and outputs about which the model is linearized.
        rates: Derivatives of the states there.
        nominal: Nominal values of the states.
        point: Description of the state, e.g. "0.5 s of a run".
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
    cyclic: tuple[str, ...] = ()

    @classmethod
    def from_jacobian(
        cls, jacobian: Vector, *, depends: Truths | None = None, **facts: Any
    ) -> "Linearization":
        """Return the linear system of d(rates, outputs) / d(states, inputs).

        Args:
            jacobian: The derivatives, rows and columns in the order of the names.
            depends: Whether a rate depends on a state; where A is not zero when None.
            facts: All attributes but the matrices and `cyclic`.
        """
        states = facts["states"]
        n = len(states)
        A = jacobian[:n, :n]
        cyclic = without_influence(A != 0 if depends is None else depends)
        return cls(
            A=A,
            B=jacobian[:n, n:],
            C=jacobian[n:, :n],
            D=jacobian[n:, n:],
            cyclic=tuple(states[i] for i in cyclic),
            **facts,
        )

    @property
    def unsteadiness(self) -> float:
        """Largest rate of the states that are not cyclic, in nominal values per second."""
        resting = [i for i, name in enumerate(self.states) if name not in self.cyclic]
        return float(np.abs(self.rates[resting] / self.nominal[resting]).max(initial=0.0))

    @property
    def is_steady(self) -> bool:
        """Whether all states but the cyclic ones are at rest."""
        return self.unsteadiness <= 1e-6

    @property
    def pattern(self) -> Vector:
        """Sparsity of A: true where a state influences the rate of another."""
        scaled = np.abs(self.A * self.nominal / self.nominal[:, None])
        pattern: Vector = scaled > NEGLIGIBLE * scaled.max(initial=0.0)
        return pattern

    @property
    def modes(self) -> tuple[Mode, ...]:
        """Eigenvalues of A with their states, the largest real part first.

        They are those of its diagonal blocks of the states that influence each other.
        """
        pattern, found = self.pattern, []
        for group in blocks(pattern):
            block = self.A[np.ix_(group, group)]
            if len(group) == 1:
                block = block * pattern[np.ix_(group, group)]
            names = tuple(self.states[i] for i in group)
            found += [Mode(complex(value), names) for value in np.linalg.eigvals(block)]
        return tuple(sorted(found, key=lambda mode: (-mode.value.real, -mode.value.imag)))

    @property
    def eigenvalues(self) -> Vector:
        """Eigenvalues of A, 1/s, in the order of `modes`."""
        return np.array([mode.value for mode in self.modes])

    def rows(self) -> list[dict[str, Any]]:
        """Return the matrices as a table with a row for each rate and each output."""
        both = np.block([[self.A, self.B], [self.C, self.D]])
        names = (*(f"{name}_dot" for name in self.states), *self.outputs)
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

    def __str__(self) -> str:
        return f"{self.model} at {self.point}: {len(self.states)} states, {self.steadiness}"

    @property
    def steadiness(self) -> str:
        """Sentence that says whether the motion is steady, and which states move on."""
        moving = [
            name
            for name, rate in zip(self.states, self.rates / self.nominal, strict=True)
            if name in self.cyclic and abs(rate) > 1e-9
        ]
        if not self.is_steady:
            worst = max(
                (i for i, name in enumerate(self.states) if name not in self.cyclic),
                key=lambda i: abs(self.rates[i] / self.nominal[i]),
            )
            return (
                f"not steady: {self.states[worst]} changes by {self.rates[worst]:.3g} per second; "
                "the eigenvalues hold for this instant"
            )
        return f"steady, moving on: {', '.join(moving)}" if moving else "at rest"


def without_influence(depends: Truths) -> tuple[int, ...]:
    """Return the columns on which only rows of the same group depend."""
    every = range(len(depends))
    needed = list(every)
    while free := [i for i in needed if not depends[np.ix_(needed, [i])].any()]:
        needed = [i for i in needed if i not in free]
    return tuple(i for i in every if i not in needed)


def blocks(pattern: Vector) -> tuple[tuple[int, ...], ...]:
    """Return the groups of states that influence each other, directly or through other states."""
    n = len(pattern)
    reach = np.eye(n, dtype=bool) | (np.asarray(pattern) != 0)
    for k in range(n):
        reach |= np.outer(reach[:, k], reach[k, :])
    both = reach & reach.T
    return tuple(dict.fromkeys(tuple(map(int, np.flatnonzero(row))) for row in both))
