"""Every fault of the table ends in one sentence, with its exit code, and leaves nothing behind."""

import sys

import pytest
from helpers.fault_rows import rows

ROWS = rows()

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="pipes, devices and /proc of Linux")


@pytest.mark.parametrize("row", ROWS, ids=[row.name for row in ROWS])
def test_fault_ends_in_one_sentence(row, ends_well):
    assert ends_well(row) == {}


def test_table_is_as_long_as_promised():
    assert len(ROWS) >= 400
    assert len({row.name for row in ROWS}) == len(ROWS)
