"""HIRES: a stiff model of how light controls a plant's growth, with eight concentrations.

Source  Schaefer, 1975; Hairer & Wanner, Solving ODEs II, section IV.10; Test Set for IVP Solvers.
"""

import casadi as ca

import cosim


def build():
    """Return the ODE: 8 states (concentrations)."""
    y = ca.SX.sym("y", 8)
    y1, y2, y3, y4, y5, y6, y7, y8 = ca.vertsplit(y)
    ode = ca.vertcat(
        -1.71 * y1 + 0.43 * y2 + 8.32 * y3 + 0.0007,
        1.71 * y1 - 8.75 * y2,
        -10.03 * y3 + 0.43 * y4 + 0.035 * y5,
        8.32 * y2 + 1.71 * y3 - 1.12 * y4,
        -1.745 * y5 + 0.43 * y6 + 0.43 * y7,
        -280 * y6 * y8 + 0.69 * y4 + 1.71 * y5 - 0.43 * y6 + 0.69 * y7,
        280 * y6 * y8 - 1.81 * y7,
        -280 * y6 * y8 + 1.81 * y7,
    )
    return cosim.from_casadi(
        {"x": y, "ode": ode},
        {"y_1": 1, "y_8": 0.0057},
        nominals={"y": 1e-3},
        name="hires",
        stop_time=321.8122,
        output_interval=3.218122,
    )
