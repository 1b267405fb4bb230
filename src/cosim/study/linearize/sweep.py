"""Eigenvalues against a parameter, and the values at which a motion becomes unstable or stable."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.errors import ParameterError
from cosim.model.values import number
from cosim.study.linearize.linearization import Linearization, blocks
from cosim.study.linearize.linearize import START, linearize

HALVINGS = 200  # of an interval with a crossing; ends earlier, where no number lies between


@dataclass(frozen=True)
class Crossing:
    """A value at which an eigenvalue crosses the imaginary axis.

    Attributes:
        value: Of the parameter.
        frequency: Of the oscillation there, rad/s; 0 for a real eigenvalue.
        states: Those that move in it.
        unstable: On which side the eigenvalue has a positive real part: "below" or "above".
        outputs: Of the model there, by name.
    """

    value: float
    frequency: float
    states: tuple[str, ...]
    unstable: str
    outputs: Mapping[str, float]

    def row(self, name: str) -> dict[str, Any]:
        """Return plain values, for tables."""
        return {
            name: f"{self.value:.15g}",
            "frequency": f"{self.frequency:.10g}",
            "unstable": self.unstable,
            "states": " ".join(self.states),
            **{key: f"{value:.15g}" for key, value in self.outputs.items()},
        }


@dataclass(frozen=True, eq=False)
class EigenvalueSweep:
    """Linear systems along a parameter, start value or input.

    Attributes:
        name, unit: What varies.
        values: Its values, (n,).
        points: The linear system at each of them.
        eigenvalues: In one order all along, 1/s, (n, states).
        crossings: Where one crosses the imaginary axis.
    """

    name: str
    unit: str
    values: Vector
    points: tuple[Linearization, ...]
    eigenvalues: Vector
    crossings: tuple[Crossing, ...]

    def rows(self) -> list[dict[str, Any]]:
        """Return a row per value: real and imaginary parts."""
        return [
            {self.name: float(value)}
            | {f"{part}_{i + 1}": float(getattr(e, part)) for i, e in enumerate(row)
               for part in ("real", "imag")}
            for value, row in zip(self.values, self.eigenvalues, strict=True)
        ]  # fmt: skip


def linearize_sweep(
    model: Dae | str,
    name: str,
    values: Sequence[float],
    *,
    at: str | float = START,
    start_values: Mapping[str, float] | None = None,
    outputs: Sequence[str] | None = None,
) -> EigenvalueSweep:
    """Linearize a model for each value of a parameter, a start or an input; find the crossings.

    States that do not act on each other at any of these values are treated apart, so that the
    zeros of motions that nothing brings back disturb no other eigenvalue.

    Args:
        model, at, start_values, outputs: See `linearize`.
        name: What varies.
        values: Increasing or decreasing, two or more.

    Raises:
        ParameterError: The values do not increase or decrease.
        CosimError: See `linearize`.

    Example:
        >>> found = linearize_sweep("bar_on_frame/reduced", "b", [0.1, 0.2], outputs=["theta"])
        >>> len(found.values)
        2
    """
    grid = np.array([number("linearize", name, value) for value in values])
    steps = np.diff(grid)
    if len(grid) < 2 or not (np.all(steps > 0) or np.all(steps < 0)):
        raise ParameterError(f"{name}: give two increasing or decreasing values or more")

    def point(value: float) -> Linearization:
        given = {**(start_values or {}), name: value}
        return linearize(model, at=at, start_values=given, outputs=outputs)

    points = tuple(map(point, grid))
    pattern = np.any([linear.pattern for linear in points], axis=0)
    groups = blocks(pattern)
    table, crossings = [], list[Crossing]()
    for group in groups:
        found = _followed([_eigenvalues(linear, group, pattern) for linear in points])
        table.append(found)
        size = np.abs(found).max(initial=0.0)
        signs = (found.real > 1e-9 * size).sum(axis=1)
        for i in np.flatnonzero(np.diff(signs)):
            ends = (float(grid[i]), float(grid[i + 1]))
            crossings.append(_crossing(point, group, pattern, ends, int(signs[i]), 1e-13 * size))
    crossings.sort(key=lambda crossing: crossing.value)
    unit = model.variable(name).unit if isinstance(model, Dae) else ""
    return EigenvalueSweep(name, unit, grid, points, np.hstack(table), tuple(crossings))


def _eigenvalues(linear: Linearization, group: tuple[int, ...], pattern: Vector) -> Vector:
    block = np.where(pattern, linear.A, 0.0)[np.ix_(group, group)]
    return np.asarray(np.linalg.eigvals(block), dtype=complex)


def _followed(rows: Sequence[Vector]) -> Vector:
    """Put the eigenvalues of neighbours next to each other, the nearest first."""
    kept = [np.sort_complex(rows[0])]
    for row in rows[1:]:
        before, left = kept[-1], list(row)
        chosen = np.empty(len(row), dtype=complex)
        apart = np.abs(before[:, None] - row[None, :])
        open_rows, open_columns = set(range(len(row))), set(range(len(row)))
        for flat in np.argsort(apart, axis=None):
            i, j = divmod(int(flat), len(row))
            if i in open_rows and j in open_columns:
                chosen[i] = left[j]
                open_rows.remove(i)
                open_columns.remove(j)
        kept.append(chosen)
    return np.array(kept)


def _crossing(
    point: Callable[[float], Linearization],
    group: tuple[int, ...],
    pattern: Vector,
    ends: tuple[float, float],
    first: int,
    nothing: float,
) -> Crossing:
    """Halve an interval until no number lies between its ends."""
    low, high = ends
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        if middle in (low, high):
            break
        found = _eigenvalues(point(middle), group, pattern)
        if int((found.real > nothing).sum()) == first:
            low = middle
        else:
            high = middle
    linear = point(high)
    found = _eigenvalues(linear, group, pattern)
    critical = found[int(np.abs(found.real).argmin())]
    frequency = abs(critical.imag)
    outside = int((_eigenvalues(point(ends[1]), group, pattern).real > nothing).sum())
    upward = (outside > first) == (ends[1] > ends[0])
    return Crossing(
        high,
        float(frequency),
        tuple(linear.states[i] for i in group),
        "above" if upward else "below",
        dict(zip(linear.outputs, map(float, linear.y), strict=True)),
    )
