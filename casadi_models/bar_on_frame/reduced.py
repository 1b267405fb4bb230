"""The bar's own equation of motion, loads in closed form: an ODE (the book's Model 2)."""

import casadi as ca
from casadi import cos, sin

from casadi_models.bar_on_frame import declaration
from casadi_models.dae import Dae
from casadi_models.mechanics import rotations


def build() -> Dae:
    """Return the ODE of the bar in a frame of given motion, all loads as outputs: 4 states."""
    model = declaration.FAMILY.formulation(
        "reduced", "equation of motion of the bar, loads in closed form"
    )
    theta, theta_dot, phi, Omega = declaration.motion(model)
    data = declaration.data(model)
    m, d, Omega_dot = data.m, data.d, data.Omega_dot
    s, c = sin(theta), cos(theta)
    inertia = data.bar_inertia[1, 1]  # about n2 and about e3

    # Euler for the bar about n2 (U2): inertia (theta'' + Omega^2 s c) = T2
    t2 = data.T2 - data.b * theta_dot
    theta_ddot = t2 / inertia - Omega**2 * s * c
    model.derivative(theta, theta_dot)
    model.derivative(theta_dot, theta_ddot)
    model.derivative(phi, Omega)
    model.derivative(Omega, Omega_dot)

    # Newton for G, Euler about e1 and e3 (U2): what the pin must supply
    force = m * ca.vertcat(-d * Omega_dot, -d * Omega**2, 0)
    t3 = inertia * (Omega_dot * c - 2 * theta_dot * Omega * s)
    torque_B = ca.vertcat(0, t2, t3)
    to_frame = rotations.about(2, theta)
    torque = to_frame @ torque_B
    declaration.outputs(model, "f1_G_F f2_G_F fk_G_F", force)
    declaration.outputs(model, "f1_G_B f2_G_B f3_G_B", to_frame.T @ force)
    declaration.outputs(model, "t1_G_F t2_G_F tk_G_F", torque)
    declaration.outputs(model, "t1_G_B t2_G_B t3_G_B", torque_B)

    # Lagrange for the frame's angle (U4): what the drive must supply
    frame_inertia = data.column_inertia[2, 2] + data.arm_inertia[2, 2] + data.arm_mass * d**2 / 4
    about_k = frame_inertia + m * d**2 + inertia * c**2
    M_phi = about_k * Omega_dot - 2 * inertia * s * c * theta_dot * Omega
    declaration.outputs(model, "M_phi", M_phi)

    # Newton-Euler for frame and bar about A: what the bearings must supply across k. The column's
    # center rests and its angular momentum is along k; the arm's center is at d/2.
    arm_force = data.arm_mass / 2 * ca.vertcat(-d * Omega_dot, -d * Omega**2, 0)
    at_G, at_arm = (ca.vertcat(0, reach, data.weld_height) for reach in (d, d / 2))
    moment = torque + ca.cross(at_G, force) + ca.cross(at_arm, arm_force)
    top = ca.vertcat(moment[1], -moment[0]) / data.column_length
    bottom = (force + arm_force)[:2] - top
    declaration.outputs(model, "f1_A_F f2_A_F f1_B_F f2_B_F", ca.vertcat(bottom, top))

    # Both vectors in (n1, n2, k), turned into the world
    to_world = rotations.about(3, phi)
    rate = ca.vertcat(0, theta_dot, Omega)
    acceleration = ca.vertcat(-Omega * theta_dot, theta_ddot, Omega_dot)
    declaration.outputs(model, "wx_bar wy_bar wz_bar", to_world @ rate)
    declaration.outputs(model, "ax_bar ay_bar az_bar", to_world @ acceleration)
    model.energies((about_k * Omega**2 + inertia * theta_dot**2) / 2, 0, nominal=10.0)
    return model.freeze()
