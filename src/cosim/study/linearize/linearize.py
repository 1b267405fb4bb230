"""`linearize`: the linear system at a state, or eigenvalues along a parameter."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypedDict, Unpack, overload

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.errors import InitialConditionError, ParameterError, UsageError
from cosim.model.catalogue import load
from cosim.model.values import number
from cosim.study.linearize.linearization import Linearization, blocks
from cosim.study.linearize.point import linearized

HALVINGS = 200  # most bisections of an interval; neighboring floating-point numbers end it


@dataclass(frozen=True)
class Crossing:
    """A value at which an eigenvalue crosses the imaginary axis.

    Attributes:
        value: Value of the parameter.
        frequency: Angular frequency of the oscillation, rad/s; 0 for a real eigenvalue.
        mode: What the model calls this mode; otherwise "real" or "oscillating".
        states: States that take part in the motion.
        unstable: Side on which the eigenvalue has a positive real part: "below" or "above".
        outputs: Outputs of the model at this value, by name.
    """

    value: float
    frequency: float
    mode: str
    states: tuple[str, ...]
    unstable: str
    outputs: Mapping[str, float]

    def row(self, name: str) -> dict[str, Any]:
        """Return the crossing as a row of a table."""
        return {
            name: f"{self.value:.15g}",
            "frequency": f"{self.frequency:.10g}",
            "mode": self.mode,
            "unstable": self.unstable,
            "states": " ".join(self.states),
            **{key: f"{value:.15g}" for key, value in self.outputs.items()},
        }


@dataclass(frozen=True, eq=False)
class EigenvalueSweep:
    """Linear systems along a parameter, start value or input.

    Attributes:
        name, unit: The varied parameter, start value or input.
        values: Its values, (n,).
        points: The linear system at each value.
        eigenvalues: Eigenvalues, 1/s, (n, states); a column follows one eigenvalue.
        modes: What the model calls the mode of each column; empty where it has no name.
        crossings: Values at which an eigenvalue crosses the imaginary axis.
        units: Units of the varied quantity and of the outputs, by name.
    """

    name: str
    unit: str
    values: Vector
    points: tuple[Linearization, ...]
    eigenvalues: Vector
    modes: tuple[str, ...]
    crossings: tuple[Crossing, ...]
    units: Mapping[str, str]

    def rows(self) -> list[dict[str, Any]]:
        """Return a row per value: real and imaginary parts."""
        return [
            {self.name: float(value)}
            | {f"{part}_{i + 1}": float(getattr(e, part)) for i, e in enumerate(row)
               for part in ("real", "imag")}
            for value, row in zip(self.values, self.eigenvalues, strict=True)
        ]  # fmt: skip


class PointKeywords(TypedDict, total=False):
    """Keywords of one linear system; see `linearize`."""

    at: str | float
    start_values: Mapping[str, float] | None
    outputs: Sequence[str] | None
    solver: str | None
    relative_tolerance: float | None


@overload
def linearize(
    model: Dae | str | os.PathLike[str], *, along: None = None, **options: Unpack[PointKeywords]
) -> Linearization: ...


@overload
def linearize(
    model: Dae | str, *, along: Mapping[str, Sequence[float]], **options: Unpack[PointKeywords]
) -> EigenvalueSweep: ...


def linearize(
    model: Dae | str | os.PathLike[str],
    *,
    along: Mapping[str, Sequence[float]] | None = None,
    **options: Unpack[PointKeywords],
) -> Linearization | EigenvalueSweep:
    """Return the linear system near a state: x' = A x + B u, y = C x + D u; or one per value.

    Along a parameter, groups of states that do not influence each other at any of its values are
    treated separately, so that the zero eigenvalues of states without a restoring force do not
    interfere.

    Args:
        model: A `Dae`, the name of a model, or the file of an FMU, whose directional derivatives
            give the matrices.
        along: One parameter, state (its initial value) or input by name with its values: two or
            more, increasing or decreasing, SI. None: one linear system.
        options: `at`: "start" (the default), the initial state; "equilibrium", which Newton's
            method finds from there, and in which states that influence nothing else may move on; or
            a time of a run, s. `start_values`: values by name that replace initial values,
            parameters or inputs, SI. `outputs`: names of y; all outputs of the model when None.
            `solver`, `relative_tolerance`: settings of the run up to a time; see `simulate`.

    Raises:
        UnknownName: A name does not exist.
        UsageError: An FMU can be linearized at its initial state only, and not along a parameter;
            or `along` does not name one variable.
        ParameterError: The values along a parameter do not increase or decrease.
        InitialConditionError: The initial values contradict the constraints, or there is no
            equilibrium near them; or an eigenvalue crosses the imaginary axis at an unsteady state.
        CosimError: See `simulate` and `linearized_fmu`.

    Example:
        >>> linearize("bar_on_frame/reduced", outputs=["theta"]).A.shape
        (4, 4)
        >>> found = linearize("bar_on_frame/reduced", along={"b": [0.1, 0.2]}, outputs=["theta"])
        >>> len(found.values)
        2
    """
    if along is None:
        return linearized(model, **options)
    if not isinstance(along, Mapping) or len(along) != 1:
        raise UsageError.of_type("linearize: along", along, "one name with its values")
    ((name, values),) = along.items()
    dae = load(model) if isinstance(model, str) and not model.endswith(".fmu") else model
    if not isinstance(dae, Dae):
        raise UsageError(f"{model}: an FMU is linearized at one state; leave along out")
    given = options.get("start_values") or {}

    def point(value: float) -> Linearization:
        at_value: PointKeywords = {**options, "start_values": {**given, name: value}}
        return linearized(dae, **at_value)

    return _along(dae, name, values, point)


def _along(
    dae: Dae, name: str, values: Sequence[float], point: Callable[[float], Linearization]
) -> EigenvalueSweep:
    """Linearize for each value of a variable, and locate the crossings."""
    grid = np.array([number("linearize", name, value) for value in values])
    steps = np.diff(grid)
    if len(grid) < 2 or not (np.all(steps > 0) or np.all(steps < 0)):
        raise ParameterError(f"{name}: give two or more values, increasing or decreasing")

    points = tuple(map(point, grid))
    pattern = np.any([linear.pattern for linear in points], axis=0)
    groups = blocks(pattern)
    table, modes, crossings = [], list[str](), list[Crossing]()
    for group in groups:
        found = _followed([_eigenvalues(linear, group, pattern) for linear in points])
        names = _mode_names(dae, group, found)
        table.append(found)
        modes += names
        size = np.abs(found).max(initial=0.0)
        signs = (found.real > 1e-9 * size).sum(axis=1)
        for i in np.flatnonzero(np.diff(signs)):
            ends = (float(grid[i]), float(grid[i + 1]))
            crossing = _crossing(point, group, pattern, ends, int(signs[i]), 1e-13 * size)
            nearest = int(np.abs(found[i] - 1j * crossing.frequency).argmin())
            crossings.append(replace(crossing, mode=names[nearest] or crossing.mode))
    crossings.sort(key=lambda crossing: crossing.value)
    units = {known: dae.variable(known).unit for known in (name, *points[0].outputs)}
    found, named = np.hstack(table), tuple(modes)
    return EigenvalueSweep(name, units[name], grid, points, found, named, tuple(crossings), units)


def _mode_names(dae: Dae, group: Sequence[int], found: Vector) -> list[str]:
    """Return what the model calls the modes of a group, by what they are at most values.

    Eigenvalues of a kind get their names only if they are as many as these.
    """
    names = [""] * len(group)
    frequencies, sizes = np.median(np.abs(found.imag), axis=0), np.median(found.real, axis=0)
    pairs = [j for j in np.argsort(frequencies, kind="stable") if frequencies[j]]
    reals = [j for j in np.argsort(-sizes) if not frequencies[j]]
    for known in dae.mode_names:
        if any(dae.states[i].name == known.state for i in group):
            for columns, given in ((pairs, np.repeat(known.oscillating, 2)), (reals, known.real)):
                if len(columns) == len(given):
                    for column, name in zip(columns, given, strict=True):
                        names[column] = str(name)
    return names


def _eigenvalues(linear: Linearization, group: tuple[int, ...], pattern: Vector) -> Vector:
    block = np.where(pattern, linear.A, 0.0)[np.ix_(group, group)]
    return np.asarray(np.linalg.eigvals(block), dtype=complex)


def _followed(rows: Sequence[Vector]) -> Vector:
    """Return eigenvalues ordered so that each column follows one, by least distance."""
    ordered = [np.sort_complex(rows[0])]
    for row in rows[1:]:
        apart = np.abs(ordered[-1][:, None] - row)
        chosen = np.empty(len(row), dtype=complex)
        for _ in row:
            i, j = np.unravel_index(np.argmin(apart), apart.shape)
            chosen[i] = row[j]
            apart[i, :] = apart[:, j] = np.inf
        ordered.append(chosen)
    return np.array(ordered)


def _crossing(
    point: Callable[[float], Linearization],
    group: tuple[int, ...],
    pattern: Vector,
    ends: tuple[float, float],
    first: int,
    negligible: float,
) -> Crossing:
    """Locate a crossing by bisection, down to neighboring floating-point numbers."""
    low, high = ends
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        if middle in (low, high):
            break
        found = _eigenvalues(point(middle), group, pattern)
        if int((found.real > negligible).sum()) == first:
            low = middle
        else:
            high = middle
    linear = point(high)
    if not linear.is_steady:
        raise InitialConditionError(
            f"{linear.model}: an eigenvalue crosses the imaginary axis at {high:.6g}, but "
            f"{linear.point} is {linear.steadiness}, and not for a limit of stability; choose the "
            "equilibrium, or initial values of a steady motion"
        )
    found = _eigenvalues(linear, group, pattern)
    critical = found[int(np.abs(found.real).argmin())]
    frequency = abs(critical.imag)
    outside = int((_eigenvalues(point(ends[1]), group, pattern).real > negligible).sum())
    upward = (outside > first) == (ends[1] > ends[0])
    return Crossing(
        high,
        float(frequency),
        "oscillating" if frequency else "real",
        tuple(linear.states[i] for i in group),
        "above" if upward else "below",
        dict(zip(linear.outputs, map(float, linear.y), strict=True)),
    )
