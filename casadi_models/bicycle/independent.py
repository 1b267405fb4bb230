"""The bicycle by Kane's method, the dependent speeds eliminated: an explicit ODE."""

from dataclasses import replace

import casadi as ca
from casadi import SX

from casadi_models.bicycle import declaration
from casadi_models.bicycle.declaration import ANGLES, DEPENDENT, INDEPENDENT, RESIDUALS
from casadi_models.bicycle.kinematics import motion
from casadi_models.dae import Dae
from casadi_models.mechanics import conditions, kane


def build() -> Dae:
    """Return the ODE in three independent speeds, the dependent ones eliminated: 11 states."""
    model = declaration.FAMILY.formulation("independent", "dependent speeds eliminated")
    q = declaration.states(model, ANGLES)
    u_I = declaration.states(model, INDEPENDENT)
    path = declaration.states(model, "xP yP")
    u_D = SX.sym("u_D", 3)
    u = ca.vertcat(u_I, u_D)
    bike = declaration.bicycle(model)
    moving = motion(bike, declaration.torques(model), q, u)

    # In W only the first constraint holds the front wheel's spin: a 2x2 block remains to be solved
    system = replace(moving.system, free=u_I, dependent=u_D, constraints=moving.slip)
    solution = kane.accelerations(system)
    relation = solution.relation @ u_I
    rolling_matrix = system.with_held_at_zero(ca.jacobian(moving.slip, u_D))

    def rolling(*rows: SX) -> SX:
        return ca.substitute(system.with_held_at_zero(ca.vertcat(*rows)), u_D, relation)

    model.derivative(ca.vertcat(q, u_I, path), rolling(u, solution.free, moving.path_rate))
    model.start_equation(q[4], moving.closure, declaration.LOOP_CLOSURE)

    front = kane.constraint_loads(system, solution.unknown)
    rear = kane.reactions(system, solution.unknown, front)
    declaration.outputs(model, DEPENDENT, relation)
    declaration.outputs(model, "fx_P fy_P fz_P", rolling(rear))
    declaration.outputs(model, "fx_Q fy_Q fz_Q", rolling(moving.C_to_N @ moving.W_to_C @ front))
    declaration.outputs(model, "zP speed", rolling(SX(0), moving.speed))
    model.start_through(u_I[1], "speed")
    declaration.outputs(model, RESIDUALS, rolling(moving.residuals()))
    declaration.energies(model, rolling(kane.kinetic_energy(system)), moving.potential)
    fz_Q = (moving.C_to_N @ moving.W_to_C @ front)[2]
    declaration.name_modes(model, q[2])
    declaration.limits(model, q[0], *ca.vertsplit(rolling(rear[2], fz_Q)))
    declaration.contact(model, q, moving.closure)
    declaration.elimination(model, bike, q[0], rolling_matrix)
    conditions.watch_masses(model, solution.mass)
    return model.freeze()
