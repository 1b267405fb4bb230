"""Derivatives of a run across an event: the jump of a solution of the variational equations.

Where an argument g(t, x, p) reaches 0, the time of the event moves by

    dt = -(g_x s + g_p q) / (dg/dt),    s = dx along the direction q of the parameters

and the derivative after the event is  R_x (s + f dt) + R_p q + R_t dt - f+ dt, where R are the new
values of the states, and f and f+ their time derivatives before and after it.

Source  Hiskens & Pai, Trajectory sensitivity analysis of hybrid systems, IEEE Trans. CAS I 47
        (2000) 204-220.
"""

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae.hybrid import Hybrid
from cosim.arrays import Vector
from cosim.integrate.call import Evaluator
from cosim.memo import cached_per_thread


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
