"""Resets are counted exactly from whatever time a run starts, on every backend.

x' = 1 is reset at a period. Rows and resets are at the same times, at others, or only at the stop
time; the oracle counts with fractions.
"""

import math
from fractions import Fraction
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import casadi as ca
import fmpy
import numpy as np
import pytest

import cosim

SOLVERS = ["dop853", "cvodes", "idas", "rk4", "erk", "rosenbrock"]
FMUS = [(fmi, kind, master) for fmi in (2, 3) for kind in ("CS", "ME") for master in ("fmpy", "c")]
# period of the resets, output interval, length of the run, s
CASES = {
    "in each second row": (Fraction(1, 2), Fraction(1, 4), 10),
    "in each row, none of which is exact": (Fraction(1, 10), Fraction(1, 10), 10),
    "in thirds": (Fraction(1, 3), Fraction(1, 3), 10),
    "between rows": (Fraction(7, 20), Fraction(1, 4), 10),
    "at the stop time": (Fraction(5, 2), Fraction(1, 2), 10),
    "once, at the stop time": (Fraction(10), Fraction(5, 2), 10),
}
STARTS = [0.0, 1.0, 1e3, 1e6, 1e9]
INTERFACES = {"CS": "CoSimulation", "ME": "ModelExchange"}
FOLDER = Path(mkdtemp())


@cache
def counter():
    model = cosim.Model("counter", stop_time=10.0, output_interval=0.5)
    period = model.parameter("period", "s", 1.0, "time between two resets")
    x, n = (
        model.state("x", "s", 0.0, "time since the last"),
        model.discrete("n", "1", 0.0, "resets"),
    )
    model.derivative(x, 1 + 0 * x)
    model.when(x >= period, {x: 0, n: n + 1}, name="reset")
    return model.freeze()


@cache
def exported(fmi):
    return cosim.export_fmu(counter(), FOLDER / f"counter_{fmi}.fmu", fmi=fmi)


def counted(backend, start, case):
    """Return rows of time and of the number of resets; of equal times, the last one tells."""
    period, interval, length = CASES[case]
    options = {
        "start_time": start,
        "stop_time": start + length,
        "output_interval": float(interval),
        "start_values": {"period": float(period)},
    }
    if backend in SOLVERS:
        run = cosim.simulate(counter(), solver=backend, **options)
    elif backend[2] == "c":
        interface = INTERFACES[backend[1]]
        run = cosim.simulate_fmu(exported(backend[0]), interface=interface, master="c", **options)
    else:
        found = fmpy.simulate_fmu(
            exported(backend[0]), fmi_type=INTERFACES[backend[1]], output=["n"], **options
        )
        return found["time"], found["n"]
    return run.time, run["n"]


def assert_exact(backend, start, case):
    period, interval, length = CASES[case]
    time, n = counted(backend, start, case)
    rows = int(Fraction(length) / interval) + 1
    right = [int(k * interval / period) for k in range(rows)]
    assert n[-1] == right[-1], (case, start)
    if len(n) == rows:  # fmpy adds a row at each event
        np.testing.assert_array_equal(n, right, f"{case}, from {start:g} s on")
    assert time[-1] == pytest.approx(start + length, rel=1e-9)


@pytest.mark.slow_rows("dop853-1000000.0")
@pytest.mark.quick_rows("cvodes-1000.0", "dop853-1000000.0")
@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("solver", SOLVERS)
def test_resets_of_a_native_run_are_counted(solver, start):
    for case in CASES:
        assert_exact(solver, start, case)


@pytest.mark.quick_rows("2-CS-c-1000.0", "3-ME-c-1000000.0")
@pytest.mark.parametrize(
    ("backend", "start"),
    [
        pytest.param(backend, start, id="-".join(map(str, (*backend, start))))
        for backend in FMUS
        for start in STARTS
        if backend[2] == "c" or start < 1e9  # fmpy ends its runs 1e-9 of the time early
    ],
)
def test_resets_of_an_fmu_are_counted(backend, start):
    for case in CASES:
        assert_exact(backend, start, case)


