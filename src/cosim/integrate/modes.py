"""Relations of a hybrid model along a motion, and the instants of a run."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress, count
from typing import NamedTuple

import casadi as ca
import numpy as np
from casadi import MX
from numpy.typing import NDArray

from casadi_models.dae import Dae
from casadi_models.dae.hybrid import Hybrid
from casadi_models.dae.hybrid import hybrid as frozen
from cosim.arrays import Vector
from cosim.codegen.functions import symbols_like
from cosim.codegen.initialization import algebraic_function
from cosim.errors import SolverError
from cosim.integrate.call import Evaluator, call_on_arrays
from cosim.memo import cached_per_thread

_BLOCK = 32  # columns of one evaluation
_FEW = 2  # columns that are evaluated one by one


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
        raise SolverError.of(system.dae.full_name, f"{names}: {error}") from None


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


@dataclass(frozen=True)
class Instant:
    """A hybrid run at an instant, after all that happens there.

    Attributes:
        t: Time, s.
        x, z: States and algebraic unknowns, SI.
        u: Inputs of the model.
        du: Their slopes.
        modes: Modes of the relations; of one that slides, its value there.
        sliding: Relations whose arguments stay 0 because their modes make them so.
    """

    t: float
    x: Vector
    z: Vector
    u: Vector
    du: Vector
    modes: Vector
    sliding: frozenset[int] = frozenset()

    @property
    def inputs(self) -> Vector:
        """Inputs with modes."""
        return np.concatenate((self.u, self.modes))

    @property
    def slopes(self) -> Vector:
        """Their time derivatives; 0 of modes."""
        return np.concatenate((self.du, np.zeros(len(self.modes))))

    def switched(self, later: "Instant") -> frozenset[int]:
        """Return the relations that have another mode later, without those that slide."""
        changed = (self.modes != later.modes).nonzero()[0].tolist()
        return frozenset(changed) - self.sliding - later.sliding

    def watched(self, system: Hybrid, p: Vector) -> Watched:
        """Evaluate the relations here, in the present modes."""
        own = sliding(system, self.sliding)
        z = np.concatenate((self.z, np.zeros(own.dae.z.numel() - len(self.z))))
        rows = self.x[None], z[None], self.inputs[None], self.slopes[None]
        return watch(own, np.array([self.t]), rows, p)


class Passed(NamedTuple):
    """An event that the solver itself went through.

    Attributes:
        before, after: Its instant.
        events: Positions of the model's events that happened there, in their order.
        zero: Relations whose arguments became 0.
    """

    before: Instant
    after: Instant
    events: list[int]
    zero: frozenset[int]


def passed_events(events: NDArray[np.void], inputs: Sequence[Vector]) -> list[Passed]:
    """Return events from their records.

    Args:
        events: The records; see `event_type`.
        inputs: Inputs of the model, and their slopes, one row per event.
    """
    times = events["time"].tolist()

    def instants(side: NDArray[np.void]) -> list[Instant]:
        rows = zip(times, side["x"], side["z"], *inputs, side["modes"], strict=True)
        return [Instant(t, x, z, u, du, modes) for t, x, z, u, du, modes in rows]

    zeros = [frozenset(compress(count(), row)) for row in events["zero"].tolist()]
    orders = [
        [i for _, i in sorted((n, i) for i, n in enumerate(order) if n)]
        for order in events["order"].tolist()
    ]
    sides = instants(events["before"]), instants(events["after"])
    return [Passed(*row) for row in zip(*sides, orders, zeros, strict=True)]
