"""The bicycle's equations against published accelerations, Newton and Euler, and one another."""

import numpy as np
import pytest
from helpers.bicycle_oracles import (
    ACCELERATIONS,
    ANGLES,
    BENCHMARK,
    RATES,
    TABLE_1,
    TABLE_1_ACCELERATIONS,
    admissible_state,
    newton_euler,
)
from helpers.equations import Equations
from scipy.linalg import null_space
from scipy.optimize import brentq

import casadi_models
from casadi_models.bicycle import book
from casadi_models.bicycle.stages import stages

FORMULATIONS = ("independent", "book", "multipliers")
FORCES = ("fx_P", "fy_P", "fz_P", "fx_Q", "fy_Q", "fz_Q")
INPUTS = ("steer_torque", "roll_torque", "rear_wheel_torque")
UNITS = {
    **dict.fromkeys(ANGLES, "rad"),
    **dict.fromkeys(RATES, "rad/s"),
    **dict.fromkeys(("xP", "yP", "zP", "loop_closure"), "m"),
    **dict.fromkeys(("speed", "slip_1", "slip_2", "slip_3"), "m/s"),
    **dict.fromkeys(FORCES, "N"),
    **dict.fromkeys(("kinetic_energy", "potential_energy", "energy"), "J"),
}
# Scalar operations of right-hand side and residuals, parameters being numbers
OPERATIONS = {"independent": 1014, "book": 2322, "multipliers": 930}


@pytest.fixture(scope="module")
def bikes():
    return {name: Equations(casadi_models.load(f"bicycle/{name}")) for name in FORMULATIONS}


@pytest.fixture(scope="module", params=FORMULATIONS)
def bike(request, bikes):
    return bikes[request.param]


def at(bike, values):
    """Return variables and accelerations; rates that the formulation calculates are not given."""
    groups = (bike.dae.states, bike.dae.inputs, bike.dae.parameters)
    names = {variable.name for group in groups for variable in group}
    given = {name: value for name, value in values.items() if name in names}
    rates = bike.rates(**given)
    return bike(**given) | {f"{name}_dot": rates[name] for name in RATES} | {"rates": rates}


def random_state(rng):
    """Return an admissible state with inputs and a bicycle within 10 % of the benchmark."""
    parameters = {name: value * rng.uniform(0.9, 1.1) for name, value in BENCHMARK.items()}
    inputs = dict(zip(INPUTS, rng.normal(0.0, 10.0, 3), strict=True))
    return admissible_state(rng, list(parameters.values())) | parameters | inputs


def demanded(values):
    """Evaluate Newton's and Euler's laws for angles, rates, accelerations and parameters."""
    laws = newton_euler()(
        q=[values[name] for name in (*ANGLES, "xP", "yP")],
        u=[values[name] for name in RATES],
        a=[values[name] for name in ACCELERATIONS],
        p=[values[name] for name in BENCHMARK],
    )
    return {name: value.full().squeeze() for name, value in laws.items()}


def imbalance(state, found):
    """Return what is missing in the balance of forces (N) and moments (N.m)."""
    law = demanded(state | found)
    at_P, at_Q = np.array([found[name] for name in FORCES]).reshape(2, 3)
    steer, roll, wheel = (state.get(name, 0.0) for name in INPUTS)

    def about(axis, arm, force):
        return axis @ np.cross(arm, force)

    return np.hstack(
        [
            law["force"] - at_P - at_Q,
            law["moment"] - np.cross(law["PQ"], at_Q) - roll * law["roll_axis"],
            law["rear_axle_moment"] - about(law["rear_axle"], law["axle_to_P"], at_P) - wheel,
            law["front_axle_moment"] - about(law["front_axle"], law["hub_to_Q"], at_Q),
            law["steering_moment"] - about(law["steering_axis"], law["axis_to_Q"], at_Q) - steer,
        ]
    )


