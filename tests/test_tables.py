"""Rows as text: aligned, cut to a width, counted beyond a number of lines."""

import pickle

import pytest

from cosim.text import Ending, Violation, html_table, json_text, short_reason, text_table, violated

ROWS = [
    {"name": "phi", "value": 0.123456, "meaning": "roll angle " * 9},
    {"name": "x", "value": None, "meaning": ""},
]


def test_columns_are_aligned_and_numbers_short():
    head, first, second = text_table(ROWS).splitlines()
    assert head == "name  value  meaning"
    assert first.startswith("phi   0.123  roll angle roll")
    assert second == "x"
    assert text_table([{"a": -0.0, "b": 1e-30}]).splitlines()[1] == "0  1e-30"


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


def test_violation_is_a_text_that_knows_its_parts():
    own = Violation(1.23456789, "the wheel lifts")
    assert own == "invalid from 1.23457 s: the wheel lifts"
    assert short_reason(own) == "invalid from 1.23 s: the wheel lifts"
    sent = pickle.loads(pickle.dumps(own))
    assert (sent, sent.time, sent.what) == (own, 1.23456789, "the wheel lifts")
    assert short_reason("the step failed") == "the step failed"
    assert Violation(1234.56789, "late") == "invalid from 1234.57 s: late"
    assert Violation(1e9 + 0.5, "late") == "invalid from 1000000000.5 s: late"
    assert Ending("it failed").after(86400.25) == "stopped after 86400.25 s: it failed"
    assert short_reason(Violation(1234.5678, "late")) == "invalid from 1234.57 s: late"
    assert short_reason(Violation(1e9 + 0.5, "late")) == "invalid from 1000000000.5 s: late"
    assert short_reason(Violation(1.234e-9, "soon")) == "invalid from 1.23e-09 s: soon"


@pytest.mark.parametrize(
    ("condition", "expected"),
    [
        ("the ground pushes it up (the wheel lifts)", "the wheel lifts"),
        ("x < 2", "not fulfilled: x < 2"),
        ("x (of the wheel) < 2", "not fulfilled: x (of the wheel) < 2"),
    ],
)
def test_violated_condition_says_what_is_wrong(condition, expected):
    assert violated(condition) == expected


def test_json_has_null_for_numbers_that_are_not_finite():
    facts = {"a": [1.5, float("nan"), (float("inf"), -0.0)], "b": {"c": -float("inf"), "d": True}}
    assert json_text(facts) == '{"a": [1.5, null, [null, -0.0]], "b": {"c": null, "d": true}}'
