"""fmuloader, which passes FMUs nothing but what the FMI asks for, against the native run."""

import pytest
from fmpy import read_model_description
from helpers.fmuloader_start import started

import cosim

pytest.importorskip("fmuloader")
NAME, STOP, STEPS = "bar_on_frame/reduced", 1.0, 100


@pytest.mark.slow_rows("2")
@pytest.mark.parametrize("fmi", [2, 3])
def test_run_in_fmuloader_is_the_native_one(fmi, exported):
    path = str(exported(NAME, fmi))
    description = read_model_description(path)
    slave, read = started(path, description)
    for i in range(STEPS):
        slave.do_step(STOP * i / STEPS, STOP / STEPS)
    names = ("theta", "theta_dot", "f1_G_F")
    references = {v.name: v.valueReference for v in description.modelVariables}
    got = read([references[name] for name in names])
    slave.terminate()
    slave.free_instance()
    run = cosim.simulate(
        cosim.load(NAME), stop_time=STOP, solver="dop853", relative_tolerance=1e-12
    )
    for name, value in zip(names, got, strict=True):
        assert value == pytest.approx(run[name][-1], rel=1e-7, abs=1e-7)
