"""Numbers of a motion between its output times, against closed forms."""

import casadi as ca
import numpy as np
import pytest

import cosim
from cosim.series.curves import Rows, curves, first_crossing, of_rows
from cosim.trajectory import Column, Trajectory


def known(function, times, *, steps=0, breaks=()):
    """Return the curve of one function that is known exactly."""
    rows = Rows(times, function(times)[:, None])
    found = curves(
        lambda t, _: function(t)[None, :, None], [rows], [steps], 1e-8, np.ones(1), breaks
    )
    return found[0]


def test_cosine_whose_periods_are_the_output_intervals_has_its_own_numbers():
    cosine = known(lambda t: np.cos(200 * np.pi * t), np.linspace(0, 1, 101))
    low, low_at, high, high_at = (values[0] for values in cosine.extremes)
    assert (low, high, high_at) == (pytest.approx(-1, abs=1e-9), 1.0, 0.0)  # 2e-11
    assert np.cos(200 * np.pi * low_at) == pytest.approx(-1, abs=1e-9)
    assert cosine.mean()[0] == pytest.approx(0, abs=1e-12)  # measured 2e-15
    assert cosine.rms()[0] == pytest.approx(np.sqrt(0.5), rel=1e-9)
    assert cosine.first(0, 0.5) == pytest.approx(1 / 600, rel=1e-9)
    assert not cosine.rough.any()


@pytest.mark.parametrize(
    ("function", "low", "high"),
    [
        (lambda t: 0 * t + 5.3, (5.3, 0), (5.3, 0)),  # constant: exact, at the first time
        (lambda t: 0 * t, (0, 0), (0, 0)),
        (lambda t: t, (0, 0), (2, 2)),  # largest at the end
        (lambda t: -t, (-2, 2), (0, 0)),  # and at the start
    ],
)
def test_extremes_at_a_row_are_exact(function, low, high):
    extremes = known(function, np.linspace(0, 2, 21)).extremes
    found = [float(values[0]) for values in extremes]
    assert found == [*low, *high]


def test_peak_between_two_rows_is_found_with_its_time():
    sine = known(np.sin, np.array([0.0, 1.0, 2.0, 3.0]))
    assert sine.extremes.high[0] == pytest.approx(1, abs=1e-10)
    assert sine.extremes.high_at[0] == pytest.approx(np.pi / 2, abs=1e-7)


@pytest.mark.parametrize("places", [(0.3,), tuple(np.arange(1, 401) / 401)], ids=["one", "many"])
def test_no_value_is_beyond_those_of_a_jump_that_is_no_event(places):
    def sides(t):
        return 1 - 2.0 * (np.searchsorted(places, t) % 2)

    found = known(sides, np.linspace(0, 1, 21))
    assert (found.extremes.low[0], found.extremes.high[0]) == (-1, 1)  # before: 1.32 and 1.54
    assert found.rough.any()


def test_both_sides_of_a_jump_count_and_nothing_beyond_them():
    def saw(t):
        return np.where(t < 1, t, t - 1)

    times = np.array([0.0, 0.4, 0.8, 1.0, 1.0, 1.2, 1.5])
    rows = Rows(times, np.array([0, 0.4, 0.8, 1.0, 0, 0.2, 0.5])[:, None])
    (found,) = curves(lambda t, _: saw(t)[None, :, None], [rows], [0], 1e-8, np.ones(1), [1.0])
    assert (found.extremes.low[0], found.extremes.high[0]) == (0, 1)
    assert found.extremes.high_at[0] == 1
    assert found.mean()[0] == pytest.approx(0.625 / 1.5, rel=1e-12)
    assert found.first(0, 0.9) == pytest.approx(0.9, rel=1e-9)


def test_a_kink_that_no_event_announces_is_refined():
    kink = known(lambda t: np.abs(t - np.pi / 3), np.linspace(0, 2, 21))
    assert kink.extremes.low[0] == pytest.approx(0, abs=1e-5)
    assert kink.mean()[0] == pytest.approx(((np.pi / 3) ** 2 + (2 - np.pi / 3) ** 2) / 4, rel=1e-6)


