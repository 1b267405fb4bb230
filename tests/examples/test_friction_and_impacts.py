"""Examples with dry friction and impacts against their closed forms."""

from math import atan2, cos, pi, sin, sqrt
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import ellipk

import cosim

FOLDER = Path(__file__).parents[2] / "examples"
G = 9.81  # m/s2
SOLVERS = pytest.mark.parametrize(
    ("solver", "bound"), [("dop853", 1e-9), ("rosenbrock", 1e-8), ("cvodes", 2e-7)]
)


def run_of(name, solver, **options):
    path = f"{FOLDER / name}.py:build"
    return cosim.simulate(path, solver=solver, relative_tolerance=1e-10, **options)


def times(run, name):
    return [event.time for event in run.events if event.name == name]


# Largest error of 8 and 7 times; measured 4e-10, 4e-10, 4e-8 s
@pytest.mark.quick_rows("cvodes-2e-07")
@SOLVERS
def test_the_block_on_the_belt_sticks_and_slips_with_the_period_of_the_closed_form(solver, bound):
    run = run_of("belt", solver)
    torn, middle, rate, belt = 0.08 * G / 4, 0.04 * G / 4, 2.0, 0.1  # m, m, rad/s, m/s
    slip = (pi + 2 * atan2(belt / rate, torn - middle)) / rate
    period = slip + 2 * (torn - middle) / belt
    tears = torn / belt + period * np.arange(8)
    np.testing.assert_allclose(times(run, "friction slides"), tears, rtol=0, atol=bound)
    sticks = times(run, "friction sticks")
    np.testing.assert_allclose(sticks, tears[: len(sticks)] + slip, rtol=0, atol=bound)
    amplitude = sqrt((torn - middle) ** 2 + (belt / rate) ** 2)
    assert run["x"].max() == pytest.approx(middle + amplitude, abs=1e-4)  # between two rows
    assert run["v"].max() < belt + 1e-7  # it is never faster than the belt


# Largest error of 9 times; measured 1e-11, 1e-11, 2e-9 s
@pytest.mark.quick_rows("cvodes-2e-07")
@SOLVERS
def test_the_pendulum_meets_its_stop_at_the_times_of_elliptic_integrals(solver, bound):
    run = run_of("pendulum_stop", solver)
    own = sqrt(G / 0.4)  # rad/s
    fastest = 2 * own * sin(1.0)  # rad/s, at the first impact
    swings = [2 * ellipk((0.8**n * sin(1.0)) ** 2) / own for n in range(1, 9)]
    expected = np.cumsum([ellipk(sin(1.0) ** 2) / own, *swings])
    np.testing.assert_allclose(times(run, "stop"), expected, rtol=0, atol=bound)
    for n, event in enumerate(run.events):
        assert event.before["rate"] == pytest.approx(-(0.8**n) * fastest, rel=10 * bound)
        assert event.after["rate"] == pytest.approx(0.8 ** (n + 1) * fastest, rel=10 * bound)
    assert run["theta"].min() > -1e-12


def crank(phi):
    """Return the place of the slider, m, and its derivative by the angle of the crank."""
    rod = sqrt(0.09 - (0.1 * sin(phi)) ** 2)
    return 0.1 * cos(phi) + rod, -0.1 * sin(phi) - 0.01 * sin(phi) * cos(phi) / rod


@pytest.mark.slow
def test_the_crank_runs_down_along_the_travel_of_its_slider():
    """Kinetic energy = that at the start - mu N (travel); the motion is a quadrature."""

    def mass(phi):
        return 0.01 + crank(phi)[1] ** 2

    first = mass(0.5) * 12**2 / 2  # J

    def energy(phi):
        back = crank(max(phi, pi))[0] - crank(pi)[0]  # travel after the dead center, m
        return first - 20.0 * 0.2 * (crank(0.5)[0] - crank(min(phi, pi))[0] + back)

    end = brentq(energy, pi, 2 * pi, xtol=1e-15)
    before = quad(lambda phi: sqrt(mass(phi) / 2 / energy(phi)), 0.5, pi, epsabs=1e-13)[0]

    def near_end(w):  # phi = end - w^2: the integrand is smooth
        phi = end - w * w
        return 2 * w * sqrt(mass(phi) / 2 / energy(phi)) if w > 1e-7 else limit

    limit = 2 * sqrt(mass(end) / 2 / (4.0 * crank(end)[1]))
    after = quad(near_end, 0.0, sqrt(end - pi), epsabs=1e-13)[0]
    # Measured: times 9e-12, 4e-12, 6e-10 s; angle 4e-11, 2e-11, 6e-9 rad
    for solver, bound in (("dop853", 1e-9), ("rosenbrock", 1e-9), ("cvodes", 1e-7)):
        run = run_of("slider_crank_friction", solver)
        assert len(run.events) == 2  # the dead center, and rest
        assert run.events[0].time == pytest.approx(before, abs=bound)
        assert run.events[1].time == pytest.approx(before + after, abs=bound)
        assert run.final["phi"] == pytest.approx(end, abs=bound)
        assert abs(run["omega"][run.time > before + after + 0.01]).max() < 1e-12
        expected = [energy(phi) for phi in run["phi"]]
        np.testing.assert_allclose(run["energy"], expected, rtol=0, atol=bound)  # J


@pytest.mark.slow
@pytest.mark.parametrize("name", ["belt", "pendulum_stop", "slider_crank_friction"])
def test_fmus_of_these_examples_agree_with_native_simulation(name, tmp_path):
    dae = cosim.load(f"{FOLDER / name}.py:build")
    path = cosim.export_fmu(dae, tmp_path / "x.fmu", solver="dop853")
    names = [variable.name for variable in dae.variables if variable.name in {
        "x", "v", "theta", "rate", "phi", "omega"}]  # fmt: skip
    native = run_of(name, "dop853")
    # Measured 6e-11 and 2e-7
    for interface, bound in (("CoSimulation", 1e-9), ("ModelExchange", 1e-5)):
        run = cosim.simulate_fmu(path, interface=interface, outputs=names, relative_tolerance=1e-10)
        for variable in names:
            assert run[variable][-1] == pytest.approx(native[variable][-1], abs=bound)
