import casadi as ca
import numpy as np
import pytest

import casadi_models
from casadi_models.dae import Dae, Model
from cosim.api import simulate
from cosim.errors import UnknownName, UsageError
from cosim.integrate.integrator import start_vectors
from cosim.model.reduction import reduce, size


@pytest.fixture(scope="module")
def bar() -> Dae:
    return casadi_models.load("bar_on_frame/reduced")


def right_hand_side(dae: Dae) -> ca.Function:
    return ca.Function("f", [dae.t, dae.x, dae.z, dae.u, dae.p], [dae.ode, dae.alg])


def test_angle_of_the_bar_needs_three_states_and_few_operations(bar):
    small = reduce(bar, ["theta"])
    assert [v.name for v in small.states] == ["theta", "theta_dot", "Omega"]
    assert size(small).operations < 30  # measured 9


def test_torque_of_the_crank_needs_neither_state_nor_bearing():
    small = reduce(casadi_models.load("crank_shaft/driven"), ["T"])
    assert (size(small).states, size(small).outputs, size(small).operations) == (0, 1, 0)


def test_torque_of_the_free_crank_drops_the_bearing_multipliers():
    small = reduce(casadi_models.load("crank_shaft/multipliers"), ["T"])
    kept = {v.name for v in small.algebraics}
    assert "T" in kept
    assert not kept & {"fx_A", "fy_A", "fx_B", "fy_B"}


def test_roll_and_steer_need_six_states_and_neither_path_nor_heading():
    small = reduce(casadi_models.load("bicycle/independent"), ["phi", "delta"])
    assert {v.name for v in small.states} == {
        "phi", "delta", "theta", "phi_dot", "delta_dot", "thetaR_dot",
    }  # fmt: skip


@pytest.mark.parametrize("name", casadi_models.CATALOG)
def test_kept_equations_are_the_same_functions_at_random_states(name):
    dae = casadi_models.load(name)
    wanted = [dae.states[0].name]
    small = reduce(dae, wanted)
    rng = np.random.default_rng(5)
    vectors = start_vectors(dae)
    rows = {v.name: i for i, v in enumerate((*dae.states, *dae.algebraics))}
    full_f, small_f = right_hand_side(dae), right_hand_side(small)
    for _ in range(10):
        x = vectors["x0"] + 0.05 * rng.standard_normal(len(vectors["x0"]))
        z = vectors["z0"] + 0.05 * rng.standard_normal(len(vectors["z0"]))
        both = np.concatenate((x, z))
        kept = np.array([both[rows[v.name]] for v in (*small.states, *small.algebraics)])
        nx = len(small.states)
        inputs = {v.name: value for v, value in zip(dae.inputs, vectors["u"], strict=True)}
        parameters = {v.name: value for v, value in zip(dae.parameters, vectors["p"], strict=True)}
        ode, _ = full_f(0, x, z, vectors["u"], vectors["p"])
        small_ode, _ = small_f(
            0,
            kept[:nx],
            kept[nx:],
            [inputs[v.name] for v in small.inputs],
            [parameters[v.name] for v in small.parameters],
        )
        expected = np.array(ode).ravel()[[rows[v.name] for v in small.states]]
        scale = 1 + np.abs(expected)
        assert np.all(np.abs(np.array(small_ode).ravel() - expected) < 1e-12 * scale)  # rounding


@pytest.mark.parametrize("outputs", [["theta"], ["M_phi"], ["tk_G_F", "phi"]])
def test_reduced_bar_runs_like_the_full_one(bar, outputs):
    tolerance = 1e-10
    full = simulate(bar, stop_time=2, relative_tolerance=tolerance, solver="erk", compiled=False)
    small = simulate(
        reduce(bar, outputs),
        stop_time=2,
        relative_tolerance=tolerance,
        solver="erk",
        compiled=False,
    )
    assert small.names == tuple(outputs)
    for name in outputs:
        np.testing.assert_allclose(small[name], full[name], rtol=0, atol=1e3 * tolerance)


def test_frozen_parameters_become_numbers(bar):
    small = reduce(bar, ["theta"], freeze=["m", "b"])
    assert {"m", "b"}.isdisjoint(v.name for v in small.parameters)
    assert any(line.startswith("freeze") for line in small.report)


def test_report_names_what_went_and_why(bar):
    report = "\n".join(reduce(bar, ["theta"]).report)
    assert "phi: no requested output depends on them" in report
    assert "operations: 62 -> 9" in report


def test_a_calculated_start_keeps_the_states_it_follows_from():
    model = Model("lever")
    angle = model.state("angle", "rad", 0.3, "angle")
    height = model.state("height", "m", 0.0, "height of the end")
    model.derivative(ca.vertcat(angle, height), ca.vertcat(0, 1))
    model.start(height, ca.sin(angle), "length of the lever")
    small = reduce(model.freeze(), ["height"])
    assert [v.name for v in small.states] == ["angle", "height"]
    assert start_vectors(small)["x0"][1] == np.sin(0.3)


def test_unknown_output_names_the_formulation_that_has_it(bar):
    with pytest.raises(UnknownName, match="bar_on_frame/two_body does"):
        reduce(bar, ["frame_shift_1"])


def test_unknown_output_names_the_nearest(bar):
    with pytest.raises(UnknownName, match="theta"):
        reduce(bar, ["thta"])


@pytest.mark.parametrize("outputs", [[], ["theta", "theta"], "theta"])
def test_useless_lists_of_outputs_are_refused(bar, outputs):
    with pytest.raises(UsageError):
        reduce(bar, outputs)


def test_unknown_frozen_parameter_is_refused(bar):
    with pytest.raises(UnknownName, match="parameter"):
        reduce(bar, ["theta"], freeze=["mass"])


def test_smooth_expressions_of_what_is_left_out_go_too():
    model = Model("apart", stop_time=1.0)
    x, y = (model.state(name, "1", 1.0, "a decay") for name in "xy")
    model.derivative(x, -model.smooth(ca.fabs(x)) * ca.fmax(x, 0.8))
    model.derivative(y, -model.smooth(ca.fabs(y)))
    small = reduce(model.freeze(), ["x"])
    run = simulate(small)
    assert run.final["x"] == pytest.approx(0.8 * np.exp(-0.8 * 0.75), abs=1e-7)  # 0.8 at 0.25 s
    assert len(run.events) == 1  # that of fmax alone
