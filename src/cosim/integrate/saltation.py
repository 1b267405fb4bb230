"""Derivatives of a run across an instant, for a model with derivatives of its states as states.

Where an argument g(t, x, p) reaches 0, the time of the event moves by

    dt = -(g_x s + g_p q) / (dg/dt),    s = dx along the direction q of the parameters

and the derivative after the event is  R_x (s + f dt) + R_p q + R_t dt - f+ dt, where R are the new
values of the states, and f and f+ their time derivatives before and after it. Events at one instant
have times of their own: they are passed one after the other.

Source  Hiskens & Pai, Trajectory sensitivity analysis of hybrid systems, IEEE Trans. CAS I 47
        (2000) 204-220.
"""

from dataclasses import replace

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae.expressions import operations
from casadi_models.dae.hybrid import Hybrid
from cosim.arrays import Vector
from cosim.codegen.hybrid_laws import added
from cosim.errors import SolverError
from cosim.integrate.call import Evaluator
from cosim.integrate.kernel import Happening, Kernel
from cosim.integrate.modes import Instant
from cosim.memo import cached_per_thread

_SAME = 1e-6  # relative difference of derivatives up to which the order of events does not matter


@cached_per_thread(16)
def _along(system: Hybrid) -> Evaluator:
    """Return `along(t, x, z, u, p, dt) -> changes` of relations' arguments and events' values."""
    dt = SX.sym("dt")
    results = [system.along(rows, dt) for rows in (system.arguments, system.rules[1])]
    return Evaluator(ca.Function("along", [*system.dae.arguments, dt], results))


def crossed(
    kernel: Kernel, p: Vector, at: Instant, first: int, slid: frozenset[int]
) -> tuple[Instant, Happening]:
    """Let all happen that happens at an instant, with the derivatives of the states.

    Args:
        kernel: The kernel of the run.
        p: Parameters.
        at: The instant just before.
        first: The relation that was located there; -1 for none.
        slid: Relations that have slid before along the same inputs.

    Raises:
        SolverError: Events happen at one time, and the derivatives depend on their order; or an
            angle jumps.
    """
    switching = kernel.switching.numbers.copy()
    zero = kernel.happen(at, first).zero
    kernel.switching.numbers[:] = switching
    argument = kernel.system.relations[first].argument if first >= 0 else SX(0)
    if first not in zero and ca.OP_ATAN2 in operations(argument):
        raise SolverError.of(
            kernel.system.dae.full_name,
            f"atan2 jumps by a turn in {kernel.system.described(first)} at {at.t:.12g} s, where "
            "derivatives are not known",
            "write the condition without atan2",
        )
    order = sorted(zero | ({first} if first >= 0 else frozenset()))
    if len(order) < 2:
        found, happened = _one(kernel, p, at, next(iter(order), -1), frozenset())
        return slid_derivatives(kernel.system, found, p, slid), happened
    other, _ = _in_order(kernel, p, at, order[::-1])
    kernel.switching.numbers[:] = switching
    found, happened = _in_order(kernel, p, at, order)
    system = kernel.system
    sizes = np.maximum(np.abs(found.x), [v.nominal for v in system.dae.states])
    if (np.abs(found.x - other.x) > _SAME * sizes).any():
        names = [system.events[i].name for i in happened.events]
        names = names or [system.described(i) for i in order]
        raise SolverError.of(
            system.dae.full_name,
            f"{', '.join(dict.fromkeys(names))} at {at.t:.12g} s happen at one time, and what "
            "follows depends on their order: there are one-sided derivatives only",
            "change an initial value or a parameter a little",
        )
    return slid_derivatives(kernel.system, found, p, slid), happened


def _in_order(
    kernel: Kernel, p: Vector, at: Instant, order: list[int]
) -> tuple[Instant, Happening]:
    """Let relations switch one after the other at one time."""
    events, zero, replan = list[int](), frozenset[int](), False
    for k, i in enumerate(order):
        at, happened = _one(kernel, p, at, i, frozenset(order[k + 1 :]))
        events += happened.events
        zero, replan = zero | happened.zero, replan or happened.replan
    return at, Happening(happened.ending, events, zero, replan)


def _one(
    kernel: Kernel, p: Vector, at: Instant, i: int, later: frozenset[int]
) -> tuple[Instant, Happening]:
    """Let one relation switch, and all that follows from that, at its own moving time.

    Args:
        kernel, p, at: See `crossed`.
        i: The relation; -1 for none.
        later: Relations that keep their modes meanwhile, although their arguments are 0.
    """
    system, nx = kernel.system, kernel.system.dae.derived
    at, dt = _at_moving_time(system, p, at, i)
    derivative = at.x[nx : 2 * nx].copy()

    def note(x: Vector, z: Vector, u: Vector, events: list[int]) -> None:
        state = np.concatenate((x[:nx], derivative, x[2 * nx :]))
        _, change = _along(system)(at.t, state, z, u, p, dt)
        before, given = derivative.copy(), set[int]()
        ends = np.cumsum([0, *(len(event.states) for event in system.events)])
        for event in events:
            for row, place in enumerate(system.events[event].states, start=int(ends[event])):
                adds = place in given and added(system)[row]
                derivative[place] = change[row] + (derivative - before)[place] * adds
                given.add(place)

    happened = kernel.happen(at, i, note, later)
    after = kernel.after(at)
    x = after.x.copy()
    x[nx : 2 * nx] = derivative
    after = replace(after, x=x)
    if dt:
        after = replace(after, x=_moved(system, p, after, -dt))
    return after, happened


def _at_moving_time(system: Hybrid, p: Vector, at: Instant, i: int) -> tuple[Instant, float]:
    """Return an instant with derivatives at the moving time of a relation, and how that moves.

    Where a mode at its edge ends sliding, rates are continuous, and so are derivatives.
    """
    if i < 0 or i in at.sliding:
        return at, 0.0
    seen = at.watched(system, p)
    change = _along(system)(at.t, at.x, at.z, at.inputs, p, 0.0)[0]
    rate = float(seen.rates[0, i])
    dt = -float(change[i]) / rate if rate and np.isfinite(change[i] / rate) else 0.0
    return replace(at, x=_moved(system, p, at, dt)), dt


def _moved(system: Hybrid, p: Vector, at: Instant, dt: float) -> Vector:
    """Return states whose derivatives are taken at a time moved by dt."""
    nx, found = system.dae.derived, at.x.copy()
    found[nx : 2 * nx] += at.watched(system, p).ode[0, :nx] * dt
    return found


def slid_derivatives(system: Hybrid, at: Instant, p: Vector, before: frozenset[int]) -> Instant:
    """Return an instant whose derivatives slide, too, with what did not slide before."""
    for i in sorted(at.sliding - before if system.dae.derived else ()):
        modes = at.modes.copy()
        modes[i] = 1.0
        free = replace(at, modes=modes, sliding=at.sliding - {i})
        moved, dt = _at_moving_time(system, p, free, i)
        at = replace(at, x=moved.x)
        at = replace(at, x=_moved(system, p, at, -dt))
    return at
