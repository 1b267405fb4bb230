"""Co-simulation through fmpy: solvers inside the FMU, at any communication step."""

from dataclasses import replace

import fmpy
import pytest
from fmpy.fmi2 import FMU2Slave

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


@pytest.mark.parametrize(("start", "step"), [(0.0, 1e-9), (1e6, 1e-9), (1e9, 1e-6)])
def test_steps_of_few_roundings_add_up(start, step, tmp_path):
    """x' = 1 + u, where u is set before each step, which so begins anew."""
    model = cosim.Model("driven", stop_time=1.0)
    x, u = model.state("x", "m", 0.0, "way"), model.input("u", "m/s", 0.0, "rate")
    model.derivative(x, 1 + u)
    path = cosim.export_fmu(model.freeze(), tmp_path / "driven.fmu", solver="dop853")
    text = fmpy.read_model_description(path)
    number = {variable.name: variable.valueReference for variable in text.modelVariables}
    slave = FMU2Slave(
        guid=text.guid,
        instanceName="driven",
        unzipDirectory=fmpy.extract(path),
        modelIdentifier=text.coSimulation.modelIdentifier,
    )
    slave.instantiate()
    slave.setupExperiment(startTime=start)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    time, exact = start, 0.0
    for k in range(100):
        slave.setReal([number["u"]], [k])
        slave.doStep(time, step)
        exact += (1 + k) * (time + step - time)
        time += step
    assert slave.getReal([number["x"]]) == pytest.approx([exact], rel=1e-12)
    slave.terminate()
    slave.freeInstance()
