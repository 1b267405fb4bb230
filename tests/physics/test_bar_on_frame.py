"""The bar on a turning frame against Unit 7, Example 2, Newton, Euler and conservation laws."""

import numpy as np
import pytest
from helpers.equations import Equations

import casadi_models
from casadi_models.units import FOOT, FOOT_POUND, INCH, SLUG, convert

FORMULATIONS = ("reduced", "two_body")
FORCES = ("f1_G_F", "f2_G_F", "fk_G_F", "f1_G_B", "f2_G_B", "f3_G_B")
FORCES += ("f1_A_F", "f2_A_F", "f1_B_F", "f2_B_F")
TORQUES = ("t1_G_F", "t2_G_F", "tk_G_F", "t1_G_B", "t2_G_B", "t3_G_B", "M_phi")
OUTPUTS = dict.fromkeys(FORCES, "N") | dict.fromkeys(TORQUES, "N.m")
OUTPUTS |= dict.fromkeys(("wx_bar", "wy_bar", "wz_bar"), "rad/s")
OUTPUTS |= dict.fromkeys(("ax_bar", "ay_bar", "az_bar"), "rad/s2")
OUTPUTS |= dict.fromkeys(("kinetic_energy", "potential_energy", "energy"), "J")
# The book's Model 2, in kg and m
MASS, ARM, BAR_INERTIA = 0.2 * SLUG, FOOT, 0.2 / 12 * SLUG * FOOT**2
COLUMN_MASS, ARM_MASS = 0.01 * SLUG, 0.005 * SLUG
FRAME_INERTIA = COLUMN_MASS * (0.5 * INCH) ** 2 / 2 + ARM_MASS * ARM**2 / 3
UNDRIVEN = {"b": 0.0, "Omega_dot": 0.0}


def load(formulation):
    return Equations(casadi_models.load(f"bar_on_frame/{formulation}"))


@pytest.fixture(scope="module", params=FORMULATIONS)
def bar(request):
    return load(request.param)


@pytest.fixture(scope="module")
def reduced():
    return load("reduced")


@pytest.fixture(scope="module")
def two_body():
    return load("two_body")


def random_state(rng):
    return {
        "theta": rng.uniform(-7, 7),
        "theta_dot": rng.uniform(-10, 10),
        "phi": rng.uniform(-7, 7),
        "Omega": rng.uniform(-20, 20),
        "Omega_dot": rng.uniform(-5, 5),
        "T2": rng.uniform(-1, 1),
    }


def test_every_formulation_has_the_outputs_of_the_contract(bar):
    assert {name: bar.dae.variable(name).unit for name in OUTPUTS} == OUTPUTS
    assert [v.name for v in bar.dae.states[:4]] == ["theta", "theta_dot", "phi", "Omega"]


def test_loads_of_the_pin_are_the_closed_forms_of_unit_2(bar):
    rng = np.random.default_rng(1)
    for _ in range(200):
        values = random_state(rng)
        at = bar(**values)
        s, c = np.sin(values["theta"]), np.cos(values["theta"])
        Omega, Omega_dot, theta_dot = (values[n] for n in ("Omega", "Omega_dot", "theta_dot"))
        f1, f2 = -MASS * ARM * Omega_dot, -MASS * ARM * Omega**2
        t3 = BAR_INERTIA * (Omega_dot * c - 2 * theta_dot * Omega * s)
        forces = {"f1_G_F": f1, "f2_G_F": f2, "fk_G_F": 0}
        forces |= {"f1_G_B": f1 * c, "f2_G_B": f2, "f3_G_B": f1 * s}
        torques = {"t1_G_F": t3 * s, "tk_G_F": t3 * c, "t1_G_B": 0, "t3_G_B": t3}
        for name, load in (forces | torques).items():
            # rounding of the largest load, f2; measured 1e-13 N of 360 N
            assert at[name] == pytest.approx(load, rel=0, abs=1e-14 * max(abs(f2), 1))


