"""The text that the benchmarks give to the peers says what CasADi evaluates."""

import math
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import cosim

FOLDER = Path(__file__).parents[1] / "benchmarks" / "peers"


@pytest.fixture(scope="module")
def walk():
    sys.path.insert(0, str(FOLDER))
    try:
        yield __import__("walk")
    finally:
        sys.path.remove(str(FOLDER))


@pytest.mark.parametrize("model", ["bicycle", "double_pendulum"])
def test_text_of_a_right_hand_side_evaluates_as_casadi_does(walk, model):
    dae = cosim.load(model)
    start = cosim.start_vectors(dae)
    numbers = ca.vertcat(ca.DM(start["p"]), ca.DM(start["u"]))
    ode = ca.substitute(dae.ode, ca.vertcat(dae.p, dae.u), ca.SX(numbers))
    function = ca.Function("rhs", [dae.t, dae.x], [ode], {"cse": True})
    values = walk.build(function, "rhs", vars(math))
    for x in start["x0"] + np.random.default_rng(5).uniform(-0.3, 0.3, (5, len(start["x0"]))):
        expected = np.array(function(0.0, x)).ravel()
        # the same operations in the same order: measured 0
        np.testing.assert_allclose(values(0.0, x), expected, rtol=1e-15, atol=1e-15)


def test_every_operation_of_the_table_keeps_its_meaning(walk):
    t, x = ca.SX.sym("t"), ca.SX.sym("x", 2)
    a, b = x[0], x[1]
    rows = [t + a, a - b, a * b, a / b, -a, a**2, 2 * b, 1 / a, ca.sqrt(b), ca.sin(a), ca.cos(b)]
    function = ca.Function("f", [t, x], [ca.vertcat(*rows, ca.tan(a), 3, 0)])
    found = walk.build(function, "f", vars(math))(0.5, (0.7, 1.9))
    a, b = 0.7, 1.9
    expected = [0.5 + a, a - b, a * b, a / b, -a, a * a, 2 * b, 1 / a, math.sqrt(b)]
    expected += [math.sin(a), math.cos(b), math.tan(a), 3, 0]
    np.testing.assert_allclose(found, expected, rtol=1e-15)


def test_operation_that_no_peer_was_told_is_refused(walk):
    t, x = ca.SX.sym("t"), ca.SX.sym("x")
    with pytest.raises(NotImplementedError, match="of f"):
        walk.source(ca.Function("f", [t, x], [ca.erf(x)]), "f")
