"""Optimal control and parameter estimation with the derivatives of `cosim.integrator`.

`bring_up` finds the smallest torque in the pin that brings the bar on the turning frame to rest at
90 deg within a second. `masses` estimates three masses of a bicycle from its roll and steer.
"""

import casadi as ca
import numpy as np

import cosim


def bring_up(solver="dop853", intervals=20, compiled=None):
    """Return the torque in each interval (N.m) and the angle at the ends of the intervals (rad)."""
    dae = cosim.load("bar_on_frame/reduced")
    grid = np.linspace(0, 1, intervals + 1)
    run = cosim.integrator(dae, grid, solver=_tight(solver), compiled=compiled)
    names = [variable.name for variable in dae.states]
    control = ca.Opti()
    torque = control.variable(1, intervals)
    u = ca.horzcat(0, torque)  # the first column of u has no effect
    angles = run(**cosim.start_vectors(dae) | {"u": u})["xf"]
    theta, theta_dot = (angles[names.index(name), :] for name in ("theta", "theta_dot"))
    control.minimize(10 * ca.sumsqr(torque) / intervals)
    control.subject_to(theta[-1] == np.pi / 2)
    control.subject_to(theta_dot[-1] == 0)
    options = {"print_level": 0, "tol": 1e-9, "hessian_approximation": "limited-memory"}
    control.solver("ipopt", {"print_time": False}, options | {"sb": "yes", "max_iter": 300})
    found = control.solve()
    return found.value(torque), found.value(theta)


def masses(record=None, solver="dop853", names=("mA", "mB", "mC"), compiled=None):
    """Return the masses of wheel, frame and fork (kg), estimated by the Gauss-Newton method."""
    dae = cosim.load("bicycle")
    grid = np.linspace(0, 2, 41)
    run = cosim.integrator(dae, grid, solver=_tight(solver), compiled=compiled)
    start = cosim.start_vectors(dae)
    rows = [[v.name for v in dae.states].index(name) for name in ("phi", "delta")]
    indices = [[v.name for v in dae.parameters].index(name) for name in names]
    p = ca.MX.sym("p", len(start["p"]))
    signals = ca.vec(run(**start | {"p": p})["xf"][rows, :])
    predicted = ca.Function("predicted", [p], [signals, ca.jacobian(signals, p)])
    if record is None:
        record = np.array(predicted(start["p"])[0]).ravel()
    guess = np.array(start["p"])
    guess[indices] *= 1.1
    for _ in range(8):
        values, slopes = (np.array(part) for part in predicted(guess))
        guess[indices] -= np.linalg.lstsq(slopes[:, indices], values.ravel() - record)[0]
    return guess[indices]


def _tight(name):
    """Return the solver of this name with an integration error far below that of the optimum."""
    solver = cosim.solvers.SOLVERS[name]
    return solver(relative_tolerance=1e-11) if solver.adaptive else solver(step_size=1e-3)


if __name__ == "__main__":
    torque, theta = bring_up()
    print(f"torque {torque[0]:.4f} ... {torque[-1]:.4f} N.m, end {np.degrees(theta[-1]):.6f} deg")
    print("masses", masses(), "kg")
