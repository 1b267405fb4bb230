"""Samples over time: metadata of a variable, and interpolation between its samples."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from casadi_models.units import converted, parse_unit
from cosim.arrays import Truths, Vector, reals
from cosim.errors import ParameterError, naming_arguments_of
from cosim.series.curves import Curves
from cosim.text import MOST_LINES, MOST_NAMES, Table, shortened, text_table

OF_ROWS = "min and max of the rows"

NOT_GIVEN = 1.0  # nominal value of a variable for which the model sets none
ROUNDING_OF_OTHERS = 1e-14  # relative size of a state that is a rounding error of another


@naming_arguments_of
@dataclass(frozen=True)
class Column:
    """Metadata of a recorded variable.

    Attributes:
        name, unit, display_unit, nominal, meaning: As in a model.
        display_factor, display_offset: Shown value = factor * value + offset, where a file defines
            its own display unit; None for the definition that the name of the display unit has.
        is_state: Whether it is a state of the equations, which a solver controls.
        is_difference: Whether its values are differences, for which an offset does not count.

    Example:
        >>> Column("phi", "rad", "deg").shown(np.array([np.pi]))
        array([180.])
    """

    name: str
    unit: str = "1"
    display_unit: str | None = None
    nominal: float = 1.0
    meaning: str = ""
    display_factor: float | None = None
    display_offset: float = 0.0
    is_state: bool = False
    is_difference: bool = False

    @property
    def shown_unit(self) -> str:
        """The unit in which the variable is shown."""
        return self.display_unit or self.unit

    @property
    def facts(self) -> dict[str, str]:
        """Unit and meaning under the names of the climate and forecast conventions."""
        return {"units": self.unit, "long_name": self.meaning}

    def shown(self, values: Vector, *, difference: bool = False) -> Vector:
        """Convert values of this variable to `shown_unit`.

        Args:
            values: In `unit`.
            difference: Whether they are differences of values, for which no offset counts.
        """
        difference |= self.is_difference
        if self.display_factor is not None:
            scaled = values * self.display_factor
            return scaled if difference else scaled + self.display_offset
        own, shown = parse_unit(self.unit), parse_unit(self.display_unit or self.unit)
        if own is None or shown is None:
            return values
        if difference:
            own, shown = own.difference(), shown.difference()
        in_display: Vector = converted(values, own, shown)
        return in_display


def summary_rows(columns: Sequence[Column], known: Curves, *, when: bool) -> list[dict[str, Any]]:
    """Return start, end, smallest and largest value of each column in display units.

    Args:
        columns: The variables.
        known: Their curves, SI, or all that is known of them.
        when: Whether to add the times of the smallest and the largest value.
    """
    values = known.rows.values
    if not len(values) or not columns:
        return []
    low, low_at, high, high_at = known.extremes
    rows = []
    for i, column in enumerate(columns):
        shown = column.shown(np.array([values[0, i], values[-1, i], low[i], high[i]])).tolist()
        row: dict[str, Any] = {"name": column.name, "unit": column.shown_unit}
        row |= dict(zip(("start", "end", "min"), shown, strict=False))
        row |= {"min at [s]": float(low_at[i])} if when else {}
        row["max"] = shown[3]
        row |= {"max at [s]": float(high_at[i])} if when else {}
        rows.append(row)
    return rows


def summary_table(columns: Sequence[Column], known: Curves, headline: str) -> Table:
    """Return `summary_rows` under a headline that says which extremes are not of the motion."""
    rows = summary_rows(columns, known, when=True)
    if rows and not len(known.begins):
        headline += f"; {OF_ROWS}"
    elif rough := [c.name for c, bad in zip(columns, known.rough.T, strict=True) if bad.any()]:
        headline += f"; min and max of points of {', '.join(rough)}"
    return Table(tuple(rows), headline, digits=6)


def summary_text(columns: Sequence[Column], known: Curves, headline: str) -> str:
    """Return `summary_rows` of rows alone, without times, as a few lines of text."""
    rows = summary_rows(columns, known, when=False)
    table = text_table(rows, most=MOST_LINES - 2)
    return "\n".join((headline, table, OF_ROWS) if rows else (headline,))


def resample(
    time: Vector, values: Vector, at: Vector, breaks: Vector | None = None
) -> tuple[Vector, Vector]:
    """Return samples at other times by local polynomials of degree 5.

    A time that occurs twice is a jump: its first sample ends the piece before, its second one
    begins the piece after. Pieces of fewer samples use polynomials of a lower degree.

    Args:
        time: Sample times in increasing order, s, (n,), n > 0.
        values: Samples, (n, columns).
        at: Times within the samples, s, (m,).
        breaks: Times of jumps, s: no polynomial holds samples of both sides. A single sample at
            such a time begins the piece after it.

    Returns:
        Values, (m, columns), and the largest change that degree 3 would make to each column, an
        estimate of the error; in pieces of up to 4 samples that of one degree less, infinite beside
        a single one.

    Raises:
        ParameterError: There is no sample between two breaks around a requested time.
    """
    twice = time[1:][np.diff(time) == 0]
    breaks = np.setdiff1d(np.empty(0) if breaks is None else breaks, twice)
    with np.errstate(invalid="ignore"):  # infinity less infinity
        five, three = (_local(time, values, at, *degree, breaks) for degree in ((6, 0), (4, 1)))
        gap = np.abs(five - three)
    return five, gap.max(axis=0, initial=0.0)


def times_within(owner: str, span: Vector, times: ArrayLike) -> Vector:
    """Return requested times, of shape () or (m,), clipped to the span up to rounding.

    Raises:
        ParameterError: They are not numbers, decrease, or are not within the span.
    """
    try:
        requested = reals(times)
    except (TypeError, ValueError) as error:
        raise ParameterError(f"{owner}: times {error}; give numbers, s") from error
    if not len(span):
        raise ParameterError(f"{owner}: the run has no output times to interpolate")
    begin, end = float(span[0]), float(span[-1])
    clipped, inside = clipped_times(span, requested)
    if requested.ndim > 1 or not inside.all():
        first = (
            requested[~inside].flat[0] if requested.size and not inside.all() else requested.shape
        )
        raise ParameterError(
            f"{owner}: time {first} is not within the run, {begin:g} ... {end:g} s; "
            "give times within it, or run longer"
        )
    if (np.diff(np.atleast_1d(requested)) < 0).any():
        raise ParameterError(f"{owner}: times decrease; give them in increasing order")
    return clipped


def clipped_times(span: Vector, times: Vector) -> tuple[Vector, Truths]:
    """Return times clipped to a span, and whether each is within it up to rounding."""
    begin, end = float(span[0]), float(span[-1])
    slack = 1e-9 * (end - begin) + 4 * np.spacing(max(abs(begin), abs(end)))
    return np.clip(times, begin, end), (times >= begin - slack) & (times <= end + slack)


def _local(
    time: Vector, values: Vector, at: Vector, points: int, fewer: int, breaks: Vector
) -> Vector:
    """Interpolate by polynomials through as many points around each time (Neville).

    At most all but `fewer` of a piece; infinite beside a sample if there is none.
    """
    jumps = np.flatnonzero(np.diff(time, prepend=-np.inf) == 0)
    edges = np.unique(np.concatenate(([0], jumps, np.searchsorted(time, breaks), [len(time)])))
    below = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 1)
    side = np.searchsorted(breaks, at, side="right")
    below += np.searchsorted(breaks, time[below], side="right") < side  # samples after the break
    last = np.minimum(below, len(time) - 1)
    lost = (below > last) | (np.searchsorted(breaks, time[last], side="right") != side)
    if lost.any():
        raise ParameterError(
            f"there is no row between two events around {at[lost][0]:g} s; give a smaller "
            "output_interval"
        )
    piece = np.searchsorted(edges, below, side="right") - 1
    result = np.empty((len(at), values.shape[1]))
    for p in np.unique(piece):
        first, end = edges[p], edges[p + 1]
        here = piece == p
        count = min(points, end - first - fewer)
        if not count:
            beside = at[here] != time[first]
            result[here] = np.where(beside[:, None], np.inf, values[first])
            continue
        start = np.clip(below[here] - max(count // 2 - 1, 0), first, end - count)
        nodes = start[:, None] + np.arange(count)
        result[here] = _neville(time[nodes], values[nodes], at[here])
    own = (time[last] == at)[:, None] & ~np.isfinite(result)  # a neighbor is not finite
    return np.where(own, values[last], result)


def _neville(t: Vector, y: Vector, at: Vector) -> Vector:
    """Evaluate polynomials through (m, count) times and (m, count, columns) values at m times."""
    table = y.copy()
    count = t.shape[1]
    for width in range(1, count):
        for i in range(count - width):
            left, right = t[:, i], t[:, i + width]
            share = ((at - left) / (right - left))[:, None]
            table[:, i] += share * (table[:, i + 1] - table[:, i])
    return table[:, 0]


def uncontrolled(
    columns: Sequence[Column], values: Vector, relative: float, absolute: ArrayLike
) -> str:
    """Return which states stay too small for the error control of their run; "" if none.

    Of a number well below its absolute tolerance divided by the relative one, a solver controls
    fewer digits than it was asked for: fewer than half of them below their geometric mean. What
    grows again from there is the matter of `model.troughs`.

    Args:
        columns: Of the states.
        values: At output times, SI, (n, states).
        relative: Relative tolerance (1).
        absolute: Absolute tolerances, SI, of shape () or (states,).
    """
    limits = np.asarray(absolute) / np.sqrt(relative)
    found = _smaller(columns, values, limits)
    if not found:
        return ""
    many = len(found) > 1
    return (
        f"the error control leaves most digits of {shortened(found, MOST_NAMES)} open, since the "
        f"nominal value of {'each' if many else 'it'} is 1; give nominal values, or a smaller "
        "absolute_tolerance"
    )


def below(
    columns: Sequence[Column],
    values: Vector,
    accuracy: float,
    what: str = "the accuracy is more than all values",
) -> str:
    """Return which variables, (times, variables), an accuracy says nothing of; "" if none."""
    found = shortened(_smaller(columns, values, accuracy), MOST_NAMES)
    return f"{what} of {found}, with the nominal value 1; give nominal values" if found else ""


def _smaller(columns: Sequence[Column], values: Vector, limits: ArrayLike) -> list[str]:
    """Name what has no nominal value, and stays below a limit, but above rounding of the others."""
    peaks = np.abs(values).max(axis=0, initial=0.0)
    rounding = ROUNDING_OF_OTHERS * peaks.max(initial=0.0)
    limits = np.broadcast_to(limits, peaks.shape)
    return [
        f"{column.name} (at most {peak:.1g})"
        for column, peak, limit in zip(columns, peaks, limits, strict=True)
        if column.nominal == NOT_GIVEN and rounding < peak < limit
    ]
