"""Examples of sessions: what a filter may expect of itself, and a controller against a system."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

import cosim

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture
def load(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    return lambda name: runpy.run_path(str(EXAMPLES / f"{name}.py"))


@pytest.mark.parametrize("name", ["filter_roll", "steered"])
def test_example_is_short(name):
    assert len((EXAMPLES / f"{name}.py").read_text().splitlines()) <= 40


@pytest.mark.slow
def test_filter_is_as_good_as_it_says(load):
    example = load("filter_roll")
    names, noise = example["NAMES"], example["NOISE"]
    truth = cosim.simulate("bicycle", start_values=example["START"], stop_time=4, outputs=names)
    squares = []
    with cosim.open("bicycle") as bike:
        for seed in range(3):
            measured = truth["phi"] + np.random.default_rng(seed).normal(0.0, noise, len(truth))
            estimates, deviations = example["filtered"](measured, bike)
            late = (estimates - truth.values)[100:]
            assert np.abs(late[:, 0]).max() < 0.6 * noise  # measured 0.31
            squares.append(np.mean((late / deviations[100:]) ** 2))
    # the filter adds a noise that the motion does not have, so that its errors are smaller
    assert 0.02 < np.mean(squares) < chi2.ppf(0.999, 4) / 4  # measured 0.32


@pytest.mark.slow
def test_python_controller_is_the_coupled_one_with_samples(load):
    example = load("steered")
    times, angles = example["ride"](example["rider"], seconds=2.0).T
    assert np.abs(angles[-50:]).max() < np.radians(0.1)  # measured 0.03 deg
    assert times[-1] == 2.0
    fallen = example["ride"](lambda _: np.zeros(2), seconds=2.0)[-1, 1]
    run = cosim.simulate("bicycle", start_values=example["START"], stop_time=2.0, outputs=["phi"])
    assert fallen == pytest.approx(run.final["phi"], abs=1e-7)  # measured 3e-8