@pytest.mark.slow
def test_rounding_does_not_add_up_over_many_rows():
    model = cosim.Model("saw", stop_time=100.0, output_interval=1e-3)
    x, n = (
        model.state("x", "s", 0.0, "time since the last"),
        model.discrete("n", "1", 0.0, "resets"),
    )
    model.derivative(x, 1.0)
    model.when(x >= 1, {x: 0, n: n + 1}, name="reset")
    dae = model.freeze()
    found = [cosim.simulate(dae, solver=solver, outputs=["n"]).final["n"] for solver in SOLVERS]
    assert found == [100] * len(SOLVERS)  # before: 99 with cvodes


@pytest.mark.quick_rows("cvodes-1000000000.0", "dop853-1000000.0")
@pytest.mark.parametrize("start", [1e6, 1e9])
@pytest.mark.parametrize("solver", ["dop853", "cvodes", "rk4"])
def test_no_event_is_early_by_the_steps_before_it(solver, start):
    """y' = 1 passes a boundary shortly after a row; a fast oscillator costs many steps."""
    model = cosim.Model("fast", stop_time=10.0, output_interval=0.5)
    x, v = model.state("x", "1", 0.0, "angle"), model.state("v", "1/s", 50.0, "rate")
    y, n = model.state("y", "s", 0.0, "time"), model.discrete("n", "1", 0.0, "passages")
    model.derivative(x, v)
    model.derivative(v, -2500 * x)
    model.derivative(y, 1 + 0 * y)
    later = model.parameter("later", "s", 0.1, "how long after a row")
    model.when(y > 5 + later, {n: n + 1}, name="beyond")
    dae, steps = model.freeze(), {"step_size": 0.01} if solver == "rk4" else {}
    span = {"start_time": start, "stop_time": start + 10, "solver": solver}
    rounding = 16 * np.spacing(start)
    for later_by in (1e-3, 2 * rounding):
        run = cosim.simulate(dae, start_values={"later": later_by}, **span, **steps)
        assert [e.time - start for e in run.events] == pytest.approx([5 + later_by], abs=rounding)


@pytest.mark.parametrize("start", [1e6, 1e9])
@pytest.mark.parametrize("solver", ["dop853", "cvodes"])
def test_what_a_jump_of_an_input_has_moved_beyond_has_switched(solver, start):
    """x' = 1 is above u for 1 s, below it for 1e-4 s from its jump on, then above it again."""
    model = cosim.Model("overtaken", stop_time=3.0, output_interval=0.25)
    x, y = model.state("x", "m", 0.0, "way"), model.state("y", "s", 0.0, "time above u")
    u = model.input("u", "m", 0.0, "what it is compared with")
    model.derivative(x, 1.0)
    model.derivative(y, ca.if_else(x > u, 1.0, 0.0))
    steps = start + np.array([0, 1, 1, 3.0]), [[-1.0], [-1.0], [1.0001], [1.0001]]
    options = {"start_time": start, "stop_time": start + 3, "solver": solver}
    run = cosim.simulate(model.freeze(), inputs=cosim.InputSeries(("u",), *steps), **options)
    rounding = 16 * np.spacing(start)
    assert run.final["y"] == pytest.approx(2.9999, abs=rounding)
    assert [e.time - start for e in run.events] == pytest.approx([1, 1.0001], abs=rounding)


