"""A preparation is cached for equal runs only."""

import numpy as np
import pytest
from helpers.oscillators import oscillator

import cosim
from cosim.errors import ParameterError, UsageError
from cosim.integrate import preparation
from cosim.integrate.preparation import prepare

DAE = oscillator().dae


def request(**changes):
    usual = {"stop_time": 1.0, "output_interval": 0.1, "solver": "erk", "compiled": False}
    return cosim.requested(DAE, **(usual | changes))


def test_equal_runs_share_a_preparation():
    assert prepare(request()) is prepare(request(start_values={"x": 2.0}))
    assert prepare(request()) is not prepare(request(relative_tolerance=1e-7))


def test_output_times_are_compared_by_their_numbers():
    one, other = np.array([0.0, 0.5, 1.0]), np.array([0.0, 0.25, 1.0])

    def at(times):
        return cosim.requested(DAE, output_times=times, compiled=False)

    first = prepare(at(one))
    assert prepare(at(one.copy())) is first
    assert prepare(at(other)).problem.grid[1] == 0.25


def test_a_truth_value_is_no_number_and_a_number_no_truth_value():
    assert cosim.simulate(DAE, stop_time=1, compiled=False).complete
    with pytest.raises(ParameterError):
        cosim.simulate(DAE, stop_time=True, compiled=False)
    with pytest.raises(UsageError):
        cosim.simulate(DAE, stop_time=1, compiled=0)


def test_a_compiler_that_comes_or_goes_is_noticed(monkeypatch):
    monkeypatch.setattr(preparation, "has_compiler", lambda: False)
    monkeypatch.setenv("PATH", "/nowhere")
    asked = cosim.requested(DAE, stop_time=1.0)
    assert not prepare(asked).problem.compiled
    monkeypatch.setattr(preparation, "has_compiler", lambda: True)
    monkeypatch.setenv("PATH", "/elsewhere")
    assert prepare(asked).problem.compiled


def test_run_without_a_compiler_says_that_it_is_interpreted(monkeypatch):
    monkeypatch.setattr(preparation, "has_compiler", lambda: False)
    run = cosim.simulate("crank_shaft", stop_time=0.1)
    assert not run.stats.compiled
    assert run.stats["note"].startswith("interpreted: there is no C compiler; bring one: pip")
