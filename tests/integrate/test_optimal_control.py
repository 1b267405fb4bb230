"""Optimal control and estimation through `integrator`: the same answer by every solver."""

import sys
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import cosim
from cosim.integrate.solvers import SOLVERS

sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))
from optimal_control import bring_up, masses

WAYS = [(name, True) for name in SOLVERS] + [
    (name, False) for name in ("cvodes", "idas", "erk", "rosenbrock")
]


@cache
def best():
    return bring_up("dop853")


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("cvodes-True", "ode8-True", "cvodes-False", "idas-False", "rosenbrock-False")
@pytest.mark.parametrize(("solver", "compiled"), WAYS)
def test_every_solver_brings_the_bar_up_with_the_same_torque(solver, compiled):
    torque, theta = bring_up(solver, compiled=compiled)
    assert theta[-1] == pytest.approx(np.pi / 2, abs=1e-8)
    np.testing.assert_allclose(torque, best()[0], rtol=0, atol=1e-6)  # N.m; measured 3e-10


def test_optimum_is_one():
    """The gradient of the cost is a combination of the constraints' gradients (differences)."""
    torque, _ = best()
    dae = cosim.load("bar_on_frame/reduced")
    run = cosim.integrator(
        dae, np.linspace(0, 1, 21), solver="dop853", relative_tolerance=1e-12, derivatives=False
    )
    given = cosim.start_vectors(dae)
    rows = [[v.name for v in dae.states].index(n) for n in ("theta", "theta_dot")]

    def end(u):
        return np.array(run(**given | {"u": np.concatenate(([0.0], u))[None]})["xf"])[rows, -1]

    h = 1e-4
    slopes = np.array([(end(torque + d) - end(torque - d)) / (2 * h) for d in h * np.eye(20)])
    price = np.linalg.lstsq(slopes, torque)[0]
    np.testing.assert_allclose(slopes @ price, torque, rtol=0, atol=1e-5)  # measured 1e-7


@pytest.mark.slow
def test_three_masses_are_recovered_from_roll_and_steer():
    found = masses()
    np.testing.assert_allclose(found, [2.0, 85.0, 4.0], rtol=1e-6)  # measured 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["cvodes", "erk", "rosenbrock"])
def test_other_solvers_recover_the_masses_from_the_record_of_one(solver):
    found = masses(solver=solver)
    np.testing.assert_allclose(found, [2.0, 85.0, 4.0], rtol=1e-6)


@pytest.mark.slow
def test_ipopt_fits_two_masses_in_few_iterations_with_every_solver():
    dae = cosim.load("bicycle")
    given, grid = cosim.start_vectors(dae), np.linspace(0, 2, 41)
    record = cosim.integrator(dae, grid, solver="dop853", relative_tolerance=1e-12)(**given)["xf"]
    sizes = np.abs(np.array(record)).max(axis=1, keepdims=True) + 1e-12
    which = [[v.name for v in dae.parameters].index(name) for name in ("mB", "mC")]
    iterations = {}
    for solver in ("dop853", "cvodes", "rosenbrock"):
        run = cosim.integrator(dae, grid, solver=solver, relative_tolerance=1e-6)
        shares, p = ca.MX.sym("shares", 2), ca.MX(given["p"])
        for i, share in zip(which, ca.vertsplit(shares), strict=True):
            p[i] *= share
        apart = (run(**given | {"p": p})["xf"] - record) / ca.repmat(ca.DM(sizes), 1, len(grid))
        problem = {"x": shares, "f": ca.sumsqr(apart)}
        quiet = {"ipopt.print_level": 0, "print_time": 0, "ipopt.sb": "yes"}
        options = {"ipopt.hessian_approximation": "limited-memory", "ipopt.max_iter": 100}
        fit = ca.nlpsol("fit", "ipopt", problem, options | quiet)
        found = np.array(fit(x0=[1.2, 0.8], lbx=0.3, ubx=3)["x"]).ravel()
        np.testing.assert_allclose(found, 1, rtol=0, atol=1e-4)
        iterations[solver] = fit.stats()["iter_count"]
    assert max(iterations.values()) <= 3 * iterations["dop853"]
