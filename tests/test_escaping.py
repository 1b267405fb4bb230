"""Foreign text on terminals and in spreadsheets."""

import io

import numpy as np
import pytest

from cosim.errors import FmuError
from cosim.text import LONGEST_SENTENCE, csv_cell, csv_text, sentence, visible
from cosim.trajectory import Column, Trajectory


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("\x1b[2J", r"\x1b[2J"),
        ("a\x07\x7f\x9b1m", r"a\x07\x7f\x9b1m"),
        ("\u202egnp.exe", r"\u202egnp.exe"),
        ("a\nb\tc", r"a\nb\tc"),
        ("Überhöhe θ", "Überhöhe θ"),
    ],
)
def test_control_characters_are_shown(text, shown):
    assert visible(text) == shown


def test_ends_of_lines_may_stay():
    assert visible("a\nb\t\r", lines=True) == "a\nb\t\\r"


def test_sentence_is_one_bounded_line():
    assert sentence("a\n  b\x1b") == r"a b\x1b"
    assert len(sentence("x" * 5000)) == LONGEST_SENTENCE
    assert str(FmuError("first\nsecond \x1b[0m")) == r"first second \x1b[0m"


@pytest.mark.parametrize("name", ["=1+1", "+x", "-x", "@SUM(A1)"])
def test_name_that_a_spreadsheet_would_compute_is_quoted(name):
    assert csv_cell(name) == f"'{name}"
    run = Trajectory("m", np.zeros(1), (Column(name), Column("x")), np.zeros((1, 2)))
    text = io.StringIO()
    run.to_csv(text)
    assert text.getvalue() == f"time,'{name},x\n0,0,0\n"


def test_cell_of_a_table_that_a_spreadsheet_would_compute_is_quoted():
    rows = [{"name": "=1+2", "=x": -1.5, "reason": "\x1b[2J"}]
    assert csv_text(rows) == "name,'=x,reason\n'=1+2,-1.5,\\x1b[2J\n"
