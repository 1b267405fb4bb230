"""Start values and algebraic unknowns: solved exactly, or refused with what has no solution."""

import casadi as ca
import numpy as np
import pytest
from casadi import SX

import cosim
from casadi_models.dae import Model
from cosim.codegen.initialization import algebraic_function
from cosim.errors import InitialConditionError
from cosim.integrate.initial_values import algebraic_values, start_values
from cosim.model.values import assign

LENGTH = 2.0


def slider(rod=5.0):
    """Declare a crank-slider: the slider's place closes the loop, its speed follows."""
    model = Model("slider")
    angle = model.state("angle", "rad", 1.0, "crank angle")
    place = model.state("place", "m", 6.0, "slider, from the crank's axis")
    speed = model.state("speed", "m/s", 0.0, "of the slider")
    length = model.parameter("rod", "m", rod, "length of the rod", positive=True)
    x, y = LENGTH * ca.cos(angle), LENGTH * ca.sin(angle)
    model.start_equation(place, (place - x) ** 2 + y**2 - length**2, "closed loop")
    # derivative of the loop for an angular velocity of 1 rad/s
    model.start(speed, -y - x * y / (place - x), "speed of the closed loop")
    model.derivative(ca.vertcat(angle, place, speed), ca.vertcat(1, speed, 0))
    return model.freeze()


def algebraic(residual, guess=0.5, start=1.0):
    model = Model("algebraic")
    x = model.state("x", "1", start, "x")
    z = model.algebraic("z", "1", guess, "z")
    u = model.input("u", "1", 0.0, "u")
    model.derivative(x, -z)
    model.equation(residual(x, z, u))
    return model.freeze()


def starts(dae, **given):
    return start_values(dae, 0.0, assign(dae, given))


# -- start values ---------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.0, 2.0, -3.0])
def test_closed_loop_is_the_closed_form(angle):
    found = starts(slider(), angle=angle)
    x, y = LENGTH * np.cos(angle), LENGTH * np.sin(angle)
    place = x + np.sqrt(25 - y**2)
    np.testing.assert_allclose(found[:2], [angle, place], rtol=4e-16)  # measured 1.2e-16
    np.testing.assert_allclose(found[2], -y - x * y / (place - x), rtol=1e-15, atol=1e-15)


@pytest.mark.parametrize("length", [1e-12, 1e-9, 1e-6, 1e-3, 1.0, 1e6])
@pytest.mark.parametrize("factor", [1e-15, 1.0, 1e15])
def test_loops_of_any_size_close(length, factor):
    model = Model("circle")
    x = model.state("x", "m", 0.6 * length, "x")
    y = model.state("y", "m", 0.9 * length, "y")
    model.derivative(ca.vertcat(x, y), SX(2, 1))
    model.start_equation(y, factor * (x**2 + y**2 - length**2), "the circle")
    found = starts(model.freeze())
    # before: 0.6 % at nanometers, and no solution at micrometers
    np.testing.assert_allclose(found[1], 0.8 * length, rtol=4e-16)  # measured 1.4e-16


def test_tiny_loop_that_cannot_close_is_refused():
    model = Model("gap")
    y = model.state("y", "m", 0.9e-9, "y")
    model.derivative(y, 0)
    model.start_equation(y, y**2 + 1e-18, "the gap")
    with pytest.raises(InitialConditionError, match="no start value of y satisfies the gap"):
        starts(model.freeze())


@pytest.mark.parametrize("size", [1e-15, 1e-12, 1e-9, 1.0])
def test_unknowns_of_small_nominal_values_are_solved_for(size):
    model = Model("cube")
    z = model.algebraic("z", "1", 1.7 * size, "z", nominal=size)
    model.equation((z**3 - 8 * size**3) / size**2)
    found = algebraic_function(model.freeze())(0, [], 1.7 * size, [], [])
    # before: 3 % at 1e-15
    np.testing.assert_allclose(float(found), 2 * size, rtol=1e-14)  # measured 2e-16


def test_start_values_that_are_given_stay_as_they_are():
    dae = cosim.load("crank_shaft")
    np.testing.assert_array_equal(starts(dae, phi=0.1, omega=3.3), [0.1, 3.3])


def test_loop_that_cannot_be_closed_names_the_state_the_law_and_the_nearest_place():
    with pytest.raises(InitialConditionError) as caught:
        starts(slider(), angle=np.pi / 2, rod=1.5)  # shorter than the crank's height, 2 m
    message = str(caught.value)
    assert "slider: no start value of place satisfies the closed loop" in message
    # at place = 0 the gap is 2^2 - 1.5^2 = 1.75 m2; the scan around 6 m ends at 6 - pi
    assert "the closest found leaves a residual of 9.92 at place = 2.858" in message


def test_bicycle_laid_down_with_its_handlebar_across_has_no_pitch():
    dae = cosim.load("bicycle")
    with pytest.raises(InitialConditionError, match="no start value of theta satisfies the pitch"):
        starts(dae, phi=1.5, delta=1.5)


