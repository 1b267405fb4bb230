"""Every formulation of the catalogue: CasADi's integrators against fmpy with the exported FMU."""

import subprocess
import sys

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from helpers.fmi_cases import INTERFACES
from helpers.samples import sampled

import casadi_models
import cosim
from cosim.fmi.check.check import check_fmu
from cosim.fmi.export.options import FmuOptions
from cosim.fmi.export.package import source_files, zipped

EVERY = pytest.mark.parametrize("name", sampled(casadi_models.CATALOG))
TIGHT = 1e-10  # relative tolerance of all solvers
BOUND = 1e-6  # largest difference, in nominal values


@pytest.mark.slow_rows("bicycle/multipliers")
@EVERY
def test_neither_fmpy_nor_our_own_checks_find_a_problem(name, exported):
    path = exported(name)
    assert validate_fmu(str(path)) == []
    assert check_fmu(path) == []


@pytest.mark.slow_rows(
    "bicycle/multipliers", "crank_shaft/multipliers", "double_pendulum/quaternion"
)
@EVERY
@pytest.mark.usefixtures("optimized")
def test_a_file_for_one_platform_is_small(name, tmp_path):
    path = cosim.export_fmu(cosim.load(name), tmp_path / "model.fmu")
    assert path.stat().st_size < 480_000  # measured 60 to 459 kB, bounds of limits included


@pytest.mark.slow_rows(
    "crank_shaft/multipliers",
    "bicycle/multipliers",
    "disk_two_bars/reduced",
    "double_pendulum/quaternion",
)
@EVERY
def test_nor_do_they_in_the_description_of_fmi_3(name, tmp_path):
    files = source_files(cosim.load(name), FmuOptions(3))
    path = tmp_path / "model.fmu"
    path.write_bytes(zipped(files))
    assert validate_fmu(str(path)) == []
    assert check_fmu(path) == []


@pytest.mark.slow_rows("ModelExchange-bicycle/multipliers", "CoSimulation-bicycle/multipliers")
@EVERY
@INTERFACES
def test_fmu_agrees_with_our_integrators_over_a_short_run(name, interface, exported):
    short = {"stop_time": 0.2, "output_interval": 0.02, "relative_tolerance": TIGHT}
    reference = cosim.simulate(cosim.load(name), compiled=False, **short)
    run = cosim.simulate_fmu(exported(name), interface=interface, **short)
    worst = cosim.compare(reference, run).worst
    assert worst.scaled <= BOUND, worst  # measured 3e-14 to 6e-8


@pytest.mark.slow
@EVERY
@INTERFACES
def test_fmu_agrees_with_our_integrators_over_the_whole_run(name, interface, exported):
    dae = cosim.load(name)
    tolerance = dae.experiment.reference_tolerance  # 1e-10; tighter for the chaotic pendulum
    reference = cosim.simulate(dae, relative_tolerance=tolerance)
    run = cosim.simulate_fmu(exported(name), interface=interface, relative_tolerance=tolerance)
    assert len(run) == len(reference)
    worst = cosim.compare(reference, run).worst
    assert worst.scaled <= BOUND, worst  # measured 6e-14 to 3e-7


@pytest.mark.slow
@EVERY
@pytest.mark.parametrize("step", [0.001, 0.01, 0.1])
def test_communication_step_does_not_matter(name, step, exported):
    span = {"stop_time": 2.0, "output_interval": 0.1, "relative_tolerance": TIGHT}
    reference = cosim.simulate(cosim.load(name), **span)
    fine = cosim.simulate_fmu(
        exported(name), interface="CoSimulation", **(span | {"output_interval": step})
    )
    every = round(0.1 / step)
    for column in reference.columns:
        gap = np.abs(fine[column.name][::every] - reference[column.name]).max()
        assert gap <= BOUND * column.nominal, column.name  # measured 1e-14 to 2e-8


@pytest.mark.quick_share(0.3)
@EVERY
def test_fmpy_without_any_option_gives_the_right_numbers(name, exported):
    result = fmpy.simulate_fmu(str(exported(name)))
    dae = cosim.load(name)
    assert result["time"][-1] == pytest.approx(dae.experiment.stop_time)
    reference = cosim.simulate(
        dae, stop_time=2.0, output_interval=0.1, relative_tolerance=TIGHT, compiled=False
    )
    rows = np.searchsorted(result["time"], reference.time - 1e-9)
    assert np.allclose(result["time"][rows], reference.time, rtol=0, atol=1e-9)
    for column in reference.columns:
        gap = np.abs(result[column.name][rows] - reference[column.name]).max()
        assert gap <= BOUND * column.nominal, column.name  # measured 3e-14 to 1e-8


@pytest.mark.slow_rows("options0-bicycle/multipliers")
@pytest.mark.parametrize("name", ["crank_shaft/driven", "bicycle/multipliers"])
@pytest.mark.parametrize("options", [[], ["--stop-time", "0.5"]])
def test_command_line_of_fmpy_gives_the_right_numbers(name, options, exported, tmp_path):
    table = tmp_path / "result.csv"
    command = [sys.executable, "-m", "fmpy", "simulate", exported(name), "--output-file", table]
    subprocess.run([*map(str, command), *options], check=True, timeout=120, cwd=tmp_path)
    result = np.genfromtxt(table, delimiter=",", names=True, deletechars="")
    stop = float(options[1]) if options else cosim.load(name).experiment.stop_time
    assert result["time"][-1] == pytest.approx(stop)
    reference = cosim.simulate(
        cosim.load(name),
        stop_time=stop,
        output_interval=stop,
        relative_tolerance=TIGHT,
        compiled=False,
    )
    for column in reference.columns:
        gap = abs(result[column.name][-1] - reference[column.name][-1])
        assert gap <= BOUND * column.nominal, column.name  # measured 5e-14 to 4e-9


@pytest.mark.quick_share(0.3)
@EVERY
@INTERFACES
def test_a_run_with_all_defaults_has_no_note(name, interface, exported):
    assert "note" not in cosim.simulate_fmu(exported(name), interface=interface).stats
