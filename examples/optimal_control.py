"""Optimal control and estimation through `cosim.integrator`, whose derivatives are right.

`bring_up` finds the least torque on the pin that brings the bar on the turning frame to 90 deg
within a second; `masses` recovers three masses of a bicycle from a record of roll and steer.
"""

import casadi as ca
import numpy as np

import cosim


def bring_up(solver="dop853", intervals=20, compiled=None):
    """Return the torque in each interval, N.m, and the angle at its ends, rad."""
    dae = cosim.load("bar_on_frame/reduced")
    grid = np.linspace(0, 1, intervals + 1)
    run = cosim.integrator(dae, grid, solver=_tight(solver), compiled=compiled)
    names = [variable.name for variable in dae.states]
    control = ca.Opti()
    torque = control.variable(1, intervals)
    u = ca.horzcat(0, torque)  # the first column of u is of no effect
    angles = run(**cosim.start_vectors(dae) | {"u": u})["xf"]
    theta, theta_dot = (angles[names.index(name), :] for name in ("theta", "theta_dot"))
    control.minimize(10 * ca.sumsqr(torque) / intervals)
    control.subject_to(theta[-1] == np.pi / 2)
    control.subject_to(theta_dot[-1] == 0)
    quiet = {"print_level": 0, "tol": 1e-9, "hessian_approximation": "limited-memory"}
    control.solver("ipopt", {"print_time": False}, quiet | {"sb": "yes", "max_iter": 300})
    found = control.solve()
    return found.value(torque), found.value(theta)


def masses(record=None, solver="dop853", names=("mA", "mB", "mC"), compiled=None):
    """Return the masses of wheel, frame and fork that roll and steer tell, kg (Gauss-Newton)."""
    dae = cosim.load("bicycle")
    grid = np.linspace(0, 2, 41)
    run = cosim.integrator(dae, grid, solver=_tight(solver), compiled=compiled)
    given = cosim.start_vectors(dae)
    rows = [[v.name for v in dae.states].index(name) for name in ("phi", "delta")]
    places = [[v.name for v in dae.parameters].index(name) for name in names]
    p = ca.MX.sym("p", len(given["p"]))
    shown = ca.vec(run(**given | {"p": p})["xf"][rows, :])
    seen = ca.Function("seen", [p], [shown, ca.jacobian(shown, p)])
    if record is None:
        record = np.array(seen(given["p"])[0]).ravel()
    guess = np.array(given["p"])
    guess[places] *= 1.1
    for _ in range(8):
        values, slopes = (np.array(part) for part in seen(guess))
        guess[places] -= np.linalg.lstsq(slopes[:, places], values.ravel() - record)[0]
    return guess[places]


def _tight(name):
    """Return a solver by name with numbers so small that only the optimum matters."""
    solver = cosim.solvers.SOLVERS[name]
    return solver(relative_tolerance=1e-11) if solver.adaptive else solver(step_size=1e-3)


if __name__ == "__main__":
    torque, theta = bring_up()
    print(f"torque {torque[0]:.4f} ... {torque[-1]:.4f} N.m, end {np.degrees(theta[-1]):.6f} deg")
    print("masses", masses(), "kg")
