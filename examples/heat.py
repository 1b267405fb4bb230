"""Heat equation on a rod with cold ends, discretized by central differences on 200 nodes.

Source  Closed form: the slowest mode sin(pi x) decays at the rate (2/h)^2 sin(pi h/2)^2.
"""

import casadi as ca
import numpy as np

import cosim

NODES = 200
H = 1 / (NODES + 1)


def build():
    """Return the ODE: 200 states (temperatures)."""
    T = ca.MX.sym("T", NODES)
    flow = ca.diff(ca.vertcat(0, T, 0)) / H
    return cosim.from_casadi(
        {"x": T, "ode": ca.diff(flow) / H},
        {"T": np.sin(np.pi * H * np.arange(1, NODES + 1))},
        {"middle": (T[NODES // 2 - 1] + T[NODES // 2]) / 2},
        units={"T": "K", "middle": "K"},
        name="heat",
        stop_time=0.1,
        output_interval=0.01,
    )
