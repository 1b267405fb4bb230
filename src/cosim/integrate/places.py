"""`Place`: where terms that time or a few quantities determine bend within a part of a step.

A solver meets the equations at the stages of its steps only: a bump of the ground between two of
them has no effect, and no error estimate shows it. Where such a term bends is known from its bounds
on the way of what moves it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import casadi as ca
import numpy as np

from casadi_models.dae import Dae
from casadi_models.dae.inner_terms import InnerTerm
from casadi_models.dae.single_terms import single_terms
from cosim.arrays import Vector
from cosim.codegen.changes import Values, apart, with_surroundings
from cosim.codegen.knots import knots_of
from cosim.codegen.landmarks import is_line, way_of
from cosim.codegen.terms import Terms, bent, terms_of
from cosim.integrate.excursions import excursions, several_terms_of
from cosim.integrate.motion import Motion, Path
from cosim.model.inputs import InputSeries

_PARTS = 4  # of the way in an average step, within which a term that every step sees is a line
_BEYOND = 0.05  # of a way, by which rows may miss its ends ...
_LARGER = 20.0  # ... where the range of a term may be so much larger that none seems to change
_MOST_CELLS = 4_000  # parts of a way
_ROWS, _MOST_STEPS = 8, 10_000  # per average step, of a motion whose places are sought; steps
_HALVINGS = 53  # of the place of a knot between edges
_INNER = 4  # intervals of a part of a place over which rates are integrated


@dataclass(frozen=True, eq=False)
class Place:
    """Where a term bends.

    Attributes:
        edges: Times between which it changes, s, ascending; one if it is narrower than rounding.
        name: Of what moves it.
        values: Returns it on a path, (n,).
    """

    edges: Vector
    name: str
    values: Callable[[Path], Vector]

    @property
    def begin(self) -> float:
        """Its first time, s."""
        return float(self.edges[0])

    @property
    def end(self) -> float:
        """Its last time, s."""
        return float(self.edges[-1])

    @property
    def is_narrow(self) -> bool:
        """Whether it is narrower than rounding."""
        return len(self.edges) == 1

    @property
    def times(self) -> Vector:
        """Times in it, and as far before and after it as it is long, s."""
        return with_surroundings(self.edges, _INNER)


def has_terms(dae: Dae) -> bool:
    """Return whether equations have terms whose bends can be found, or are to be named."""
    return bool(terms_of(dae)) or several_terms_of(dae) is not None


def _moving(dae: Dae) -> list[str]:
    """Return the names of what may move terms."""
    return [*(state.name for state in dae.states), "time"]


def watched_terms(dae: Dae) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return what moves the terms that no step passes over, and those that a step may pass over.

    The names of several quantities of one term are joined by commas.
    """
    names = _moving(dae)
    single, several = [names[moving] for moving in single_terms(dae)], several_terms_of(dae)
    if several is None:
        return tuple(single), ()
    return tuple(dict.fromkeys([*single, *several.names])), several.unbounded


def places_on(dae: Dae, path: Path, p: Vector, steps: int) -> list[Place]:
    """Return where terms bend within a part of an average step of a path of so many steps.

    Args:
        dae, path, p, steps: The equations, the path, parameters, and the number of its steps.
    """
    names, found = _moving(dae), list[Place]()
    for terms in terms_of(dae):
        turned = path.with_turns(terms.moving)
        for of_way, edges in _bends(terms, turned, dae, p, steps):
            values = partial(_along, terms, of_way)
            times = _times(turned.time, _moved(terms, turned), edges)
            found += [Place(own, names[terms.moving], values) for own in times]
    several = several_terms_of(dae)
    if several is None:
        return found
    for term, edges in excursions(several, path, p, steps):
        values = partial(several.along, term, p)
        found.append(Place(edges, several.names[term], values))
    return found


def _along(terms: Terms, of_way: Values, path: Path) -> Vector:
    return of_way(_moved(terms, path))


def _moved(terms: Terms, path: Path) -> Vector:
    """Return what moves some terms on a path, (n,)."""
    return np.asarray(np.vstack((path.states, path.time))[terms.moving])


def _bends(
    terms: Terms, path: Path, dae: Dae, p: Vector, steps: int
) -> list[tuple[Values, Vector]]:
    """Return where on the way of what moves its terms bend within a part of an average step.

    Returns:
        A term as a function of what moves it, and values of this between which it changes,
        ascending.
    """
    x = _moved(terms, path)
    way = float(np.abs(np.diff(x)).sum())
    if not (np.isfinite(way) and way > 0):
        return []
    low, high = float(x.min()) - _BEYOND * way, float(x.max()) + _BEYOND * way
    count = int(np.clip(np.ceil(_PARTS * steps * (high - low) / way), 1, _MOST_CELLS))
    edges = np.linspace(low, high, count + 1)
    knots = _knots(dae, terms, p, edges)
    reached, found = np.unique(np.clip(edges, x.min(), x.max())), list[tuple[Values, Vector]]()
    for term in range(len(terms.values)):
        values, parts = bent(dae, terms, term, p, edges, knots)
        if not parts and not np.ptp(values(edges)) <= _LARGER * np.ptp(values(reached)):
            values, parts = bent(dae, terms, term, p, reached, knots)
        found += [(values, own) for own in parts]
    return found


