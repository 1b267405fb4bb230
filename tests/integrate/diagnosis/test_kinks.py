"""Which switch of a model is named where a solver gave up."""

import casadi as ca
import numpy as np

import cosim
from cosim.integrate.diagnosis.kinks import nearest_kink

NONE = np.empty(0)


def kink(x: ca.MX, ode: ca.MX, *place: float) -> str:
    dae = cosim.from_casadi({"x": x, "ode": ode}, name="switched")
    return nearest_kink(dae, 0.0, np.array(place), NONE, NONE, NONE)


def test_a_law_without_a_switch_has_no_kink():
    x = ca.MX.sym("x")
    assert kink(x, -ca.sin(x), 0.3) == ""


def test_nearest_of_several_is_named():
    x = ca.MX.sym("x")
    law = ca.fabs(x - 2) + ca.fmin(x, 0.5)
    assert kink(x, law, 0.6).startswith("fmin switches where (0.5-x) is 0")
    assert kink(x, law, 2.1).startswith("fabs switches where (x-2) is 0")


def test_condition_is_named_not_what_compares_its_truth():
    """`conditional` compares a truth with 1, and that difference is 0 wherever it holds."""
    x = ca.MX.sym("x")
    law = ca.if_else(x > 0.1, -x, -2 * x, True)  # short circuit
    assert kink(x, law, 0.3).startswith("< switches where (0.1-x) is 0, and it is -0.2 there")


def test_switches_beside_calls_of_matrix_functions_are_found():
    x = ca.MX.sym("x", 3)
    law = -x + ca.logsumexp(x) + ca.fabs(x[0] - 1)
    assert kink(x, law, 1.25, 0, 0).startswith("fabs switches where (x_1-1) is 0, and it is 0.25")
