"""The worked example of docs/kane.md, judged by what the page does not know."""

import re
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import cosim

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "kane.md").read_text(encoding="utf-8")
STATE = {"arm": 0.3, "swing": 0.5, "arm_rate": 2.0, "swing_rate": -1.5}


@pytest.fixture(scope="module")
def page():
    """Return what the page's code defines."""
    names = {}
    for code in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL):
        exec(code, names)
    return names


@pytest.fixture(scope="module")
def rates(page):
    """Return the accelerations and outputs of the page's model at `STATE`, for a current."""
    dae = page["build"]()
    function = ca.Function("rates", dae.arguments, [dae.ode, dae.outputs])
    p = [v.start for v in dae.parameters]
    names = [v.name for v in dae.output_variables]

    def at(current, **changes):
        state = {**STATE, **changes}
        ode, outputs = function(0, [*state.values(), current], [], [0.0], p)
        return np.array(ode).ravel()[2:4], dict(zip(names, np.array(outputs).ravel(), strict=True))

    return at


def test_accelerations_are_those_that_lagrange_confirms(rates):
    dae = cosim.load(f"{ROOT / 'examples' / 'furuta.py'}:build")
    function = ca.Function("rates", dae.arguments, [dae.ode])
    p = [v.start for v in dae.parameters]
    for current in (0.0, 2.0):
        expected = function(0, list(STATE.values()), [], [0.09 * current], p)
        found, _ = rates(current)
        np.testing.assert_allclose(found, np.array(expected).ravel()[2:], rtol=1e-12)


def test_hanging_pendulum_is_held_by_its_weight(rates):
    _, outputs = rates(0.0, swing=0.0, arm_rate=0.0, swing_rate=0.0)
    assert outputs["lift"] == pytest.approx(0.075 * 9.81, rel=1e-12)


def test_torque_that_prescribes_an_acceleration_gives_it_to_the_free_arm(page, rates):
    torque = page["torque_for"](STATE["swing"], STATE["arm_rate"], STATE["swing_rate"], 10.0)
    found, _ = rates(torque / 0.09)
    assert found[0] == pytest.approx(10.0, rel=1e-12)


@pytest.mark.slow
def test_power_of_the_motor_is_the_rate_of_the_energy(page):
    run = cosim.simulate(
        page["build"](), inputs={"voltage": "6*sin(4*t)"}, output_interval=1e-3, stop_time=2.0,
        relative_tolerance=1e-10, solver="erk",
    )  # fmt: skip
    power = run["torque"] * run["arm_rate"]
    work = np.concatenate(([0.0], np.cumsum((power[1:] + power[:-1]) / 2 * np.diff(run.time))))
    gained = run["energy"] - run["energy"][0]
    assert np.abs(gained - work).max() < 1e-6  # J; of the trapezoidal rule
    assert np.ptp(work) > 0.01
