"""Models that contain time, and input series: the same run compiled and interpreted.

A right-hand side without its derivative by time or input let a compiled `rosenbrock` take 500
times the steps.
"""

import casadi as ca
import numpy as np
import pytest

from casadi_models.dae import Model
from cosim.integrate.simulate import simulate
from cosim.integrate.solvers import SOLVERS
from cosim.model.inputs import InputSeries

BOTH_WAYS = [name for name, solver in SOLVERS.items() if not solver.compiled_only]


def swing():
    """Declare a stiff pendulum on a pivot that moves in time, pushed from outside."""
    model = Model("swing", stop_time=2.0)
    phi = model.state("phi", "rad", 0.3, "angle")
    rate = model.state("rate", "rad/s", 0.0, "its rate")
    push = model.input("push", "rad/s2", 0.0, "torque over inertia")
    lift = 5 * ca.sin(20 * model.t)
    model.derivative(phi, rate)
    model.derivative(rate, -(9.81 + lift) * ca.sin(phi) - 20 * rate + push)
    return model.freeze()


SERIES = InputSeries(
    ("push",), np.array([0.0, 0.33, 0.9, 1.4, 2.0]), np.array([[0.0], [9.0], [-4.0], [6.0], [0.0]])
)


@pytest.mark.parametrize("solver", BOTH_WAYS)
@pytest.mark.parametrize("inputs", [None, SERIES], ids=["time", "input series"])
def test_compiled_and_interpreted_runs_take_the_same_steps(solver, inputs):
    numbers = {"relative_tolerance": 1e-8} if SOLVERS[solver].adaptive else {}
    one, two = (
        simulate(swing(), solver=solver, inputs=inputs, compiled=compiled, **numbers)
        for compiled in (False, True)
    )
    assert two.stats["steps"] == pytest.approx(one.stats["steps"], rel=0.02)  # measured equal
    apart = np.abs(one.values - two.values).max()
    assert apart < 1e-7  # measured 0 to 1e-12


def test_rosenbrock_takes_no_more_steps_for_time_and_inputs_than_its_order_needs():
    run = simulate(swing(), solver="rosenbrock", relative_tolerance=1e-8, inputs=SERIES)
    assert run.stats["steps"] < 2000  # measured below 600; 100 times as many without df/dt


def test_steps_of_dop853_end_at_the_samples_of_a_series():
    """An error of rounding there, and none that grows where the slope of an input changes."""
    driven = {"inputs": SERIES, "output_interval": 0.07}
    loose, tight = (
        simulate(
            swing(), solver="dop853", relative_tolerance=r, inputs=SERIES, output_interval=0.07
        )
        for r in (1e-10, 1e-13)
    )
    assert loose.time[-1] == 2.0
    assert len(loose) == 30
    apart = np.abs(loose["phi"] - tight["phi"]).max()
    assert apart < 1e-11  # measured below 1e-12; 1e-8 with kinks within steps
    other = simulate(swing(), solver="rosenbrock", relative_tolerance=1e-11, **driven)
    assert np.abs(other["phi"] - tight["phi"]).max() < 1e-8


def test_samples_outside_the_run_or_at_its_outputs_are_no_trouble():
    dae = swing()
    for start, stop, interval in (
        (0.33, 0.9, 0.19),
        (0.5, 0.6, 0.1),
        (1.9, 3.0, 0.1),
        (0, 2, 0.33),
    ):
        options = {"start_time": start, "stop_time": stop, "output_interval": interval}
        one, two = (
            simulate(dae, solver=s, relative_tolerance=1e-10, inputs=SERIES, **options)
            for s in ("dop853", "erk")
        )
        np.testing.assert_array_equal(one.time, two.time)
        assert np.abs(one.values - two.values).max() < 1e-6
