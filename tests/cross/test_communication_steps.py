"""Co-simulation through fmpy: solvers inside the FMU, at any communication step."""

from dataclasses import replace

import pytest

import cosim

TIGHT = 1e-10
SPAN = {"stop_time": 1.0, "relative_tolerance": TIGHT}


def runs(path, steps):
    """Return the same run at several communication steps, every 0.1 s of them."""
    for step in steps:
        run = cosim.simulate_fmu(path, interface="CoSimulation", output_interval=step, **SPAN)
        every = round(0.1 / step)
        yield replace(run, time=run.time[::every], values=run.values[::every])


@pytest.mark.slow_rows(
    "bar_on_frame/reduced-erk-2-1e-08",
    "bar_on_frame/reduced-rosenbrock-2-1e-08",
    "crank_shaft/multipliers-rosenbrock-3-1e-08",
)
@pytest.mark.parametrize(
    ("name", "solver", "fmi", "spread"),
    [
        ("bar_on_frame/reduced", "dop853", 2, 1e-12),  # one solution, interpolated
        ("bar_on_frame/reduced", "dop853", 3, 1e-12),
        ("bar_on_frame/reduced", "erk", 2, 1e-8),  # begins anew in every step
        ("bar_on_frame/reduced", "rosenbrock", 2, 1e-8),
        ("crank_shaft/multipliers", "rosenbrock", 3, 1e-8),
        ("crank_shaft/multipliers", "dop853", 2, 1e-12),
    ],
)
def test_every_solver_agrees_with_our_integrators_at_every_step(
    name, solver, fmi, spread, tmp_path
):
    dae = cosim.load(name)
    path = cosim.export_fmu(dae, tmp_path / "model.fmu", fmi=fmi, solver=solver)
    reference = cosim.simulate(dae, output_interval=0.1, compiled=False, **SPAN)
    first, *others = runs(path, (0.1, 0.01, 0.002))
    assert cosim.compare(reference, first).worst.scaled < 1e-7  # measured 3e-14 to 7e-9
    for other in others:
        assert cosim.compare(first, other).worst.scaled < spread  # measured 9e-16, 1e-11, 3e-14
