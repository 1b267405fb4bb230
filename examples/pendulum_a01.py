"""IFToMM benchmark A01: a simple pendulum in Cartesian coordinates, starting horizontally.

Source  Gonzalez, Dopico, Lugris, Cuadrado, Multibody System Dynamics 16, 2006.
"""

import casadi as ca
from casadi import SX

from casadi_models.dae import Model
from casadi_models.mechanics.kane import InertialTerm, Load
from casadi_models.mechanics.mechanism import mechanism


def build():
    """Return the DAE of a point mass of 1 kg on a massless rod of 1 m."""
    model = Model("pendulum_a01", stop_time=10.0)
    q = ca.vertcat(
        model.state("x", "m", -1.0, "place to the right"),
        model.state("y", "m", 0.0, "height"),
    )
    u = SX.sym("u", 2)
    found = mechanism(
        model, q, u, [InertialTerm(u, u)], [Load(u[1], SX(-9.81))], {"rod": (ca.dot(q, q) - 1) / 2}
    )
    model.energies(found.kinetic_energy, 9.81 * q[1])
    return model.freeze()
