"""`EigenvalueSweep`: linear systems along a parameter, followed from value to value."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Truths, Vector
from cosim.errors import InitialConditionError, ParameterError
from cosim.model.values import number
from cosim.study.linearize.linearization import Linearization, Mode, growth
from cosim.study.linearize.spectrum import Spectrum, Step, blocks

HALVINGS = 200  # most bisections of an interval; neighboring floating-point numbers end it
REFINEMENTS = 12  # most bisections of an interval whose eigenvalues are hard to distinguish


@dataclass(frozen=True)
class Crossing:
    """A value at which an eigenvalue crosses the imaginary axis, or with a period the unit circle.

    Attributes:
        value: Value of the parameter.
        frequency: Angular frequency of the oscillation, rad/s; 0 for a real eigenvalue.
        mode: What the model calls this mode; otherwise "real" or "oscillating".
        states: States that take part in the motion.
        unstable: Side on which the motion grows: "below" or "above".
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
        eigenvalues: Eigenvalues, (n, states), 1/s or factors per period; a column follows one.
        modes: What the model calls the mode of each column; empty where it has no name.
        crossings: Values at which an eigenvalue crosses the imaginary axis, or with a period the
            unit circle. Two crossings of one eigenvalue between neighboring values cancel out.
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

    @property
    def period(self) -> float | None:
        """Period of the discrete maps, s; None for x' = A x."""
        return self.points[0].period

    @property
    def is_stable(self) -> Truths:
        """Whether no motion grows beyond what rounding leaves open, (n,)."""
        return np.array(
            [all(mode.growth <= mode.error for mode in linear.modes) for linear in self.points]
        )

    def rows(self) -> list[dict[str, Any]]:
        """Return a row per value: real and imaginary parts."""
        return [
            {self.name: float(value)}
            | {f"{part}_{i + 1}": float(getattr(e, part)) for i, e in enumerate(row)
               for part in ("real", "imag")}
            for value, row in zip(self.values, self.eigenvalues, strict=True)
        ]  # fmt: skip


def eigenvalue_sweep(
    dae: Dae, name: str, values: Sequence[float], point: Callable[[float], Linearization]
) -> EigenvalueSweep:
    """Linearize for each value of a variable, follow the eigenvalues, and locate the crossings.

    Args:
        dae: The model.
        name: The varied variable.
        values: Its values, increasing or decreasing, SI.
        point: Returns the linear system at a value.

    Raises:
        ParameterError: The values do not increase or decrease.
        InitialConditionError: An eigenvalue crosses at an unsteady state.
    """
    grid = np.array([number("linearize", name, value) for value in values])
    steps = np.diff(grid)
    if len(grid) < 2 or not (np.all(steps > 0) or np.all(steps < 0)):
        raise ParameterError(f"{name}: give two or more values, increasing or decreasing")

    points = tuple(map(point, grid))
    influence = np.any([linear.influence for linear in points], axis=0)
    table, modes, crossings = [], list[str](), list[Crossing]()
    for group in blocks(influence):
        track = _Track(point, group, influence)
        found, crossed = track.along([track.at(*pair) for pair in zip(grid, points, strict=True)])
        names = _mode_names(dae, group, found)
        table.append(found)
        modes += names
        crossings += [track.crossing(*ends, names[column]) for column, ends in crossed]
    crossings.sort(key=lambda crossing: crossing.value)
    units = {known: dae.variable(known).unit for known in (name, *points[0].outputs)}
    found, named = np.hstack(table), tuple(modes)
    return EigenvalueSweep(name, units[name], grid, points, found, named, tuple(crossings), units)


@dataclass(frozen=True, eq=False)
class _Place:
    """The spectrum of a group of states at a value of the parameter."""

    value: float
    linear: Linearization
    spectrum: Spectrum
    block: Vector

    @property
    def sides(self) -> Vector:
        """Whether each motion decays, -1, or grows, 1; 0 where rounding leaves it open."""
        found = self.growth
        return np.where(np.abs(found) <= self.spectrum.errors, 0.0, np.sign(found))

    @property
    def growth(self) -> Vector:
        """How fast each motion grows; see `Mode.growth`."""
        found: Vector = growth(self.spectrum.values, self.linear.period)
        return found

    @cached_property
    def coincidences(self) -> int:
        """Number of pairs of eigenvalues that are equal within rounding."""
        values, errors = self.spectrum.values, self.spectrum.errors
        apart = np.abs(values[:, None] - values) - errors[:, None] - errors
        return int(np.count_nonzero(np.triu(apart <= 0, 1)))


