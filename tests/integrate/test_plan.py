"""What is settled once serves equal runs only."""

import numpy as np
import pytest
from helpers.oscillators import oscillator

from cosim.errors import ParameterError, UsageError
from cosim.integrate.plan import Asked, Times, plan
from cosim.integrate.run import worthwhile as deciding
from cosim.integrate.simulate import simulate


def asked(**changes):
    usual = Asked(None, Times(0.0, 1.0, 0.1), "erk", (1e-6, None, None), None, False, project=False)
    return usual._replace(**changes)


def test_equal_runs_have_one_plan():
    dae = oscillator().dae
    assert plan(dae, asked()) is plan(dae, asked())
    assert plan(dae, asked()) is not plan(dae, asked(numbers=(1e-7, None, None)))


def test_own_times_are_told_apart_by_their_numbers():
    dae = oscillator().dae
    one, other = np.array([0.0, 0.5, 1.0]), np.array([0.0, 0.25, 1.0])
    first = plan(dae, asked(times=Times(interval=one)))
    assert plan(dae, asked(times=Times(interval=one.copy()))) is first
    assert plan(dae, asked(times=Times(interval=other))).problem.grid[1] == 0.25


def test_a_truth_value_is_not_the_number_that_equals_it():
    dae = oscillator().dae
    assert simulate(dae, stop_time=1, compiled=False).complete
    with pytest.raises(ParameterError):
        simulate(dae, stop_time=True, compiled=False)
    with pytest.raises(UsageError):
        simulate(dae, stop_time=1, compiled=0)


def test_a_compiler_that_comes_or_goes_is_noticed(monkeypatch):
    dae = oscillator().dae
    monkeypatch.setattr(deciding, "has_compiler", lambda: False)
    monkeypatch.setenv("PATH", "/nowhere")
    assert not plan(dae, asked(compiled=None)).problem.compiled
    monkeypatch.setattr(deciding, "has_compiler", lambda: True)
    monkeypatch.setenv("PATH", "/elsewhere")
    assert plan(dae, asked(compiled=None)).problem.compiled
