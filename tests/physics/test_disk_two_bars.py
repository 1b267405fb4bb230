"""Two bars below a turning disk against Lagrange's and Newton's laws and the static equilibrium."""

from functools import cache

import numpy as np
import pytest
import sympy as sp
from helpers.equations import Equations
from scipy.integrate import cumulative_simpson
from scipy.optimize import fsolve

import casadi_models
from casadi_models.units import FOOT, FOOT_POUND, SLUG

FORMULATIONS = ("reduced", "multipliers")
FORCES = ("f1_H1", "f2_H1", "f3_H1", "f1_H2", "f2_H2", "f3_H2")
OUTPUTS = dict.fromkeys(FORCES, "N")
OUTPUTS |= dict.fromkeys(("M_disk", "spring_torque_1", "spring_torque_2"), "N.m")
OUTPUTS |= dict.fromkeys(("kinetic_energy", "potential_energy", "energy"), "J")
STATES = ["theta1", "theta2", "theta1_dot", "theta2_dot", "phi"]
# Data of Exercise 7.1, SI
MASS, LENGTH, RADIUS = 0.1 * SLUG, 2 * FOOT, 0.1 * FOOT
REACH, DROP, OMEGA, G = 0.5 * FOOT, 0.2 * FOOT, 2 * np.pi, 32.174 * FOOT
K1, K2, C1, C2 = (value * FOOT_POUND for value in (50, 5, 4, 0.4))


def load(formulation):
    return Equations(casadi_models.load(f"disk_two_bars/{formulation}"))


@pytest.fixture(scope="module", params=FORMULATIONS)
def disk(request):
    return load(request.param)


@pytest.fixture(scope="module")
def twins():
    return [load(name) for name in FORMULATIONS]


def random_state(rng):
    angles, rates = rng.uniform(-3, 3, 2), rng.uniform(-10, 10, 2)
    return dict(zip(STATES, [*angles, *rates, rng.uniform(-7, 7)], strict=True))


@cache
def lagrange():
    """Return M_disk, generalized forces of theta1 and theta2 and the hinge forces of the contract.

    Derived from places and rotation matrices in the world alone, as functions of the angles
    (phi, theta1, theta2), their rates and accelerations.
    """
    t = sp.Symbol("t")
    angles = [sp.Function(name)(t) for name in ("phi", "theta1", "theta2")]
    phi, *thetas = angles
    across = MASS * (3 * RADIUS**2 + LENGTH**2) / 12
    inertia = sp.diag(across, across, MASS * RADIUS**2 / 2)
    in_world = sp.rot_ccw_axis3(phi)  # R of D in the world
    kinetic, potential, forces = sp.Integer(0), sp.Integer(0), []
    joint = in_world * sp.Matrix([0, REACH, -DROP])
    for theta in thetas:
        rotation = in_world * sp.rot_ccw_axis1(theta)
        center = joint - rotation * sp.Matrix([0, 0, LENGTH / 2])
        joint = joint - rotation * sp.Matrix([0, 0, LENGTH])
        spin = rotation.T * rotation.diff(t)  # skew matrix of the angular velocity in the bar
        omega = sp.Matrix([spin[2, 1], spin[0, 2], spin[1, 0]])
        velocity = center.diff(t)
        kinetic += MASS * velocity.dot(velocity) / 2 + omega.dot(inertia * omega) / 2
        potential += MASS * G * center[2]
        forces.append(in_world.T * MASS * (center.diff(t, 2) + sp.Matrix([0, 0, G])))
    theta1, theta2 = thetas
    potential += K1 * theta1**2 / 2 + K2 * (theta2 - theta1) ** 2 / 2
    relative = theta2.diff(t) - theta1.diff(t)
    dissipation = C1 * theta1.diff(t) ** 2 / 2 + C2 * relative**2 / 2  # Rayleigh's
    loads = [
        kinetic.diff(q.diff(t)).diff(t)
        - (kinetic - potential).diff(q)
        + dissipation.diff(q.diff(t))
        for q in angles
    ]
    on_bar_2 = forces[1]
    results = [*loads, *(forces[0] + on_bar_2), *on_bar_2]
    symbols = sp.symbols("q:3 v:3 a:3")
    orders = [(q.diff(t, order) if order else q) for order in (0, 1, 2) for q in angles]
    plain = dict(zip(orders, symbols, strict=True))
    replaced = [sp.sympify(e).subs(list(reversed(plain.items()))) for e in results]
    return sp.lambdify(symbols, replaced, cse=True)


def test_every_formulation_has_the_outputs_of_the_contract(disk):
    assert {name: disk.dae.variable(name).unit for name in OUTPUTS} == OUTPUTS
    assert [v.name for v in disk.dae.states[:5]] == STATES


@pytest.mark.slow
def test_accelerations_and_loads_are_those_of_lagrange_and_newton(disk):
    rng = np.random.default_rng(1)
    for _ in range(100):
        values = random_state(rng)
        at, rates = disk(**values), disk.rates(**values)
        theta1, theta2, rate1, rate2, phi = values.values()
        acceleration1, acceleration2 = rates["theta1_dot"], rates["theta2_dot"]
        drive, *rest = lagrange()(
            *(phi, theta1, theta2), *(OMEGA, rate1, rate2), *(0.0, acceleration1, acceleration2)
        )
        assert np.abs(rest[:2]).max() < 1e-11  # N.m of 230; measured 2e-13
        assert at["M_disk"] == pytest.approx(drive, rel=0, abs=1e-12)  # N.m of 74; measured 7e-14
        forces = [at[name] for name in FORCES]
        np.testing.assert_allclose(forces, rest[2:], rtol=0, atol=1e-11)  # N of 480; measured 1e-12