@pytest.mark.parametrize("start", [0.0, 1e9])
@pytest.mark.parametrize("power", [3, 5])
def test_what_slowly_leaves_its_boundary_does_so_at_once(power, start):
    """x = t^power / power! from the start on: x > 0 holds at all later times."""
    model = cosim.Model("departing", stop_time=2.0)
    chain = [model.state(f"x{i}", "1", 0.0, "way") for i in range(power)]
    y = model.state("y", "s", 0.0, "time beyond")
    for this, following in zip(chain, [*chain[1:], 1 + 0 * y], strict=True):
        model.derivative(this, following)
    model.derivative(y, ca.if_else(chain[0] > 0, 1.0, 0.0))
    run = cosim.simulate(model.freeze(), start_time=start, stop_time=start + 2, solver="dop853")
    assert run.final["y"] == pytest.approx(2, abs=1e-12)


@pytest.mark.parametrize("unit", [1e-12, 1e-9, 1e3, 1e6, 1e9])
@pytest.mark.parametrize("power", [3, 4])
def test_what_slowly_leaves_its_boundary_does_so_on_any_time_scale(power, unit):
    """x = (t / unit)^power, on scales on which derivatives by seconds are tiny."""
    model = cosim.Model("departing", stop_time=4 * unit, output_interval=unit)
    chain = [model.state(f"x{i}", "1", 0.0, "way") for i in range(power)]
    y = model.state("y", "s", 0.0, "time at the boundary")
    highest = math.factorial(power) / unit**power + 0 * y
    for this, following in zip(chain, [*chain[1:], highest], strict=True):
        model.derivative(this, following)
    model.derivative(y, ca.if_else(chain[0] <= 0, 1.0, 0.0))
    for solver in ("dop853", "cvodes"):
        assert cosim.simulate(model.freeze(), solver=solver).final["y"] == 0  # before: 2e-2 units


@pytest.mark.parametrize("start", [0.0, 1e5, 1e9])
@pytest.mark.parametrize(("power", "unit", "size"), [(3, 1e6, 1e-6), (4, 1e3, 1e-3), (5, 1e6, 1.0)])
def test_what_slowly_leaves_its_boundary_in_slow_runs_does_so_at_once(power, unit, size, start):
    """x = size (t / unit)^power / power!, by states that change within the unit."""
    model = cosim.Model("departing", stop_time=unit, output_interval=unit / 4)
    chain = [model.state(f"x{i}", "1", 0.0, "way") for i in range(power)]
    n = model.discrete("n", "1", 0.0, "departures")
    for this, following in zip(chain, [*chain[1:], size], strict=True):
        model.derivative(this, following / unit)
    model.when(chain[0] > 0, {n: n + 1}, name="departs")
    dae = model.freeze()
    for solver in ("dop853", "cvodes"):
        run = cosim.simulate(dae, solver=solver, start_time=start, stop_time=start + unit)
        # before: up to 1e-2 units later, and with dop853 too many steps from 1e5 s on
        assert [event.time for event in run.events] == [start]


@pytest.mark.quick_rows("cvodes-1700000000.0", "rk4-100000000.0")
@pytest.mark.parametrize("start", [0.0, 1e7, 1e8, 1.7e9])
@pytest.mark.parametrize("solver", ["dop853", "cvodes", "rk4"])
def test_fast_events_of_a_late_run_keep_their_distance(solver, start):
    """A relay turns x' = 1 and -1 at w and -w, with no end of a step between these."""
    model = cosim.Model("relay", stop_time=1.0, output_interval=0.1)
    x, d = model.state("x", "1", 0.0, "place"), model.discrete("d", "1", 1.0, "direction")
    width, steps = 3e-4, {"step_size": 0.01} if solver == "rk4" else {}
    model.derivative(x, d)
    model.when(x >= width, {d: -1}, name="up")
    model.when(x <= -width, {d: 1}, name="down")
    span = {"start_time": start, "stop_time": start + 0.1, "solver": solver}
    run = cosim.simulate(model.freeze(), **span, **steps)
    assert len(run.events) > 160
    distances, rounding = np.diff([e.time for e in run.events]), np.spacing(start + 1)
    # before: 3e-6 more at 1e7 s, 5e-4 less at 1e8 s, and none at 1.7e9 s ("Zeno")
    np.testing.assert_allclose(distances, 2 * width, rtol=1e-11, atol=4 * rounding)


