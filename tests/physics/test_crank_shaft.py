"""The crank shaft against the formulas and printed numbers of Unit 7, Example 1."""

import casadi as ca
import numpy as np
import pytest
from helpers.equations import Equations

import casadi_models
from casadi_models.units import convert

SEGMENT_MASS, LENGTH = 0.1517629907418644, 0.1524  # kg, m: 6 in of 1/2 in steel
FORMULATIONS = ("driven", "multipliers")
OUTPUTS = {"fx_A": "N", "fy_A": "N", "fx_B": "N", "fy_B": "N", "T": "N.m"}
OUTPUTS |= dict.fromkeys(("kinetic_energy", "potential_energy", "energy"), "J")


@pytest.fixture(scope="module", params=FORMULATIONS)
def crank(request):
    return Equations(casadi_models.load(f"crank_shaft/{request.param}"))


@pytest.fixture(scope="module")
def twins():
    return [Equations(casadi_models.load(f"crank_shaft/{name}")) for name in FORMULATIONS]


def test_every_formulation_has_the_outputs_of_the_contract(crank):
    assert {name: crank.dae.variable(name).unit for name in OUTPUTS} == OUTPUTS
    assert [v.name for v in crank.dae.states[:2]] == ["phi", "omega"]


def test_start_loads_are_those_the_book_prints(crank):
    start = crank()
    printed = {"fx_A": "-6.4994", "fy_A": "0.025998", "fx_B": "6.4994", "fy_B": "-0.025998"}
    for name, digits in printed.items():
        assert f"{convert(start[name], 'N', 'lbf'):.5g}" == digits
    assert f"{convert(start['T'], 'N.m', 'ft.lbf'):.5g}" == "0.086659"


def test_loads_are_the_closed_forms_of_newton_and_euler(crank):
    rng = np.random.default_rng(1)
    ml = SEGMENT_MASS * LENGTH
    for _ in range(100):
        omega, alpha = rng.uniform(-200, 200, 2)
        at = crank(phi=rng.uniform(-10, 10), omega=omega, alpha=alpha)
        x, y, torque = ml * omega**2 / 2, ml * alpha / 2, 10 / 3 * ml * LENGTH * alpha
        expected = [-x, y, x, -y, torque]
        actual = [at[name] for name in ("fx_A", "fy_A", "fx_B", "fy_B", "T")]
        np.testing.assert_allclose(actual, expected, rtol=1e-14)  # measured 4e-16


def test_inertia_is_the_matrix_of_the_text(crank):
    ((_, inertia),) = crank.dae.inertias
    values = [v.start for v in crank.dae.parameters]
    matrix = np.array(ca.Function("inertia", [crank.dae.p], [inertia])(values))
    text = np.array([[22 / 3, 0, 2], [0, 32 / 3, 0], [2, 0, 10 / 3]])
    # measured 7e-16
    np.testing.assert_allclose(matrix / (SEGMENT_MASS * LENGTH**2), text, rtol=0, atol=1e-14)


def test_formulations_agree_at_random_states(twins):
    rng = np.random.default_rng(2)
    for _ in range(1000):
        omega, g = rng.uniform(-200, 200), rng.uniform(0, 20)
        values = {"phi": rng.uniform(-10, 10), "omega": omega, "g": g}
        values |= {"alpha": rng.uniform(-50, 50), "segment_length": rng.uniform(0.05, 1)}
        driven, multipliers = (equations(**values) for equations in twins)
        scale = max(abs(driven[name]) for name in OUTPUTS)
        for name in OUTPUTS:
            # measured 5e-16 of the largest load
            assert multipliers[name] == pytest.approx(driven[name], rel=0, abs=1e-13 * scale)


def test_bearings_carry_the_weight_at_any_angle(crank):
    rng = np.random.default_rng(3)
    for _ in range(100):
        phi, g = rng.uniform(-10, 10), rng.uniform(1, 20)
        at = crank(phi=phi, omega=0.0, alpha=0.0, g=g)
        x, y = at["fx_A"] + at["fx_B"], at["fy_A"] + at["fy_B"]
        world = [x * np.cos(phi) - y * np.sin(phi), x * np.sin(phi) + y * np.cos(phi)]
        weight = 8 * SEGMENT_MASS * g
        # measured 6e-16 of the weight
        np.testing.assert_allclose(world, [0, weight], rtol=0, atol=1e-14 * weight)
        assert at["fy_A"] == pytest.approx(at["fy_B"], rel=0, abs=1e-14 * weight)  # G midway


def test_drive_power_is_the_rate_of_energy(crank):
    rng = np.random.default_rng(4)
    for _ in range(100):
        values = {"phi": rng.uniform(-10, 10), "omega": rng.uniform(-200, 200)}
        values |= {"alpha": rng.uniform(-50, 50), "g": rng.uniform(0, 20)}
        power = crank(**values)["T"] * values["omega"]
        assert crank.rates(**values)["energy"] == pytest.approx(power, rel=1e-12)  # measured 1e-13


def test_bearings_and_drive_hold_the_free_body_on_its_axis(crank):
    rtol = 1e-8
    run = crank.run(4.0, rtol=rtol, g=9.80665)
    np.testing.assert_allclose(run["phi"][-1], 280.0, rtol=rtol)  # 50 t + 5 t^2; measured 6e-16
    loose = [v.name for v in crank.dae.states if v.name.startswith("shaft_")]
    for name in loose:  # after 45 turns: 9e-13 m, rad, per second
        assert np.abs(run[name]).max() < 1e-2 * rtol
