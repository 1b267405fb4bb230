"""Condition monitors against matrices that energies, slips and equations of motion give."""

import math

import numpy as np
import pytest
from helpers.bicycle_oracles import ANGLES, BENCHMARK, RATES
from helpers.equations import Equations
from scipy.optimize import brentq

import casadi_models
import cosim
from casadi_models.bicycle import book
from casadi_models.bicycle.stages import stages
from cosim.model.catalogue import loaded

SHAFT = ("shaft_v1", "shaft_v2", "shaft_v3", "shaft_w1", "shaft_w2", "omega")
FRAME = ("frame_v1", "frame_v2", "frame_v3", "frame_w1", "frame_w2", "Omega")
BAR = ("bar_v1", "bar_v2", "bar_v3", "theta_dot", "bar_w3")  # bar_w1 has no inertia: slender
BARS = [f"bar{i}_{n}" for i in "12" for n in ("v1", "v2", "v3", "w2", "w3")]
ACROSS = ("w1_x", "w1_y", "w2_x", "w2_y")
SPEEDS = {  # in whose accelerations the equations of motion are solved
    "crank_shaft/multipliers": SHAFT,
    "bar_on_frame/two_body": FRAME + BAR,
    "bicycle/independent": RATES[:3],
    "bicycle/book": RATES[:3],
    "bicycle/multipliers": RATES,
    "disk_two_bars/reduced": ("theta1_dot", "theta2_dot"),
    "disk_two_bars/multipliers": (*BARS, "theta1_dot", "theta2_dot"),
    "double_pendulum/quaternion": ACROSS,
    "double_pendulum/euler_313": ACROSS,
    "double_pendulum/euler_313_axial": ACROSS,
    "double_pendulum/multipliers": (*[f"v{a}_G{i}" for i in "12" for a in "xyz"], *ACROSS),
}
KEPT = [name for name in SPEEDS if loaded(name).algebraics]
NAMES = ("mass_condition", "constraint_condition", "singularity_distance")


@pytest.fixture(scope="module")
def models():
    return {name: watched(name) for name in SPEEDS}


def watched(name):
    return Equations(loaded(name).watching((*NAMES, "position_drift")))


def random_state(model, rng):
    """Return states off the constraints, and parameters up to 10 % from their values."""
    dae = model.dae
    sizes = {v.name: v.start * rng.uniform(0.9, 1.1) for v in dae.parameters}
    sizes |= {"frame_inertia": 1.0} if "frame_inertia" in sizes else {}
    state = {v.name: rng.uniform(-0.6, 0.6) for v in dae.states}
    for link in "12":
        parts = [n for n in state if n.startswith(f"q{link}_")]
        q = rng.normal(size=len(parts))
        state |= dict(zip(parts, q / max(np.linalg.norm(q), 1e-9), strict=True))
    return state | sizes


def mass_from_energy(model, speeds, values):
    """Return the second derivatives of the kinetic energy, exact for a quadratic form."""
    n = len(speeds)
    mass = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            corners = 0.0
            for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                moved = dict.fromkeys(speeds, 0.0)
                moved[speeds[i]] += a
                moved[speeds[j]] += b
                corners += a * b * model(**values | moved)["kinetic_energy"]
            mass[i, j] = corners / 4
    return mass


def condition(matrix):
    """Return |A| |A^+| / m, which lies between cond(A) / m and cond(A)."""
    m, largest = min(matrix.shape), np.linalg.cond(matrix)
    found = np.linalg.norm(matrix) * np.linalg.norm(np.linalg.pinv(matrix)) / m
    assert largest / m * (1 - 1e-9) <= found <= largest * (1 + 1e-9)
    return found


def unit_diagonal(mass):
    size = np.sqrt(np.diag(mass))
    return mass / np.outer(size, size)


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows(
    "crank_shaft/multipliers",
    "bar_on_frame/two_body",
    "disk_two_bars/multipliers",
    "bicycle/independent",
)
@pytest.mark.parametrize("name", SPEEDS)
def test_mass_condition_is_that_of_the_kinetic_energy(models, name):
    rng = np.random.default_rng(40)
    for _ in range(3):
        values = random_state(models[name], rng)
        expected = condition(unit_diagonal(mass_from_energy(models[name], SPEEDS[name], values)))
        # measured up to 5e-14, of bars in series
        assert models[name](**values)["mass_condition"] == pytest.approx(expected, rel=1e-12)


@pytest.mark.slow_rows("bicycle/multipliers")
@pytest.mark.parametrize("name", KEPT)
def test_constraint_condition_is_that_of_the_equations_that_are_solved(models, name):
    rng = np.random.default_rng(41)
    n = len(models[name].dae.algebraics) - len(loads(name))
    for _ in range(20):
        values = random_state(models[name], rng)
        matrix = models[name].matrix(**values)  # [[M, -A^T], [A, 0]]
        mass, jacobian = np.diag(matrix[:n, :n]), matrix[n:, :n]
        if name.startswith("bicycle"):
            jacobian = to_wheel_axes(values) @ jacobian
        scaled = jacobian / np.sqrt(np.where(mass > 0, mass, 1.0))
        scaled /= np.linalg.norm(scaled, axis=1)[:, None]
        found = models[name](**values)["constraint_condition"]
        assert found == pytest.approx(condition(scaled), rel=1e-12)  # measured up to 9e-15


def loads(name):
    """Return the multipliers: the unknowns that are no accelerations."""
    dae = loaded(name)
    return [v.name for v in dae.algebraics if not v.unit.endswith("/s2")]


