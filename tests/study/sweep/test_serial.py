"""A Dae as bytes is the same Dae."""

import numpy as np
import pytest

import cosim
from cosim.study.sweep.serial import dae_from_bytes, dae_to_bytes
from cosim.study.sweep.subject import Subject, opened


@pytest.mark.parametrize("name", ["bicycle/book", "bicycle/multipliers", "double_pendulum"])
def test_a_dae_from_bytes_runs_to_the_same_bits(name):
    dae = cosim.load(name)
    again = dae_from_bytes(dae_to_bytes(dae))
    assert again.full_name == dae.full_name
    assert [v.name for v in again.variables] == [v.name for v in dae.variables]
    runs = [cosim.simulate(d, stop_time=0.1, compiled=False) for d in (dae, again)]
    np.testing.assert_array_equal(runs[0].values, runs[1].values)
    content = dae_to_bytes(dae)
    assert opened(Subject("dae", content)).digest == opened(Subject("model", name)).digest
