"""Runs of FMUs that went wrong: told in a sentence, and nothing stays."""

import math
import re
import signal
import sys
import tempfile
import threading
import zipfile
from xml.etree import ElementTree as ET

import fmpy
import pytest
from helpers.fmi_cases import INTERFACES, VERSIONS
from helpers.fmu_files import set_attributes, with_description
from helpers.foreign_part import foreign_part

import cosim
from cosim.errors import (
    FmuError,
    UsageError,
)
from cosim.fmi.archive import DESCRIPTION
from cosim.fmi.run.exported import run

pytestmark = pytest.mark.usefixtures("no_trace")

# -- runs that went wrong -----------------------------------------------------------------------


@pytest.mark.slow_rows("2-ModelExchange", "2-CoSimulation")
@INTERFACES
@VERSIONS
def test_run_that_ends_early_is_an_error(interface, fmi, fmus, capfd):
    """CVODE of fmpy stops near the pole; the solver inside says how far it came."""
    with pytest.raises(FmuError) as caught:
        cosim.simulate_fmu(fmus["blow_up", fmi], interface=interface)
    assert "SUNDIALS" not in capfd.readouterr().err.upper()
    if interface == "CoSimulation":
        reached = r"fmi\dDoStep: the step from 1\.4\d+ to 1\.4\d+ came no further than 1\.428"
        assert re.search(reached + r"\d*; .* closer output times allow more$", str(caught.value))


def test_failed_run_of_a_model_s_own_fmu_names_the_model():
    model = cosim.Model("blow_up", stop_time=2.0)
    y = model.state("y", "1", 1.0, "goes to infinity at 1 s")
    model.derivative(y, y**2)
    with pytest.raises(FmuError, match=r"^blow_up: fmi2DoStep failed"):
        run(cosim.requested(model.freeze()), "CoSimulation")


class Puppet:
    """fmpy's instance, with one method replaced."""

    def __init__(self, monkeypatch, name: str, replacement) -> None:
        original = getattr(fmpy.fmi2.FMU2Slave, name)
        monkeypatch.setattr(
            fmpy.fmi2.FMU2Slave, name, lambda *a, **k: replacement(original, *a, **k)
        )


def test_result_that_is_no_number_is_an_error(fmus, monkeypatch):
    def poisoned(original, instance, vr):
        values = original(instance, vr)
        return [float("nan") if value < 1.9 * 0.7 else value for value in values]

    Puppet(monkeypatch, "getReal", poisoned)
    with pytest.raises(FmuError, match="x is not finite at 0 s"):
        cosim.simulate_fmu(fmus["decay", 2])


def test_fmu_that_repeats_a_discarded_step_for_ever_is_stopped(fmus, monkeypatch):
    """fmpy tries a discarded step again at the same time, without end."""

    def discarded(original, *_arguments, **_more):
        raise fmpy.fmi1.FMICallException("fmi2DoStep", 2)

    Puppet(monkeypatch, "doStep", discarded)
    monkeypatch.setattr(fmpy.fmi2.FMU2Slave, "getBooleanStatus", lambda *_: False)
    with pytest.raises(FmuError, match=r"fmi2DoStep failed with status 2 \(discard\)"):
        cosim.simulate_fmu(fmus["decay", 2], interface="CoSimulation")


def test_instance_is_freed_when_a_run_fails(fmus, monkeypatch):
    freed = []
    Puppet(monkeypatch, "freeInstance", lambda f, *a: (freed.append(1), f(*a)))
    with pytest.raises(FmuError):
        cosim.simulate_fmu(fmus["blow_up", 2], interface="CoSimulation")
    assert freed == [1]


def test_description_of_another_version_is_an_error(fmus, tmp_path):
    path = with_description(
        fmus["decay", 2], tmp_path / "x.fmu", set_attributes(".", fmiVersion="4")
    )
    with pytest.raises(FmuError, match=r"is of FMI 4, which cannot be run; export it as"):
        cosim.simulate_fmu(path)


