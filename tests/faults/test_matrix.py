"""Every fault of the table ends with one message and its exit code, and leaves no files."""

import sys

import pytest
from helpers.fault_rows import rows
from helpers.samples import sampled

ROWS = {row.name: row for row in rows()}
SAMPLE = [*ROWS][::6]  # each row starts a process

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="pipes, devices and /proc of Linux")


@pytest.mark.slow_rows("own.py:sleep")
# an interrupt may come between the opening of a file and the `with` that would close it
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("name", sampled(ROWS, SAMPLE))
def test_fault_ends_with_one_message(name, ends_well):
    assert ends_well(ROWS[name]) == {}


def test_table_has_at_least_400_rows_with_different_names():
    assert len(ROWS) >= 400
    assert len(ROWS) == len(rows())