def _changes_side(low: _Place, i: int, high: _Place, k: int) -> bool:
    """Tell whether an eigenvalue begins or ceases to grow; once for a conjugate pair."""
    if low.spectrum.values[i].imag < 0 and high.spectrum.values[k].imag < 0:
        return False
    return bool((low.sides[i] > 0) != (high.sides[k] > 0))


@dataclass(frozen=True, eq=False)
class _Track:
    """The eigenvalues of a group of states, followed along a parameter."""

    point: Callable[[float], Linearization]
    group: tuple[int, ...]
    influence: Truths

    def at(self, value: float, linear: Linearization | None = None) -> _Place:
        """Return the spectrum at a value."""
        found = self.point(value) if linear is None else linear
        block = found.A[np.ix_(self.group, self.group)]
        return _Place(value, found, found.spectrum(self.group, self.influence), block)

    def along(
        self, places: Sequence[_Place]
    ) -> tuple[Vector, list[tuple[int, tuple[_Place, int, _Place, int]]]]:
        """Return the eigenvalues with one in each column, and where which of them changes sides.

        A place of change is a column, the last place before it with the row of the eigenvalue, and
        the first place after it with the row there.
        """
        first = anchor = places[0]
        usual = min(place.coincidences for place in places)  # as of zeros that are always there
        order = np.lexsort((first.spectrum.values.imag, first.spectrum.values.real))
        columns, rows, crossed = list(map(int, order)), [first.spectrum.values[order]], []
        for place in places[1:]:
            at_anchor = columns
            for low, high, partners in self._steps(anchor, place, REFINEMENTS):
                later = [partners[i] for i in columns]
                crossed += [
                    (j, (low, i, high, k))
                    for j, (i, k) in enumerate(zip(columns, later, strict=True))
                    if high.coincidences <= usual and _changes_side(low, i, high, k)
                ]
                columns = later
            rows.append(place.spectrum.values[columns])
            if place.coincidences <= usual:
                anchor = place
            else:  # so that eigenvalues that meet there are followed across
                columns = at_anchor
        return np.array(rows), crossed

    def _steps(
        self, low: _Place, high: _Place, refinements: int
    ) -> list[tuple[_Place, _Place, tuple[int, ...]]]:
        """Return steps between two places in which it is sure what becomes of each eigenvalue."""
        step = self._step(low, high)
        middle = (low.value + high.value) / 2
        ends = not refinements or middle in (low.value, high.value)
        if ends or step.is_sure(low.sides, high.sides):
            return [(low, high, step.partners)]
        between = self.at(middle)
        return [
            *self._steps(low, between, refinements - 1),
            *self._steps(between, high, refinements - 1),
        ]

    def _step(self, low: _Place, high: _Place) -> Step:
        return Step.between(low.spectrum, high.spectrum, high.block - low.block)

    def crossing(self, low: _Place, row: int, end: _Place, k: int, name: str) -> Crossing:
        """Locate the crossing of an eigenvalue, down to neighboring floating-point numbers.

        It is followed from both sides: where two meet, each may continue as either of two.

        Args:
            low, row: Place before the crossing, and index of the eigenvalue there.
            end, k: Place after it, and index there.
            name: What the model calls the mode.
        """
        begin, high, grows = low.value, end, bool(low.sides[row] > 0)
        decided = low.sides[row] * end.sides[k] < 0  # otherwise it leaves the axis
        for _ in range(HALVINGS):
            middle = (low.value + high.value) / 2
            if middle in (low.value, high.value):
                break
            between = self.at(middle)
            found = between.growth if decided else between.sides
            before = self._step(low, between).partners[row]
            after = self._step(between, high).partners.index(k)
            crossed, is_beyond = (bool(found[i] > 0) != grows for i in (before, after))
            grown = [np.count_nonzero(place.sides > 0) for place in (low, between)]
            if crossed or (is_beyond and grown[0] != grown[1]):
                high, k = between, before if crossed else after
            else:
                low, row = between, before if is_beyond else after
        linear = high.linear
        if not linear.is_steady:
            raise InitialConditionError(
                f"{linear.model}: an eigenvalue crosses the imaginary axis at {high.value:.6g}, "
                f"but {linear.point} is {linear.steadiness}, and not for a limit of stability; "
                'choose the equilibrium (--equilibrium; in Python at="equilibrium"), or initial '
                "values of a steady motion"
            )
        mode = Mode(complex(high.spectrum.values[k]), (), period=linear.period)
        return Crossing(
            float(high.value) + 0.0,  # no -0
            mode.frequency,
            name or ("oscillating" if mode.frequency else "real"),
            tuple(linear.states[i] for i in self.group),
            "above" if grows != (end.value > begin) else "below",
            dict(zip(linear.outputs, map(float, linear.y), strict=True)),
        )


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