def test_description_without_a_version_is_an_error(fmus, tmp_path):
    def anonymous(root: ET.Element) -> None:
        del root.attrib["fmiVersion"]

    path = with_description(fmus["decay", 2], tmp_path / "x.fmu", anonymous)
    with pytest.raises(FmuError, match="is of FMI of unknown version, which cannot be run"):
        cosim.simulate_fmu(path)


def test_a_name_that_two_variables_have_is_an_error(fmus, tmp_path):
    def rename(root: ET.Element) -> None:
        for name in ("x", "y"):
            root.find(f"ModelVariables/*[@name='{name}']").set("name", "z")

    path = with_description(fmus["decay", 2], tmp_path / "x.fmu", rename)
    with pytest.raises(FmuError, match="2 variables have the name 'z'; rename one"):
        cosim.simulate_fmu(path)


def test_texts_are_not_recorded_and_cannot_be_asked_for(fmus, tmp_path):
    def add_text(root: ET.Element) -> None:
        variables = root.find("ModelVariables")
        text = ET.SubElement(
            variables, "ScalarVariable", name="text", valueReference="0", causality="output",
            variability="discrete", initial="calculated",
        )  # fmt: skip
        ET.SubElement(text, "String")

    path = with_description(fmus["decay", 2], tmp_path / "x.fmu", add_text)
    assert cosim.simulate_fmu(path).names == ("x", "y")
    with pytest.raises(UsageError, match="text is not a single number"):
        cosim.simulate_fmu(path, outputs=["text"])


def test_no_folder_for_temporary_files_is_told(fmus, monkeypatch, tmp_path):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))
    with pytest.raises(FmuError, match=r"there is no folder for temporary files.*TMPDIR"):
        cosim.simulate_fmu(fmus["decay", 2])


def test_description_of_the_archive_is_the_one_that_counts(fmus):
    with zipfile.ZipFile(fmus["decay", 2]) as archive:
        assert archive.namelist().count(DESCRIPTION) == 1


@INTERFACES
# where Ctrl-C falls between open() and its `with`, Python closes the file and says so
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("seconds", [0.3, 0.31, 0.32])  # mostly within a callback of ctypes
def test_ctrl_c_ends_a_run_wherever_it_is(fmus, interface, seconds):
    path, span = fmus["decay", 2], {"stop_time": 1e4, "output_interval": 0.01}
    timer = threading.Timer(seconds, signal.raise_signal, [signal.SIGINT])
    before = signal.getsignal(signal.SIGINT)
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        cosim.simulate_fmu(path, interface=interface, **span)
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.skipif(sys.platform != "linux", reason="it compiles for linux64")
def test_file_that_cannot_begin_without_its_tool_says_so(tmp_path):
    path = foreign_part(tmp_path, "lag", fault={"MADE": "return 0"}, needsExecutionTool="true")
    with pytest.raises(FmuError, match=r"Failed to instantiate .*; it needs other to run"):
        cosim.simulate_fmu(path)


@pytest.mark.skipif(sys.platform != "linux", reason="it compiles for linux64")
@pytest.mark.parametrize("nominal", ["0", "-1", "INF", "NaN"])
def test_nominal_value_that_is_none_counts_as_1(nominal, tmp_path):
    """Coupled, 0 was "part 'load': its output y is not finite", and -1 an estimate below 0."""
    edit = set_attributes("ModelVariables/ScalarVariable[@name='y']/Real", nominal=nominal)
    part = with_description(foreign_part(tmp_path, "lag"), tmp_path / "nominal.fmu", edit)
    assert cosim.simulate_fmu(part).column("y").nominal == 1
    wires, start = {"load.u": "motor.y", "motor.u": "load.y"}, {"motor.x": 1.0}
    system = cosim.couple({"motor": part, "load": part}, wires, start_values=start, stop_time=1.0)
    run = system.simulate(accuracy=1e-4, output_interval=0.1)
    error = abs(run.final["motor.y"] - (1 + math.exp(-2)) / 2)
    assert error <= run.stats["error_estimate"] <= 1e-4