def _knots(dae: Dae, terms: Terms, p: Vector, edges: Vector) -> Vector:
    """Return where tables of what moves have their knots; within edges, if they are of no line."""
    found = [np.empty(0)]
    for term in terms.tables:
        if is_line(dae, term):
            found.append(way_of(dae, term, knots_of(term), p))
        else:
            found.append(_reached(dae, term, p, knots_of(term), edges))
    return np.unique(np.concatenate(found))


def _reached(dae: Dae, term: InnerTerm, p: Vector, values: Vector, edges: Vector) -> Vector:
    """Return where between edges a variable that is no line has some ascending values."""
    symbol = ca.vertcat(dae.x, dae.t)[term.movers[0]]
    variable = ca.Function("variable", [symbol, dae.p], [term.variable])
    own = np.array(variable(edges[None], p)).ravel()
    first, last = (values.searchsorted(end(own[:-1], own[1:])) for end in (np.fmin, np.fmax))
    cells = np.repeat(np.arange(len(first)), last - first)
    goals = np.concatenate([np.empty(0), *(values[i:j] for i, j in zip(first, last, strict=True))])
    rises = (own[:-1] < own[1:])[cells]
    low, high = edges[cells], edges[cells + 1]
    for _ in range(_HALVINGS if len(cells) else 0):
        middle = (low + high) / 2
        beyond = (np.array(variable(middle[None], p)).ravel() > goals) == rises
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    return high


def _times(t: Vector, x: Vector, edges: Vector) -> list[Vector]:
    """Return when what moves is between the first and the last of some values.

    Args:
        t: Times, s, (n,).
        x: What moves, on lines between them, (n,).
        edges: Values, ascending.

    Returns:
        For each time that it is, the times at which it begins, is at one of the values, and ends;
        for each time that it is at the only value, this.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = (edges[:, None] - x[:-1]) / np.diff(x)
    _, rows = within = np.nonzero((shares >= 0) & (shares <= 1))
    crossings = t[rows] + shares[within] * np.diff(t)[rows]
    if len(edges) == 1:
        return list(np.unique(crossings)[:, None])
    at = np.unique([t[0], *crossings, t[-1]])
    middles = np.interp((at[:-1] + at[1:]) / 2, t, x)
    inside = (edges[0] < middles) & (middles < edges[-1])
    return apart(list(zip(at[:-1][inside].tolist(), at[1:][inside].tolist(), strict=True)))


def step_count(motion: Motion) -> int:
    """Return how many steps of a motion count: at least one, and not more than are looked at."""
    return min(max(motion.counts.steps or 0, 1), _MOST_STEPS)


def rows_between(motion: Motion, grid: Vector) -> Vector:
    """Return times within a grid, s, if the rows of a motion show too little of it; else none."""
    steps = step_count(motion)
    return np.empty(0) if motion.is_as_dense_as(2 * steps) else finer_grid(grid, steps)


def finer_grid(grid: Vector, steps: int) -> Vector:
    """Return a grid with times between its own, so that every average step has several."""
    steps = min(steps, _MOST_STEPS)
    count = np.ceil(_ROWS * steps * np.diff(grid) / (grid[-1] - grid[0])).astype(int)
    gaps = [np.linspace(a, b, n + 1) for a, b, n in zip(grid, grid[1:], count, strict=False)]
    return np.concatenate(gaps)


def finer_than_steps(motion: Motion, inputs: InputSeries | None) -> str:
    """Return which table, or rows of inputs, has more values than a motion has equal steps."""
    begin, end = motion.time[[0, -1]]
    if inputs is not None:
        rows = (begin < inputs.time) & (inputs.time < end)
        if rows.sum() > step_count(motion):
            return f"steps pass over rows of {', '.join(inputs.names)}"
    path = Path.of(motion)
    for terms in terms_of(motion.dae):
        x = _moved(terms, path)
        knots = _knots(motion.dae, terms, motion.p, np.unique(x))
        if ((x.min() < knots) & (knots < x.max())).sum() > step_count(motion):
            return f"steps pass over knots of a table of {_moving(motion.dae)[terms.moving]}"
    return ""
