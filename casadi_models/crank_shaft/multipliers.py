"""The crank shaft as a free body in two bearings, with a drive: an index-1 DAE."""

import casadi as ca
from casadi import SX

from casadi_models.crank_shaft.shaft import FAMILY, LOADS, properties, spin, weight
from casadi_models.dae import Dae
from casadi_models.mechanics import kane, rotations
from casadi_models.mechanics.joints import free_joint, watch_joints


def build() -> Dae:
    """Return the DAE of a free body held by bearings and a drive: 12 states, 11 algebraics."""
    model = FAMILY.formulation(
        "multipliers", "free body; bearing forces and drive torque are the multipliers"
    )
    phi, omega = spin(model)
    shaft = properties(model)
    # Place of G in the world, its velocity in the follower axes X', Y', Z
    joint = free_joint(model, "shaft", 3, phi, omega, "omega_dot", velocity_in="body")
    to_B = 2 * shaft.length * rotations.unit(3)
    at_A, at_B = (joint.velocity + ca.cross(joint.omega, arm) for arm in (-to_B, to_B))
    drive = SX.sym("drive_rate")  # the last constraint ties the shaft to the drive
    system = kane.System(
        q=joint.q,
        q_dot=joint.q_dot,
        free=joint.speeds,
        prescribed=drive,
        prescribed_dot=shaft.alpha,
        inertias=kane.body(shaft.mass, shaft.inertia, joint.velocity, joint.omega),
        loads=(weight(shaft, joint.velocity, joint.rotation),),
        constraints=ca.vertcat(at_A[:2], at_B[:2], omega - drive),
    )
    loads = [model.algebraic(n, u, 0.0, m, nominal=size) for n, u, m, size in LOADS]
    model.equation(kane.multiplier_equations(system, joint.accelerations, ca.vertcat(*loads)))
    potential = shaft.mass * shaft.g * joint.shift[1]
    model.energies(kane.kinetic_energy(system), potential, nominal=50.0)
    watch_joints(model, (joint,), system)
    forbidden = ca.vertcat(joint.shift[:2], joint.tilts)
    model.invariant("position_drift", forbidden, forbidden, "the bearings hold")
    held = system.constraints[:4]  # without the drive
    model.invariant("velocity_drift", joint.speeds, held, "the bearings hold at rest")
    return model.freeze()
