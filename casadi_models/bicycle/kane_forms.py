"""Formulations of the bicycle by Kane's method: dependent speeds eliminated, or multipliers."""

from dataclasses import replace

import casadi as ca
from casadi import SX, cos

from casadi_models import conditions, kane
from casadi_models.bicycle import declaration
from casadi_models.bicycle.kinematics import motion
from casadi_models.dae import Dae, Model

_ANGLES = "phi thetaR delta psi theta thetaF"
_INDEPENDENT = "phi_dot thetaR_dot delta_dot"
_DEPENDENT = "psi_dot theta_dot thetaF_dot"
_RESIDUALS = "loop_closure slip_1 slip_2 slip_3"

CLOSING_RATE = 1.0  # 1/s; at 0 gaps add up, beyond 1 little is gained: docs/drift.md


def independent() -> Dae:
    """Return the ODE in three independent speeds, the dependent ones eliminated: 11 states."""
    model = declaration.new_model("independent", "dependent speeds eliminated")
    q = declaration.states(model, _ANGLES)
    u_I = declaration.states(model, _INDEPENDENT)
    path = declaration.states(model, "xP yP")
    u_D = SX.sym("u_D", 3)
    u = ca.vertcat(u_I, u_D)
    bike = declaration.bicycle(model)
    moving = motion(bike, declaration.torques(model), q, u)

    # In W only the first constraint holds the front wheel's spin: a 2x2 block remains to be solved
    system = replace(moving.system, free=u_I, dependent=u_D, constraints=moving.slip)
    solution = kane.accelerations(system)
    relation = solution.relation @ u_I
    rolling_matrix = system.at_rest(ca.jacobian(moving.slip, u_D))

    def rolling(*rows: SX) -> SX:
        return ca.substitute(system.at_rest(ca.vertcat(*rows)), u_D, relation)

    model.derivative(ca.vertcat(q, u_I, path), rolling(u, solution.free, moving.path_rate))
    model.start_equation(q[4], moving.closure, declaration.LOOP_CLOSURE)

    front = kane.constraint_loads(system, solution.unknown)
    rear = kane.reactions(system, solution.unknown, front)
    declaration.outputs(model, _DEPENDENT, relation)
    declaration.outputs(model, "fx_P fy_P fz_P", rolling(rear))
    declaration.outputs(model, "fx_Q fy_Q fz_Q", rolling(moving.C_to_N @ moving.W_to_C @ front))
    declaration.outputs(model, "zP speed", rolling(SX(0), moving.speed))
    declaration.outputs(model, _RESIDUALS, rolling(moving.residuals()))
    declaration.energies(model, rolling(kane.kinetic_energy(system)), moving.potential)
    fz_Q = (moving.C_to_N @ moving.W_to_C @ front)[2]
    declaration.limits(model, q[0], *ca.vertsplit(rolling(rear[2], fz_Q)))
    declaration.contact(model, q, moving.closure)
    declaration.elimination(model, bike, q[0], rolling_matrix)
    conditions.watch_masses(model, solution.mass)
    return model.freeze()


def multipliers() -> Dae:
    """Return the DAE in six speeds, the front contact force as multipliers: 14 states."""
    model = declaration.new_model("multipliers", "front contact force as multipliers")
    q = declaration.states(model, _ANGLES)
    u = declaration.states(model, f"{_INDEPENDENT} {_DEPENDENT}")
    path = declaration.states(model, "xP yP")
    u_dot, front = _unknowns(model)
    moving = motion(declaration.bicycle(model), declaration.torques(model), q, u)
    rate = model.closing_rate(CLOSING_RATE)

    # In N, so that the multipliers are the components of the ground's force
    system = replace(moving.system, constraints=moving.C_to_N @ moving.W_to_C @ moving.slip)
    slip = system.at_rest(system.constraints)  # its part along N3 is the rate of the closure
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
    residuals = system.at_rest(moving.residuals())
    declaration.outputs(model, _RESIDUALS, residuals)
    declaration.energies(model, kane.kinetic_energy(system), moving.potential)
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
        for name in f"{_INDEPENDENT} {_DEPENDENT}".split()
    ]
    forces = []
    for name in ("fx_Q", "fy_Q", "fz_Q"):
        unit, meaning, size = declaration.QUANTITIES[name]
        forces.append(model.algebraic(name, unit, 0.0, meaning, nominal=size))
    return ca.vertcat(*accelerations), ca.vertcat(*forces)
