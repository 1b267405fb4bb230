"""Bounds of distances and angles over a box, also where an angle jumps by a turn."""

import casadi as ca
import numpy as np
import pytest
from casadi import SX

from casadi_models.dae.time_bounds import bounds_along, bounds_within

FORMS = {
    "hypot": lambda x, y: ca.hypot(x, y),
    "atan2": lambda x, y: ca.atan2(y, x),
    "two": lambda x, y: ca.atan2(y, x) - 2 * ca.atan2(x - y, 0.3 + x),
}


@pytest.mark.parametrize("form", FORMS)
def test_values_within_a_box_are_within_bounds_that_close(form):
    random, x = np.random.default_rng(3), SX.sym("x", 2)
    low, high = SX.sym("low", 2), SX.sym("high", 2)
    value = FORMS[form](x[0], x[1])
    function = ca.Function("f", [x], [value])
    bounds = ca.Function("b", [low, high], list(bounds_within(value, x, (low, high))))
    begins = np.vstack((random.uniform(-1, 1, (60, 2)), [[0, 0], [-1, 0], [-0.5, -0.01], [0, -1]]))
    for width in (1.0, 0.1, 1e-4):
        for begin in begins:
            points = begin[:, None] + width * random.uniform(0, 1, (2, 3000))
            seen = np.array(function(points)).ravel()
            least, most = (float(end) for end in bounds(begin, begin + width))
            assert least <= seen.min() + 1e-12
            assert seen.max() <= most + 1e-12
            assert most - least < 1.5 * np.ptp(seen) + 100 * width


def test_an_angle_that_jumps_has_no_bound_by_its_slope_and_one_by_both_its_values():
    y, length = SX.sym("y"), SX.sym("length")
    value = ca.exp(-(((ca.atan2(y, -1) - 0.5) / 0.01) ** 2))
    bounds = ca.Function("b", [y, length], list(bounds_along(value, y, length)))
    by_slope, by_value = (float(bound) for bound in bounds(-1e-3, 2e-3))
    assert np.isnan(by_slope)
    assert by_value < 1e-12  # 0 at -pi and at pi, 1 between
    assert not np.isnan(float(bounds(1e-3, 2e-3)[0]))