def test_bar_obeys_the_differential_equation_of_unit_2(bar):
    rng = np.random.default_rng(2)
    for _ in range(200):
        values = random_state(rng)
        t2 = values["T2"] - 0.02 * FOOT_POUND * values["theta_dot"]
        assert bar(**values)["t2_G_F"] == pytest.approx(t2, rel=1e-14)
        restoring = values["Omega"] ** 2 * np.sin(values["theta"]) * np.cos(values["theta"])
        expected = t2 / BAR_INERTIA - restoring
        # rad/s2 of 210; measured 3e-14
        assert bar.rates(**values)["theta_dot"] == pytest.approx(expected, rel=0, abs=1e-12)


@pytest.mark.parametrize("frame_inertia", [0.0, 1.0])
def test_drive_torque_is_the_moment_of_the_pin_loads_and_the_frames_inertia(bar, frame_inertia):
    rng = np.random.default_rng(3)
    for _ in range(200):
        values = random_state(rng)
        at = bar(**values, frame_inertia=frame_inertia)
        moment = at["tk_G_F"] - ARM * at["f1_G_F"]
        moment += frame_inertia * FRAME_INERTIA * values["Omega_dot"]
        assert at["M_phi"] == pytest.approx(moment, rel=0, abs=2e-14)  # N.m of 3.5; measured 9e-16


@pytest.mark.slow
def test_formulations_agree_at_random_states(reduced, two_body):
    rng = np.random.default_rng(4)
    for i in range(1000):
        values = random_state(rng)
        values |= {"frame_inertia": float(i % 2), "weld_height": rng.uniform(0.1, 0.6)}
        values |= {name: rng.uniform(0.1, 3) for name in ("m", "d", "length", "column_length")}
        values |= {name: rng.uniform(0.01, 1) for name in ("b", "arm_mass", "column_radius")}
        one, other = reduced(**values), two_body(**values)
        scale = max(abs(one[name]) for name in OUTPUTS)
        for name in OUTPUTS:
            # the largest output is the scale; measured 8e-15
            assert other[name] == pytest.approx(one[name], rel=0, abs=1e-12 * scale)
        rates = [equations.rates(**values)["theta_dot"] for equations in (reduced, two_body)]
        assert rates[1] == pytest.approx(rates[0], rel=1e-12, abs=1e-12)  # measured 2e-15


def test_two_body_algebra_is_regular_though_the_bar_has_no_axial_inertia(two_body):
    rng = np.random.default_rng(5)
    for i in range(50):
        values = random_state(rng)
        condition = np.linalg.cond(two_body.matrix(**values, frame_inertia=float(i % 2)))
        assert condition < 1e4  # measured 315


def test_bearings_bear_the_pin_loads_and_the_inertia_of_column_and_arm_at_every_sample(two_body):
    run = two_body.run(10.0, rtol=1e-8)
    # The column's center rests on the axis; the arm's center circles at half the arm's length
    arm_1, arm_2 = (-ARM_MASS * ARM / 2 * rate for rate in (1.0, run["Omega"] ** 2))
    sum_1 = run["f1_A_F"] + run["f1_B_F"] - run["f1_G_F"] - arm_1
    sum_2 = run["f2_A_F"] + run["f2_B_F"] - run["f2_G_F"] - arm_2
    assert np.abs(sum_1).max() < 1e-12  # N; measured 5e-14
    assert np.abs(sum_2).max() < 1e-12  # N of 236; measured 4e-14


def test_bearing_moments_about_the_foot_balance_pin_and_arm(bar):
    rng = np.random.default_rng(6)
    weld, top = 18 * INCH, 24 * INCH
    for _ in range(200):
        values = random_state(rng)
        at = bar(**values)
        arm_1, arm_2 = (-ARM_MASS * ARM / 2 * values[n] for n in ("Omega_dot", "Omega"))
        arm_2 *= values["Omega"]
        about_1 = -top * at["f2_B_F"] + weld * (at["f2_G_F"] + arm_2) - at["t1_G_F"]
        about_2 = top * at["f1_B_F"] - weld * (at["f1_G_F"] + arm_1) - at["t2_G_F"]
        assert max(abs(about_1), abs(about_2)) < 1e-12  # N.m of 170; measured 6e-14


