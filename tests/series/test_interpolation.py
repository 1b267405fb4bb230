"""Samples at other times: exact for polynomials, of order 6 for the rest, never across a jump."""

import numpy as np
import pytest

from cosim.series.samples import resample


def test_polynomial_of_degree_5_is_met_exactly_and_samples_are_kept():
    rng = np.random.default_rng(3)
    time = np.sort(rng.uniform(0, 2, 12))
    at = np.sort(np.r_[rng.uniform(time[0], time[-1], 50), time])
    law = np.polynomial.Polynomial(rng.normal(size=6))
    found, _ = resample(time, law(time)[:, None], at)
    np.testing.assert_allclose(found[:, 0], law(at), rtol=0, atol=1e-11)  # measured 2e-14
    np.testing.assert_array_equal(resample(time, law(time)[:, None], time)[0][:, 0], law(time))


def test_error_falls_with_the_sixth_power_and_the_estimate_is_above_it():
    at = np.linspace(1, 2, 999)
    errors = []
    for n in (40, 80):
        time = np.linspace(0, 3, n + 1)
        found, estimate = resample(time, np.sin(5 * time)[:, None], at)
        errors.append(np.abs(found[:, 0] - np.sin(5 * at)).max())
        assert errors[-1] < estimate[0]
    assert errors[0] / errors[1] == pytest.approx(64, rel=0.2)  # measured 62


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_samples_are_kept_beside_one_that_is_not_finite(number):
    time = np.linspace(0, 1, 11)
    values = np.where(np.arange(11) == 5, number, time)
    found, _ = resample(time, values[:, None], time[[0, 4, 5, 6, 10]])
    np.testing.assert_array_equal(found[:, 0], values[[0, 4, 5, 6, 10]])


def test_jump_is_kept_and_both_sides_stay_their_own():
    time = np.array([0, 1, 2, 2, 3, 4.0])
    values = np.array([0, 1, 2, 10, 10, 10.0])[:, None]
    found, _ = resample(time, values, np.array([0.5, 1.999, 2.0, 2.001, 3.5]))
    np.testing.assert_allclose(found[:, 0], [0.5, 1.999, 10, 10, 10])


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
def test_few_samples_take_a_lower_degree(n):
    time = np.arange(n, dtype=float)
    found, _ = resample(time, (3 + 2 * time)[:, None], np.linspace(0, n - 1, 7))
    np.testing.assert_allclose(found[:, 0], 3 + 2 * np.linspace(0, n - 1, 7), atol=1e-14)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_estimate_of_few_samples_is_not_below_the_error(n):
    """Of t^n, whose polynomial through n samples lacks one degree, up to an event that is no row.

    A single sample tells nothing of what is beside it.
    """
    time = np.append(np.arange(n, dtype=float), [n, n + 1])
    at, breaks = np.array([0.5]), np.array([n - 0.25])
    found, estimate = resample(time, (time**n)[:, None], at, breaks)
    assert np.abs(found[:, 0] - at**n) <= estimate
    _, of_samples = resample(time, (time**n)[:, None], time, breaks)
    assert of_samples == 0