@pytest.mark.slow
def test_formulations_agree_at_random_states(twins):
    rng = np.random.default_rng(2)
    for _ in range(1000):
        values = random_state(rng)
        values |= {"Omega": rng.uniform(-20, 20), "g": rng.uniform(0, 20)}
        values |= {name: rng.uniform(0.1, 2) for name in ("bar_mass", "bar_length", "hinge_radius")}
        values |= {name: rng.uniform(0, 50) for name in ("k1", "k2", "c1", "c2")}
        one, other = (equations(**values) for equations in twins)
        scale = max(abs(one[name]) for name in OUTPUTS)
        for name in OUTPUTS:
            assert other[name] == pytest.approx(one[name], rel=0, abs=1e-13 * scale)  # 2e-15
        rates = [equations.rates(**values) for equations in twins]
        for name in ("theta1_dot", "theta2_dot"):
            assert rates[1][name] == pytest.approx(rates[0][name], rel=1e-11)  # measured 2e-13


def test_spring_torques_are_hookes_with_damping(disk):
    values = {"theta1": 0.3, "theta2": -0.2, "theta1_dot": 2.0, "theta2_dot": 5.0}
    at = disk(**values)
    assert at["spring_torque_1"] == pytest.approx(-K1 * 0.3 - C1 * 2.0, rel=1e-14)
    assert at["spring_torque_2"] == pytest.approx(K2 * 0.5 - C2 * 3.0, rel=1e-14)


@pytest.mark.slow
def test_drive_less_dampers_is_the_rate_of_energy_at_random_states(disk):
    rng = np.random.default_rng(3)
    for _ in range(200):
        values = random_state(rng)
        relative = values["theta2_dot"] - values["theta1_dot"]
        damped = C1 * values["theta1_dot"] ** 2 + C2 * relative**2
        power = disk(**values)["M_disk"] * OMEGA - damped
        # W of 1000; measured 1e-12
        assert disk.rates(**values)["energy"] == pytest.approx(power, rel=0, abs=1e-10)


@pytest.mark.slow
def test_drive_less_dampers_adds_up_to_the_energy_over_the_run(disk):
    run = disk.run(20.0, rtol=1e-11, points=20001)
    relative = run["theta2_dot"] - run["theta1_dot"]
    power = run["M_disk"] * OMEGA - C1 * run["theta1_dot"] ** 2 - C2 * relative**2
    work = cumulative_simpson(power, x=run["time"], initial=0.0)
    error = run["energy"] - run["energy"][0] - work
    assert np.abs(error).max() < 1e-8 * np.abs(run["energy"]).max()  # measured 5e-10


def turning_potential(theta):
    """Return gravity, springs and centrifugal potential, the bars being cut into thin slices."""
    theta1, theta2 = theta
    stations, weights = np.polynomial.legendre.leggauss(3)  # exact for squares along a bar
    stations, weights = (stations + 1) / 2 * LENGTH, weights / 2 * MASS
    total = K1 * theta1**2 / 2 + K2 * (theta2 - theta1) ** 2 / 2
    reach, height = REACH, -DROP
    for angle in (theta1, theta2):
        radial = reach + stations * np.sin(angle)
        # a slice of radius r has its mean squares r^2/4 across the bar, along and across e1
        spread = RADIUS**2 / 4 * (1 + np.cos(angle) ** 2)
        total += np.sum(weights * G * (height - stations * np.cos(angle)))
        total -= np.sum(weights * OMEGA**2 / 2 * (radial**2 + spread))
        reach, height = reach + LENGTH * np.sin(angle), height - LENGTH * np.cos(angle)
    return total


def turning_torque(theta):
    """Return the gradient of the potential, by complex steps."""
    steps = 1e-30j * np.eye(2)
    return [turning_potential(theta + step).imag / 1e-30 for step in steps]


@pytest.mark.slow_rows("multipliers")
def test_final_angles_are_the_static_equilibrium_in_the_turning_frame(disk):
    static = fsolve(turning_torque, [0.5, 0.5], xtol=1e-14)
    run = disk.run(20.0, rtol=1e-12)
    final = [run["theta1"][-1], run["theta2"][-1]]
    np.testing.assert_allclose(final, static, rtol=0, atol=1e-9)  # rad; measured 1e-11


def test_bars_stay_in_their_hinges():
    equations = load("multipliers")
    rtol = 1e-8
    run = equations.run(20.0, rtol=rtol)
    for name in (v.name for v in equations.dae.states[5:]):
        assert np.abs(run[name]).max() < 1e-2 * rtol  # m, rad, per second; measured 7e-13


def test_bars_hang_still_below_a_disk_at_rest(disk):
    at, rates = disk(Omega=0.0), disk.rates(Omega=0.0)
    assert abs(rates["theta1_dot"]) + abs(rates["theta2_dot"]) < 1e-14
    assert at["f3_H1"] == pytest.approx(2 * MASS * G, rel=1e-14)
    assert at["f3_H2"] == pytest.approx(MASS * G, rel=1e-14)
