"""The bicycle by Kane's method, the front contact force as multipliers: an index-1 DAE."""

from dataclasses import replace

import casadi as ca
from casadi import SX, cos

from casadi_models.bicycle import declaration
from casadi_models.bicycle.declaration import ANGLES, DEPENDENT, INDEPENDENT, RESIDUALS
from casadi_models.bicycle.kinematics import motion
from casadi_models.dae import Dae, Model
from casadi_models.mechanics import conditions, kane

CLOSING_RATE = 1.0  # 1/s; at 0 gaps add up, beyond 1 little is gained: docs/drift.md


def build() -> Dae:
    """Return the DAE in six speeds, the front contact force as multipliers: 14 states."""
    model = declaration.FAMILY.formulation("multipliers", "front contact force as multipliers")
    q = declaration.states(model, ANGLES)
    u = declaration.states(model, f"{INDEPENDENT} {DEPENDENT}")
    path = declaration.states(model, "xP yP")
    u_dot, front = _unknowns(model)
    moving = motion(declaration.bicycle(model), declaration.torques(model), q, u)
    rate = model.closing_rate(CLOSING_RATE)

    # In N, so that the multipliers are the components of the ground's force
    system = replace(moving.system, constraints=moving.C_to_N @ moving.W_to_C @ moving.slip)
    # its part along N3 is the rate of the closure
    slip = system.with_held_at_zero(system.constraints)
    closing = 2 * rate * slip + ca.vertcat(0, 0, rate**2 * moving.closure)
    residual = kane.multiplier_equations(system, u_dot, front)
    model.equation(residual + ca.vertcat(SX.zeros(u.numel()), closing))
    model.derivative(ca.vertcat(q, u, path), ca.vertcat(u, u_dot, moving.path_rate))

    rolling = replace(moving.system, free=u[:3], dependent=u[3:], constraints=moving.slip)
    model.start_equation(q[4], moving.closure, declaration.LOOP_CLOSURE)
    model.start(u[3:], kane.speed_relation(rolling) @ u[:3], declaration.ROLLING)

    rear = kane.reactions(system, u_dot, front)
    declaration.outputs(model, "fx_P fy_P fz_P", rear)
    declaration.outputs(model, "zP speed", ca.vertcat(0, moving.speed))
    model.start_through(u[1], "speed")
    residuals = system.with_held_at_zero(moving.residuals())
    declaration.outputs(model, RESIDUALS, residuals)
    declaration.energies(model, kane.kinetic_energy(system), moving.potential)
    declaration.name_modes(model, q[2])
    declaration.limits(model, q[0], rear[2], front[2])
    declaration.drift_limits(model, residuals[0], residuals[1:])
    declaration.contact(model, q, moving.closure)
    mass = kane.mass_matrix(system)
    declaration.rolling(model, u, residuals[1:], sizes=conditions.equal_energies(mass))
    conditions.watch_masses(model, mass)
    in_wheel_axes = replace(system, constraints=moving.slip)  # yaw does not count there
    conditions.watch_constraints(model, kane.constraint_matrix(in_wheel_axes), mass)
    conditions.watch_singularity(model, cos(q[0]))
    return model.freeze()


def _unknowns(model: Model) -> tuple[SX, SX]:
    """Declare the accelerations (6, 1) and the force of the ground on the front wheel (3, 1)."""
    accelerations = [
        model.algebraic(f"{name}_dot", "rad/s2", 0.0, f"rate of {name}", nominal=1.0)
        for name in f"{INDEPENDENT} {DEPENDENT}".split()
    ]
    forces = []
    for name in ("fx_Q", "fy_Q", "fz_Q"):
        unit, meaning, size = declaration.QUANTITIES[name]
        forces.append(model.algebraic(name, unit, 0.0, meaning, nominal=size))
    return ca.vertcat(*accelerations), ca.vertcat(*forces)
