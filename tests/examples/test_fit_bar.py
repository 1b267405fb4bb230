"""Fit to measurements: errors as small as the Cramer-Rao bound allows, and what has no answer."""

import re
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

import cosim

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "examples" / "fit_bar.py"
TRUE = {"b": 0.035, "theta": np.radians(63.0), "theta_dot": 2.7}
NOISE = np.radians(0.5)
SEEDS = 100


@pytest.fixture(scope="module")
def example():
    return runpy.run_path(str(SCRIPT))


@pytest.fixture(scope="module")
def exact(example):
    times = np.sort(np.random.default_rng(1).uniform(0.02, 4.0, 60))
    return cosim.simulate(
        example["DAE"], start_values=TRUE, output_times=times, outputs=["theta"],
        relative_tolerance=1e-11,
    )  # fmt: skip


@pytest.mark.nightly
def test_errors_of_a_hundred_records_are_as_the_cramer_rao_bound_says(example, exact):
    jacobian = example["slopes"]([*TRUE.values()], [*TRUE], exact)
    assert jacobian.shape == (60, 3)
    bound = NOISE**2 * np.linalg.inv(jacobian.T @ jacobian)
    initial = {name: 1.1 * value for name, value in TRUE.items()}
    errors, covered = [], 0
    for seed in range(SEEDS):
        noise = NOISE * np.random.default_rng(seed).normal(size=exact.values.shape)
        values, covariance = example["fit"](replace(exact, values=exact.values + noise), initial)
        errors.append([values[name] - true for name, true in TRUE.items()])
        covered += abs(errors[-1][0]) < 1.96 * np.sqrt(covariance[0, 0])
    errors = np.array(errors)
    spread = np.sqrt(np.mean(errors**2, axis=0) / np.diag(bound))
    np.testing.assert_allclose(spread, 1.0, atol=0.2)  # measured 1.01 to 1.06; 0.07 is one sigma
    total = np.einsum("si,ij,sj->", errors, np.linalg.inv(bound), errors)
    assert (
        chi2.ppf(0.005, 3 * SEEDS) < total < chi2.ppf(0.995, 3 * SEEDS)
    )  # measured 316 of 241 ... 367
    assert 88 <= covered <= 99  # of 95 % intervals; measured 92


def test_only_one_combination_of_damping_mass_and_length_is_identified(example, exact):
    assert example["identifiable"](exact, {"b": 0.035, "m": 2.9, "length": 0.3}) == 1
    assert example["identifiable"](exact, TRUE) == 3


@pytest.mark.slow
def test_script_writes_the_fitted_scene_and_fmu(tmp_path, monkeypatch, capsys):
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(SCRIPT), run_name="__main__")
    printed = capsys.readouterr().out.strip()
    page = (ROOT / "docs" / "fit.md").read_text()
    assert (
        printed.splitlines()[:4]
        == re.search(r"```text\n(b = .*?)```", page, re.S)[1].splitlines()[:4]
    )
    assert Path("fit.png").stat().st_size > 10_000
    scene = cosim.run_scene(cosim.read_scene("fitted.toml"), stop_time=1.0, outputs=["theta"])
    fmu = cosim.simulate_fmu("fitted.fmu", stop_time=1.0, outputs=["theta"])
    assert cosim.compare(scene, fmu).agrees
    assert scene["theta"][0] == pytest.approx(TRUE["theta"], abs=0.02)
