"""Time derivatives of outputs from a rest on, whatever the time scale of the motion."""

import casadi as ca
import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave

import cosim


@pytest.mark.parametrize("solver", ["dop853", "rk4"])
@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1.0, 1e3])
def test_output_derivatives_at_a_rest_are_those_of_the_closed_form(solver, scale, tmp_path):
    """s = t / T: x'' = (cos(s) - x) / T^2 from rest, so that x = s sin(s) / 2."""
    model = cosim.Model("resonance", stop_time=10 * scale, output_interval=scale / 2)
    x, v = model.state("x", "m", 0.0, "way"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(x, v)
    model.derivative(v, (ca.cos(model.t / scale) - x) / scale**2)
    model.output("y", "1", ca.sin(model.t / scale) + x, "what begins to move")
    model.output("z", "1", ca.sin(model.t / scale + 1), "what moves")
    path = cosim.export_fmu(model.freeze(), tmp_path / "resonance.fmu", solver=solver)
    text = fmpy.read_model_description(path)
    number = {variable.name: variable.valueReference for variable in text.modelVariables}
    slave = FMU2Slave(
        guid=text.guid,
        instanceName="resonance",
        unzipDirectory=fmpy.extract(path),
        modelIdentifier=text.coSimulation.modelIdentifier,
    )
    slave.instantiate()
    slave.setupExperiment(startTime=0.0, stopTime=10 * scale)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    exact = {"y": (1, 1, -1), "z": (np.cos(1), -np.sin(1), -np.cos(1))}
    for name, rates in exact.items():
        for order, rate in enumerate(rates, start=1):
            (found,) = slave.getRealOutputDerivatives([number[name]], [order])
            assert found * scale**order == pytest.approx(rate, abs=2e-5)  # measured 3e-6
    slave.terminate()
    slave.freeInstance()
