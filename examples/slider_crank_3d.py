"""Spatial slider-crank: a crank about x and a slider along x, connected by a rod with ball joints.

Source  Haug, Computer Aided Kinematics and Dynamics, 1989 (lengths and masses).
"""

import casadi as ca
from casadi import SX, cos, sin

from casadi_models.dae import Model
from casadi_models.mechanics.kane import InertialTerm, Load
from casadi_models.mechanics.mechanism import mechanism

CRANK, ROD, SIDE, HEIGHT = 0.08, 0.3, 0.1, 0.12  # m
CRANK_INERTIA, ROD_MASS, SLIDER_MASS = 1e-4, 0.5, 2.0  # kg.m2, kg


def build():
    """Return the ODE of the crank's angle; the dependent speed of the slider is eliminated."""
    model = Model("slider_crank_3d", stop_time=2.0)
    q = ca.vertcat(
        model.state("theta", "rad", 0.0, "angle of the crank about x"),
        model.state("s", "m", 0.2, "place of the slider", nominal=0.1),
    )
    u = SX.sym("u", 2)
    pin = ca.vertcat(0, SIDE - CRANK * sin(q[0]), HEIGHT + CRANK * cos(q[0]))
    ends = ca.vertcat(q[1], 0, 0), pin
    v, w = (ca.jtimes((ends[0] + sign * ends[1]) / 2, q, u) for sign in (1, -1))
    inertias = [
        InertialTerm(u, ca.vertcat(CRANK_INERTIA, SLIDER_MASS) * u),
        InertialTerm(v, ROD_MASS * v),  # rod: velocity of its center
        InertialTerm(w, ROD_MASS / 3 * w),  # slender rod: half the relative velocity of its ends
    ]
    loop = {"rod": ca.sumsqr(ends[0] - ends[1]) - ROD**2}
    loads = [Load(v[2], SX(-9.81 * ROD_MASS))]
    found = mechanism(
        model, q, u, inertias, loads, loop, independent=q[0], speed_starts={"theta": 6.0}
    )
    model.energies(found.kinetic_energy, 9.81 * ROD_MASS * pin[2] / 2)
    return model.freeze()