def to_wheel_axes(values):
    """Return the rotation from N to heading, axle and downward axis of the front wheel."""
    stage = stages()["transformations"]
    signals = book.constants()(**{name: values[name] for name in BENCHMARK}) | values
    signals = stage(**{name: signals[name] for name in stage.name_in()})
    down = signals["N_3"].full().ravel()
    w3 = np.array([down[0], 0.0, down[2]]) / np.hypot(down[0], down[2])
    axes = np.column_stack(([w3[2], 0.0, -w3[0]], [0.0, 1.0, 0.0], w3))  # in C
    return axes.T @ signals["R_R2C"].full()


def test_elimination_is_as_well_conditioned_as_the_slip_is_in_the_dependent_rates(models):
    rng, slips = np.random.default_rng(42), ("slip_1", "slip_2", "slip_3")
    for _ in range(20):
        values = random_state(models["bicycle/multipliers"], rng)
        rest = values | dict.fromkeys(RATES, 0.0)
        columns = [models["bicycle/multipliers"](**rest | {rate: 1.0}) for rate in RATES[3:]]
        expected = condition(np.array([[c[slip] for c in columns] for slip in slips]))
        for name in ("bicycle/independent", "bicycle/book"):
            known = {v.name for v in (*models[name].dae.states, *models[name].dae.parameters)}
            given = {n: value for n, value in values.items() if n in known}
            found = models[name](**given)["constraint_condition"]
            assert found == pytest.approx(expected, rel=1e-13)  # measured 7e-16


def test_conditions_tell_the_steer_angle_where_elimination_ends(models):
    forms = {name: models[f"bicycle/{name}"] for name in ("independent", "book", "multipliers")}
    upright = dict.fromkeys(ANGLES, 0.0)

    def at(form, steer):
        def closure(pitch):
            return forms["book"](**upright | {"delta": steer, "theta": pitch})["loop_closure"]

        pitch = brentq(closure, -0.4, 0.4, xtol=1e-15)
        return forms[form](**upright | {"delta": steer, "theta": pitch})

    for form in ("independent", "book"):
        limit = brentq(lambda steer, f=form: at(f, steer)["singularity_distance"], 1.5, 1.7)
        assert math.degrees(limit) == pytest.approx(91.8, abs=0.05)
        ratio = at(form, limit - 1e-6)["constraint_condition"] * 1e-6
        assert at(form, limit - 1e-3)["constraint_condition"] * 1e-3 == pytest.approx(
            ratio, rel=0.1
        )
    there = at("multipliers", limit)
    assert there["constraint_condition"] < 2  # measured 1.3
    assert there["singularity_distance"] == pytest.approx(1.0)  # upright


def test_leaning_by_90_degrees_is_no_distance_from_the_singularity(models):
    for name in ("independent", "book", "multipliers"):
        found = models[f"bicycle/{name}"](phi=math.pi / 2)
        assert abs(found["singularity_distance"]) < 1e-15
    flat = models["bicycle/multipliers"](
        phi=math.pi / 2 - 1e-5
    )  # yaw and pitch turn about one axis
    assert flat["mass_condition"] > 1e9


def test_distance_of_the_euler_angles_is_the_smaller_sine(models):
    rng = np.random.default_rng(43)
    for name in ("euler_313", "euler_313_axial"):
        model = models[f"double_pendulum/{name}"]
        for _ in range(20):
            first, second = rng.uniform(-4, 4, 2)
            found = model(theta1=first, theta2=second)
            expected = min(abs(math.sin(first)), abs(math.sin(second)))
            assert found["singularity_distance"] == pytest.approx(expected, rel=1e-15)


def test_tilted_joint_nears_its_singularity(models):
    for name, tilt in (("crank_shaft", "shaft_tilt_2"), ("disk_two_bars", "bar2_tilt_3")):
        found = models[f"{name}/multipliers"](**{tilt: math.pi / 2})
        assert abs(found["singularity_distance"]) < 1e-15


def test_frame_without_mass_makes_the_mass_matrix_singular(models):
    light = models["bar_on_frame/two_body"](frame_inertia=0.0)
    assert light["mass_condition"] == math.inf
    assert light["constraint_condition"] < 2  # the constraints still hold the frame; measured 1.1
    assert np.linalg.cond(models["bar_on_frame/two_body"].matrix(frame_inertia=0.0)) < 1e4


def test_drift_is_the_largest_gap(models):
    found = models["bicycle/book"](theta=1e-3)
    assert found["position_drift"] == pytest.approx(abs(found["loop_closure"]), rel=1e-15)
    loose = watched("crank_shaft/multipliers")(shaft_shift_1=2e-3, shaft_tilt_2=-3e-3)
    assert loose["position_drift"] == 3e-3
    long = watched("double_pendulum/quaternion")
    assert long(q1_w=1.1, q2_w=1.0)["position_drift"] == pytest.approx(0.21)


@pytest.mark.parametrize("name", casadi_models.CATALOG)
def test_monitors_cost_nothing_until_they_are_asked_for(name):
    dae = loaded(name)
    names = [v.name for v, _ in dae.monitors]
    assert not {v.name for v in dae.variables} & set(names)
    asked = dae.watching(names)
    assert asked.operations() == dae.operations()
    assert asked.observed == (*dae.observed, *names)


@pytest.mark.slow
def test_run_and_reduction_compute_the_monitors_that_are_named():
    dae = loaded("bicycle")
    run = cosim.simulate(dae, stop_time=0.1, outputs=["phi", "singularity_distance"])
    assert run.names == ("phi", "singularity_distance")
    small = cosim.reduce(dae, ["phi", "singularity_distance"])
    assert len(small.states) == 6
    assert cosim.compare(run, cosim.simulate(small, stop_time=0.1)).agrees
