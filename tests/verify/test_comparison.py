"""Comparing runs: scaled, worst first, and nothing that is not a number slips through."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.trajectory import Column, Event, Trajectory
from cosim.verify.comparison import apart, compare


def run(time=(0, 1, 2), model="m", solver=None, **variables):
    columns = tuple(Column(name, "m", nominal=10.0) for name in variables)
    table = np.array([*variables.values()], dtype=float).reshape(len(variables), -1).T
    return Trajectory(model, np.array(time), columns, table, {"solver": solver} if solver else {})


def test_difference_is_scaled_by_the_nominal_value_and_knows_its_time():
    result = compare(run(x=[0, 1, 2]), run(x=[0, 1.5, 2.25]))
    (difference,) = result.differences
    assert (difference.name, difference.scaled, difference.time) == ("x", 0.05, 1.0)
    assert not result.agrees
    assert compare(run(x=[0, 1, 2]), run(x=[0, 1.5, 2.25]), bound=0.05).agrees


def test_largest_difference_comes_first():
    first = run(x=[0, 1, 2], y=[0, 0, 0], z=[1, 1, 1])
    result = compare(first, run(x=[0, 1, 2.1], y=[0, 0.3, 0], z=[1, 1, 1]))
    assert [d.name for d in result.differences] == ["y", "x", "z"]
    assert result.worst is result.differences[0]


def test_only_common_variables_are_compared_without_those_left_out():
    first, second = run(x=[0, 0, 0], y=[0, 0, 0]), run(y=[0, 0, 0], x=[9, 9, 9], w=[1, 1, 1])
    assert {d.name for d in compare(first, second).differences} == {"x", "y"}
    assert compare(first, second, without=["x"]).agrees


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("both", [False, True])
def test_what_is_not_finite_agrees_with_nothing_and_comes_first(bad, both):
    names = "abcdefg"
    first = {name: [0, 0, 0] for name in names}
    second = {name: [0, 1e-9, 0] for name in names}
    second["d"] = [0, bad, 0]
    if both:
        first["d"] = [0, bad, 0]
    result = compare(run(**first), run(**second))
    assert result.worst.name == "d"
    assert result.worst.scaled == math.inf
    assert not result.agrees


@pytest.mark.parametrize(
    ("second", "reason"),
    [
        (run(y=[0, 0, 0]), "no variable in common"),
        (run(time=(0, 1), x=[0, 0]), r"index 2 on \(3 and 2 in all\); run both with the same"),
        (run(time=(0, 1, 2.1), x=[0, 0, 0]), "different output times from index 2 on"),
    ],
)
def test_runs_that_cannot_be_compared_are_rejected(second, reason):
    with pytest.raises(UsageError, match=reason):
        compare(run(x=[0, 0, 0]), second, resample=False)


def test_runs_without_output_times_are_rejected():
    empty = run(time=(), x=[])
    with pytest.raises(UsageError, match="m has no output times; there is nothing to compare"):
        compare(empty, empty)


def test_times_may_differ_by_rounding():
    assert compare(run(x=[0, 0, 0]), run(time=(0, 1 + 1e-12, 2), x=[0, 0, 0])).agrees


@pytest.mark.parametrize("bound", [math.nan, 0, -1, math.inf, "1", True])
def test_bound_must_be_a_positive_number(bound):
    with pytest.raises(ParameterError, match="compare: bound = "):
        compare(run(x=[0, 0, 0]), run(x=[0, 0, 0]), bound=bound)


def test_verdict_in_words_names_both_runs_the_variable_and_the_bound():
    text = str(compare(run(x=[0, 0, 1], solver="erk"), run(x=[0, 0, 0], model="n")))
    expected = "m [erk] and n DIFFER: x by 1.00e-01 of its nominal value at 2 s (bound 1e-06)"
    assert text == expected


# -- other output times ---------------------------------------------------------------------------


def sampled(n, law=np.sin, start=0.0, stop=2.0, **more):
    time = np.linspace(start, stop, n)
    return replace(run(time=time, x=law(time)), **more)


def test_other_output_times_are_interpolated_with_a_note():
    result = compare(sampled(21), sampled(32))
    assert result.agrees
    assert "compared at 21 times of the first run, 0 ... 2 s" in str(result)
    assert "the second run is interpolated, with an estimated error of" in result.note
    off = compare(sampled(21), sampled(32, lambda t: np.sin(t) + 1e-3))
    assert off.worst.scaled == pytest.approx(1e-4, rel=1e-3)  # nominal 10


def test_other_output_times_are_computed_again_if_possible():
    second = sampled(3)
    again = replace(second, again=lambda t: run(time=t, x=np.sin(t)))
    assert not compare(sampled(21), second).agrees
    result = compare(sampled(21), again)
    assert result.worst.scaled == 0
    assert result.note.endswith("the second run is computed again there")


@pytest.mark.parametrize("known", [True, False], ids=["values", "times"])
@pytest.mark.parametrize(("one", "other"), [(201, 301), (301, 201), (301, 50)])
@pytest.mark.parametrize("jump", [1.0, 1.003])
def test_other_output_times_are_not_interpolated_across_an_event(jump, one, other, known):
    """x = t before, and t + 1 after; 0.3 off between rows on either side of the jump before."""

    def saw(n):
        sides = ({"x": jump}, {"x": jump + 1}) if known else ({}, {})
        return sampled(n, lambda t: t + (t >= jump), events=(Event(jump, "jump", *sides),))

    result = compare(saw(one), saw(other))
    assert result.worst.scaled < 1e-14
    later = compare(saw(one), sampled(other, lambda t: t + (t >= jump + 0.3)))
    assert later.worst.scaled == pytest.approx(0.1, rel=0.5)  # nominal 10


def test_only_the_common_span_is_compared_with_a_note():
    result = compare(sampled(21, stop=2.0), sampled(101, start=0.5, stop=9.5))
    assert "compared at 16 times of the first run, 0.5 ... 2 s" in result.note


def test_runs_without_a_common_time_are_rejected():
    with pytest.raises(UsageError, match="no time in common: they run from 0 to 2 s and from 3"):
        compare(sampled(21), sampled(21, start=3, stop=5))


def test_comparison_shows_its_worst_variables_in_few_lines():
    many = {f"v{i}": [0, 0, i] for i in range(99)}
    zero = {name: [0, 0, 0] for name in many}
    result = compare(run(**many), run(**zero))
    lines = repr(result).splitlines()
    assert len(lines) == 15
    assert lines[0] == str(result)
    assert lines[1].split() == ["name", "difference", "at", "[s]", "largest", "rms", "unit"]
    assert lines[2].split() == ["v98", "9.8", "2", "98", "56.6", "m"]
    assert "<td>v98</td><td>9.8</td><td>2</td>" in result._repr_html_()
    assert next(iter(result)) is result.worst


# -- measurements ---------------------------------------------------------------------------------


def measured(path, text):
    path.write_text(text)
    return Trajectory.read_csv(path)


def test_run_is_evaluated_at_the_measured_times_and_gaps_are_left_out(tmp_path):
    rig = measured(tmp_path / "rig.csv", "time,x [cm]\n0.1,11\n0.1,9\n0.7,\n1.3,133\n5,0\n")
    line = run(time=(0, 0.5, 2), x=[0, 0.5, 2])  # x = t
    for first, second, sign in ((line, rig, 1), (rig, line, -1)):
        result = compare(first, second, bound=0.1)
        np.testing.assert_array_equal(result.residuals.time, [0.1, 0.1, 0.7, 1.3])
        residuals = sign * result.residuals["x"]
        np.testing.assert_allclose(residuals, [0.01, -0.01, np.nan, 0.03], atol=1e-15)
        nominal = first.column("x").nominal
        assert result.worst.scaled == pytest.approx(0.03 / nominal)
        assert result.worst.time == 1.3
        assert "compared at 4 times" in result.note
        assert "gaps left out: 1" in str(result)
    row = compare(line, rig).rows()[0]
    assert (row["unit"], row["largest"]) == ("m", pytest.approx(0.03))
    assert row["rms"] == pytest.approx(math.sqrt(11e-4 / 3))
    assert compare(rig, line).rows()[0]["largest"] == pytest.approx(3.0)  # in cm


def test_gap_of_a_simulation_agrees_with_nothing_even_next_to_a_measurement(tmp_path):
    rig = measured(tmp_path / "rig.csv", "time,x [m]\n0,0\n1,\n2,0\n")
    assert compare(run(x=[0, np.nan, 0]), rig, bound=1.0).worst.scaled == 0  # not measured there
    assert compare(run(x=[np.nan, 0, 0]), rig, bound=1.0).worst.scaled == math.inf


def test_variable_without_a_measured_value_is_rejected(tmp_path):
    rig = measured(tmp_path / "rig.csv", "time,x [m],y [m]\n0,,1\n1,,1\n")
    both = run(time=(0, 1), x=[0, 0], y=[1, 1])
    with pytest.raises(UsageError, match=r"x has no measured value .* without=\['x'\]"):
        compare(both, rig)
    assert compare(both, rig, without=["x"]).agrees


def test_picture_has_points_a_line_and_the_residuals_in_one_unit(tmp_path):
    rig = measured(tmp_path / "rig.csv", "time,x [cm]\n0,10\n1,110\n2,210\n")
    result = compare(run(x=[0, 1, 2]), rig)
    figure = result.plot(tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 5000
    above, below = figure.axes
    line, points = above.lines
    np.testing.assert_allclose(points.get_ydata(), line.get_ydata() + 0.1)  # both in m
    np.testing.assert_allclose(below.lines[0].get_ydata(), 0.1)
    assert (line.get_marker(), points.get_linestyle()) == ("None", "None")
    with pytest.raises(UnknownName, match="no variable 'y'"):
        result.plot(names="y")


@pytest.mark.parametrize("bound", [1e-9, 1e-3, 0.3, 10.0])
def test_the_difference_does_not_depend_on_the_bound(bound):
    time = np.linspace(0, 2, 201)
    columns = (Column("h", "m"),)
    jump = Event(1.0, "impact", {"h": 0.0}, {"h": 0.0})
    ball = Trajectory("ball", time, columns, np.abs(np.cos(np.pi * time))[:, None], events=(jump,))
    flat = Trajectory("flat", time, columns, np.zeros((201, 1)))
    found = compare(ball, flat, bound=bound)
    assert (found.worst.scaled, found.agrees) == (1.0, bound >= 1)


@pytest.mark.parametrize("size", [5e-9, 1e-3, 1.0, 7.0])
def test_a_small_state_without_nominal_value_is_compared_with_its_own_largest_value(size):
    x = np.array([[0.0], [0.5], [1.0]]) * size
    runs = [
        Trajectory("m", np.arange(3.0), (Column("q", "C", is_state=True),), x * factor)
        for factor in (1.0, 0.94)
    ]
    found = compare(*runs)
    assert found.worst.scaled == pytest.approx(0.06 * max(size, 1) if size > 1 else 0.06)
    assert not found
    assert ("of its nominal value" in str(found)) == (size >= 1)


@pytest.mark.parametrize("factor", [0.94, 1.0, -1.0])
def test_a_small_state_beside_a_large_one_is_noted_where_it_differs(factor):
    """6 % of 1e-7 beside 1e4 agreed without a word."""
    columns = tuple(Column(name, "m", is_state=True) for name in ("small", "large"))
    course = np.array([0.0, 0.5, 1.0])
    runs = [
        Trajectory("m", np.arange(3.0), columns, np.array([course * size, course * 1e4]).T)
        for size in (1e-7, factor * 1e-7)
    ]
    found = compare(*runs)
    assert found
    words = f"small differs by {abs(1 - factor):.1g} of its largest value 1e-07"
    assert (words in found.note) == (factor != 1)
    assert (found.note == "") == (factor == 1)


@pytest.mark.parametrize("size", [0.0, 1e-17, 1e-11])
def test_states_that_are_0_for_their_error_control_agree(size):
    columns = (Column("q", "C", is_state=True),)
    runs = [
        Trajectory("m", np.arange(3.0), columns, np.full((3, 1), sign * size)) for sign in (1, -1)
    ]
    assert compare(*runs)


def test_residuals_of_temperatures_are_differences_of_degrees():
    warm, warmer = (
        Trajectory("m", [0, 1], [Column("T", "K", "degC")], [[kelvin]] * 2) for kelvin in (300, 305)
    )
    (row,) = compare(warm, warmer).rows()
    assert (row["largest"], row["rms"], row["unit"]) == (5, 5, "degC")


@pytest.mark.parametrize("scale", [1e-12, 1.0, -1e9])
def test_output_times_differ_relative_to_the_span(scale):
    times = scale * np.arange(3) if scale > 0 else scale + np.arange(3)
    shift = 0.1 * (times[1] - times[0])
    for moved, index in ((times + shift, 0), (np.append(times[:2], times[2] + shift), 2)):
        assert apart(run(times, x=times), run(moved, x=moved)) == index
    assert apart(run(times, x=times), run(times, x=times)) is None
    near = np.nextafter(times, np.inf)
    assert apart(run(times, x=times), run(near, x=times)) is None
