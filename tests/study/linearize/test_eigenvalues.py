"""Eigenvalues by structure and in any units, followed along a parameter; states without a slope."""

import casadi as ca
import numpy as np
import pytest

import cosim
from casadi_models.dae import Model
from cosim.errors import InitialConditionError
from cosim.study.linearize.spectrum import Spectrum, Step


def linear_model(matrix, names="xyz"):
    """A model x' = A x; entries may be functions of the parameter mu."""
    model = Model("linear")
    mu = model.parameter("mu", "1", 0.5, "mu")
    states = [model.state(name, "1", 0.0, name) for name in names[: len(matrix)]]
    for state, row in zip(states, matrix, strict=True):
        entries = (entry(mu) if callable(entry) else entry for entry in row)
        model.derivative(state, sum(a * x for a, x in zip(entries, states, strict=True)))
    return model.freeze()


def test_eigenvalues_of_a_light_stiff_cantilever_do_not_depend_on_its_units():
    found = cosim.linearize(linear_model([[0, 1e12], [-0.1, 0]]))
    size = np.sqrt(0.1 * 1e12)
    np.testing.assert_allclose(sorted(found.eigenvalues.imag), [-size, size], rtol=1e-15)


def test_unstable_loop_beside_a_very_fast_state_keeps_its_eigenvalues():
    found = cosim.linearize(linear_model([[0, 1, 0], [1, 0, 0], [0, 0, -1e13]]))
    np.testing.assert_allclose(sorted(found.eigenvalues.real), [-1e13, -1, 1], rtol=1e-15)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("size", [1e-200, 1e200])
def test_squares_of_entries_do_not_leave_the_range_of_numbers(size):
    found = cosim.linearize(linear_model([[0, size], [-size, 0]]))
    np.testing.assert_allclose(sorted(found.eigenvalues.imag), [-size, size], rtol=1e-15)


def test_double_integrator_has_two_zeros_without_rounding():
    assert cosim.linearize(linear_model([[0, 1], [0, 0]])).eigenvalues.tolist() == [0, 0]


def test_undamped_modes_are_undecided_and_damped_ones_are_decided():
    undamped = Spectrum.of(np.array([[1e-17, 1.0], [-1.0, 1e-17]]), np.zeros((2, 2)))
    assert np.all(np.abs(undamped.values.real) <= undamped.errors)
    assert not cosim.linearize(linear_model([[-1e-6, 1], [-1, -1e-6]])).undecided


def test_error_of_an_eigenvalue_covers_its_true_error():
    generator = np.random.default_rng(1)
    for _ in range(20):
        exact = np.diag([-1e6, -1.0, 1e-3])
        turn = generator.normal(size=(3, 3))
        found = Spectrum.of(turn @ exact @ np.linalg.inv(turn), np.zeros((3, 3)))
        order = np.argsort(found.values.real)
        apart = np.abs(found.values[order] - np.diag(exact))
        assert np.all(apart <= 10 * np.linalg.cond(turn) * found.errors[order])


@pytest.mark.quick_rows("values2")
@pytest.mark.parametrize("values", [np.linspace(-0.95, 1, 20), np.linspace(-1, 1, 21), [-1, 0.7]])
def test_eigenvalues_mu_and_minus_mu_cross_at_0(values):
    sweep = cosim.linearize(
        linear_model([[0, lambda m: m], [lambda m: m, 0]]), along={"mu": values}
    )
    assert [c.value for c in sweep.crossings] == pytest.approx([0, 0], abs=1e-15)
    assert sorted(c.unstable for c in sweep.crossings) == ["above", "below"]
    falling, rising = sorted(sweep.eigenvalues.real.T.tolist(), key=lambda column: column[-1])
    np.testing.assert_allclose(rising, values, atol=1e-15)  # each column follows one eigenvalue
    np.testing.assert_allclose(falling, np.negative(values), atol=1e-15)


@pytest.mark.parametrize("decreasing", [False, True])
def test_crossing_of_a_slow_mode_beside_a_fast_one_is_located(decreasing):
    dae = linear_model([[lambda m: 1e-6 * (m - 0.3), 0.0], [1.0, -1e6]])
    coupled = linear_model([[lambda m: 1e-6 * (m - 0.3), 1e-9], [1e-9, -1e6]])
    values = np.linspace(0, 1, 8)[:: -1 if decreasing else 1]
    for model, accuracy in ((dae, 1e-15), (coupled, 1e-3)):
        (crossing,) = cosim.linearize(model, along={"mu": values}).crossings
        assert crossing.value == pytest.approx(0.3, abs=accuracy)
        assert crossing.unstable == "above"


@pytest.mark.parametrize("decreasing", [False, True])
@pytest.mark.parametrize("damping", [-0.2, -0.05, 0.05])
def test_column_buckles_where_its_stiffness_vanishes(damping, decreasing):
    """Shortly before (or after), its oscillation splits into two real modes."""
    dae = linear_model([[0, 1.0], [lambda m: m - 0.7, damping]])
    for values in (np.linspace(0, 1, 8), [0.0, 1.0], [0.65, 0.72]):
        along = {"mu": values[:: -1 if decreasing else 1]}
        (crossing,) = cosim.linearize(dae, along=along).crossings
        assert crossing.value == pytest.approx(0.7, abs=1e-14)
        assert crossing.frequency == 0
        assert crossing.unstable == ("above" if damping < 0 else "below")