def test_rule_without_a_solution_is_named_and_not_the_one_before_it():
    model = Model("two")
    a = model.state("a", "1", 1.0, "a")
    b = model.state("b", "1", 1.0, "b")
    c = model.parameter("c", "1", 0.25, "c")
    model.start_equation(a, a**2 - 4, "first law")
    model.start_equation(b, b**2 + c - a, "second law")
    model.derivative(ca.vertcat(a, b), ca.vertcat(0, 0))
    dae = model.freeze()
    np.testing.assert_allclose(starts(dae), [2, np.sqrt(1.75)], rtol=1e-15)
    with pytest.raises(InitialConditionError, match=r"start value of b satisfies the second law"):
        starts(dae, c=3.0)


def test_formula_without_a_value_is_named():
    model = Model("root")
    x = model.state("x", "1", 0.0, "x")
    p = model.parameter("p", "1", 4.0, "p")
    model.start(x, ca.sqrt(p), "square root")
    model.derivative(x, 0)
    dae = model.freeze()
    assert starts(dae).tolist() == [2.0]
    with pytest.raises(InitialConditionError, match="square root; its formula has no value"):
        starts(dae, p=-1.0)


def test_calculated_start_value_outside_its_bounds_is_rejected():
    model = Model("bounded")
    x = model.state("x", "m", 0.5, "x", minimum=0.0, maximum=1.0)
    p = model.parameter("p", "m", 0.5, "p")
    model.start(x, p, "copy")
    model.derivative(x, 0)
    with pytest.raises(InitialConditionError, match=r"the start of x is 3 m, outside 0 \.\.\. 1"):
        starts(model.freeze(), p=3.0)


# -- algebraic unknowns ---------------------------------------------------------------------------


def test_linear_equations_are_solved_at_once_whatever_the_guess():
    solve = algebraic_function(algebraic(lambda x, z, u: 4 * x * z - 2 + u))
    for guess in (0.0, np.nan, 1e300):
        assert float(solve(0, 2.0, guess, 1.0, [])) == 0.125


def test_nonlinear_equations_are_solved_from_the_guess():
    solve = algebraic_function(algebraic(lambda x, z, u: z**2 - x))
    assert float(solve(0, 2.0, 0.5, 0, [])) == pytest.approx(np.sqrt(2), rel=1e-15)
    assert float(solve(0, 2.0, -0.5, 0, [])) == pytest.approx(-np.sqrt(2), rel=1e-15)


@pytest.mark.parametrize("x", [-1.0, -1e-3, np.nan])
def test_nonlinear_equations_without_a_solution_give_no_number(x):
    solve = algebraic_function(algebraic(lambda x, z, u: z**2 - x))
    assert np.isnan(float(solve(0, x, 0.5, 0, [])))


@pytest.mark.parametrize(
    ("residual", "start", "what"),
    [
        pytest.param(lambda x, z, u: z**2 - x, -1.0, "z", id="no root"),
        pytest.param(
            lambda x, z, u: x * z - 1, 0.0, "equation 1 of 1 contains no unknown", id="singular"
        ),
    ],
)
def test_start_values_without_consistent_unknowns_are_rejected(residual, start, what):
    dae = algebraic(residual)
    values = assign(dae, {"x": start})
    told = rf"algebraic: .* no solution at the start \({what}"
    with pytest.raises(InitialConditionError, match=told):
        algebraic_values(dae, 0.0, values.x, values)


def test_systems_without_algebraic_unknowns_have_none():
    dae = cosim.load("crank_shaft")
    values = assign(dae)
    assert algebraic_values(dae, 0.0, values.x, values).shape == (0,)


def test_redundant_start_equations_are_rejected_with_one_message():
    """CasADi's factorization of their slopes raises an error of its own."""
    model = Model("twice")
    a, b = model.state("a", "1", 0.3, "a"), model.state("b", "1", 0.4, "b")
    both = ca.vertcat(a, b)
    model.derivative(both, -both)
    model.start_equation(both, ca.vertcat(a + b - 1, 2 * a + 2 * b - 2), "the sum")
    with pytest.raises(InitialConditionError, match="no start value of a, b satisfies the sum;"):
        cosim.simulate(model.freeze(), compiled=False)


def test_first_guess_from_which_nothing_is_found_is_what_to_change():
    """z^2 = x has slope 0 at z = 0, the guess that nobody gave; exp z = x is flat far below."""
    x, z = ca.SX.sym("x"), ca.SX.sym("z")
    flat = cosim.from_casadi({"x": x, "z": z, "ode": -x, "alg": z**2 - x}, {"x": 1.0})
    told = r"equation 1 of 1 has slope 0 at the initial guess\); .*give another initial guess"
    with pytest.raises(InitialConditionError, match=told):
        cosim.simulate(flat, compiled=False)
    far = {"x": x, "z": z, "ode": -x, "alg": ca.exp(z) - x}
    with pytest.raises(InitialConditionError, match=r"z is not finite\); .*start value of z, or"):
        cosim.simulate(cosim.from_casadi(far, {"x": 1.0, "z": -50.0}), compiled=False)
