"""Bounds of what a mode or a comparison chooses."""

import casadi as ca
import numpy as np
import pytest
from casadi import SX

from casadi_models.dae.time_bounds import bounds_within


def bounds_of(value, x, *given):
    """Return a function of the ends of x, and of what is given, that returns those of a value."""
    low, high = SX.sym("low"), SX.sym("high")
    return ca.Function("ends", [low, high, *given], [*bounds_within(value, x, (low, high))])


def test_what_a_mode_chooses_keeps_its_infinite_end():
    x, mode = SX.sym("x"), SX.sym("mode")
    found = bounds_of(ca.if_else(mode, ca.exp(x), 0), x, mode)(0, 1000, 1)
    assert [float(end) for end in found] == [1, np.inf]  # before: NaN


@pytest.mark.parametrize(
    ("law", "ends", "found"),
    [
        (lambda x: x < 1, (0, 0.5), (7, 7)),
        (lambda x: x < 1, (0, 2), (0, 7)),
        (lambda x: x < 1, (2, 3), (0, 0)),
        (lambda x: x == 1, (0, 2), (0, 7)),
        (lambda x: x == 1, (2, 3), (0, 0)),
        (lambda x: x != 1, (2, 3), (7, 7)),
        (lambda x: x != 1, (1, 1), (0, 7)),
        (lambda x: ca.logic_and(x > 0, x < 1), (0.5, 2), (0, 7)),
        (lambda x: ca.logic_not(x < 1), (2, 3), (7, 7)),
    ],
)
def test_a_comparison_chooses_between_the_ends_of_both_branches(law, ends, found):
    x = SX.sym("x")
    values = bounds_of(ca.if_else(law(x), 7 + 0 * x, 0), x)(*ends)
    assert [float(end) for end in values] == [*found]
