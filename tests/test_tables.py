"""Rows as text: aligned, cut to a width, counted beyond a number of lines."""

import pytest

from cosim.text import html_table, invalid_from, text_table, violation

ROWS = [
    {"name": "phi", "value": 0.123456, "meaning": "roll angle " * 9},
    {"name": "x", "value": None, "meaning": ""},
]


def test_columns_are_aligned_and_numbers_short():
    head, first, second = text_table(ROWS).splitlines()
    assert head == "name  value  meaning"
    assert first.startswith("phi   0.123  roll angle roll")
    assert second == "x"


@pytest.mark.parametrize("width", [30, 60, 79])
def test_long_cells_give_way_to_the_width(width):
    lines = text_table(ROWS, width=width).splitlines()
    assert max(map(len, lines)) == width
    assert lines[1].endswith("\u2026")
    assert lines[1].startswith("phi   0.123  roll")


def test_lines_beyond_the_most_are_counted():
    rows = [{"i": i} for i in range(30)]
    lines = text_table(rows, most=15).splitlines()
    assert len(lines) == 15
    assert lines[-1] == "... and 17 more"
    assert lines[-2] == "12"
    assert len(text_table(rows[:14], most=15).splitlines()) == 15
    assert text_table([]) == ""


def test_html_says_the_same_and_escapes():
    table = html_table([{"a<b": "x & y", "n": 1.23456}], "who < what")
    assert "<th>a&lt;b</th>" in table
    assert "<td>x &amp; y</td><td>1.23</td>" in table
    assert "<caption>who &lt; what</caption>" in table


@pytest.mark.parametrize(
    ("reason", "expected"),
    [
        ("invalid from 1.5 s: the wheel lifts", "the wheel lifts"),
        ("invalid from 0.5 s: not fulfilled: x < 2", "not fulfilled: x < 2"),
        ("from 0.5 s on the step is too large", "the step is too large"),
        ("the step failed", "the step failed"),
    ],
)
def test_violation_is_named_in_a_few_words(reason, expected):
    assert violation(reason) == expected


@pytest.mark.parametrize(
    ("condition", "expected"),
    [
        ("the ground pushes it up (the wheel lifts)", "invalid from 1.5 s: the wheel lifts"),
        ("x < 2", "invalid from 1.5 s: not fulfilled: x < 2"),
        ("x (of the wheel) < 2", "invalid from 1.5 s: not fulfilled: x (of the wheel) < 2"),
    ],
)
def test_invalid_run_says_from_when_and_why(condition, expected):
    assert invalid_from(1.5, condition) == expected
