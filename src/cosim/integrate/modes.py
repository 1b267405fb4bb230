"""Modes of a hybrid model at an instant, and the jumps of derivatives of a run across an event.

Where an argument g(t, x, p) reaches 0, the time of the event moves by

    dt = -(g_x s + g_p q) / (dg/dt),    s = dx along the direction q of the parameters

and the derivative after the event is  R_x (s + f dt) + R_p q + R_t dt - f+ dt, where R are the new
values of the states, and f and f+ their time derivatives before and after it.

Source  Hiskens & Pai, Trajectory sensitivity analysis of hybrid systems, IEEE Trans. CAS I 47
        (2000) 204-220.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import casadi as ca
import numpy as np
from casadi import MX, SX

from casadi_models.dae import Dae
from casadi_models.dae.hybrid import Hybrid
from casadi_models.dae.hybrid import hybrid as frozen
from casadi_models.dae.relations import COMPARISONS
from cosim.arrays import Vector
from cosim.codegen.functions import symbols_like
from cosim.codegen.initialization import algebraic_function
from cosim.errors import SolverError
from cosim.integrate.call import Evaluator, call_on_arrays
from cosim.memo import cached_per_thread

MOST_ROUNDS = 100  # of event iteration at one instant
_BLOCK = 32  # columns of one evaluation
_FEW = 2  # columns that are evaluated one by one
_ROUNDING = 64 * np.finfo(float).eps  # relative size of a rate below which it is taken as 0
_TIMES = 8 * np.finfo(float).eps  # relative distance of times that rounding may make of equal ones
_EDGE = 1e-9  # by which the mode of a relation that slides may leave -1 ... 1


@cached_per_thread(16)
def hybrid(dae: Dae) -> Hybrid | None:
    """Return the frozen equations of a model; None if it has no events."""
    return frozen(dae)


@cached_per_thread(16)
def blended(system: Hybrid) -> Hybrid:
    """Return the equations for modes between -1 and 1."""
    return system.blended()


@cached_per_thread(32)
def sliding(system: Hybrid, which: frozenset[int]) -> Hybrid:
    """Return the equations in which the arguments of some relations stay 0; raises SolverError."""
    try:
        return system.slid(which)
    except ValueError as error:
        names = ", ".join(system.described(i) for i in sorted(which))
        raise SolverError(f"{system.dae.full_name}: {names}: {error}") from None


class Watched(NamedTuple):
    """Relations and rates of change at n times, one row per time.

    Attributes:
        unknowns: Algebraic unknowns.
        arguments, rates: Arguments of the relations, and their time derivatives.
        solved, solved_rates: Modes of those that slide, and their time derivatives.
        seconds: Second time derivatives of the arguments.
        rate_sizes: Sizes of `rates`, see `Hybrid.rate_sizes`.
        ode: Time derivatives of the states.
    """

    unknowns: Vector
    arguments: Vector
    rates: Vector
    solved: Vector
    solved_rates: Vector
    seconds: Vector
    rate_sizes: Vector
    ode: Vector


@cached_per_thread(32)
def _watch_function(system: Hybrid, closely: bool) -> ca.Function:
    """Return `watch(t, x, z, u, p, du/dt)` with the fields of `Watched`; z is a guess."""
    dae = system.dae
    t, x, z, u, p = symbols = symbols_like(dae)
    du = MX.sym("du", u.numel())
    if dae.algebraics:
        z = algebraic_function(dae)(t, x, z, u, p)
    found = system.watching("seen", closely=closely)(t, x, z, u, p, du)
    return ca.Function("watch", [*symbols, du], [z, *found])


@cached_per_thread(32)
def _watch_block(system: Hybrid) -> ca.Function:
    return _watch_function(system, False).map("watch_block", "serial", _BLOCK, [4], [])


@cached_per_thread(32)
def _watch_one(system: Hybrid, closely: bool) -> Evaluator:
    return Evaluator(_watch_function(system, closely))


def watch(
    system: Hybrid,
    times: Vector,
    rows: tuple[Vector, Vector, Vector, Vector],
    p: Vector,
    *,
    closely: bool = True,
) -> Watched:
    """Evaluate relations at n times.

    Args:
        system: Frozen equations.
        times: s, (n,).
        rows: States, guesses of the algebraic unknowns, inputs with modes, and slopes of these,
            one row per time.
        p: Parameters.
        closely: Whether the last three fields are evaluated; otherwise they are empty.
    """
    n, size = len(times), _BLOCK
    if n <= _FEW or closely:
        evaluate, (x, z, u, du) = _watch_one(system, closely), rows
        found = [evaluate(times[k], x[k], z[k], u[k], p, du[k]) for k in range(n)]
        columns = [np.array(column) for column in zip(*found, strict=True)]
        return Watched(*columns, *[np.empty((n, 0))] * (len(Watched._fields) - len(columns)))
    function = _watch_block(system)
    padding = -n % size
    given = [np.concatenate((a, np.repeat(a[-1:], padding, 0))) for a in (times[:, None], *rows)]
    results = [np.empty((n + padding, function.size1_out(i))) for i in range(function.n_out())]
    for k in range(0, n, size):
        *known, slopes = (np.ascontiguousarray(a[k : k + size]) for a in given)
        block = [result[k : k + size] for result in results]
        if not call_on_arrays(function.buffer(), [*known, p, slopes], block):
            for result in block:
                result.fill(np.nan)
    empty = [np.empty((n, 0))] * (len(Watched._fields) - len(results))
    return Watched(*(result[:n] for result in results), *empty)


@cached_per_thread(16)
def _spread(system: Hybrid) -> Evaluator:
    return Evaluator(system.rounding("spread"))


@dataclass(frozen=True)
class Instant:
    """A hybrid run at an instant, after all that happens there.

    Attributes:
        t: Time, s.
        x, z: States and algebraic unknowns, SI.
        u: Inputs of the model.
        du: Their slopes.
        modes: Modes of the relations; of one that slides, its value there.
        sliding: Relations whose arguments stay 0.
        zero: Relations whose arguments are exactly 0 here, whatever rounding makes of them.
    """

    t: float
    x: Vector
    z: Vector
    u: Vector
    du: Vector
    modes: Vector
    sliding: frozenset[int] = frozenset()
    zero: frozenset[int] = frozenset()

    def switched(self, later: "Instant") -> frozenset[int]:
        """Return the relations that have another mode later, without those that slide."""
        changed = (self.modes != later.modes).nonzero()[0].tolist()
        return frozenset(changed) - self.sliding - later.sliding

    def noise(self, system: Hybrid, p: Vector, sizes: Vector) -> Vector:
        """Return what rounding of states of some sizes makes of the arguments, (m,)."""
        u = np.concatenate((self.u, self.modes))
        (found,) = _spread(system)(self.t, self.x, self.z, u, p, sizes)
        noise: Vector = _ROUNDING * np.nan_to_num(found, posinf=0.0)
        return noise

    def without_moved(self, before: "Instant", system: Hybrid, p: Vector) -> "Instant":
        """Return the same where what was 0, or slid, has not stayed so since a jump began."""
        if not (self.zero or self.sliding):
            return self
        was, now = (at.watched(system, p).arguments[0] for at in (before, self))
        same = frozenset(np.flatnonzero(was == now).tolist())
        return replace(self, zero=self.zero & same, sliding=self.sliding & same)

    def watched(self, system: Hybrid, p: Vector) -> Watched:
        """Evaluate the relations here, in the present modes."""
        own = sliding(system, self.sliding)
        z = np.concatenate((self.z, np.zeros(own.dae.z.numel() - len(self.z))))
        u = np.concatenate((self.u, self.modes))
        du = np.concatenate((self.du, np.zeros(len(self.modes))))
        return watch(own, np.array([self.t]), (self.x[None], z[None], u[None], du[None]), p)


def begun(system: Hybrid, at: Instant, p: Vector) -> Instant:
    """Return an instant with the modes of its values and of what follows from them."""
    modes = np.ones(len(system.relations))
    # arguments may hold the modes of others, most of them of relations before them
    for count in [*range(1, len(modes) + 1), len(modes)]:
        row = replace(at, modes=modes.copy()).watched(system, p)
        modes[:count] = literal_modes(system, row.arguments[0])[:count]
    apart = row.arguments[0] - np.where(system.floors, np.round(row.arguments[0]), 0.0)
    near = np.abs(apart) <= _TIMES * np.abs(at.t * np.nan_to_num(row.rates[0]))
    due = {i for i, line in enumerate(system.linear) if line and near[i]}  # but for rounding
    return settled(system, replace(at, modes=modes, zero=at.zero | due), p, frozenset())


def settled(
    system: Hybrid, at: Instant, p: Vector, decided: frozenset[int], sizes: Vector | None = None
) -> Instant:
    """Return an instant with modes that are consistent with what follows.

    The mode of a relation whose argument is 0 is that of the first time derivative that is not. If
    neither mode is consistent, the relation slides (Filippov).

    Args:
        system: Frozen equations.
        at: The instant; its modes are those before it.
        p: Parameters.
        decided: Relations that keep their mode here although their arguments are 0.
        sizes: Rates of the arguments (m,) in whose rounding a rate is 0; as for all rates if None.

    Raises:
        SolverError: No modes are consistent.
    """
    for trial in range(MOST_ROUNDS):
        row = at.watched(system, p)
        at = replace(at, z=row.unknowns[0, : len(at.z)])
        if not trial:
            resting = {i for i in at.zero if _rests_beyond(system, at, row, i)}
            at = replace(at, zero=at.zero - resting)
        modes, slides = at.modes.copy(), set(at.sliding)
        for place, i in enumerate(sorted(at.sliding)):
            modes[i] = row.solved[0, place]
            if abs(modes[i]) > 1 + _EDGE:
                slides.discard(i)
                modes[i] = np.sign(modes[i])
        if slides != at.sliding:
            at = replace(at, modes=modes, sliding=frozenset(slides))
            continue
        at = replace(at, modes=modes)
        free = (i for i in range(len(modes)) if i not in at.sliding and i not in decided)
        scales = _ROUNDING * (row.rate_sizes[0] if sizes is None else sizes)
        tried = (_changed(system, at, row, i, p, scales[i]) for i in free)
        changed = next((other for other in tried if other is not at), None)
        if changed is None:
            return at
        at = changed
    raise SolverError(
        f"{system.dae.full_name}: no consistent modes at {at.t:.12g} s after {MOST_ROUNDS} trials "
        f"({', '.join(system.described(i) for i in sorted(at.zero))})"
    )


def _rests_beyond(system: Hybrid, at: Instant, row: Watched, i: int) -> bool:
    """Tell whether an argument that became 0 came to rest beyond it, where its value decides."""
    if system.relations[i].floor or i in at.sliding:
        return False
    fastest = max(abs(row.rates[0, i]), abs(row.seconds[0, i]))
    return bool(fastest <= _ROUNDING and at.modes[i] * row.arguments[0, i] < -_ROUNDING)


def _changed(system: Hybrid, at: Instant, row: Watched, i: int, p: Vector, scale: float) -> Instant:
    """Return the instant with another mode of a relation, or with that relation sliding."""
    mode, zero = _consistent(system, at, row, i, scale)
    if mode == at.modes[i]:
        return at
    modes = at.modes.copy()
    modes[i] = mode
    other = replace(at, modes=modes)
    if zero and not system.relations[i].floor:
        back, _ = _consistent(system, other, other.watched(system, p), i, scale)
        if back != mode:
            return replace(other, sliding=at.sliding | {i})
    return other


def _consistent(
    system: Hybrid, at: Instant, row: Watched, i: int, scale: float
) -> tuple[float, bool]:
    """Return the mode that values and rates require, and whether the argument is 0."""
    relation, argument = system.relations[i], float(row.arguments[0, i])
    if not np.isfinite(argument):  # of a branch that is not taken
        return float(at.modes[i]), False
    boundary = float(np.round(argument)) if relation.floor else 0.0
    if i not in at.zero and argument != boundary:
        mode = np.floor(argument) if relation.floor else np.sign(argument)
        return float(mode), False
    for rate in (row.rates[0, i], row.seconds[0, i]):
        if abs(rate) > scale:
            up = bool(rate > 0)
            return (boundary - (not up) if relation.floor else 2.0 * up - 1.0), True
    if relation.floor:
        return boundary, True
    stays = relation.at_zero if relation.operation in COMPARISONS else at.modes[i]
    return float(stays), True


def stillness(row: Watched) -> Vector:
    """Return the rates of arguments that are but rounding, (m,), of one row; 0 if they move."""
    still = _ROUNDING * row.rate_sizes[0]
    return np.where(np.maximum(np.abs(row.rates[0]), np.abs(row.seconds[0])) <= still, still, 0.0)


def literal_modes(system: Hybrid, arguments: Vector) -> Vector:
    """Return the modes by value: 1, or the integer, on a boundary; NaN makes comparisons false."""
    modes = np.where(system.floors, np.floor(arguments), np.where(arguments >= 0, 1.0, -1.0))
    compares = np.array([r.operation in COMPARISONS for r in system.relations], dtype=bool)
    return np.where(np.isfinite(arguments), modes, np.where(compares, -1.0, 1.0))


def guards(system: Hybrid, modes: Vector, values: Vector, rates: Vector) -> tuple[Vector, Vector]:
    """Return how far each argument is within the range of its mode, and the rate of that.

    Args:
        system: Frozen equations.
        modes: Present modes, (m,).
        values, rates: Arguments and their time derivatives, one row per time, (n, m).
    """
    low, high = values - modes, modes + 1 - values
    nearer = low < high
    inside = np.where(system.floors, np.where(nearer, low, high), modes * values)
    towards = np.where(system.floors, np.where(nearer, rates, -rates), modes * rates)
    return inside, towards


@cached_per_thread(16)
def along(system: Hybrid) -> Evaluator:
    """Return `along(t, x, z, u, p, dt) -> changes` of relations' arguments and events' values."""
    dt = SX.sym("dt")
    values = ca.vertcat(SX(0, 1), *(event.values for event in system.events))
    results = [system.along(rows, dt) for rows in (system.arguments, values)]
    return Evaluator(ca.Function("along", [*system.dae.arguments, dt], results))


def shift(g: float, rate: float) -> float:
    """Return by how much the time of an event moves; 0 where it only touches its boundary."""
    return -g / rate if rate and np.isfinite(g / rate) else 0.0


def moved(x: Vector, nx: int, rates: Vector, dt: float) -> Vector:
    """Return states whose derivatives, after the first nx, are taken at a time moved by dt."""
    found = x.copy()
    found[nx : 2 * nx] += rates[:nx] * dt
    return found
