"""The arm of a URDF file against Pinocchio, which reads the same file."""

import casadi as ca
import numpy as np
import pytest

import cosim

ARM = cosim.load("examples/arm.py:build")
DAMPING = np.array([0.5, 0.5, 0.5, 0.2, 0.2, 0.2])


def test_accelerations_are_those_of_pinocchio():
    pin = pytest.importorskip("pinocchio")
    model = pin.buildModelFromUrdf("examples/arm.urdf")
    model.damping = np.zeros(6)
    data, random = model.createData(), np.random.default_rng(0)
    joints = list(model.names)[1:]
    states, inputs = ([v.name for v in group] for group in (ARM.states, ARM.inputs))
    rates = ca.Function("rates", ARM.arguments, [ARM.ode])
    for _ in range(100):
        q, v, torque = (random.uniform(-size, size, 6) for size in (3.0, 2.0, 20.0))
        wanted = pin.aba(model, data, q, v, torque - DAMPING * v)
        values = dict(zip(joints, q, strict=True)) | {
            f"{name}_rate": rate for name, rate in zip(joints, v, strict=True)
        }
        drives = {f"{name}_torque": value for name, value in zip(joints, torque, strict=True)}
        x, u = [values[name] for name in states], [drives[name] for name in inputs]
        found = np.array(rates(0, x, [], u, [])).ravel()
        own = np.array([found[states.index(f"{name}_rate")] for name in joints])
        np.testing.assert_allclose(own, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())


def test_arm_runs_as_an_fmu(tmp_path):
    fmu = cosim.export_fmu(ARM, tmp_path / "arm.fmu")
    run = cosim.simulate(ARM, solver="dop853", relative_tolerance=1e-10, stop_time=1.0)
    again = cosim.simulate_fmu(fmu, stop_time=1.0, relative_tolerance=1e-10)
    assert cosim.compare(run, again).agrees
