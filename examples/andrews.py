"""Andrews' squeezing mechanism: seven bodies, six loops, reduced from index 3 to 1.

Source  Schiehlen (ed.), Multibody Systems Handbook, 1990; Hairer & Wanner, Solving ODEs II, VII.7.
"""

import casadi as ca
from casadi import SX, cos, sin

import cosim

M = (0.04325, 0.00365, 0.02373, 0.00706, 0.07050, 0.00706, 0.05498)  # kg
J = (2.194e-6, 4.410e-7, 5.255e-6, 5.667e-7, 1.169e-5, 5.667e-7, 1.912e-5)  # kg.m2
Q = "-.0617138900142764496 0 .45527981916307038 .222668390165885885 .48736497954384255 "
START = [float(angle) for angle in f"{Q} -.222668390165885885 1.23054744454982119".split()]


def build():
    """Return the DAE: 14 states (angles and rates); accelerations and loop loads are unknowns."""
    q, v, a, load = SX.sym("q", 7), SX.sym("v", 7), SX.sym("a", 7), SX.sym("load", 6)
    b, k2, c, k4, d, k6, e = q[0], q[0] + q[1], q[2], q[3] + q[4], q[4], q[5] + q[6], q[6]
    x, y = (lambda s: ca.vertcat(cos(s), sin(s))), (lambda s: ca.vertcat(sin(s), -cos(s)))
    A, B, C = SX([-0.06934, -0.00227]), SX([-0.03635, 0.03273]), SX([0.014, 0.072])
    P, D = 0.007 * x(b) - 0.028 * x(k2), B + 0.02 * x(c) + 0.018 * y(c)
    places = [0.00092 * x(b), 0.007 * x(b) - 0.0115 * x(k2), 0.01043 * x(c) + 0.01874 * y(c),
              0.00579 * y(k4) + 0.04 * x(d), 0.02308 * x(d) - 0.00916 * y(d),
              0.00579 * x(k6) + 0.04 * y(e), 0.01228 * y(e) - 0.00449 * x(e)]  # fmt: skip
    loops = [B + 0.035 * y(c), A + 0.02 * y(k4) + 0.04 * x(d), A + 0.02 * x(k6) + 0.04 * y(e)]
    g = ca.vertcat(*(P - end for end in loops))
    bodies = zip(M, J, places, (b, k2, c, k4, d, k6, e), strict=True)
    T = SX(0)
    for m, j, place, turn in bodies:
        T += m * ca.sumsqr(ca.jtimes(place, q, v)) + j * ca.jtimes(turn, q, v) ** 2
    spring = 4530 * (ca.norm_2(D - C) - 0.07785) ** 2 / 2
    momentum, G = ca.gradient(T / 2, v), ca.jacobian(g, q)
    force = ca.gradient(T / 2 - spring, q) + ca.vertcat(0.033, SX(6, 1))
    motion = ca.jacobian(momentum, v) @ a + ca.jtimes(momentum, q, v) - force + G.T @ load
    alg = ca.vertcat(motion, G @ a + ca.jtimes(G @ v, q, v))
    system = {"x": [q, v], "z": [a, load], "ode": ca.vertcat(v, a), "alg": alg}
    return cosim.from_casadi(system, {"q": START}, nominals={"a": 1e4, "v": 100, "load": 100},
                             name="andrews", stop_time=0.03, output_interval=3e-4)  # fmt: skip
