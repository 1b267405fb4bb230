"""Discrete maps of sampled loops and Floquet multipliers, against closed forms."""

import casadi as ca
import numpy as np
import pytest

import cosim
from casadi_models.dae import Model
from cosim.errors import FmuError, InitialConditionError
from cosim.model.values import assign
from cosim.study.linearize.linearize import linearize
from cosim.study.linearize.period import period_of

PERIOD, DECAY = 0.5, np.exp(-0.5)


def sampled(gain=8.0, *, target=0.0, offset=0.0):
    """The plant x' = u - x + d with the controller u = target - gain x every half second."""
    model = Model("sampled", stop_time=20.0)
    x, u = model.state("x", "m", 0.0, "x"), model.discrete("u", "1", 0.0, "control")
    k = model.parameter("gain", "1", gain, "gain")
    d = model.input("d", "1", 0.0, "disturbance")
    model.derivative(x, u - x + d)
    model.every(PERIOD, {u: target - k * x}, offset=offset)
    model.output("y", "m", 2 * x + u + 3 * d, "y")
    return model.freeze()


@pytest.mark.parametrize("offset", [0.0, 0.2])
def test_sampled_loop_has_the_matrices_of_its_discrete_map(offset):
    found = linearize(sampled(offset=offset), at="equilibrium")
    assert found.period == pytest.approx(PERIOD, rel=1e-15)
    factor = DECAY - 8 * (1 - DECAY)
    assert found.eigenvalues[0] == pytest.approx(factor, rel=1e-9)  # measured 2e-13
    if not offset:  # from just before one sample to just before the next one
        np.testing.assert_allclose(found.A, [[factor, 0], [-8, 0]], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(found.B, [[1 - DECAY], [0]], rtol=1e-9, atol=1e-12)
        np.testing.assert_array_equal(found.C, [[2, 1]])
        np.testing.assert_array_equal(found.D, [[3]])
    assert "a discrete map per 0.5 s" in str(found)
    assert found.modes[0].growth == pytest.approx(-factor - 1, rel=1e-9)


@pytest.mark.parametrize("begin", [1e6, 1e6 + 0.03, 1e9])
def test_sampled_loop_has_its_map_at_late_times(begin):
    model = Model("late", stop_time=1.0)
    x, u = model.state("x", "m", 0.0, "x"), model.discrete("u", "1", 0.0, "control")
    model.derivative(x, u - x)
    model.every(0.1, {u: -x}, offset=begin % 0.1)
    found = linearize(model.freeze(), start_time=begin)
    factor = np.exp(-0.1) - (1 - np.exp(-0.1))
    rounding = 4 * np.spacing(begin)
    np.testing.assert_allclose(found.A, [[factor, 0], [-1, 0]], rtol=0, atol=1e-9 + rounding)


def test_sampled_loop_is_linearized_after_a_time_of_a_run_too():
    found = linearize(sampled(2.0, target=3.0), at=20.0)
    assert found.is_steady
    assert found.eigenvalues[0] == pytest.approx(DECAY - 2 * (1 - DECAY), rel=1e-9)
    assert linearize(sampled(2.0, target=3.0)).steadiness.startswith("not periodic: u changes by")


def test_equilibrium_of_a_sampled_loop_is_that_of_the_loop():
    found = linearize(sampled(2.0, target=3.0), at="equilibrium")
    np.testing.assert_allclose(found.x, [1.0, 1.0], rtol=1e-8)
    assert found.steadiness == "periodic"


@pytest.mark.slow
def test_limit_gain_of_the_sampled_loop_is_where_its_factor_is_minus_1():
    sweep = linearize(sampled(), at="equilibrium", along={"gain": np.linspace(1, 8, 4)})
    (crossing,) = sweep.crossings
    assert crossing.value == pytest.approx((1 + DECAY) / (1 - DECAY), rel=1e-9)
    assert crossing.unstable == "above"
    assert crossing.frequency == pytest.approx(np.pi / PERIOD)


def test_two_rates_have_the_map_of_their_common_period():
    model = Model("rates")
    x = model.state("x", "1", 1.0, "x")
    model.derivative(x, -x)
    model.every(0.2, {x: 0.5 * x})
    model.every(0.3, {x: 3 * x}, offset=0.05)
    found = linearize(model.freeze())
    assert found.period == pytest.approx(0.6, rel=1e-12)
    assert found.A[0, 0] == pytest.approx(0.5**3 * 9 * np.exp(-0.6), rel=1e-9)


def test_periods_without_a_common_one_are_rejected():
    model = Model("rates")
    x = model.state("x", "1", 1.0, "x")
    model.derivative(x, -ca.cos(model.t) * x)
    model.every(0.2, {x: 0.5 * x})
    with pytest.raises(InitialConditionError, match="no common period"):
        linearize(model.freeze())


def mathieu(stiffness, depth):
    """x'' + (a - 2 q cos(2 t)) x = 0."""
    model = Model("mathieu")
    x, v = model.state("x", "1", 0.0, "x"), model.state("v", "1/s", 0.0, "v")
    a, q = (model.parameter(n, "1", s, n) for n, s in (("a", stiffness), ("q", depth)))
    model.derivative(x, v)
    model.derivative(v, -(a - 2 * q * ca.cos(2 * model.t)) * x)
    return model.freeze()


def test_mathieu_equation_is_unstable_in_its_tongue_and_stable_at_its_border():
    found = linearize(mathieu(1.0, 0.4))
    assert found.period == pytest.approx(np.pi, rel=1e-15)
    assert np.prod(found.eigenvalues) == pytest.approx(1, rel=1e-8)  # Liouville
    assert found.modes[0].growth > 0.5
    # The characteristic value b1(q) of Mathieu's equation ends the tongue (DLMF 28.6.3)
    q = 0.1
    border = 1 - q - q**2 / 8 + q**3 / 64 - q**4 / 1536
    sweep = linearize(mathieu(1.0, q), along={"a": [border - 0.02, border + 0.02]})
    (crossing,) = sweep.crossings
    assert crossing.value == pytest.approx(border, abs=1e-7)


@pytest.mark.quick_rows("<lambda>-6.283185307179586_0", "<lambda>-18.84955592153876")
@pytest.mark.parametrize(
    ("law", "period"),
    [
        (lambda t: ca.sin(3 * t) * ca.cos(2 * t), 2 * np.pi),
        (lambda t: ca.fmod(t, 0.7), 0.7),
        (lambda t: t - 0.25 * ca.floor(t / 0.25), 0.25),
        (lambda t: ca.if_else(ca.sin(t) > 0, 1, 2), 2 * np.pi),
        (lambda t: ca.sin(t / 3 + ca.pi / 4) ** 2, 6 * np.pi),
    ],
)
def test_period_of_a_coefficient_is_read_from_its_formula(law, period):
    model = Model("periodic")
    x = model.state("x", "1", 0.0, "x")
    model.derivative(x, -(2 + law(model.t)) * x)
    found = linearize(model.freeze())
    assert found.period == pytest.approx(period, rel=1e-12)
    t = np.linspace(0, period, 200_001)
    mean = np.mean(2 + np.array(ca.Function("f", [model.t], [law(model.t)]).map(len(t))(t))[0][:-1])
    assert np.log(found.A[0, 0].real) == pytest.approx(-mean * period, rel=1e-4)


@pytest.mark.parametrize("period", [49.0, 98.0, 0.25])  # 49 (1 / 49) is below 1
def test_sawtooth_has_a_period_although_its_slopes_differ_by_rounding(period):
    model = Model("sawtooth")
    x = model.state("x", "1", 0.0, "x")
    model.derivative(x, -(2 + model.t - period * ca.floor(model.t / period)) * x)
    dae = model.freeze()
    assert period_of(dae, assign(dae)) == pytest.approx(period, rel=1e-15)


@pytest.mark.parametrize("law", [ca.exp, ca.sqrt, lambda t: t, lambda t: t * ca.sin(t)])
def test_coefficient_without_a_period_is_rejected(law):
    model = Model("aging")
    x = model.state("x", "1", 0.0, "x")
    model.derivative(x, -law(model.t) * x)
    with pytest.raises(InitialConditionError, match="x depends on time without a period"):
        linearize(model.freeze())


def timed_loop(law):
    """x' = u - x; every 0.1 s, u becomes -8 law(t) x."""
    model = Model("timed_loop")
    x, u = model.state("x", "1", 1.0, "x"), model.discrete("u", "1", 0.0, "u")
    model.derivative(x, u - x)
    model.every(0.1, {u: -8 * law(model.t) * x})
    return model.freeze()


def test_sampled_law_that_is_periodic_in_time_has_the_map_of_the_common_period():
    found = linearize(timed_loop(lambda t: ca.cos(2 * np.pi * t / 0.3)))
    assert found.period == pytest.approx(0.3, rel=1e-12)  # before: 0.1, as if cos were always 1
    decay = np.exp(-0.1)
    factors = [decay - 8 * (1 - decay) * np.cos(2 * np.pi * k / 3) for k in range(3)]
    assert found.eigenvalues[0] == pytest.approx(np.prod(factors), rel=1e-8)


def test_sampled_law_without_a_period_is_rejected():
    with pytest.raises(InitialConditionError, match="of u depends on time without a period"):
        linearize(timed_loop(lambda t: t))


def test_load_in_a_sampled_law_leaves_the_map_as_it_is():
    loaded = Model("loaded")
    x, u = loaded.state("x", "1", 1.0, "x"), loaded.discrete("u", "1", 0.0, "u")
    loaded.derivative(x, u - x)
    loaded.every(0.1, {u: loaded.t - 8 * x})
    found = linearize(loaded.freeze())
    assert found.period == pytest.approx(0.1, rel=1e-12)
    assert found.eigenvalues[0] == pytest.approx(np.exp(-0.1) - 8 * (1 - np.exp(-0.1)), rel=1e-9)


def test_load_that_depends_on_time_leaves_the_linear_system_as_it_is():
    model = Model("loaded")
    x = model.state("x", "1", 0.0, "x")
    model.derivative(x, -2 * x + ca.exp(model.t))
    found = linearize(model.freeze())
    assert found.period is None
    assert found.A.tolist() == [[-2.0]]


def test_periodic_motion_of_a_driven_nonlinear_oscillator_is_found():
    model = Model("duffing", stop_time=200.0)
    x, v = model.state("x", "1", 0.0, "x"), model.state("v", "1/s", 0.0, "v")
    model.derivative(x, v)
    model.derivative(v, -0.5 * v - x - x**3 + 0.2 * ca.cos(2 * model.t))
    dae = model.freeze()
    found = linearize(dae, at="equilibrium")
    late = cosim.simulate(dae, stop_time=100 * np.pi, relative_tolerance=1e-10)
    np.testing.assert_allclose(found.x, late.values[-1, :2], atol=1e-7)
    assert found.modes[0].growth < 0
    assert np.prod(found.eigenvalues) == pytest.approx(np.exp(-0.5 * np.pi), rel=1e-8)


def test_sampled_model_with_another_event_is_rejected():
    model = Model("both")
    x, u = model.state("x", "1", 0.0, "x"), model.discrete("u", "1", 0.0, "u")
    model.derivative(x, u - x)
    model.every(0.5, {u: -x})
    model.when(x > 1, {x: 0}, name="reset")
    with pytest.raises(InitialConditionError, match="event 'reset' may happen within a period"):
        linearize(model.freeze())


def test_fmu_whose_linear_system_changes_with_time_is_rejected(tmp_path):
    """The multiplier of this Mathieu equation is above 1, but its A at the start is stable."""
    path = cosim.export_fmu(mathieu(1.0, 0.4), tmp_path / "mathieu.fmu")
    with pytest.raises(FmuError, match="is another one than at the start"):
        linearize(path)


def test_load_on_an_fmu_leaves_its_linear_system_as_it_is(tmp_path):
    model = Model("loaded")
    x, v = model.state("x", "1", 0.0, "x"), model.state("v", "1/s", 0.0, "v")
    model.derivative(x, v)
    model.derivative(v, -4 * x + ca.cos(2 * model.t))
    found = linearize(cosim.export_fmu(model.freeze(), tmp_path / "loaded.fmu"))
    assert sorted(mode.value.imag for mode in found.modes) == pytest.approx([-2, 2], abs=1e-15)


def test_fmu_with_samples_is_rejected(tmp_path):
    path = cosim.export_fmu(sampled(), tmp_path / "sampled.fmu")
    with pytest.raises(FmuError, match="has an event at"):
        linearize(path)
