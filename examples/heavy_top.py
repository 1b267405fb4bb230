"""Heavy symmetric top in steady precession, with a unit quaternion and body rates.

Source  Goldstein, Classical Mechanics, section 5.7: steady precession where
        (C - A) W^2 cos(th) + C s W = m g l, with s the spin relative to the precessing axes.
"""

import casadi as ca
from casadi import SX

import cosim
from casadi_models.mechanics.rotations import from_quaternion, quaternion_product

MASS, ARM, A, C, G = 15.0, 1.0, 15.46875, 0.46875, 9.81  # kg, m, kg.m2 about the point, m/s2
TILT, PRECESSION = 1.0, 2.0  # rad, rad/s
SPIN = (MASS * G * ARM / PRECESSION + (A - C) * PRECESSION * float(ca.cos(TILT))) / C  # rad/s


def build():
    """Return the ODE: 7 states (quaternion from body to world, and body rates)."""
    q, w = SX.sym("q", 4), SX.sym("w", 3)
    R, inertia = from_quaternion(q), ca.diag(SX([A, A, C]))
    torque = ca.cross(ca.vertcat(0, 0, ARM), R.T @ ca.vertcat(0, 0, -MASS * G))
    w_dot = (torque - ca.cross(w, inertia @ w)) / ca.diag(inertia)
    q_dot = quaternion_product(q, ca.vertcat(1 - ca.sumsqr(q), w / 2))
    start = {
        "q": [float(ca.cos(TILT / 2)), float(ca.sin(TILT / 2)), 0, 0],
        "w": [0, PRECESSION * float(ca.sin(TILT)), SPIN + PRECESSION * float(ca.cos(TILT))],
    }
    axis = R[:, 2]
    return cosim.from_casadi(
        {"x": [q, w], "ode": ca.vertcat(q_dot, w_dot)},
        start,
        {"axis": axis, "energy": ca.dot(w, inertia @ w) / 2 + MASS * G * ARM * axis[2]},
        units={"w": "rad/s", "energy": "J"},
        nominals={"w_3": SPIN, "energy": 100.0},
        name="heavy_top",
        stop_time=2.0,
    )