def test_crossings_of_coupled_modes_are_those_of_the_determinant():
    generator = np.random.default_rng(99)
    for _ in range(3):
        a, b = generator.normal(size=(2, 3, 3))
        rows = [
            [lambda m, u=u, v=v: u + m * v for u, v in zip(*pair, strict=True)]
            for pair in zip(a, b, strict=True)
        ]
        values = np.linspace(-1, 1, 81)
        found = cosim.linearize(linear_model(rows), along={"mu": values}).crossings
        dets = [np.linalg.det(a + m * b) for m in (-2, -1, 1, 2)]
        roots = np.roots(np.polyfit((-2, -1, 1, 2), dets, 3))
        real = sorted(r.real for r in roots if abs(r.imag) < 1e-12 and abs(r.real) < 1)
        assert [c.value for c in found if not c.frequency] == pytest.approx(real, abs=1e-9)


def test_mode_that_only_touches_the_axis_does_not_cross_it():
    dae = linear_model([[lambda m: -(m**2)]])
    assert not cosim.linearize(dae, along={"mu": [-1.0, 0.0, 1.0]}).crossings


def test_pairs_are_exchanged_until_each_eigenvalue_has_its_own_continuation():
    first = Spectrum.of(np.array([[0.0, 1.0], [1.0, 0.0]]), np.zeros((2, 2)))
    second = Spectrum.of(np.array([[0.0, -1.0], [-1.0, 0.0]]), np.zeros((2, 2)))
    change = np.array([[0.0, -2.0], [-2.0, 0.0]])
    step = Step.between(first, second, change)
    np.testing.assert_allclose(second.values[list(step.partners)], -first.values)


def law_model(law, *, output=None):
    model = Model("law")
    x, u = model.state("x", "1", 0.0, "x"), model.input("u", "1", 0.0, "u")
    model.derivative(x, law(x, u))
    if output is not None:
        model.output("y", "1", output(x, u), "y")
    return model.freeze()


def saturated(value):
    return ca.fmin(ca.fmax(value, -1), 1)


@pytest.mark.parametrize(
    "law",
    [
        lambda x, u: -x + ca.sin(x) / x,
        lambda x, u: -x + ca.sign(x) * ca.fabs(x) ** (1 / 3),
        lambda x, u: -x + ca.sqrt(x),
    ],
)
def test_state_without_a_finite_derivative_is_rejected(law):
    with pytest.raises(InitialConditionError, match=r"x"):
        cosim.linearize(law_model(law))


@pytest.mark.parametrize("u", [1.0, -1.0])
def test_corner_of_nested_saturations_is_rejected(u):
    dae = law_model(lambda x, u: -x + saturated(saturated(u)))
    said = r"^law: f(min|max) of [^@_]*u[^@_]* exactly at 0 at .* another one on each side"
    with pytest.raises(InitialConditionError, match=said):
        cosim.linearize(dae, start_values={"u": u})
    assert cosim.linearize(dae, start_values={"u": 0.5 * u}).B.tolist() == [[1.0]]
    assert cosim.linearize(dae, start_values={"u": 2 * u}).B.tolist() == [[0.0]]


def test_kink_of_an_output_is_rejected_where_the_output_is_requested():
    dae = law_model(lambda x, u: u - x, output=lambda x, u: ca.fabs(x))
    with pytest.raises(InitialConditionError, match=r"exactly at 0 .* another one on each side"):
        cosim.linearize(dae, outputs=["y"])
    assert cosim.linearize(dae, outputs=["x"]).C.tolist() == [[1.0]]
    assert cosim.linearize(dae, outputs=["y"], start_values={"x": -2.0}).C.tolist() == [[-1.0]]


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize(
    ("law", "x", "switch"),
    [
        (lambda x: ca.sign(x) - x, 0.0, "sign of x is exactly at 0"),
        (lambda x: ca.floor(x) - x, 0.0, "floor of x is exactly at 0"),
        (lambda x: ca.ceil(x) - x, 3.0, "ceil of .* is exactly at -3"),
        (lambda x: ca.fmod(x, 1.0) - x, 2.0, "fmod of .* is exactly at 2"),
        (lambda x: ca.if_else(x > 1, 1.0, -x), 1.0, "< of .* is exactly at 0"),
    ],
)
def test_state_at_a_jump_with_equal_slopes_on_both_sides_is_rejected(law, x, switch):
    dae = law_model(lambda x, u: law(x))
    with pytest.raises(InitialConditionError, match=f"{switch} at its initial state"):
        cosim.linearize(dae, start_values={"x": x})  # before: A of one side, without a word
    assert cosim.linearize(dae, start_values={"x": x + 0.25}).A.shape == (1, 1)


def test_remainder_of_a_small_number_is_the_number():
    dae = law_model(lambda x, u: ca.fmod(x, 1.0) - 3 * x)
    assert cosim.linearize(dae, start_values={"x": 0.0}).A.tolist() == [[-2.0]]