def test_power_of_drive_and_pin_is_the_rate_of_energy(bar):
    rng = np.random.default_rng(7)
    for i in range(200):
        values = random_state(rng) | {"frame_inertia": float(i % 2)}
        at, rates = bar(**values), bar.rates(**values)
        power = at["M_phi"] * values["Omega"] + at["t2_G_F"] * values["theta_dot"]
        assert rates["energy"] == pytest.approx(power, rel=0, abs=1e-12)  # W of 95; measured 2e-14


def test_angular_velocity_turns_the_long_axis_and_its_rate_is_the_acceleration(bar):
    rng = np.random.default_rng(8)
    for _ in range(100):
        values = random_state(rng)
        at, rates = bar(**values), bar.rates(**values)
        step = 1e-30j  # complex-step derivative of e1 in the world
        theta = values["theta"] + step * values["theta_dot"]
        phi = values["phi"] + step * values["Omega"]
        e1 = np.array([np.cos(theta) * np.cos(phi), np.cos(theta) * np.sin(phi), -np.sin(theta)])
        omega = [at["wx_bar"], at["wy_bar"], at["wz_bar"]]
        # 1/s of 22; measured 4e-15
        np.testing.assert_allclose(np.cross(omega, e1.real), e1.imag / 1e-30, rtol=0, atol=1e-13)
        for axis in "xyz":
            assert at[f"a{axis}_bar"] == pytest.approx(
                rates[f"w{axis}_bar"], rel=0, abs=1e-12
            )  # 3e-14


@pytest.mark.slow_rows("two_body")
def test_run_of_the_book_ends_with_the_printed_numbers(bar):
    run = bar.run(10.0)
    in_pounds = run["f1_G_F"] / convert(1, "lbf", "N")
    # at all times; measured 3e-12: rounding of f2, which is 265 times larger
    np.testing.assert_allclose(in_pounds, -0.2, rtol=1e-11)
    assert f"{convert(run['tk_G_F'][-1], 'N.m', 'ft.lbf'):.6f}" == "0.016656"
    assert abs(run["theta"][-1]) < 1e-2  # measured 6e-4


@pytest.mark.slow
def test_bar_settles_level_and_the_torque_about_k_at_a_sixtieth(reduced):
    run = reduced.run(40.0)
    assert abs(run["theta"][-1]) < 1e-9  # measured 7e-12
    assert convert(run["tk_G_F"][-1], "N.m", "ft.lbf") == pytest.approx(1 / 60, rel=1e-9)  # 0


@pytest.mark.slow_rows("1e-08", "1e-10")
@pytest.mark.parametrize("rtol", [1e-4, 1e-6, 1e-8, 1e-10])
def test_jacobi_integral_drifts_no_more_than_the_tolerance_allows(reduced, rtol):
    run = reduced.run(10.0, rtol=rtol, **UNDRIVEN)
    jacobi = run["theta_dot"] ** 2 + (2 * np.pi * np.sin(run["theta"])) ** 2
    assert np.abs(jacobi / jacobi[0] - 1).max() < 300 * rtol  # measured 2 to 38 rtol


def test_upright_bar_leaves_its_equilibrium_as_cosh(bar):
    offset, rtol = 1e-6, 1e-12
    run = bar.run(1.0, rtol=rtol, theta=np.pi / 2 - offset, theta_dot=0.0, **UNDRIVEN)
    grown = offset * np.cosh(2 * np.pi * run["time"])  # of the linearized equation, to offset^3
    # errors grow as the offset does; measured 4 and 8 rtol / offset
    np.testing.assert_allclose(np.pi / 2 - run["theta"], grown, rtol=50 * rtol / offset)


@pytest.mark.parametrize("theta", [0.0, np.pi / 2, np.pi])
def test_level_and_upright_are_equilibria(bar, theta):
    rate = bar.rates(theta=theta, theta_dot=0.0)["theta_dot"]
    assert abs(rate) < 1e-13  # rad/s2; measured 5e-15


def test_two_bodies_stay_in_bearings_and_pin(two_body):
    rtol = 1e-8
    run = two_body.run(10.0, rtol=rtol)
    for name in (v.name for v in two_body.dae.states[4:]):
        assert np.abs(run[name]).max() < 1e-2 * rtol  # m, rad, per second; measured 8e-14
