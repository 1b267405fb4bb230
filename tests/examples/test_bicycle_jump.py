"""A bicycle jumps off a bump: energy, flight, landings, and the same events by every backend."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

import cosim
from cosim.model.catalogue import load

FILE = Path(__file__).parents[2] / "examples" / "bicycle_jump.py"
SEQUENCE = [
    "front wheel loses grip",
    "front wheel lifts off",
    "rear wheel loses grip",
    "rear wheel lifts off",
    "front wheel lands",
    "rear wheel lands",
]
# The benchmark bicycle: forward and upward places, m, and masses, kg, of its bodies
BODIES = {"A": (0, 0.3, 2), "B": (0.3, 0.9, 85), "C": (0.9, 0.7, 4), "D": (1.02, 0.35, 3)}
MASS = sum(m for *_, m in BODIES.values())
FORWARD = sum(m * x for x, _, m in BODIES.values()) / MASS
SPIN_INERTIA = {"A": 0.12, "D": 0.28}  # kg.m2
G = 9.81  # m/s2


@cache
def model():
    return load(f"{FILE}:build")


@cache
def jump(solver="dop853", tolerance=1e-10):
    return cosim.simulate(model(), solver=solver, relative_tolerance=tolerance)


def event(name):
    return next(event for event in jump().events if event.name == name)


# Largest relative change of energy + loss; measured 3e-12, 5e-12, 5e-10, 4e-7
@pytest.mark.slow
@pytest.mark.parametrize(
    ("solver", "tolerance", "bound"),
    [
        ("dop853", 1e-10, 1e-8),
        ("rosenbrock", 1e-10, 1e-8),
        ("cvodes", 1e-10, 1e-8),
        ("dop853", 1e-6, 5e-6),
    ],
)
def test_energy_and_loss_are_constant(solver, tolerance, bound):
    run = jump(solver, tolerance)
    assert abs((run["energy"] + run["loss"]) / run["energy"][0] - 1).max() < bound
    assert run.final["loss"] == pytest.approx(138.295172, abs=1e-3)  # J, of 3.1 kJ


@pytest.mark.slow
def test_what_rises_after_an_event_is_no_event_again():
    """A wheel's gap grows from 0 as t^2: at first, a solver's error is larger and of any sign."""
    run = cosim.simulate(model(), solver="cvodes", stop_time=0.4)
    assert run.stats.steps < 1000  # 476; 3,288 with events by errors


@pytest.mark.slow_rows("values0", "values1")
@pytest.mark.parametrize("values", [{"x_dot": 4.0}, {"x_dot": 10.0}, {"height": 0.02}])
def test_energy_and_loss_are_constant_at_other_speeds_and_bumps(values):
    options = {"solver": "dop853", "relative_tolerance": 1e-10, "start_values": values}
    run = cosim.simulate(model(), **options)
    assert run.events
    assert abs((run["energy"] + run["loss"]) / run["energy"][0] - 1).max() < 1e-8  # 2e-12 to 1e-11
    for wheel in "AD":
        assert run[f"normal{wheel}"].min() > -1e-9  # N


@pytest.mark.slow_rows("rosenbrock", "erk", "cvodes")
@pytest.mark.parametrize("solver", ["dop853", "rosenbrock", "cvodes", "erk"])
def test_wheels_lift_off_fly_and_land(solver):
    run = jump(solver)
    assert [event.name for event in run.events] == SEQUENCE
    times = [event.time for event in run.events]
    reference = [event.time for event in jump().events]
    assert times == pytest.approx(reference, abs=5e-8)  # s; measured 3e-9 (cvodes)


def test_the_ground_only_pushes_and_wheels_do_not_sink_into_it():
    run = jump()
    for wheel in "AD":
        assert run[f"normal{wheel}"].min() > -1e-9  # N; measured 0
        assert run[f"gap{wheel}"].min() > -2e-9  # m; measured -1e-9, the clearance of a landing
        assert run[f"gap{wheel}"].max() > 0.1
    for landing in ("front wheel lands", "rear wheel lands"):
        values = event(landing).after
        assert min(values["impulseA"], values["impulseD"]) >= 0  # N s; measured 0, 10, 51, 102


def test_no_variable_is_far_above_its_nominal_value():
    """By it, differences of FMUs are measured: 138 J lost had the nominal value 1 J."""
    for column, values in zip(jump().columns, jump().values.T, strict=True):
        assert abs(values).max() < 100 * column.nominal, column.name


def test_weight_is_on_both_wheels_at_the_start():
    run = jump()
    assert run["normalA"][0] == pytest.approx(MASS * G * (1 - FORWARD / 1.02), rel=1e-12)
    assert run["normalD"][0] == pytest.approx(MASS * G * FORWARD / 1.02, rel=1e-12)


def test_the_mass_center_flies_along_a_parabola_while_both_wheels_are_in_the_air():
    start, end = event("rear wheel lifts off"), event("front wheel lands")
    assert end.time - start.time == pytest.approx(0.162615, abs=1e-5)  # s
    run = jump()
    inside = (run.time > start.time) & (run.time < end.time)
    assert inside.sum() > 30
    t = run.time[inside] - start.time
    first = start.after
    height = first["z"] + first["z_dot"] * t - G * t**2 / 2
    # Measured 3e-16 m, 2e-15 m, 6e-17 rad
    np.testing.assert_allclose(run["z"][inside], height, rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        run["x"][inside], first["x"] + first["x_dot"] * t, rtol=0, atol=1e-12
    )
    np.testing.assert_allclose(
        run["theta"][inside], first["theta"] + first["theta_dot"] * t, rtol=0, atol=1e-12
    )


def test_landing_of_the_front_wheel_keeps_the_angular_momentum_about_its_contact():
    """The impulse acts there; the spin of the rear wheel, in the air, does not change."""
    landing = event("front wheel lands")
    before, after = landing.before, landing.after
    up = sum(m * z for _, z, m in BODIES.values()) / MASS
    inertia = 11.0 + 0.06  # of frame and fork
    inertia += sum(m * ((x - FORWARD) ** 2 + (z - up) ** 2) for x, z, m in BODIES.values())
    place = before["sD"], 0.1 * np.exp(-(((before["sD"] - 3.5) / 0.4) ** 2))

    def momentum(values):  # kg.m2/s, nose up
        arm = values["x"] - place[0], values["z"] - place[1]
        orbital = MASS * (arm[0] * values["z_dot"] - arm[1] * values["x_dot"])
        spins = sum(i * values[f"spin{wheel}"] for wheel, i in SPIN_INERTIA.items())
        return orbital + inertia * values["theta_dot"] - spins

    assert momentum(after) == pytest.approx(momentum(before), rel=1e-8)  # clearance: 1e-9 m
    assert after["spinA"] == before["spinA"]
    lost = before["energy"] - after["energy"]
    assert lost == pytest.approx(after["loss"] - before["loss"], rel=1e-10)
    assert lost > 40  # J


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    path = tmp_path_factory.mktemp("jump") / "bicycle_jump.fmu"
    return cosim.export_fmu(model(), path, solver="dop853")


# Largest difference of final values from native simulation; measured 2e-12 and, with an importer
# that starts anew at each place of the bump, 9e-7 of the value
@pytest.mark.nightly
@pytest.mark.parametrize(("interface", "bound"), [("CoSimulation", 1e-10), ("ModelExchange", 2e-6)])
def test_an_fmu_jumps_as_the_native_model_does(fmu, interface, bound):
    names = ("x", "z", "theta", "x_dot", "z_dot", "theta_dot", "spinA", "spinD", "loss")
    run = cosim.simulate_fmu(
        fmu, interface=interface, relative_tolerance=1e-10, outputs=[*names, "energy"]
    )
    for name in names:
        assert run[name][-1] == pytest.approx(jump()[name][-1], rel=bound, abs=bound)
    assert abs((run["energy"] + run["loss"]) / run["energy"][0] - 1).max() < bound
