"""Chain of eight slender links under gravity, in absolute angles, starting horizontally.

Source  Kane's equations; a test compares them with Lagrange's equations in closed form.
"""

import casadi as ca
from casadi import SX, cos, sin

from casadi_models.dae import Model
from casadi_models.mechanics.kane import InertialTerm, Load
from casadi_models.mechanics.mechanism import mechanism

LINKS = 8  # of 0.125 m and 1 kg
LENGTH = 1 / LINKS


def build():
    """Return the ODE: 16 states (angles from the downward vertical, and rates)."""
    model = Model("chain", stop_time=1.0)
    q = ca.vertcat(
        *(
            model.state(f"q{i}", "rad", 0.5 * 3.141592653589793, f"angle of link {i}")
            for i in range(1, LINKS + 1)
        )
    )
    u = SX.sym("u", LINKS)
    velocity, height = SX(2, 1), SX(0)
    inertias, loads, potential = [], [], SX(0)
    for i in range(LINKS):
        half = LENGTH / 2 * ca.vertcat(cos(q[i]), sin(q[i])) * u[i]
        center, velocity = velocity + half, velocity + 2 * half
        inertias += [InertialTerm(center, center), InertialTerm(u[i], LENGTH**2 / 12 * u[i])]
        loads.append(Load(center[1], SX(-9.81)))
        potential += 9.81 * (height - LENGTH / 2 * cos(q[i]))
        height -= LENGTH * cos(q[i])
    found = mechanism(model, q, u, inertias, loads)
    model.energies(found.kinetic_energy, potential, nominal=10.0)
    return model.freeze()
