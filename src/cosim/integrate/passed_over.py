"""`attentive`: a motion whose steps pass over no term that time or a few quantities determine.

Where such a term bends within a part of a step (`integrate.places`), the motion must obey the
equations: the change of the states is the integral of their rates. Where it does not, it is
computed again with steps that end there.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import casadi as ca
import numpy as np

from casadi_models.dae import Dae
from casadi_models.dae.expressions import RELATIONS, operations
from cosim.arrays import Vector
from cosim.codegen.changes import parted
from cosim.integrate.call import INTERRUPTED
from cosim.integrate.excursions import several_terms_of
from cosim.integrate.modes import hybrid
from cosim.integrate.motion import CERTAIN, Motion, Path, rates_at, simpson
from cosim.integrate.places import Place, has_terms, places_on, rows_between, step_count
from cosim.memo import cached_per_thread
from cosim.model.values import own_sizes

Attempt = Callable[[Vector, Vector], Motion]  # output times, further ends of steps

_EFFECT = 100.0  # least defect of a state that matters, in tolerances
_MOST_ROUNDS, _MOST_PLACES = 20, 10_000
_LOOKS = 2  # for places: the second has rows in those of the first, and finds them exactly
_MOST_ENDS = 1_000  # of steps in a place


def attentive(attempt: Attempt, grid: Vector, tolerance: float, dae: Dae) -> Motion:
    """Return the motion over output times whose steps pass over no term that bends.

    With validity conditions, it has rows where terms bend, too.

    Args:
        attempt: Integrates over output times, with steps that end at further times.
        grid: Output times, s.
        tolerance: The larger one of the solver's tolerances (1).
        dae: The equations with the conditions of events; see `with_conditions`.
    """
    plain = attempt(grid, np.empty(0))
    if plain.reason or len(plain.time) < 2 or not has_terms(dae):
        return plain
    search = _Search(attempt, grid, tolerance, dae, plain)
    search.run()
    if search.motion.reason == INTERRUPTED:
        return search.motion
    return replace(search.result(), note=search.note())


class _Search:
    """A search for what steps pass over, by motions with ever more rows and ends of steps.

    Args:
        attempt, grid, tolerance, dae: See `attentive`.
        plain: The motion over output times alone.

    Attributes:
        motion: The last one, with all rows and ends of steps.
        rows, ends: Further times of rows, and of ends of steps, within the grid, s.
        places: Where terms bend.
        passed: Those of them that the steps of the last motion pass over.
        settled: Those in which more steps have changed nothing.
        narrow: Those narrower than rounding, of the last motion that has any.
    """

    def __init__(
        self, attempt: Attempt, grid: Vector, tolerance: float, dae: Dae, plain: Motion
    ) -> None:
        self.attempt, self.grid, self.tolerance, self.dae = attempt, grid, tolerance, dae
        self.plain = self.motion = plain
        self.rows, self.ends = rows_between(plain, grid), np.empty(0)
        self.places, self.passed = list[Place](), list[Place]()
        self.settled, self.narrow = list[Place](), list[Place]()

    def run(self) -> None:
        """Refine the motion until it passes over no place, or a finer one is of no use."""
        if len(self.rows):
            self.motion = self._refined()
        for _ in range(_MOST_ROUNDS):
            new = self._new_places()
            if self.motion.reason or not (self.passed or new):
                return
            self.places += new
            if len(self.places) > _MOST_PLACES:
                self.passed = self.passed or new
                return
            is_finer = self._divide_steps()
            if self.passed and not new and not is_finer:
                return
            self.rows = _inside(self.grid, [self.rows, *(place.times for place in new)])
            before, self.motion = self.motion, self._refined()
            self._judge(before)

    def _refined(self) -> Motion:
        return self.attempt(np.union1d(self.grid, self.rows), self.ends)

    def _new_places(self) -> list[Place]:
        """Return where terms bend outside the known places; those of no width are noted."""
        path = Path.of(self.motion)
        found = self._bends_within(path, step_count(self.plain))
        known = found or self.passed
        if not known and path.strays(self._least_effects()):
            found = self._bends_within(path, 1)  # some step is far longer than the average one
        self.narrow = [place for place in found if place.is_narrow] or self.narrow
        return [place for place in found if not place.is_narrow]

    def _bends_within(self, path: Path, steps: int) -> list[Place]:
        return _apart(places_on(self.dae, path, self.motion.p, steps), self.places)

    def _divide_steps(self) -> bool:
        """Let steps end within the places that were passed over; return whether any does anew."""
        fewer = len(self.ends)
        divided = [_divided(self.motion, place, self.ends) for place in self.passed]
        self.ends = _inside(self.grid, [self.ends, *divided])
        return len(self.ends) > fewer

    def _judge(self, before: Motion) -> None:
        """Note which places the motion passes over still, and which it does not need to see."""
        least = self._least_effects()
        self.settled += [p for p in self.passed if _is_settled(before, self.motion, p, least)]
        open_ones = (place for place in self.places if place not in self.settled)
        self.passed = [place for place in open_ones if _is_passed(self.motion, place, least)]

    def _least_effects(self) -> Vector:
        """Return the differences of the states that matter, (nx,)."""
        return _EFFECT * self.tolerance * _sizes(self.motion)

    def result(self) -> Motion:
        """Return the motion over output times, with steps that end where those of the last do."""
        motion = self.plain
        if self.plain.dae.limits and self.places:
            rows = _inside(self.grid, [place.times for place in self.places])
            motion = self.attempt(np.union1d(self.grid, rows), self.ends)
        elif len(self.ends):
            motion = self.attempt(self.grid, self.ends)
        if self.motion is self.plain or self.motion.reason or motion.reason == INTERRUPTED:
            return motion
        # its rows may let the solver see what it otherwise passes over
        agree = _agree(self.motion, motion, self.grid, self._least_effects())
        return motion if agree else self.motion

    def note(self) -> str:
        """Return what steps may have passed over nevertheless; empty if nothing."""
        if self.passed:
            return f"{_passing(self.passed[0])}; set max_step"
        if self.narrow:
            return f"{_passing(self.narrow[0])}, which is shorter than rounding"
        return _note_on_unbounded(self.dae, "max_step")


def unquestioned(motion: Motion, dae: Dae) -> Motion | None:
    """Return a complete motion as `attentive` does, if its rows show that all is seen; else None.

    Args:
        motion: The first motion that `attentive` looks at.
        dae: See `attentive`.
    """
    if not has_terms(dae):
        return motion
    steps = step_count(motion)
    if not motion.is_as_dense_as(2 * steps) or places_on(dae, Path.of(motion), motion.p, steps):
        return None
    return replace(motion, note=_note_on_unbounded(dae, "max_step"))


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
    return bool(alone) or has_terms(watched)


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
    steps = step_count(motion)
    switched = [a.t for a, b in motion.instants if (a.modes != b.modes)[alone].any()]
    switches = [np.array(switched)]
    rows = rows_between(motion, grid)
    places = list[Place]()
    for _ in range(_LOOKS):
        motion = again(rows) if len(rows) else motion
        places = places_on(watched, Path.of(motion), motion.p, steps)
        if len(places) > _MOST_PLACES:  # to look at each would take minutes and gigabytes
            return _inside(grid, switches)
        if not places:
            break
        rows = _inside(grid, [rows, *(place.times for place in places)])
    return _inside(grid, [*switches, *(place.edges for place in places)])


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


def _note_on_unbounded(dae: Dae, remedy: str) -> str:
    """Return what steps may pass over where terms have no bounds; empty if all have."""
    terms = several_terms_of(dae)
    if terms is None or not terms.unbounded:
        return ""
    return f"steps may pass over changes of a term of {terms.unbounded[0]}; set {remedy}"


def with_note_on_steps(motion: Motion) -> Motion:
    """Return the motion of equal steps, with a note if a term changes within a part of one."""
    if len(motion.time) < 2 or motion.reason:
        return motion
    dae, remedy = motion.dae, "a smaller step_size"
    steps = step_count(motion)
    found = places_on(dae, Path.of(motion), motion.p, steps) if has_terms(dae) else []
    note = f"{_passing(found[0])}; set {remedy}" if found else _note_on_unbounded(dae, remedy)
    return replace(motion, note=note)


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
        fine, coarse = (simpson(t[::k], rates[:, ::k]).cumsum(axis=1) for k in (1, 2))
        fine = fine[:, 1::2]
        off = np.abs(x[:, 4::4] - x[:, :1] - fine)
        if (off > np.maximum(least[:, None], CERTAIN * np.abs(fine - coarse))).any():
            return True
    return False


def _is_settled(before: Motion, after: Motion, place: Place, least: Vector) -> bool:
    """Return whether more steps in a place have changed no state after it: all is seen."""
    last = [motion.time.searchsorted(place.times[-1]) for motion in (before, after)]
    if last[0] >= len(before.time) or last[1] >= len(after.time):
        return False
    changes = np.abs(before.states[:, last[0]] - after.states[:, last[1]])
    return before.time[last[0]] == after.time[last[1]] and bool((changes <= least).all())


def _divided(motion: Motion, place: Place, ends: Vector) -> Vector:
    """Return times at which steps must end for a solver to see a term in a place, s."""
    t = place.times
    known: Vector = ends[(t[0] <= ends) & (ends <= t[-1])]
    if len(known) > _MOST_ENDS:
        return known
    values = place.values(Path.of(motion).at(t))
    middles = (known[:-1] + known[1:]) / 2  # those at the ends were too few
    return np.union1d(parted(t, values, float(np.ptp(values))), middles)
