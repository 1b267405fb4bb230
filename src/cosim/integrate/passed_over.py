"""`attentive`: a motion whose steps pass over no term that time or one state determines.

A solver meets the equations at the stages of its steps only: a bump of the ground between two of
them has no effect, and no error estimate shows it. Where such a term bends within a part of a step
is known from its bounds. There the motion must obey the equations: the change of the states is the
integral of their rates. Where it does not, it is computed again with steps that end there.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import casadi as ca
import numpy as np

from casadi_models.dae import Dae
from casadi_models.dae.expressions import RELATIONS, operations
from casadi_models.dae.single_terms import single_terms
from cosim.arrays import Vector
from cosim.codegen.changes import apart, bent_parts, parted, with_surroundings
from cosim.codegen.landmarks import knots_of, way_of
from cosim.codegen.terms import Terms, terms_of
from cosim.integrate.call import INTERRUPTED
from cosim.integrate.excursions import excursions, several_terms_of
from cosim.integrate.modes import hybrid
from cosim.integrate.motion import Motion, Path, rates_at
from cosim.memo import cached_per_thread
from cosim.model.inputs import InputSeries
from cosim.model.values import own_sizes

Attempt = Callable[[Vector, Vector], Motion]  # output times, further ends of steps

_EFFECT = 100.0  # least defect of a state that matters, in tolerances
_PARTS = 4  # of the way in an average step, within which a term that every step sees is a line
_BEYOND = 0.05  # of a way, by which rows may miss its ends
_MOST_CELLS = 4_000  # parts of a way
_ROWS, _MOST_STEPS = 8, 10_000  # per average step, of a motion whose places are sought; steps
_INNER = 4  # intervals of a part of a place over which rates are integrated
_CERTAIN = 4  # times the error of that integral
_MOST_ROUNDS, _MOST_PLACES = 20, 10_000
_LOOKS = 2  # for places: the second has rows in those of the first, and finds them exactly
_MOST_ENDS = 1_000  # of steps in a place


@dataclass(frozen=True, eq=False)
class Place:
    """Where a term bends: its edges, s, what moves it, and its values on a path."""

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


def attentive(attempt: Attempt, grid: Vector, tolerance: float, dae: Dae) -> Motion:
    """Return the motion over output times whose steps pass over no term of time or one state.

    With validity conditions, it has rows where terms bend, too.

    Args:
        attempt: Integrates over output times, with steps that end at further times.
        grid: Output times, s.
        tolerance: The larger one of the solver's tolerances (1).
        dae: The equations with the conditions of events; see `with_conditions`.
    """
    plain = attempt(grid, np.empty(0))
    steps = _counted(plain)
    if plain.reason or len(plain.time) < 2 or not _has_terms(dae):
        return plain
    rows, ends, places = rows_between(plain, grid), np.empty(0), list[Place]()
    motion = attempt(np.union1d(grid, rows), ends) if len(rows) else plain
    passed = list[Place]()
    settled, narrow = list[Place](), list[Place]()
    for _ in range(_MOST_ROUNDS):
        found = _apart(_found(dae, motion, steps), places)
        new = [place for place in found if not place.is_narrow]
        narrow = [place for place in found if place.is_narrow] or narrow
        if motion.reason or not (passed or new):
            break
        places += new
        if len(places) > _MOST_PLACES:
            passed = passed or new
            break
        rows = _inside(grid, [rows, *(place.times for place in new)])
        divided = [_divided(motion, place, ends) for place in passed]
        fewer, ends = ends, _inside(grid, [ends, *divided])
        if passed and not new and len(ends) == len(fewer):
            break
        before, motion = motion, attempt(np.union1d(grid, rows), ends)
        least = _EFFECT * tolerance * _sizes(motion)
        settled += [place for place in passed if _is_settled(before, motion, place, least)]
        passed = [
            place for place in places if place not in settled and _is_passed(motion, place, least)
        ]
    searched = motion
    if searched.reason == INTERRUPTED:
        return searched
    if plain.dae.limits and places:
        motion = attempt(np.union1d(grid, _inside(grid, [place.times for place in places])), ends)
    else:
        motion = attempt(grid, ends) if len(ends) else plain
    least = _EFFECT * tolerance * _sizes(searched)
    complete = not searched.reason and motion.reason != INTERRUPTED
    if places and complete and not _agree(searched, motion, grid, least):
        motion = searched  # whose rows let the solver see what it otherwise passes over
    if narrow and not passed:
        return replace(motion, note=f"{_passing(narrow[0])}, which is shorter than rounding")
    if not passed:
        return _with_note_on_unbounded(dae, motion)
    return replace(motion, note=f"{_passing(passed[0])}; set max_step")


def unquestioned(motion: Motion, dae: Dae) -> Motion | None:
    """Return a complete motion as `attentive` does, if its rows show that all is seen; else None.

    Args:
        motion: The first motion that `attentive` looks at.
        dae: See `attentive`.
    """
    if not _has_terms(dae):
        return motion
    steps = _counted(motion)
    if not motion.is_as_dense_as(2 * steps) or _found(dae, motion, steps):
        return None
    return _with_note_on_unbounded(dae, motion)


@cached_per_thread(16)
def with_conditions(dae: Dae) -> Dae:
    """Return the frozen equations of a model, with the conditions of its events as limits."""
    system = hybrid(dae)
    return dae if system is None else system.with_conditions()


@cached_per_thread(16)
def with_switching(dae: Dae, names: tuple[str, ...]) -> Dae:
    """Return a model in which the relations of some outputs are events, if they can be."""
    outputs = zip(dae.output_variables, ca.vertsplit(dae.outputs), strict=True)
    own = {v.name for v, y in outputs if v.name in names and operations(y) & RELATIONS}
    if own <= {*dae.driving}:
        return dae
    switching = replace(dae, driving=tuple(sorted({*dae.driving, *own})))
    systems = hybrid(dae), hybrid(switching)
    known, more = (0 if system is None else len(system.relations) for system in systems)
    return switching if more > known else dae


@cached_per_thread(16)
def _with_outputs(dae: Dae, names: tuple[str, ...]) -> tuple[Dae, list[int]]:
    """Return `with_conditions` with some outputs as limits, and the modes of outputs alone."""
    system = hybrid(dae)
    dae = with_conditions(dae)
    outputs = zip(dae.output_variables, ca.vertsplit(dae.outputs), strict=True)
    own = ((value, v.name) for v, value in outputs if v.name in names)
    alone = list[int]()
    if system is not None:
        laws = ca.vertcat(dae.ode, dae.alg, *system.rules)
        modes = enumerate(ca.vertsplit(system.modes))
        alone = [i for i, mode in modes if not ca.depends_on(laws, mode)]
    return replace(dae, limits=(*dae.limits, *own)), alone


def may_change(dae: Dae, names: tuple[str, ...]) -> bool:
    """Return whether outputs, or the equations, have terms or relations of `changes_of`."""
    watched, alone = _with_outputs(dae, names)
    return bool(alone) or _has_terms(watched)


def changes_of(
    dae: Dae, names: tuple[str, ...], motion: Motion, again: Callable[[Vector], Motion]
) -> Vector:
    """Return between which times quantities may change within a part of an average step, s.

    Terms that bend more often than `_MOST_PLACES` are left out.

    Args:
        dae: The model; see `with_switching`.
        names: Of the quantities; those that are no outputs change where the equations do.
        motion: The motion.
        again: Returns it with further rows.
    """
    grid = motion.time
    if len(grid) < 2:
        return np.empty(0)
    watched, alone = _with_outputs(dae, names)
    steps = _counted(motion)
    switched = [a.t for a, b in motion.instants if (a.modes != b.modes)[alone].any()]
    switches = [np.array(switched)]
    rows = rows_between(motion, grid)
    places = list[Place]()
    for _ in range(_LOOKS):
        motion = again(rows) if len(rows) else motion
        places = _found(watched, motion, steps)
        if len(places) > _MOST_PLACES:  # to look at each would take minutes and gigabytes
            return _inside(grid, switches)
        if not places:
            break
        rows = _inside(grid, [rows, *(place.times for place in places)])
    return _inside(grid, [*switches, *(place.edges for place in places)])


def watched_terms(dae: Dae) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return what moves the terms that no step passes over, and those that a step may pass over.

    The names of several quantities of one term are joined by commas.
    """
    names = _moving(dae)
    single, several = [names[moving] for moving in single_terms(dae)], several_terms_of(dae)
    if several is None:
        return tuple(single), ()
    return tuple(dict.fromkeys([*single, *several.names])), several.unbounded


