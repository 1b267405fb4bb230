"""Pieces of a run whose lengths differ by rounding share one engine."""

import re
from collections import Counter

import casadi as ca
import numpy as np
import pytest

import cosim
from casadi_models.dae import Model
from cosim.errors import SolverError
from cosim.integrate.solvers import SOLVERS

A, GAIN, PERIOD = 0.5, 0.8, 0.05


def sampled_lag(algebraic):
    """Declare x' = -A x + h, in which h = -GAIN x is taken every PERIOD."""
    model = Model("lag", stop_time=5.0, output_interval=0.02)
    x = model.state("x", "1", 1.0, "x")
    held = model.discrete("held", "1", 0.0, "held value")
    rate = held - A * x
    if algebraic:
        rate = model.algebraic("rate", "1/s", 0.0, "its rate")
        model.equation(rate - held + A * x)
    model.derivative(x, rate)
    model.every(PERIOD, {held: -GAIN * x}, name="sample")
    return model.freeze()


def exact(times):
    x, found = 1.0, np.empty(len(times))
    for k in range(int(times[-1] / PERIOD) + 1):
        rest = -GAIN * x / A
        here = times >= k * PERIOD - 1e-9
        found[here] = rest + (x - rest) * np.exp(-A * (times[here] - k * PERIOD))
        x = rest + (x - rest) * np.exp(-A * PERIOD)
    return found


@pytest.fixture
def built(monkeypatch):
    """Return how many engines each solver has built."""
    counts = Counter()
    for name, solver in SOLVERS.items():

        def engine(self, problem, name=name, own=solver.engine):
            counts[name] += 1
            return own(self, problem)

        monkeypatch.setattr(solver, "engine", engine)
    return counts


BOTH = [
    (name, compiled)
    for name, solver in SOLVERS.items()
    for compiled in (False, True)
    if not solver.takes_times or not (compiled or solver.compiled_only)
]


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows(*(f"{n}-{c}" for n, c in BOTH if n not in ("cvodes", "idas", "rk4")))
@pytest.mark.parametrize(("name", "compiled"), BOTH)
@pytest.mark.parametrize("largest", [None, 0.004])
def test_samples_share_engines(name, compiled, largest, built):
    adaptive = SOLVERS[name].adaptive
    size = {"max_step": largest} if adaptive else {"step_size": largest}
    dae = sampled_lag(SOLVERS[name].solves_dae)
    run = cosim.simulate(dae, solver=name, compiled=compiled, **size)
    bound = 1e-6 if adaptive else 1e-9  # measured 3e-7 and 3e-11
    np.testing.assert_allclose(run["x"], exact(run.time), rtol=0, atol=bound)
    runs = 1 if adaptive else 2  # fixed steps are checked by smaller ones
    assert built[name] <= 16 * runs  # of 100 pieces; measured 14


def test_trials_of_an_event_share_an_engine(built):
    model = Model("ball", stop_time=3.0, output_interval=0.02)
    h, v = model.state("h", "m", 1.0, "height"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(h, v)
    model.derivative(v, -9.81 - 0.3 * ca.sin(h))
    model.when(h < 0, {v: -0.8 * v}, name="impact")
    run = cosim.simulate(model.freeze(), solver="cvodes")
    assert built["cvodes"] <= 3 * len(run.events)  # measured 14 of 6


@pytest.mark.parametrize("name", ["cvodes", "erk"])
@pytest.mark.parametrize("compiled", [False, True])
def test_message_of_a_piece_gives_the_time_of_the_run(name, compiled):
    model = Model("blow_up", stop_time=2.0)
    x, n = model.state("x", "1", 1.0, "x"), model.discrete("n", "1", 0, "samples")
    model.derivative(x, x * x)
    model.every(0.3, {n: n + 1}, name="sample")
    with pytest.raises(SolverError) as error:
        cosim.simulate(model.freeze(), solver=name, compiled=compiled)
    times = re.findall(r"\bt = ([-+.\de]*\d)", str(error.value))
    np.testing.assert_allclose([float(t) for t in times], 1.0, rtol=0, atol=1e-3)


LATE = 1e9  # s; the double next to it is 1.2e-7 s away


def driven_oscillator():
    """Declare x'' = -4 x + u from cos(0), and w' = cos(t - LATE)."""
    model = Model("late", stop_time=5.0, output_interval=0.125)
    x, v = model.state("x", "m", 1.0, "place"), model.state("v", "m/s", 0.0, "speed")
    w, u = model.state("w", "s", 0.0, "integral"), model.input("u", "m/s2", 0.0, "drive")
    model.derivative(x, v)
    model.derivative(v, -4 * x + u)
    model.derivative(w, ca.cos(model.t - LATE))
    return model.freeze()


ADAPTIVE = [name for name, solver in SOLVERS.items() if solver.adaptive]


@pytest.mark.slow_rows(*(f"drive1-{name}" for name in ADAPTIVE if name != "cvodes"))
@pytest.mark.parametrize("name", ADAPTIVE)
@pytest.mark.parametrize("drive", [None, {"u": f"4*(t - {LATE})"}], ids=["free", "drive1"])
def test_late_times_do_not_round_steps(name, drive):
    """cvodes was 1.2e-4 off, and dop853 7.4e-7, without a note."""
    settings = {"relative_tolerance": 1e-10, "inputs": drive}
    run = cosim.simulate(
        driven_oscillator(), solver=name, start_time=LATE, stop_time=LATE + 5, **settings
    )
    t = run.time - LATE
    x = np.cos(2 * t) if drive is None else np.cos(2 * t) + t - np.sin(2 * t) / 2
    rounding = 4 * np.spacing(LATE)  # of the times at which laws of time are evaluated
    np.testing.assert_allclose(run["x"], x, rtol=0, atol=rounding if drive else 5e-8)
    np.testing.assert_allclose(run["w"], np.sin(t), rtol=0, atol=rounding)


def test_late_times_do_not_round_steps_of_many_runs():
    dae = driven_oscillator()
    starts = {"x": np.array([0.5, 1.0, 2.0])}
    times = {"start_time": LATE, "stop_time": LATE + 5}
    runs = cosim.simulate_many(dae, start_values=starts, relative_tolerance=1e-10, **times)
    t = np.arange(41) * 0.125
    exact = np.outer(starts["x"], np.cos(2 * t))
    np.testing.assert_allclose(runs["x"], exact, rtol=0, atol=5e-8)


@pytest.mark.parametrize("late", [LATE, 1e12])
def test_what_rests_at_a_late_time_is_simulated(late, tmp_path):
    """dop853 began with 1e-6 s: 'step size too small', and in an FMU 'a singularity'."""
    model = Model("rest", stop_time=5.0, output_interval=1.0)
    x, v = model.state("x", "m", 0.0, "place"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(x, v)
    model.derivative(v, -4 * x)
    dae, times = model.freeze(), {"start_time": late, "stop_time": late + 5}
    runs = [cosim.simulate(dae, solver="dop853", **times)]
    runs.append(cosim.simulate_many(dae, start_values={"x": np.zeros(3)}, **times))
    runs.append(cosim.simulate_fmu(cosim.export_fmu(dae, tmp_path / "rest.fmu", fmi=2), **times))
    for run in runs:
        np.testing.assert_array_equal(run["x"], 0)