@pytest.mark.parametrize("start", [1e6, 1e9])
@pytest.mark.parametrize("solver", ["dop853", "cvodes", "erk", "rosenbrock"])
def test_rows_and_events_are_as_accurate_from_a_late_start_on(solver, start):
    model = cosim.Model("swing", stop_time=3.0, output_interval=0.25)
    x, v = model.state("x", "1", 0.0, "angle"), model.state("v", "1/s", 1.0, "rate")
    n = model.discrete("n", "1", 0.0, "passages")
    model.derivative(x, v)
    model.derivative(v, -x)
    model.when(x > 0.5, {n: n + 1}, name="half")
    span = {"start_time": start, "stop_time": start + 3, "relative_tolerance": 1e-10}
    run = cosim.simulate(model.freeze(), solver=solver, **span)
    assert np.abs(run["x"] - np.sin(run.time - start)).max() < 1e-8  # measured 3e-9, cvodes
    assert [e.time - start for e in run.events] == pytest.approx([np.pi / 6], abs=1e-15 * start)


@pytest.mark.parametrize("start", [1e8, 1e9])
@pytest.mark.parametrize("driven_by", ["input", "time"])
def test_what_drives_a_late_fmu_is_as_accurate_as_its_times(driven_by, start, tmp_path):
    """x'' = sin(5 t) - x; no tolerance asks for more digits than times have."""
    model = cosim.Model("driven", stop_time=3.0, output_interval=0.1)
    x, v = model.state("x", "1", 0.0, "angle"), model.state("v", "1/s", 1.0, "rate")
    force, begin = model.input("u", "1", 0.0, "force"), model.parameter("begin", "s", 0.0, "time")
    model.derivative(x, v)
    model.derivative(v, (force if driven_by == "input" else ca.sin(5 * (model.t - begin))) - x)
    dae, rows = model.freeze(), np.linspace(0, 3, 31)

    def options(begin, tolerance):
        series = cosim.InputSeries(("u",), begin + rows, np.sin(5 * rows)[:, None])
        span = {"start_time": begin, "stop_time": begin + 3, "start_values": {"begin": begin}}
        return {"inputs": series, "relative_tolerance": tolerance, **span}

    fmu = cosim.export_fmu(dae, tmp_path / "driven.fmu", solver="dop853")
    right = cosim.simulate(dae, solver="dop853", **options(0, 1e-12))
    run = cosim.simulate_fmu(fmu, interface="CoSimulation", **options(start, 1e-10))
    difference = abs(run["x"][-1] - right["x"][-1])  # before: "a singularity, or more steps than"
    assert difference < np.spacing(start)  # measured 0.1 to 0.7 roundings


@pytest.mark.parametrize(("start", "period"), [(1e6, 1e-9), (1e9, 1e-6)])
@pytest.mark.parametrize("solver", ["dop853", "cvodes", "rk4", "FMU"])
def test_motion_between_samples_that_are_few_roundings_apart_adds_up(
    solver, start, period, tmp_path
):
    model = cosim.Model("sampled", stop_time=1.0)
    x, n = model.state("x", "s", 0.0, "time"), model.discrete("n", "1", 0.0, "samples")
    model.derivative(x, 1 + 0 * x)
    model.every(period, {n: n + 1}, name="sample")
    dae, length = model.freeze(), 100 * period
    span = {"start_time": start, "stop_time": start + length, "output_interval": length / 2}
    if solver == "FMU":
        run = cosim.simulate_fmu(cosim.export_fmu(dae, tmp_path / "sampled.fmu"), **span)
    else:
        run = cosim.simulate(dae, solver=solver, **span)
    np.testing.assert_allclose(run["x"], run.time - start, rtol=1e-12)
