"""Models that contain time, and input series: the same run compiled and interpreted.

A right-hand side without its derivative by time or input let a compiled `rosenbrock` take 500
times the steps.
"""

import casadi as ca
import numpy as np
import pytest
from helpers.oscillators import resting_spring

from casadi_models.dae import Model
from cosim.api import simulate
from cosim.errors import CosimError, SolverError
from cosim.integrate.ensemble.simulate_many import simulate_many
from cosim.integrate.solvers import SOLVERS
from cosim.model.driving import with_laws
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


@pytest.mark.slow_rows(
    "time-erk",
    "time-rosenbrock",
    "time-ode8",
    "input series-erk",
    "input series-rosenbrock",
    "input series-ode8",
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


@pytest.mark.slow
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


ADAPTIVE = [name for name, solver in SOLVERS.items() if solver.adaptive]


def decay(rate):
    model = Model("decay", stop_time=1 / rate)
    x = model.state("x", "1", 1.0, "what is left")
    model.derivative(x, -rate * x)
    return model.freeze()


@pytest.mark.slow_rows("1e-09-erk", "1e-09-rosenbrock", "1e-12-erk", "1e-12-rosenbrock")
@pytest.mark.parametrize("solver", ADAPTIVE)
@pytest.mark.parametrize("interval", [1e-9, 1e-12])
def test_output_times_of_a_nanosecond_or_less_are_integrated(solver, interval):
    span = 10 * interval
    run = simulate(decay(1 / span), solver=solver, output_interval=interval)
    error = np.abs(run["x"] - np.exp(-run.time / span)).max()
    assert error < 100 * 1e-8  # measured below 4e-8; 0.6 where such times are passed


def test_failure_in_a_short_run_names_the_time_in_seconds():
    model = Model("blow_up", stop_time=1e-9)
    x = model.state("x", "1", 1.0, "pole at 0.5 ns")
    model.derivative(x, 2e9 * x * x)
    with pytest.raises(SolverError, match=r"At t = 5e-10 and h ="):
        simulate(model.freeze(), solver="cvodes", output_interval=1e-10)


def bump(t):
    """Return 1 from 50 to 55 s, nearly, and 0 elsewhere, without a switch that solvers locate."""
    return np.exp(-(((t - 52.5) / 2.5) ** 64))


@pytest.mark.slow_rows("erk-True", "rosenbrock-True")
@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("solver", ADAPTIVE)
def test_bump_after_a_rest_is_not_stepped_over(solver, compiled):
    if SOLVERS[solver].compiled_only and not compiled:
        return
    run = simulate(resting_spring(), solver=solver, inputs={"force": bump}, compiled=compiled)
    # of 1 - exp(-t/4) (cos wt + sin wt / (4 w)) at its first maximum; 0 if missed
    first = 1 + np.exp(-0.25 * np.pi / np.sqrt(1 - 0.25**2))
    assert run["x"].max() == pytest.approx(
        first, abs=2e-3
    )  # measured 5.4e-4, of the rounded corners


@pytest.mark.slow_rows("erk", "rosenbrock")
@pytest.mark.parametrize("solver", ADAPTIVE)
def test_largest_step_is_honored_and_changes_no_other_run(solver):
    calm = {"solver": solver, "stop_time": 100.0, "start_values": {"x": 1e-3}}
    limited = simulate(resting_spring(), max_step=0.01, **calm)
    assert limited.stats["steps"] >= 10_000 * (1 - 1e-9)
    free, wide = (simulate(resting_spring(), max_step=step, **calm) for step in (None, 1e3))
    assert free.stats["steps"] == wide.stats["steps"] < 5000
    np.testing.assert_array_equal(free.values, wide.values)


def swell(t):
    """Return 1 at 52.5 s, and 0 elsewhere for long, of a wave that rests nowhere for ever."""
    return np.sin(np.pi * t / 105) ** 400


@pytest.mark.slow
def test_variants_in_lanes_see_what_single_runs_see():
    dae = with_laws(resting_spring(), (("force", swell),))
    many = simulate_many(dae, {"x": [0.0, 1e-3]})
    assert many.stats["lanes"]
    assert many["x"].max() > 1  # 0 where the swell is missed
    rests = with_laws(resting_spring(), (("force", bump),))  # its edges are places
    assert simulate_many(rests, {"x": [0.0, 1e-3]})["x"].max() > 1
    short = simulate_many(resting_spring(), {"x": [1e-3]}, max_step=0.01)
    assert short.steps[0] >= 10_000


def test_run_at_other_times_keeps_the_steps_of_a_driven_run():
    run = simulate(resting_spring(), inputs={"force": bump}, solver="dop853")
    again = run.at([20.0, 52.0, 70.0])
    assert again.stats["steps"] == run.stats["steps"]


@pytest.mark.parametrize(("solver", "step"), [("rk4", 0.1), ("cvodes", 0.0), ("cvodes", -1.0)])
def test_largest_step_that_makes_no_sense_is_rejected(solver, step):
    with pytest.raises(CosimError, match="max_step"):
        simulate(resting_spring(), solver=solver, max_step=step)


@pytest.mark.slow_rows("0.5051-0.5071", "0.5-0.51")
@pytest.mark.parametrize(("begin", "end"), [(0.3, 0.7), (0.3, 0.57), (0.5051, 0.5071), (0.5, 0.51)])
def test_pulses_of_a_python_function_are_seen(begin, end):
    model = Model("mass", stop_time=1.0)
    v, force = model.state("v", "m/s", 0.0, "speed"), model.input("f", "N", 0.0, "force")
    model.derivative(v, force)
    run = simulate(
        model.freeze(),
        solver="dop853",
        relative_tolerance=1e-10,
        inputs={"f": lambda t: float(begin <= t < end)},
    )
    assert run.final["v"] == pytest.approx(end - begin, abs=1e-12)


def test_kinks_are_seen_where_the_relative_tolerance_is_0():
    """Of x' = u, where each line from -1 to 1 or back leads to 0."""
    model = Model("sum", stop_time=1.0, output_interval=1.0)
    x, u = model.state("x", "m", 0.0, "way"), model.input("u", "m/s", 0.0, "speed")
    model.derivative(x, u)
    time = np.linspace(0, 1, 52)
    run = simulate(
        model.freeze(),
        inputs=InputSeries(("u",), time, (-1.0) ** np.arange(52)[:, None]),
        solver="dop853",
        relative_tolerance=0.0,
        absolute_tolerance=1e-8,
    )
    assert abs(run["x"][-1]) < 1e-14