def _counted(motion: Motion) -> int:
    return min(max(motion.counts.steps or 0, 1), _MOST_STEPS)


def _has_terms(dae: Dae) -> bool:
    return bool(terms_of(dae)) or several_terms_of(dae) is not None


def _moving(dae: Dae) -> list[str]:
    """Return the names of what may move terms."""
    return [*(state.name for state in dae.states), "time"]


def _moved(terms: Terms, path: Path) -> Vector:
    """Return what moves some terms on a path, (n,)."""
    return np.asarray(np.vstack((path.states, path.time))[terms.moving])


def _along(terms: Terms, term: int, p: Vector, path: Path) -> Vector:
    return terms.value(term, p)(_moved(terms, path))


def _found(dae: Dae, motion: Motion, steps: int) -> list[Place]:
    """Return where terms bend within a part of an average step."""
    names = _moving(dae)
    path, p, found = Path.of(motion), motion.p, list[Place]()
    for terms in terms_of(dae):
        turned = path.with_turns(terms.moving)
        for term, edges in _bends(terms, turned, dae, p, steps):
            values = partial(_along, terms, term, p)
            times = _times(turned.time, _moved(terms, turned), edges)
            found += [Place(own, names[terms.moving], values) for own in times]
    several = several_terms_of(dae)
    if several is None:
        return found
    for term, edges in excursions(several, path, p, steps):
        values = partial(several.along, term, p)
        found.append(Place(edges, several.names[term], values))
    return found


