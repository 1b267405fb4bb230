"""Furuta's pendulum: a pendulum on an arm that a torque turns about the vertical.

Source  Cazzolato & Prime, J. Control Science and Engineering, 2011, doi:10.1155/2011/528341.
"""

import casadi as ca
from casadi import SX, cos, sin

from casadi_models.dae import Model
from casadi_models.mechanics.kane import InertialTerm, Load
from casadi_models.mechanics.mechanism import mechanism


def build():
    """Return the ODE: 4 states (angles of the arm and of the pendulum, and their rates)."""
    model = Model("furuta", stop_time=5.0)
    q = ca.vertcat(
        model.state("arm", "rad", 0.0, "angle of the arm about the vertical"),
        model.state("swing", "rad", 2.5, "angle of the pendulum from hanging"),
    )
    torque = model.input("torque", "N.m", 0.0, "on the arm")
    values = {"J1": 2.5e-2, "J2": 1.2e-3, "m": 0.075, "arm_length": 0.278, "reach": 0.148}  # SI
    units = ("kg.m2", "kg.m2", "kg", "m", "m")
    J1, J2, m, L, reach = (
        model.parameter(n, unit, values[n], n) for n, unit in zip(values, units, strict=True)
    )
    u = SX.sym("u", 2)
    c, s = cos(q[0]), sin(q[0])
    along, across = ca.vertcat(c, s, 0), ca.vertcat(-s, c, 0)
    center = L * along + reach * (sin(q[1]) * across - cos(q[1]) * ca.vertcat(0, 0, 1))
    v = ca.jtimes(center, q, u)
    turn = ca.vertcat(u[1], -sin(q[1]) * u[0], -cos(q[1]) * u[0])  # of the rod, in body axes
    slender = InertialTerm(turn, ca.vertcat(J2, J2, 0) * turn, turn)
    inertias = [InertialTerm(u[0], J1 * u[0]), InertialTerm(v, m * v), slender]
    loads = [Load(v[2], -9.81 * m), Load(u[0], torque)]
    found = mechanism(model, q, u, inertias, loads)
    model.energies(found.kinetic_energy, 9.81 * m * center[2])
    return model.freeze()