def test_one_row_and_rows_alone_are_what_they_are():
    one = of_rows(Rows(np.array([3.0]), np.array([[7.0, np.nan]])))
    assert (one.mean()[0], one.rms()[0], one.extremes.high[0]) == (7, 7, 7)
    assert np.isnan(one.extremes.low[1])
    assert one.first(0, 7) == 3
    rows = of_rows(Rows(np.array([0.0, 1.0]), np.array([[0.0], [2.0]])))
    assert (rows.mean()[0], rows.first(0, 1)) == (1, 0.5)
    assert np.isnan(rows.first(0, 3))


def test_many_runs_are_refined_each_by_itself():
    rates = np.array([1.0, 300.0])
    times = np.linspace(0, 1, 11)

    def sample(t, runs):
        return np.sin(rates[runs][:, None, None] * t[None, :, None])

    rows = [Rows(times, np.sin(rate * times)[:, None]) for rate in rates]
    slow, fast = curves(sample, rows, [0, 0], 1e-8, np.ones(1))
    (alone,) = curves(lambda t, _: np.sin(t)[None, :, None], rows[:1], [0], 1e-8, np.ones(1))
    assert len(slow.begins) < len(fast.begins)
    assert slow.mean() == alone.mean()
    assert fast.extremes.high[0] == pytest.approx(1, abs=1e-10)


# -- runs -----------------------------------------------------------------------------------------


def ball():
    model = cosim.Model("stiff_floor", stop_time=1.0)
    h, v = model.state("h", "m", 0.5, "height"), model.state("v", "m/s", 0.0, "speed")
    force = 1e6 * ca.fmax(-h, 0)
    model.derivative(h, v)
    model.derivative(v, -9.81 + force)
    model.output("F", "N", force, "contact force")
    return model.freeze()


LARGEST = 9.81 + np.sqrt(9.81**2 + 1e6 * 2 * 9.81 * 0.5)  # N, from the energy; 2,078 on the rows


def test_largest_contact_force_of_a_run_is_that_of_the_energy():
    row = next(r for r in cosim.simulate(ball(), solver="dop853").summary() if r["name"] == "F")
    assert row["max"] == pytest.approx(LARGEST, rel=1e-5)
    assert row["min"] == pytest.approx(0, abs=1e-6)


def test_speeds_of_a_bouncing_ball_are_those_of_both_sides_of_its_impact():
    model = cosim.Model("bouncing", stop_time=0.6)
    h, v = model.state("h", "m", 1.0, "height"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(h, v)
    model.derivative(v, -9.81)
    model.when(h < 0, {v: -0.5 * v}, name="impact")
    found = cosim.simulate(model.freeze(), output_interval=0.1).select("v").curves
    speed = np.sqrt(2 * 9.81)
    assert found.extremes.low[0] == pytest.approx(-speed, rel=1e-7)
    assert found.extremes.high[0] == pytest.approx(speed / 2, rel=1e-7)
    fall = speed / 9.81
    height = 1 - (0.5 * speed * (0.6 - fall) - 9.81 / 2 * (0.6 - fall) ** 2)
    assert found.mean()[0] == pytest.approx(-height / 0.6, rel=1e-6)


def test_runs_without_a_motion_say_that_their_numbers_are_of_the_rows():
    rows = Trajectory("m", [0, 1, 2], (Column("x"),), [[0], [1], [4]])
    fixed = cosim.simulate("crank_shaft", stop_time=0.1, solver="rk4")
    adaptive = cosim.simulate("crank_shaft", stop_time=0.1)
    assert rows.summary().caption.endswith("; min and max of the rows")
    assert fixed.summary().caption.endswith("; min and max of the rows")
    assert "of the rows" not in adaptive.summary().caption
    assert repr(adaptive).endswith("min and max of the rows")  # it computes nothing


def test_a_crossing_of_tiny_values_is_found():
    assert first_crossing(np.array([0.0, 1.0]), np.array([3e-200, -1e-200])) == 0.75
