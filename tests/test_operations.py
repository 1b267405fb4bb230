import json
from pathlib import Path

import pytest

import casadi_models

RECORDED = json.loads((Path(__file__).parents[1] / "benchmarks" / "operations.json").read_text())


def test_every_right_hand_side_has_a_recorded_count():
    assert set(RECORDED) == set(casadi_models.CATALOG)


@pytest.mark.parametrize("name", casadi_models.CATALOG)
def test_right_hand_side_takes_no_more_operations_than_recorded(name):
    """A rise is explained and recorded anew by benchmarks/operations.py --record, or undone."""
    assert casadi_models.load(name).operations() <= RECORDED[name]
