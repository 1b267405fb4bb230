"""Bounds of polynomials, which an expression holds multiplied out."""

from math import prod

import casadi as ca
import numpy as np
import pytest
from casadi import SX

from casadi_models.dae.time_bounds import bounds_along, bounds_within


def random_polynomial(random, x):
    """Return a sum of random products of the variables."""
    terms = []
    for _ in range(5):
        chosen = random.integers(0, x.numel(), random.integers(0, 5))
        terms.append(prod((x[int(i)] for i in chosen), start=SX(random.normal())))
    return sum(terms[1:], terms[0])


@pytest.mark.parametrize("seed", range(10))
def test_values_within_a_box_are_within_bounds_that_close(seed):
    random, n = np.random.default_rng(seed), 1 + seed % 3
    x, low, high = (SX.sym(name, n) for name in ("x", "low", "high"))
    value = random_polynomial(random, x)
    found = bounds_within(ca.exp(value), x, (low, high))
    function = ca.Function("f", [x], [ca.exp(value)])
    bounds = ca.Function("b", [low, high], list(found))
    for width in (1.0, 1e-2, 1e-4):
        begin = random.uniform(-1, 1, n)
        points = begin[:, None] + width * random.uniform(0, 1, (n, 2000))
        seen = np.array(function(points)).ravel()
        least, most = (float(end) for end in bounds(begin, begin + width))
        assert least <= seen.min() * (1 + 1e-12)
        assert seen.max() <= most * (1 + 1e-12)
        if width < 1e-3:  # too wide by the square of the width alone, and what samples miss
            assert most - least < 1.2 * np.ptp(seen) + 1e3 * width**2


def test_a_square_that_is_multiplied_out_is_bounded_as_closely_as_one_that_is_not():
    s, length, place = SX.sym("s"), SX.sym("length"), 1.5e6
    forms = [((s - place) / 30) ** 2, (s * s - 2 * place * s + place**2) / 900]
    off = []
    for form in forms:
        bounds = bounds_along(ca.exp(-form), s, length)
        off.append(ca.Function("off", [s, length], list(bounds)))
    begins = place + np.linspace(-2000, 2000, 41)
    close, open_ = (np.fmin(*map(np.array, f(begins[None], 100.0))) for f in off)
    assert (open_ <= 1.01 * close + 1e-3).all()  # before: infinite