def _agree(one: Motion, other: Motion, grid: Vector, least: Vector) -> bool:
    """Return whether two motions have as many events, and equal states on a grid.

    Args:
        one, other: The motions.
        grid: Times, s.
        least: Differences of the states that matter, (nx,).
    """
    times = grid[np.isin(grid, one.time) & np.isin(grid, other.time)]
    columns = (m.states[:, m.time.searchsorted(times)] for m in (one, other))
    same = (np.abs(np.subtract(*columns)) <= least[:, None]).all()
    return bool(same) and len(one.events) == len(other.events)


def _with_note_on_unbounded(dae: Dae, motion: Motion, remedy: str = "max_step") -> Motion:
    terms = several_terms_of(dae)
    if terms is None or not terms.unbounded:
        return motion
    text = f"steps may pass over changes of a term of {terms.unbounded[0]}; set {remedy}"
    return replace(motion, note=text)


def with_note_on_steps(motion: Motion) -> Motion:
    """Return the motion of equal steps, with a note if a term changes within a part of one."""
    if len(motion.time) < 2 or motion.reason:
        return motion
    steps = _counted(motion)
    found = _found(motion.dae, motion, steps) if _has_terms(motion.dae) else []
    if not found:
        return _with_note_on_unbounded(motion.dae, motion, "a smaller step_size")
    return replace(motion, note=f"{_passing(found[0])}; set a smaller step_size")


def finer_than_steps(motion: Motion, inputs: InputSeries | None) -> str:
    """Return which table, or rows of inputs, has more values than a motion has equal steps."""
    begin, end = motion.time[[0, -1]]
    if inputs is not None:
        rows = (begin < inputs.time) & (inputs.time < end)
        if rows.sum() > _counted(motion):
            return f"steps pass over rows of {', '.join(inputs.names)}"
    path = Path.of(motion)
    for terms in terms_of(motion.dae):
        x, knots = _moved(terms, path), _knots(motion.dae, terms, motion.p)
        if ((x.min() < knots) & (knots < x.max())).sum() > _counted(motion):
            return f"steps pass over knots of a table of {_moving(motion.dae)[terms.moving]}"
    return ""


def _sizes(motion: Motion) -> Vector:
    own = own_sizes(motion.dae, motion.states[:, 0])
    return np.asarray(np.maximum(own, np.abs(motion.states).max(axis=1)))


def _apart(found: list[Place], known: list[Place]) -> list[Place]:
    """Return the places whose middles lie in none of those that are known."""
    begins, ends = (np.array([place.edges[i] for place in known]) for i in (0, -1))
    middles = ((place.begin + place.end) / 2 for place in found)
    pairs = zip(found, middles, strict=True)
    return [place for place, t in pairs if not ((begins <= t) & (t <= ends)).any()]


def _passing(place: Place) -> str:
    return f"steps may pass over a change of a term of {place.name} near {place.begin:.9g} s"


def _inside(grid: Vector, times: list[Vector]) -> Vector:
    """Return the times within a grid, each once."""
    every = np.unique(np.concatenate(times))
    return np.asarray(every[(grid[0] < every) & (every < grid[-1])])


def rows_between(motion: Motion, grid: Vector) -> Vector:
    """Return times within a grid, s, if the rows of a motion show too little of it; else none."""
    steps = _counted(motion)
    return np.empty(0) if motion.is_as_dense_as(2 * steps) else between(grid, steps)


def between(grid: Vector, steps: int) -> Vector:
    """Return a grid with times between its own, so that every average step has several."""
    steps = min(steps, _MOST_STEPS)
    count = np.ceil(_ROWS * steps * np.diff(grid) / (grid[-1] - grid[0])).astype(int)
    gaps = [np.linspace(a, b, n + 1) for a, b, n in zip(grid, grid[1:], count, strict=False)]
    return np.concatenate(gaps)


