"""Van der Pol's oscillator, very stiff: eps y'' = (1 - y^2) y' - y with eps = 1e-6.

Source  Hairer & Wanner, Solving ODEs II, section IV.10; Test Set for IVP Solvers, problem VDPOL.
"""

import casadi as ca

import cosim


def build():
    """Return the ODE: 2 states (position and velocity)."""
    y, v, eps = ca.SX.sym("y"), ca.SX.sym("v"), ca.SX.sym("eps")
    ode = ca.vertcat(v, ((1 - y**2) * v - y) / eps)
    return cosim.from_casadi(
        {"x": ca.vertcat(y, v), "p": eps, "ode": ode},
        {"y": 2, "v": 0, "eps": 1e-6},
        name="van_der_pol",
        stop_time=2.0,
    )
