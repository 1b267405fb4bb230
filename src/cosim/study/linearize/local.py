"""The equations that a run follows at a state, and their derivatives."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import chain, combinations
from typing import NamedTuple

import casadi as ca
import numpy as np

from casadi_models.dae import Dae
from casadi_models.dae.hybrid import Hybrid
from cosim.arrays import Truths, Vector
from cosim.errors import InitialConditionError
from cosim.integrate.initial_values import algebraic_values
from cosim.integrate.kernel import settled
from cosim.integrate.modes import Instant, blended, hybrid, sliding
from cosim.integrate.outputs import derivatives_at
from cosim.memo import cached_per_thread
from cosim.model.reduction import pattern
from cosim.model.values import Values
from cosim.study.linearize.spectrum import EPS

SAME = 1e-9  # relative difference of equal linear systems
TRIALS = 2  # pairs of states beside a state that show what rounding changes
JUMP = 1e-3  # of the largest entry of A, beside which an entry has no value within rounding
LEAST_JUMP = 1e-6  # the same for an A without entries, 1/s
OPEN = 8.0  # an entry is open to rounding if it is below this many changes


class LocalSystem(NamedTuple):
    """Rates and outputs at a state, their derivatives, and what rounding leaves open in A.

    Rows of the Jacobian are rates and outputs, columns states and inputs.
    """

    rates: Vector
    outputs: Vector
    jacobian: Vector
    noise: Vector
    influence: Truths


class Edge(NamedTuple):
    """A relation that switches at a state: where it does, and its mode on the other side."""

    where: str
    other: float


def local_system(
    dae: Dae, names: tuple[str, ...], time: float, x: Vector, values: Values, point: str
) -> LocalSystem:
    """Return the linear system at a state.

    Args:
        dae: The model.
        names: Its outputs.
        time: Time of the state, s.
        x: The state.
        values: Values of inputs and parameters.
        point: Description of the state, for errors.

    Raises:
        InitialConditionError: There is no derivative, or another one on each side.
    """
    own, u, edges = followed(with_kinks_of(dae, names), time, x, values)
    here = replace(values, u=u)
    rates, outputs, jacobian = at_point(own, names, time, x, here)
    n = len(x) + len(values.u)
    knowns = [v.name for v in (*dae.states, *dae.inputs)]
    unknowns = [*(f"{v.name}_dot" for v in dae.states), *names]
    reject_no_number(dae.full_name, jacobian[:, :n], unknowns, knowns, point)
    sizes = sorted({1, 2, len(edges)})  # how many relations at 0 are on their other side
    for places in chain.from_iterable(combinations(edges, size) for size in sizes):
        other = u.copy()
        other[[*places]] = [edges[place].other for place in places]
        beyond = at_point(own, names, time, x, replace(values, u=other))
        change = (beyond[2] - jacobian)[:, :n]
        values_jump = any(map(_differ, beyond[:2], (rates, outputs)))
        size = np.abs(jacobian[:, :n]).max(initial=0.0)
        if values_jump or not np.abs(change).max(initial=0.0) <= SAME * size:
            what = " and ".join(edges[place].where for place in places)
            raise InitialConditionError(
                f"{dae.full_name}: {what} at {point}, and the linear system is another one on each "
                "side; choose a state on one of them"
            )
    rows = slice(0, len(x))

    def at(place: Vector) -> Vector:
        return at_point(own, (), time, place, here)[2][rows, rows]

    nominal = np.array([v.nominal for v in dae.states])
    A = jacobian[rows, rows]
    noise = rounding(at, x, nominal, A)
    scaled, size = (np.abs(m) * nominal / nominal[:, None] for m in (noise, A))
    jumping = np.argwhere(~(scaled <= max(JUMP * size.max(initial=0.0), LEAST_JUMP)))
    for i, j in jumping[:1]:
        raise _without_derivative(dae.full_name, unknowns[i], knowns[j], A[i, j], point)
    return LocalSystem(rates, outputs, jacobian[:, :n], noise, influence(own))


@cached_per_thread(8)
def with_kinks_of(dae: Dae, names: tuple[str, ...]) -> Dae:
    """Return the model in which relations of some outputs have modes, too."""
    return replace(dae, driving=(*dae.driving, *names))


def _differ(one: Vector, other: Vector) -> bool:
    """Tell whether values jump."""
    change, size = np.abs(one - other), np.fmax(np.abs(one), np.abs(other))
    return bool((change > SAME * size + EPS * size.max(initial=0.0)).any())


def rounding(
    jacobian: Callable[[Vector], Vector], x: Vector, nominal: Vector, here: Vector
) -> Vector:
    """Return what rounding leaves open in a Jacobian: how it changes within rounding of the state.

    Args:
        jacobian: The Jacobian at a state, (n, n).
        x: The state, (n,).
        nominal: Nominal values of the states.
        here: The Jacobian at x.
    """
    generator = np.random.default_rng(0)
    size, changes = EPS * np.fmax(np.abs(x), nominal), np.zeros_like(here)
    for _ in range(TRIALS if len(x) else 0):
        shift = size * generator.uniform(-1, 1, len(x))
        for place in (x + shift, x - shift):
            changes = np.fmax(changes, np.abs(jacobian(place) - here))
    return OPEN * changes


def reject_no_number(
    model: str, jacobian: Vector, rows: Sequence[str], columns: Sequence[str], point: str
) -> None:
    """Reject derivatives that are no numbers.

    Raises:
        InitialConditionError: A derivative is not finite, as of sin(x) / x or a cube root at 0.
    """
    wrong = np.argwhere(~np.isfinite(jacobian))
    if len(wrong):
        i, j = (int(k) for k in wrong[0])
        raise _without_derivative(model, rows[i], columns[j], jacobian[i, j], point)


def _without_derivative(
    model: str, row: str, column: str, value: float, point: str
) -> InitialConditionError:
    return InitialConditionError(
        f"{model}: {row} has no finite derivative with respect to {column} at {point} "
        f"(evaluated: {value:.3g}), so that there is no linear system; choose another state, or "
        "write the expression so that it has a derivative there"
    )


def influence(dae: Dae) -> Truths:
    """Return the sparsity of d(rate)/d(state), algebraic unknowns eliminated."""
    through = np.outer(pattern(dae.ode, dae.z).any(axis=1), pattern(dae.alg, dae.x).any(axis=0))
    return pattern(dae.ode, dae.x) | through


def followed(
    dae: Dae, time: float, x: Vector, values: Values
) -> tuple[Dae, Vector, dict[int, Edge]]:
    """Return the equations that a run follows from a state, and their inputs.

    These are the inputs of the model and the modes of its relations. The last result are those of
    them, by position, that may have two values here.
    """
    system = hybrid(dae)
    if system is None or not system.relations:
        return dae, values.u, {}
    z, still = algebraic_values(dae, time, x, values), np.zeros(len(values.u))
    at = Instant(time, x, z, values.u, still, np.ones(len(system.relations)))
    at, zero = settled(system, at, values.p)
    rests = [i for i in zero.keys() - at.sliding if at.modes[i] == 0 and not system.floors[i]]
    at.modes[rests] = 1.0  # one of its sides, which the other one is compared with
    u, n = np.concatenate((values.u, at.modes)), len(values.u)
    edges = dict[int, Edge]()
    for i, edge in zero.items():
        relation = system.relations[i]
        inner = relation.floor and relation.operation == "fmod" and edge == 0  # of a size
        if i not in at.sliding and not inner:
            other = 2 * edge - relation.floor - at.modes[i]
            edges[n + i] = Edge(f"{system.described(i)} is exactly at {edge:g}", other)
    return _without_events(system, at.sliding), u, edges


@cached_per_thread(8)
def _without_events(system: Hybrid, slides: frozenset[int]) -> Dae:
    """Return frozen equations in which outputs follow what slides."""
    own = sliding(blended(system), slides)
    if not slides:
        return own.dae
    held, solved = own.modes[list(own.sliding)], own.solved
    return replace(own.dae, outputs=ca.substitute(own.dae.outputs, held, solved))


def at_point(
    dae: Dae, names: tuple[str, ...], time: float, x: Vector, values: Values
) -> tuple[Vector, Vector, Vector]:
    """Return rates and outputs at a state, and their derivatives by states and inputs."""
    z = algebraic_values(dae, time, x, values)
    return derivatives_at(dae, names, time, x, z, values.u, values.p)
