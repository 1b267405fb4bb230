"""Car axis: a bar on two springs, one wheel on a bumpy road, reduced from index 3 to index 1.

Source  Schneider, 1991; Mazzia & Magherini, Test Set for IVP Solvers, 2008, problem CARAX.
"""

import casadi as ca
from casadi import SX, sin, sqrt

import cosim

EPS, M, L, L0, BUMP, FAST = 1e-2, 10.0, 1.0, 0.5, 0.1, 10.0


def build():
    """Return the DAE: 8 states (positions and velocities); accelerations and loads are unknowns."""
    t, q, v, a, load = SX.sym("t"), *(SX.sym(n, 4) for n in "qva"), SX.sym("load", 2)
    left, right = q[:2], q[2:]
    wheel = ca.vertcat(sqrt(L**2 - (BUMP * sin(FAST * t)) ** 2), BUMP * sin(FAST * t))
    g = ca.vertcat(ca.dot(left, wheel), ca.dot(left - right, left - right) - L**2)
    springs = [(L0 / ca.norm_2(r) - 1) * r for r in (left, right - wheel)]
    weight = EPS**2 * M / 2
    force = ca.vertcat(*springs) - weight * SX([0, 1, 0, 1]) + ca.jacobian(g, q).T @ load
    rate = ca.jtimes(g, q, v) + ca.jacobian(g, t)
    closed = ca.jacobian(rate, t) + ca.jtimes(rate, q, v) + ca.jtimes(rate, v, a)
    return cosim.from_casadi(
        {
            "t": t,
            "x": [q, v],
            "z": [a, load],
            "ode": ca.vertcat(v, a),
            "alg": ca.vertcat(weight * a - force, closed),
        },
        {"q": [0, 0.5, 1, 0.5], "v": [-0.5, 0, -0.5, 0]},
        units={"q": "m", "v": "m/s"},
        nominals={"a": 10, "load": 1e-2},
        name="car_axis",
        stop_time=3.0,
    )
