"""Repeated runs of one model build nothing again, and threads share nothing."""

from threading import Thread

import numpy as np
import pytest
from helpers.engines import build
from helpers.oscillators import WAYS, oscillator

import cosim
from cosim.model.solver import Tolerance
from cosim.model.times import time_grid

GRID = time_grid(0, 1, 0.1)


def test_engine_of_equal_settings_is_built_once():
    dae = oscillator().dae
    first = build(dae, GRID, "cvodes", Tolerance(1e-6))
    assert build(dae, GRID.copy(), "cvodes", Tolerance(1e-6)) is first


@pytest.mark.parametrize(
    "other",
    [
        {"grid": time_grid(0, 1, 0.2)},
        {"solver": "erk"},
        {"tolerance": Tolerance(1e-7)},
        {"tolerance": Tolerance(1e-6, 1e-9)},
        {"dae": oscillator().dae},
    ],
    ids=lambda other: next(iter(other)),
)
def test_engine_of_other_settings_is_another_one(other):
    settings = {"grid": GRID, "solver": "cvodes", "tolerance": Tolerance(1e-6)}
    settings["dae"] = oscillator().dae
    assert build(**settings) is not build(**settings | other)


def test_each_thread_has_its_own_engine():
    dae = oscillator().dae
    built = [build(dae, GRID)]
    thread = Thread(target=lambda: built.append(build(dae, GRID)))
    thread.start()
    thread.join()
    assert built[0] is not built[1]


@pytest.mark.slow_rows("rosenbrock-True")
@pytest.mark.parametrize(("solver", "compiled"), WAYS)
def test_run_does_not_depend_on_those_before_it(solver, compiled):
    options = {"solver": solver, "stop_time": 1.0, "output_interval": 0.1, "compiled": compiled}
    dae = oscillator().dae
    states = [variable.name for variable in dae.states]
    moved = {states[0]: 0.3}
    kept = [
        cosim.simulate(dae, start_values=start, **options).values for start in (None, moved, None)
    ]
    fresh = cosim.simulate(oscillator().dae, start_values=moved, **options).values
    assert not np.array_equal(kept[0], kept[1])
    np.testing.assert_array_equal(kept[0], kept[2])
    np.testing.assert_array_equal(kept[1], fresh)
