"""The hydraulic crane of the LIM benchmarks for co-simulation, with the force as interface.

Source  M. A. Naya, J. Cuadrado, D. Dopico, U. Lugris, Arch. Mech. Eng. 58, 2011, 223-243.
"""

from math import cos, pi, sin, sqrt

import casadi as ca
from scipy.optimize import fsolve

import cosim

LENGTH, SECOND, GRAVITY = 1.0, 0.5, 9.81  # m, m, m/s2
MASS, TIP, LOAD = 200.0, 250.0, 100.0  # kg
AREA, STROKE, DAMPING, VALVE = 0.0065, 0.442, 1e5, 0.67  # m2, m, N.s/m, 1
DENSITY, PUMP, TANK = 850.0, 7.6e6, 0.1e6  # kg/m3, Pa, Pa
ANGLE = pi / 6
REST = LENGTH * sqrt(1 - sqrt(3) / 2 * cos(ANGLE))  # m, of the cylinder


def rates(p, kappa, s, v, root):
    """Return the rates of the two pressures, Pa/s."""

    def stiffness(p):
        a, b = 6.53e-10, -1.19e-18
        return (1 + a * p + b * p**2) / (a + 2 * b * p)

    found = []
    for pressure, sign, opened in ((p[0], 1, kappa), (p[1], -1, 1 - kappa)):
        flow = opened * root(2 * (PUMP - pressure) / DENSITY)
        flow -= (1 - opened) * root(2 * (pressure - TANK) / DENSITY)
        chamber = AREA * (STROKE / 2 - sign * (s - REST))
        found.append(stiffness(pressure) / chamber * (sign * AREA * v + 5e-4 * VALVE * flow))
    return found


def crane() -> cosim.System:
    """Return the crane in its equilibrium."""
    lever = sqrt(3) / 4 * LENGTH**2 * sin(ANGLE) / REST
    weight = GRAVITY * LENGTH * cos(ANGLE) * (MASS / 2 + TIP + LOAD) / lever

    def unbalanced(guess):
        p = 1e6 * guess[:2]
        speeds = rates(p, guess[2], REST, 0.0, sqrt)
        return [(AREA * (p[1] - p[0]) - weight) / 1e4, speeds[0] / 1e9, speeds[1] / 1e9]

    p1, p2, kappa = fsolve(unbalanced, [3.3, 4.4, 0.5], xtol=1e-14)
    arm, cylinder = cosim.Model("arm", stop_time=1.0), cosim.Model("cylinder", stop_time=1.0)
    q = [arm.state(n, "rad", start, n) for n, start in (("q1", ANGLE), ("q2", -pi / 2))]
    w = [arm.state(n, "rad/s", 0.0, n) for n in ("w1", "w2")]
    force = arm.input("force", "N", float(1e6 * AREA * (p2 - p1)), "of the cylinder")
    s = LENGTH * ca.sqrt(1 - sqrt(3) / 2 * ca.cos(q[0]))
    lever = sqrt(3) / 4 * LENGTH**2 * ca.sin(q[0]) / s
    both = LENGTH * SECOND * LOAD
    mixed, first = both * ca.cos(q[0] - q[1]), LENGTH**2 * (MASS / 3 + TIP + LOAD)
    matrix = ca.blockcat([[first, mixed], [mixed, SECOND**2 * LOAD]])
    turning = both * ca.sin(q[0] - q[1]) * ca.vertcat(w[1] ** 2, -(w[0] ** 2))
    pull = GRAVITY * ca.vertcat(
        LENGTH * (MASS / 2 + TIP + LOAD) * ca.cos(q[0]), SECOND * LOAD * ca.cos(q[1])
    )
    acceleration = ca.solve(matrix, ca.vertcat(lever * force, 0) - turning - pull)
    for place, speed, rate in zip(q, w, ca.vertsplit(acceleration), strict=True):
        arm.derivative(place, speed)
        arm.derivative(speed, rate)
    arm.output("s", "m", s, "length of the cylinder")
    arm.output("v", "m/s", lever * w[0], "its rate")
    p = [cylinder.state(n, "Pa", 1e6 * float(x), n) for n, x in (("p1", p1), ("p2", p2))]
    s, v = cylinder.input("s", "m", REST, "length"), cylinder.input("v", "m/s", 0.0, "its rate")
    for pressure, rate in zip(p, rates(p, float(kappa), s, v, ca.sqrt), strict=True):
        cylinder.derivative(pressure, rate)
    cylinder.output("force", "N", AREA * (p[1] - p[0]) - DAMPING * v, "force")
    parts = {"arm": arm.freeze(), "cylinder": cylinder.freeze()}
    wires = {"arm.force": "cylinder.force", "cylinder.s": "arm.s", "cylinder.v": "arm.v"}
    return cosim.couple(parts, wires)
