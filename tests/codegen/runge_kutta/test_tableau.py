"""Order conditions of the fixed-step methods, and the order seen when the step is halved.

Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, II.2: a method has order p when
sum b_i Phi_i(t) = 1 / gamma(t) for every rooted tree t of at most p nodes.
"""

from fractions import Fraction

import casadi as ca
import numpy as np
import pytest
from helpers.order_conditions import density, stage_weights, trees

from cosim.codegen.runge_kutta.tableau import ODE8, RK4, Tableau, step_function

METHODS = {"rk4": RK4, "ode8": ODE8}

NUMBER_OF_TREES = [1, 1, 2, 4, 9, 20, 48, 115]  # with 1 to 8 nodes


def residual(tableau, tree):
    total = sum(b * w for b, w in zip(tableau.b, stage_weights(tree, tableau.a), strict=True))
    return abs(float(total - Fraction(1, density(tree))))


def test_number_of_rooted_trees_is_the_published_one():
    assert [len(trees(n)) for n in range(1, 9)] == NUMBER_OF_TREES


@pytest.mark.parametrize("tree", [t for n in range(1, 5) for t in trees(n)], ids=str)
def test_rk4_satisfies_every_condition_exactly(tree):
    assert residual(RK4, tree) == 0


@pytest.mark.slow_rows("8")
@pytest.mark.parametrize("nodes", range(1, 9))
def test_ode8_satisfies_every_condition_to_the_digits_of_its_source(nodes):
    # Its published coefficients are fractions close to the true ones; measured 4e-18 to 6e-18
    assert max(residual(ODE8, tree) for tree in trees(nodes)) < 1e-16


@pytest.mark.slow_rows("ode8")
@pytest.mark.parametrize("tableau", METHODS.values(), ids=METHODS)
def test_order_is_not_higher_than_declared(tableau):
    assert (
        max(residual(tableau, tree) for tree in trees(tableau.order + 1)) > 1e-6
    )  # measured 1e-2, 8e-6


@pytest.mark.parametrize("tableau", METHODS.values(), ids=METHODS)
def test_method_is_explicit(tableau):
    assert [len(row) for row in tableau.a] == list(range(len(tableau.b)))


@pytest.mark.parametrize(("name", "coarsest"), [("rk4", 10), ("ode8", 2)])
def test_halving_the_step_four_times_shows_the_order(name, coarsest):
    """y' = y cos(t), y(0) = 1 has the solution exp(sin(t))."""
    t, y = ca.MX.sym("t"), ca.MX.sym("y")
    rhs = ca.Function("rhs", [t, y, ca.MX.sym("u", 0), ca.MX.sym("p", 0)], [y * ca.cos(t)])
    step = step_function(rhs, METHODS[name])
    errors = []
    for steps in coarsest * 2 ** np.arange(5):
        h, value = 2.0 / steps, 1.0
        for i in range(steps):
            value = float(step(value, i * h, h, [], []))
        errors.append(abs(value - np.exp(np.sin(2.0))))
    orders = np.log2(errors[:-1]) - np.log2(errors[1:])
    above_rounding = np.array(errors[1:]) > 100 * np.finfo(float).eps
    assert above_rounding.sum() >= 3
    # measured 4.03 4.02 4.01 4.01; 8.02 8.14 8.08, and 7.1 to 7.7 where rounding begins to count
    assert orders[above_rounding] == pytest.approx(METHODS[name].order, abs=0.35)


def test_step_uses_time_inputs_and_parameters():
    t, x, u, p = (ca.MX.sym(n) for n in "txup")
    rhs = ca.Function("rhs", [t, x, u, p], [p * t**3 + u])
    for tableau in METHODS.values():
        end = float(step_function(rhs, tableau)(1.0, 2.0, 0.5, 3.0, 4.0))
        assert end == pytest.approx(1 + (2.5**4 - 2**4) + 1.5, rel=1e-15)


THIRD = Fraction(1, 3)


@pytest.mark.parametrize(
    ("parts", "reason"),
    [
        ((((), (1,)), (THIRD, THIRD)), "weights of the step add up to 0.66"),
        ((((), (1,)), (0, 1), (0, THIRD)), "weights of stage 2 add up to 1.0, its node is 0.33"),
        ((((), (0, 1)), (0, 1)), "weights of earlier stages only"),
        ((((),), (0, 1)), "give a row for each stage"),
    ],
)
def test_tableau_with_a_wrong_weight_is_rejected(parts, reason):
    with pytest.raises(ValueError, match=reason):
        Tableau(2, *parts)


def test_wrong_digit_in_the_coefficients_of_ode8_is_found():
    row = (*ODE8.a[6][:3], Fraction(77736539, 692538347), *ODE8.a[6][4:])
    with pytest.raises(ValueError, match="weights of stage 7"):
        Tableau(8, (*ODE8.a[:6], row, *ODE8.a[7:]), ODE8.b, ODE8.nodes)
