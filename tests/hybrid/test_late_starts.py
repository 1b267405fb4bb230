"""Resets are counted exactly from whatever time a run starts, on every backend.

x' = 1 is reset at a period. Rows and resets are at the same times, at others, or only at the stop
time; the oracle counts with fractions.
"""

from fractions import Fraction
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

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