def test_variables_are_those_of_the_contract(bike):
    dae = bike.dae
    units = {v.name: v.unit for v in (*dae.states, *dae.algebraics, *dae.output_variables)}
    accelerations = dict.fromkeys(ACCELERATIONS, "rad/s2") if dae.algebraics else {}
    assert units == UNITS | accelerations
    assert {v.name: v.unit for v in dae.inputs} == dict.fromkeys(INPUTS, "N.m")
    assert {v.name: v.start for v in dae.parameters} == BENCHMARK
    assert [body for body, _ in dae.inertias] == ["rear wheel", "rear frame", "fork", "front wheel"]
    assert dae.experiment.stop_time == 20.0


def test_states_of_book_are_in_its_order(bikes):
    names = [variable.name for variable in bikes["book"].dae.states]
    assert names == [*ANGLES, *RATES, "xP", "yP", "zP"]


@pytest.mark.parametrize("name", FORMULATIONS)
def test_equations_need_no_more_operations_than_recorded(bikes, name):
    assert bikes[name].dae.operations() <= OPERATIONS[name]


def test_accelerations_are_those_of_basu_mandal(bike):
    found = at(bike, TABLE_1)
    for name, expected in TABLE_1_ACCELERATIONS.items():
        # Measured up to 1.1e-12 for 4.6 (steer): the table's states are given to 5e-14
        np.testing.assert_allclose(found[name], expected, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
def test_formulations_agree_at_random_admissible_states(bikes):
    rng = np.random.default_rng(20)
    for _ in range(1000):
        state = random_state(rng)
        found = {name: at(bike, state) for name, bike in bikes.items()}
        for names in (ACCELERATIONS, FORCES, ("kinetic_energy", "potential_energy")):
            columns = np.array([[found[f][n] for n in names] for f in FORMULATIONS])
            spread = np.ptp(columns, axis=0).max() / np.abs(columns).max()
            assert spread < 1e-11  # measured 2e-14, forces 2e-13


def test_contact_forces_and_inputs_balance_newton_and_euler(bike):
    rng = np.random.default_rng(21)
    for _ in range(100):
        state = random_state(rng)
        found = at(bike, state)
        assert np.abs(imbalance(state, found)).max() < 1e-10  # N, N.m of up to 4e3; measured 1e-11


def test_energies_are_those_of_the_bodies(bike):
    rng = np.random.default_rng(22)
    for _ in range(100):
        state = random_state(rng)
        found = at(bike, state)
        law = demanded(state | found)
        for name in ("kinetic", "potential"):  # measured 4e-15
            np.testing.assert_allclose(found[f"{name}_energy"], law[name], rtol=1e-13)


def test_energy_grows_with_the_power_of_the_inputs(bike):
    rng = np.random.default_rng(23)
    for _ in range(100):
        state = random_state(rng)
        rates = (state["delta_dot"], state["phi_dot"], state["thetaR_dot"])
        power = np.dot([state[name] for name in INPUTS], rates)
        growth = at(bike, state)["rates"]["energy"]
        np.testing.assert_allclose(growth, power, rtol=0, atol=1e-9)  # W; measured 1e-10


def test_rolling_keeps_the_front_wheel_on_the_ground(bike):
    rng = np.random.default_rng(24)
    for _ in range(100):
        state = random_state(rng)
        found = at(bike, state)
        for name in ("loop_closure", "slip_1", "slip_2", "slip_3"):
            assert abs(found[name]) < 1e-13  # m, m/s; measured 1e-14
            assert abs(found["rates"][name]) < 1e-11  # m/s, m/s2; measured 3e-13


def test_bicycle_at_rest_stands_on_its_weight(bike):
    found = at(bike, dict.fromkeys(("phi_dot", "thetaR_dot"), 0.0))
    masses = {"mA": 0.0, "mB": 0.3, "mC": 0.9, "mD": 1.02}  # mass centers forward of P, m
    weight = 9.81 * np.array([BENCHMARK[name] for name in masses])
    front = weight @ list(masses.values()) / 1.02
    expected = [0, 0, front - weight.sum(), 0, 0, -front]
    np.testing.assert_allclose(
        [found[n] for n in FORCES], expected, atol=1e-11
    )  # N; measured 1e-13
    np.testing.assert_allclose([found[n] for n in ACCELERATIONS], 0, atol=1e-12)  # 1e-14


def test_multipliers_stay_regular_where_the_dependent_speeds_are_not(bikes):
    bike, upright = bikes["multipliers"], dict.fromkeys((*ANGLES, *RATES), 0.0)
    parameters = dict(BENCHMARK)

    def rolling(delta):
        """Return the pitch that closes the loop, and d(slip)/du."""
        state = upright | {"delta": delta, "xP": 0.0, "yP": 0.0} | dict.fromkeys(ACCELERATIONS, 0.0)

        def law(theta):
            return demanded(state | parameters | {"theta": theta})

        theta = brentq(lambda theta: law(theta)["PQ"][2], -0.4, 0.4, xtol=1e-15)
        return theta, law(theta)["rolling"]

    steer = brentq(lambda delta: np.linalg.det(rolling(delta)[1][:, 3:]), 1.5, 1.7, xtol=1e-15)
    assert np.degrees(steer) == pytest.approx(91.8, abs=0.05)
    theta, matrix = rolling(steer)
    assert np.linalg.cond(matrix[:, 3:]) > 1e14
    speeds = null_space(matrix) @ [2.0, -1.0, 3.0]
    state = upright | {"delta": steer, "theta": theta} | dict(zip(RATES, speeds, strict=True))

    ratio = np.linalg.cond(bike.matrix(**state)) / np.linalg.cond(bike.matrix(**upright))
    assert ratio < 10  # measured 4.7
    found = at(bike, state)
    path = {"xP": 0.0, "yP": 0.0}
    assert np.abs(imbalance(state | path | parameters, found)).max() < 1e-10
    for name in ("loop_closure", "slip_1", "slip_2", "slip_3"):
        assert abs(found["rates"][name]) < 1e-11


def test_constants_are_those_of_the_books_table():
    geometry = book.constants()(**BENCHMARK)["geometry"].full().ravel()
    printed = {
        "xB": 0.3,
        "zB": 0.6,
        "xS": 0.9067915590623501,
        "zS": 0.2946344379171024,
        "xC": 0.02610059280343250,
        "zC": -0.1023073115806087,
        "xD": 0.03207142672761934,
        "zD": 0.2676445084476887,
    }
    np.testing.assert_allclose(geometry[3:], list(printed.values()), rtol=0, atol=2e-16)


def test_stages_called_one_by_one_lead_from_the_state_vector_to_its_derivative(bikes):
    constants, every = book.constants(), stages()
    assert len(every) == 10
    rng = np.random.default_rng(25)
    for _ in range(20):
        state = random_state(rng)
        y = [state.get(variable.name, 0.0) for variable in bikes["book"].dae.states]
        torques = [state[name] for name in ("roll_torque", "rear_wheel_torque", "steer_torque")]
        signals = constants(**{name: state[name] for name in BENCHMARK})
        signals |= {"y": y, "torques": torques}
        for stage in every.values():
            signals |= stage(**{name: signals[name] for name in stage.name_in()})
        rates = at(bikes["book"], state)["rates"]
        expected = [rates[variable.name] for variable in bikes["book"].dae.states]
        found = signals["dydt"].full().ravel()
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)  # measured 0


def test_constraint_matrices_give_the_velocity_of_the_front_contact():
    constants, every = book.constants(), stages()
    rng = np.random.default_rng(26)
    for _ in range(100):
        state = random_state(rng)
        u = rng.normal(size=6)  # the wheel slips
        signals = constants(**{name: state[name] for name in BENCHMARK}) | state
        for name in ("transformations", "constraints"):
            stage = every[name]
            signals |= stage(**{n: signals[n] for n in stage.name_in()})
        slip = signals["R_R2C"].T @ (signals["C_1"] @ u[:3] + signals["C_2"] @ u[3:])
        expected = demanded(state | dict.fromkeys(ACCELERATIONS, 0.0))["rolling"] @ u
        np.testing.assert_allclose(slip.full().ravel(), expected, atol=1e-13)  # measured 1e-15
