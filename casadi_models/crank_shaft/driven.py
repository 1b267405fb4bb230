"""The crank shaft with a prescribed spin: an ODE; loads are reactions."""

import casadi as ca
from casadi import SX

from casadi_models.crank_shaft.shaft import FAMILY, LOADS, properties, spin, weight
from casadi_models.dae import Dae
from casadi_models.mechanics import kane, rotations


def build() -> Dae:
    """Return the ODE of the prescribed spin; bearing forces and torque are reactions: 2 states."""
    model = FAMILY.formulation(
        "driven", "prescribed spin; reactions of bearings and drive as outputs"
    )
    phi, omega = spin(model)
    shaft = properties(model)
    model.derivative(phi, omega)
    model.derivative(omega, shaft.alpha)

    # Constrained speeds: those of the bearing points A and B across the axis, so that the residual
    # of each equation is one bearing force. The speed along Z is free: no force acts along Z.
    a, b = SX.sym("v_A", 2), SX.sym("v_B", 2)
    span = 4 * shaft.length
    tilt = ca.vertcat((a[1] - b[1]) / span, (b[0] - a[0]) / span)
    velocity = ca.vertcat((a + b) / 2, 0)
    rate = ca.vertcat(tilt, omega)
    system = kane.System(
        q=phi,
        q_dot=omega,
        free=SX(0, 1),
        prescribed=omega,
        prescribed_dot=shaft.alpha,
        held=ca.vertcat(a, b),
        inertias=kane.body(shaft.mass, shaft.inertia, velocity, rate),
        loads=(weight(shaft, velocity, rotations.about(3, phi)),),
    )
    torque, *forces = ca.vertsplit(kane.reactions(system, SX(0, 1)))
    for (name, unit, meaning, size), load in zip(LOADS, [*forces, torque], strict=True):
        model.output(name, unit, load, meaning, nominal=size)
    model.energies(kane.kinetic_energy(system), 0, nominal=50.0)  # G stays on the axis
    return model.freeze()
