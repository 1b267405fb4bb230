"""Quadrotor: a rigid body with the lift and drag torque of four rotors.

Source  Mahony, Kumar & Corke, IEEE Robotics & Automation Magazine 19, 2012.
"""

import casadi as ca
from casadi import SX

import cosim
from casadi_models.mechanics.rotations import from_quaternion, quaternion_product

MASS, ARM, INERTIA, DRAG, G = 0.5, 0.17, (3.2e-3, 3.2e-3, 5.5e-3), 0.016, 9.81  # SI


def build():
    """Return the ODE: 13 states (position, velocity, quaternion, body rates), 4 rotor forces."""
    r, v, q, w, f = (SX.sym(n, k) for n, k in (("r", 3), ("v", 3), ("q", 4), ("w", 3), ("f", 4)))
    torque = ca.vertcat(
        ARM * (f[1] - f[3]), ARM * (f[2] - f[0]), DRAG * (f[0] - f[1] + f[2] - f[3])
    )
    inertia = SX(list(INERTIA))
    v_dot = from_quaternion(q) @ ca.vertcat(0, 0, ca.sum1(f)) / MASS - ca.vertcat(0, 0, G)
    q_dot = quaternion_product(q, ca.vertcat(1 - ca.sumsqr(q), w / 2))
    w_dot = (torque - ca.cross(w, inertia * w)) / inertia
    return cosim.from_casadi(
        {"x": [r, v, q, w], "u": f, "ode": ca.vertcat(v, v_dot, q_dot, w_dot)},
        {"q_1": 1, "f": [1.5, 1.2, 1.5, 1.2]},
        {"yaw": ca.atan2(2 * (q[0] * q[3] + q[1] * q[2]), 1 - 2 * (q[2] ** 2 + q[3] ** 2))},
        units={"r": "m", "v": "m/s", "w": "rad/s", "f": "N", "yaw": "rad"},
        meanings={"f": "force of a rotor"},
        name="quadrotor",
        stop_time=1.0,
    )