def _bends(terms: Terms, path: Path, dae: Dae, p: Vector, steps: int) -> list[tuple[int, Vector]]:
    """Return where on the way of what moves its terms bend within a part of an average step.

    Returns:
        The position of a term, and values of what moves between which it changes, ascending.
    """
    x = _moved(terms, path)
    way = float(np.abs(np.diff(x)).sum())
    if not (np.isfinite(way) and way > 0):
        return []
    low, high = float(x.min()) - _BEYOND * way, float(x.max()) + _BEYOND * way
    count = int(np.clip(np.ceil(_PARTS * steps * (high - low) / way), 1, _MOST_CELLS))
    edges, knots = np.linspace(low, high, count + 1), _knots(dae, terms, p)
    return [
        (term, own)
        for term in range(len(terms.bounded))
        for own in bent_parts(
            terms.value(term, p), terms.off(term, p), edges, knots, is_table=terms.alone[term]
        )
    ]


def _knots(dae: Dae, terms: Terms, p: Vector) -> Vector:
    """Return where tables of what moves have their knots."""
    own = (way_of(dae, term, knots_of(term), p) for term in terms.tables)
    return np.unique(np.concatenate([np.empty(0), *own]))


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
    at = np.unique([t[0], *(t[rows] + shares[within] * np.diff(t)[rows]), t[-1]])
    if len(edges) == 1:
        return list(np.unique(t[rows] + shares[within] * np.diff(t)[rows])[:, None])
    middles = np.interp((at[:-1] + at[1:]) / 2, t, x)
    inside = (edges[0] < middles) & (middles < edges[-1])
    return apart(list(zip(at[:-1][inside].tolist(), at[1:][inside].tolist(), strict=True)))


def _is_passed(motion: Motion, place: Place, least: Vector) -> bool:
    """Return whether the states in a place do not change as the integrals of their rates tell.

    Args:
        motion: With rows at the times of the place.
        place: The place.
        least: Differences of the states that matter, (nx,).
    """
    times = place.times
    first, last = np.searchsorted(motion.time, times[[0, -1]])
    rows = first + np.flatnonzero(np.isin(motion.time[first : last + 1], times))
    bounds = [-np.inf, *(before.t for before, _ in motion.instants), np.inf]
    for after, until in pairwise(bounds):
        at = rows[(after < motion.time[rows]) & (motion.time[rows] < until)]
        at = at[: (len(at) - 1) // 4 * 4 + 1]
        if len(at) < 5:
            continue
        t, x = motion.time[at], motion.states[:, at]
        rates = rates_at(motion, at)
        fine, coarse = _simpson(t, rates)[:, 1::2], _simpson(t[::2], rates[:, ::2])
        off = np.abs(x[:, 4::4] - x[:, :1] - fine)
        if (off > np.maximum(least[:, None], _CERTAIN * np.abs(fine - coarse))).any():
            return True
    return False


def _is_settled(before: Motion, after: Motion, place: Place, least: Vector) -> bool:
    """Return whether more steps in a place have changed no state after it: all is seen."""
    last = [motion.time.searchsorted(place.times[-1]) for motion in (before, after)]
    if last[0] >= len(before.time) or last[1] >= len(after.time):
        return False
    changes = np.abs(before.states[:, last[0]] - after.states[:, last[1]])
    return before.time[last[0]] == after.time[last[1]] and bool((changes <= least).all())


def _simpson(t: Vector, rows: Vector) -> Vector:
    """Return the integrals of rows up to every second time; intervals need not be equal."""
    a, b = np.diff(t)[::2], np.diff(t)[1::2]
    weights = 2 - b / a, (a + b) ** 2 / (a * b), 2 - a / b
    parts = (w * rows[:, i : i + 2 * len(a) : 2] for i, w in enumerate(weights))
    return np.asarray((sum(parts) * (a + b) / 6).cumsum(axis=1))


def _divided(motion: Motion, place: Place, ends: Vector) -> Vector:
    """Return times at which steps must end for a solver to see a term in a place, s."""
    t = place.times
    known: Vector = ends[(t[0] <= ends) & (ends <= t[-1])]
    if len(known) > _MOST_ENDS:
        return known
    values = place.values(Path.of(motion).at(t))
    middles = (known[:-1] + known[1:]) / 2  # those at the ends were too few
    return np.union1d(parted(t, values, float(np.ptp(values))), middles)
