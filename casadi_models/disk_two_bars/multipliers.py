"""Two free bars held by hinge constraints: an index-1 DAE."""

import casadi as ca
from casadi import SX

from casadi_models.dae import Dae
from casadi_models.disk_two_bars import bars
from casadi_models.mechanics import kane
from casadi_models.mechanics.joints import free_joint, watch_joints


def build() -> Dae:
    """Return the DAE of two free bars held by hinge constraints: 25 states, 22 algebraics."""
    model = bars.FAMILY.formulation(
        "multipliers", "free bars; hinge forces and torques are the multipliers"
    )
    motion = bars.motion(model)
    data = bars.data(model)
    model.derivative(motion.phi, data.Omega)
    joints = [
        free_joint(model, body, 1, angle, rate, acceleration, velocity_in="carrier")
        for body, angle, rate, acceleration in (
            ("bar1", motion.theta1, motion.theta1_dot, "theta1_dot_dot"),
            ("bar2", motion.theta2, motion.theta2_dot, "theta2_dot_dot"),
        )
    ]
    bar1, bar2 = (bars.Bar(j.rotation, j.omega, j.shift, j.velocity) for j in joints)
    terms = bars.terms(motion, data, bar1, bar2)
    relative = bar2.omega - bar2.rotation.T @ bar1.rotation @ bar1.omega  # in the axes of bar 2
    system = kane.System(
        q=ca.vertcat(*(j.q for j in joints)),
        q_dot=ca.vertcat(*(j.q_dot for j in joints)),
        free=ca.vertcat(*(j.speeds for j in joints)),
        prescribed=data.Omega,
        prescribed_dot=SX(0),
        inertias=terms.inertias,
        loads=terms.loads,
        constraints=ca.vertcat(bar1.velocity, bar2.velocity, bar1.omega[1:], relative[1:]),
    )
    accelerations = ca.vertcat(*(j.accelerations for j in joints))
    forces = [
        model.algebraic(n, "N", 0.0, bars.hinge_load("force", n), nominal=10.0) for n in bars.FORCES
    ]
    torques = [
        model.algebraic(n, "N.m", 0.0, bars.hinge_load("torque", n))
        for n in ("t2_H1", "t3_H1", "t2_H2", "t3_H2")
    ]
    loads = ca.vertcat(*forces, *torques)
    model.equation(kane.multiplier_equations(system, accelerations, loads))
    bars.outputs(model, system, terms, kane.reactions(system, accelerations, loads))
    watch_joints(model, joints, system)
    forbidden = ca.vertcat(*(ca.vertcat(j.shift, j.tilts) for j in joints))
    model.invariant("position_drift", forbidden, forbidden, "the hinges hold")
    model.invariant("velocity_drift", system.free, system.constraints, "the hinges hold at rest")
    return model.freeze()
