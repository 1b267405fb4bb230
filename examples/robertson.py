"""Robertson's chemical kinetics: a stiff system with rates over nine decades.

Source  H. H. Robertson, 1966; Mazzia & Magherini, Test Set for IVP Solvers, 2008, problem ROBER.
"""

import casadi as ca

import cosim


def build():
    """Return the ODE: 3 states (concentrations)."""
    y = ca.SX.sym("y", 3)
    slow, fast, middle = 0.04 * y[0], 3e7 * y[1] ** 2, 1e4 * y[1] * y[2]
    ode = ca.vertcat(middle - slow, slow - middle - fast, fast)
    return cosim.from_casadi(
        {"x": y, "ode": ode},
        {"y": [1, 0, 0]},
        nominals={"y_2": 1e-5},
        name="robertson",
        stop_time=40.0,
        output_interval=4.0,
    )
