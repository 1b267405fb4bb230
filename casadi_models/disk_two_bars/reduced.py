"""The two angles alone; hinge forces are reactions: an ODE."""

import casadi as ca
from casadi import SX

from casadi_models.dae import Dae
from casadi_models.disk_two_bars import bars
from casadi_models.mechanics import conditions, kane, rotations


def build() -> Dae:
    """Return the ODE of the two angles, hinge forces and drive torque as reactions: 5 states."""
    model = bars.FAMILY.formulation(
        "reduced", "equations of the two angles; hinge forces are reactions"
    )
    motion = bars.motion(model)
    data = bars.data(model)
    theta = ca.vertcat(motion.theta1, motion.theta2)
    theta_dot = ca.vertcat(motion.theta1_dot, motion.theta2_dot)

    # Constrained speeds: of each bar's upper end relative to the body that carries it, so that the
    # residual of each equation is one component of a hinge force.
    gaps = SX.sym("gap_rate", 3, 2)
    both = [
        bars.Bar(
            rotations.about(1, theta[i]), rotations.unit(1) * theta_dot[i], SX(3, 1), gaps[:, i]
        )
        for i in (0, 1)
    ]
    terms = bars.terms(motion, data, *both)
    system = kane.System(
        q=theta,
        q_dot=theta_dot,
        free=theta_dot,
        prescribed=data.Omega,
        prescribed_dot=SX(0),
        held=ca.vec(gaps),
        inertias=terms.inertias,
        loads=terms.loads,
    )
    solution = kane.accelerations(system)
    theta_ddot = solution.free
    conditions.watch_masses(model, solution.mass)
    model.derivative(motion.phi, data.Omega)
    model.derivative(theta, theta_dot)
    model.derivative(theta_dot, theta_ddot)
    M_disk, *forces = ca.vertsplit(kane.reactions(system, theta_ddot))
    for name, force in zip(bars.FORCES, forces, strict=True):
        model.output(name, "N", force, bars.hinge_load("force", name), nominal=10.0)
    bars.outputs(model, system, terms, M_disk)
    return model.freeze()
