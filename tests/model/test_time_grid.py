"""Output times: where they lie, and which of them are refused."""

import math

import numpy as np
import pytest

from cosim.errors import ParameterError
from cosim.integrate.keywords import requested
from cosim.model.times import checked_grid, time_grid


def test_whole_number_of_intervals_ends_at_the_stop_time():
    grid = time_grid(0, 4, 0.01)
    assert len(grid) == 401
    assert grid[0] == 0
    assert grid[-1] == 4
    np.testing.assert_allclose(np.diff(grid), 0.01, rtol=1e-12)


def test_rest_of_an_interval_is_the_last_one():
    assert time_grid(1, 2, 0.3).tolist() == pytest.approx([1, 1.3, 1.6, 1.9, 2])
    assert time_grid(0, 0.1, 5).tolist() == [0, 0.1]


def test_span_that_is_tiny_beside_the_interval_has_both_ends():
    assert time_grid(0, 1e-12, 0.01).tolist() == [0, 1e-12]


def test_equal_start_and_stop_give_one_time():
    assert time_grid(2.5, 2.5, 0.01).tolist() == [2.5]


def test_stop_that_rounding_moved_makes_no_extra_interval():
    assert len(time_grid(0, 0.1 + 0.2, 0.1)) == 4
    assert len(time_grid(0, 1, 1 / 3 * (1 + 1e-9))) == 4
    late = 2.0**20  # after which 1e-5 s are 1.00001e-5 s
    assert len(time_grid(late, late + 1e-5, 1e-6)) == 11


@pytest.mark.parametrize("interval", [0.01, 0.1, 1 / 3, 0.007])
def test_shorter_run_has_the_first_times_of_the_longer_one(interval):
    full = time_grid(0.3, 7.3, interval)
    for k in range(1, len(full) - 1):
        np.testing.assert_array_equal(time_grid(0.3, full[k], interval), full[: k + 1])


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ((0, -1, 0.1), "stop_time = -1 s lies before start_time = 0 s; give a later stop"),
        ((0, 5e-324, 1e-3), "a run of 4.94066e-324 s has no steps; give a later stop"),
        ((0, math.nan, 0.1), "stop_time = nan is not finite"),
        ((math.inf, 1, 0.1), "start_time = inf is not finite"),
        ((0, "1", 0.1), "stop_time = '1' is not a real number"),
        ((0, 1, 0), "output_interval = 0 is not positive"),
        ((0, 1, -0.1), "output_interval = -0.1 is not positive"),
        ((0, 1, math.nan), "output_interval = nan is not finite"),
        ((0, 1, 1e-9), r"makes 1e\+09 output times of 1 numbers, 16 GB; give a larger one"),
        ((0, 1e308, 1e-308), "makes inf output times"),
        ((1e16, 1e16 + 8, 0.1), r"is not after the one before it; .* double precision"),
    ],
)
def test_impossible_span_is_refused_in_one_sentence(arguments, reason):
    with pytest.raises(ParameterError, match=reason) as caught:
        time_grid(*arguments)
    assert "\n" not in str(caught.value)


def test_memory_counts_every_number_of_a_row():
    assert len(time_grid(0, 1, 1e-6)) == 1_000_001
    with pytest.raises(ParameterError, match=r"of 1000 numbers, 8\.01 GB"):
        time_grid(0, 1, 1e-6, numbers=1000)


@pytest.mark.parametrize(
    ("grid", "reason"),
    [
        ([0.0], "two or more finite times"),
        ([], "two or more finite times"),
        (3.0, "two or more finite times"),
        ([[0, 1]], "in one dimension"),
        ([0, math.nan], "finite times"),
        ([0, 1, 1], r"time 2 \(1 s\) is not after the one before it"),
        ([0, 2, 1, 0], r"time 2 \(1 s\) is not after the one before it"),
        (["a", "b"], "give times in s"),
        (None, "two or more|give times"),
    ],
)
def test_grid_that_does_not_increase_is_refused(grid, reason):
    with pytest.raises(ParameterError, match=f"grid: .*({reason})"):
        checked_grid(grid)


def test_a_new_span_replaces_the_times_of_a_request():
    request = requested("crank_shaft", output_times=[0.1, 0.25, 0.4])
    shorter = requested(request, stop_time=0.2, output_interval=0.1)
    np.testing.assert_allclose(shorter.times.grid(shorter.dae), [0, 0.1, 0.2])
    closer = requested(request, output_interval=0.2)
    np.testing.assert_allclose(closer.times.grid(closer.dae), [0, 0.2, 0.4])
    assert requested(request).times == request.times
    assert requested(request, start_time=0.05).times.grid(request.dae)[0] == 0.05
    with pytest.raises(ParameterError, match="increase"):
        requested(request, start_time=0.2)


@pytest.mark.parametrize(
    ("stop", "interval", "intervals"),
    [(6.000004, 1e-5, 600_001), (6.00000005, 1e-5, 600_000), (1.0, 0.3333333, 3), (1.0, 0.333, 4)],
)
def test_the_last_interval_is_shorter_or_hardly_longer(stop, interval, intervals):
    grid = time_grid(0, stop, interval)
    assert len(grid) == intervals + 1
    assert grid[-1] == stop
    assert np.diff(grid)[-1] <= 1.01 * interval


@pytest.mark.parametrize(
    ("start", "stop", "interval"),
    [
        (1e6, 1000000.0000040873, 4.087284888812758e-09),
        (-1e9, -999999999.99999, 1e-6),
        (1e9, 1000000000.0000031, 3.0594922546836176e-06),
    ],
)
def test_intervals_of_a_few_roundings_make_a_grid(start, stop, interval):
    grid = time_grid(start, stop, interval)
    assert (grid[0], grid[-1]) == (start, stop)
    assert np.diff(grid).max() <= interval + 2 * np.spacing(abs(start))
