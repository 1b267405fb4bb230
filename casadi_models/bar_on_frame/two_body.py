"""Frame and bar as bodies in bearings, drive and pin: an index-1 DAE (the book's Model 1)."""

import casadi as ca
from casadi import SX

from casadi_models.bar_on_frame import declaration
from casadi_models.dae import Dae
from casadi_models.mechanics import kane
from casadi_models.mechanics.joints import free_joint, watch_joints


def build() -> Dae:
    """Return the DAE of frame and bar in bearings, drive and pin: 24 states, 22 algebraics."""
    model = declaration.FAMILY.formulation(
        "two_body", "two bodies; loads of bearings, drive and pin are the multipliers"
    )
    theta, theta_dot, phi, Omega = declaration.motion(model)
    data = declaration.data(model)
    # Place of the column's foot A in the world, of the bar's center G from the arm's end; both
    # velocities in F
    frame = free_joint(model, "frame", 3, phi, Omega, "phi_dot_dot", velocity_in="body")
    bar = free_joint(model, "bar", 2, theta, theta_dot, "theta_dot_dot", velocity_in="carrier")

    def of_frame(point: SX) -> SX:
        """Return the velocity of a point of F, in F."""
        return frame.velocity + ca.cross(frame.omega, point)

    at_A, at_B = SX.zeros(3), ca.vertcat(0, 0, data.column_length)
    at_arm, at_G = (ca.vertcat(0, reach, data.weld_height) for reach in (data.d / 2, data.d))
    velocity = of_frame(at_G + bar.shift) + bar.velocity  # of G, in F
    omega = bar.rotation.T @ frame.omega + bar.omega  # of the bar, in (e1, n2, e3)
    drive = SX.sym("drive_rate")  # the fifth constraint ties the frame to the drive
    system = kane.System(
        q=ca.vertcat(frame.q, bar.q),
        q_dot=ca.vertcat(frame.q_dot, bar.q_dot),
        free=ca.vertcat(frame.speeds, bar.speeds),
        prescribed=drive,
        prescribed_dot=data.Omega_dot,
        inertias=(
            *kane.body(data.column_mass, data.column_inertia, of_frame(at_B / 2), frame.omega),
            *kane.body(data.arm_mass, data.arm_inertia, of_frame(at_arm), frame.omega),
            kane.InertialTerm(velocity, data.m * velocity, frame.omega),
            kane.InertialTerm(omega, data.bar_inertia @ omega, omega),
        ),
        loads=(kane.Load(theta_dot, data.T2 - data.b * theta_dot),),
        constraints=ca.vertcat(
            of_frame(at_A)[:2], of_frame(at_B)[:2], Omega - drive, bar.velocity, bar.omega[[0, 2]]
        ),
    )
    accelerations = ca.vertcat(frame.accelerations, bar.accelerations)
    loads = declaration.algebraics(
        model, "f1_A_F f2_A_F f1_B_F f2_B_F M_phi f1_G_F f2_G_F fk_G_F t1_G_B t3_G_B"
    )
    model.equation(kane.multiplier_equations(system, accelerations, loads))

    t1, t3 = ca.vertsplit(loads[8:])
    torque_B = ca.vertcat(t1, data.T2 - data.b * theta_dot, t3)
    declaration.outputs(model, "f1_G_B f2_G_B f3_G_B", bar.rotation.T @ loads[5:8])
    declaration.outputs(model, "t1_G_F t2_G_F tk_G_F", bar.rotation @ torque_B)
    declaration.outputs(model, "t2_G_B", torque_B[1])
    rate = frame.rotation @ bar.rotation @ omega
    declaration.outputs(model, "wx_bar wy_bar wz_bar", rate)
    declaration.outputs(model, "ax_bar ay_bar az_bar", system.time_derivative(rate, accelerations))
    model.energies(kane.kinetic_energy(system), 0, nominal=10.0)
    watch_joints(model, (frame, bar), system)
    forbidden = ca.vertcat(frame.shift[:2], frame.tilts, bar.shift, bar.tilts)
    model.invariant("position_drift", forbidden, forbidden, "bearings and pin hold")
    held = ca.vertcat(system.constraints[:4], system.constraints[5:])  # without the drive
    model.invariant("velocity_drift", system.free, held, "bearings and pin hold at rest")
    return model.freeze()
