"""The arm of a URDF file against Pinocchio, which reads the same file."""

import casadi as ca
import numpy as np
import pytest

import cosim

pytest.importorskip("yourdfpy", reason='needs `pip install "cosim-rigid[urdf]"`')
ARM = cosim.load("examples/arm.py:build")
DAMPING = np.array([0.5, 0.5, 0.5, 0.2, 0.2, 0.2])


def accelerations(joints, q, v, torque):
    """Return the accelerations of the example, by joint."""
    states, inputs = ([v.name for v in group] for group in (ARM.states, ARM.inputs))
    values = dict(zip(joints, q, strict=True)) | {
        f"{name}_rate": rate for name, rate in zip(joints, v, strict=True)
    }
    drives = {f"{name}_torque": value for name, value in zip(joints, torque, strict=True)}
    x, u = [values[name] for name in states], [drives[name] for name in inputs]
    rates = ca.Function("rates", ARM.arguments, [ARM.ode])
    found = np.array(rates(0, x, [], u, [])).ravel()
    return np.array([found[states.index(f"{name}_rate")] for name in joints])


def test_accelerations_are_those_that_pinocchio_calculated():
    joints = ["pan", "lift", "elbow", "wrist_pitch", "wrist_yaw", "wrist_roll"]
    q, v = (0.3, -1.1, 0.7, 2.0, -0.4, 1.2), (0.5, -0.8, 1.1, -1.6, 0.9, 2.0)
    found = accelerations(joints, q, v, (10.0, -40.0, 15.0, 3.0, -2.0, 1.0))
    wanted = [  # version 4.1.0, aba
        -0.8214966724613655, -41.88278781943039, 122.09684789953255,
        -67.75338301011388, -9.151089762922693, 7.789844336489962,
    ]  # fmt: skip
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())


def test_accelerations_are_those_of_pinocchio():
    pin = pytest.importorskip("pinocchio")
    model = pin.buildModelFromUrdf("examples/arm.urdf")
    model.damping = np.zeros(6)
    data, random = model.createData(), np.random.default_rng(0)
    joints = list(model.names)[1:]
    for _ in range(100):
        q, v, torque = (random.uniform(-size, size, 6) for size in (3.0, 2.0, 20.0))
        wanted = pin.aba(model, data, q, v, torque - DAMPING * v)
        own = accelerations(joints, q, v, torque)
        np.testing.assert_allclose(own, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())


@pytest.mark.slow
def test_arm_runs_as_an_fmu(tmp_path):
    fmu = cosim.export_fmu(ARM, tmp_path / "arm.fmu")
    run = cosim.simulate(ARM, solver="dop853", relative_tolerance=1e-10, stop_time=1.0)
    again = cosim.simulate_fmu(fmu, stop_time=1.0, relative_tolerance=1e-10)
    assert cosim.compare(run, again).agrees
