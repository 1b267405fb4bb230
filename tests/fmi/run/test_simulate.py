"""FMUs through fmpy: what is asked for is done or refused; a run that went wrong is no result."""

import ctypes
import re
import signal
import tempfile
import threading
import zipfile
from pathlib import Path
from xml.etree import ElementTree as ET

import fmpy
import numpy as np
import pytest
from helpers.fmu_files import remove, rewritten, set_attributes, with_description
from helpers.small_models import decay

import cosim
from casadi_models.dae import Dae, Model
from cosim.errors import (
    FmuError,
    ParameterError,
    SecurityError,
    UnknownName,
    UsageError,
)
from cosim.fmi.archive import DESCRIPTION, unpacked

INTERFACES = pytest.mark.parametrize("interface", ["ModelExchange", "CoSimulation"])
VERSIONS = pytest.mark.parametrize("fmi", [2, 3])


def blow_up() -> Dae:
    """Return x' = x^2 from x = 0.7: infinite at 1.4286 s."""
    model = Model("blow_up", description="no solution for long", source="a test", stop_time=2.0)
    x = model.state("x", "1", 0.7, "what grows")
    model.derivative(x, x**2)
    return model.freeze()


def gap() -> Dae:
    """Return x' = 0 with x(0)^2 = size, which has no solution for a negative size."""
    model = Model("gap", description="start from an equation", source="a test", stop_time=1.0)
    x = model.state("x", "1", 1.0, "root")
    size = model.parameter("size", "1", 4.0, "square of the root")
    model.derivative(x, 0)
    model.start_equation(x, x**2 - size, "closure of the gap")
    return model.freeze()


@pytest.fixture(scope="module")
def fmus(tmp_path_factory):
    """FMUs of small models by name and version."""
    folder = tmp_path_factory.mktemp("small")
    models = {"decay": decay(), "blow_up": blow_up(), "gap": gap()}
    return {
        (name, fmi): cosim.export_fmu(dae, folder / f"{name}_{fmi}.fmu", fmi=fmi)
        for name, dae in models.items()
        for fmi in (2, 3)
    }


@pytest.fixture(autouse=True)
def no_trace(tmp_path, monkeypatch):
    """Whatever happens: no temporary folder stays, and nobody changes the current folder."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    before = Path.cwd()
    yield
    assert list(folder.iterdir()) == []
    assert Path.cwd() == before


# -- what may be asked for ----------------------------------------------------------------------


@INTERFACES
@VERSIONS
def test_run_ends_at_the_stop_time_and_keeps_the_interval(interface, fmi, fmus):
    run = cosim.simulate_fmu(
        fmus["decay", fmi], interface=interface, stop_time=0.25, output_interval=0.1
    )
    assert np.allclose(run.time, [0, 0.1, 0.2, 0.25], rtol=0, atol=1e-12)
    assert np.allclose(run["x"], np.exp(-0.5 * run.time), rtol=1e-7, atol=0)  # measured 1e-9
    assert run.units == {"time": "s", "x": "m", "y": "m"}
    assert run.stats["solver"] == f"fmpy {interface}"


@INTERFACES
def test_default_experiment_is_that_of_the_fmu(interface, fmus):
    run = cosim.simulate_fmu(fmus["decay", 2], interface=interface)
    assert np.allclose(run.time, np.arange(101) / 100, rtol=0, atol=1e-12)


@INTERFACES
def test_run_may_begin_later(interface, fmus):
    run = cosim.simulate_fmu(fmus["decay", 2], interface=interface, start_time=5.0)
    assert (run.time[0], run.time[-1]) == pytest.approx((5.0, 6.0))
    assert run["x"][-1] == pytest.approx(np.exp(-0.5), rel=1e-7)  # measured 1e-9


@INTERFACES
def test_run_of_no_length_is_the_start(interface, fmus):
    run = cosim.simulate_fmu(fmus["decay", 2], interface=interface, stop_time=0.0)
    assert (run.time.tolist(), run["x"].tolist()) == ([0.0], [1.0])


@INTERFACES
@VERSIONS
def test_values_reach_the_fmu(interface, fmi, fmus):
    values = {"x": 3.0, "rate": 2.0, "force": 0.5}
    run = cosim.simulate_fmu(
        fmus["decay", fmi], interface=interface, start=values, relative_tolerance=1e-9
    )
    exact = 0.25 + 2.75 * np.exp(-2 * run.time)
    assert np.allclose(run["y"], 2 * exact, rtol=1e-6, atol=0)  # measured 2e-8


@INTERFACES
def test_values_change_a_run_as_on_the_other_road(interface, exported):
    start = {"phi_dot": 0.3, "w": 1.1, "mB": 80.0, "steer_torque": 0.2, "delta": 0.01}
    span = {"stop_time": 0.3, "output_interval": 0.1, "relative_tolerance": 1e-10}
    dae = cosim.load("bicycle/multipliers")
    reference = cosim.simulate(dae, start=start, compiled=False, **span)
    plain = cosim.simulate(dae, compiled=False, **span)
    run = cosim.simulate_fmu(exported(dae.full_name), interface=interface, start=start, **span)
    assert cosim.compare(reference, run).worst.scaled < 1e-7  # measured 4e-9
    assert cosim.compare(plain, run).worst.scaled > 1e-2


def test_only_wanted_outputs_are_recorded(fmus):
    names = ["y", "der(x)", "rate"]
    assert cosim.simulate_fmu(fmus["decay", 2], outputs=names).names == tuple(names)


def test_evaluations_of_the_derivatives_are_counted(fmus):
    run = cosim.simulate_fmu(fmus["decay", 2], interface="ModelExchange")
    assert 50 < run.stats["rhs_calls"] < 1000  # measured 114


# -- what is refused before the FMU is loaded ---------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "error", "reason"),
    [
        ({"interface": "Model"}, UnknownName, "no interface 'Model'; did you mean ModelEx"),
        ({"start": {"rat": 1.0}}, UnknownName, "no start value 'rat'; did you mean rate"),
        ({"outputs": ["z"]}, UnknownName, "no output 'z'"),
        ({"start": {"y": 1.0}}, UsageError, "y cannot be set"),
        ({"start": {"der(x)": 1.0}}, UsageError, "cannot be set"),
        ({"start": {"time": 1.0}}, UsageError, "time cannot be set"),
        ({"start": {"x": float("nan")}}, ParameterError, "x = nan is not finite"),
        ({"start": {"x": "1"}}, ParameterError, "x = '1' is not a real number"),
        ({"stop_time": -1.0}, ParameterError, "stop_time = -1 s lies before start_time = 0 s"),
        ({"stop_time": float("inf")}, ParameterError, "stop_time = inf is not finite"),
        ({"start_time": float("nan")}, ParameterError, "start_time = nan is not finite"),
        ({"output_interval": 0.0}, ParameterError, "output_interval = 0.0 is not positive"),
        ({"output_interval": -1.0}, ParameterError, "is not positive"),
        ({"output_interval": 1e-9}, ParameterError, "makes 1e.09 output times"),
        ({"relative_tolerance": 0.0}, ParameterError, "relative_tolerance = 0.0 is not positive"),
        ({"relative_tolerance": 0.5}, ParameterError, "is above 0.1"),
    ],
)
def test_nonsense_is_refused_in_one_sentence(arguments, error, reason, fmus):
    with pytest.raises(error, match=reason):
        cosim.simulate_fmu(fmus["decay", 2], **arguments)


def test_interface_that_the_fmu_lacks_is_told(fmus, tmp_path):
    path = with_description(fmus["decay", 2], tmp_path / "x.fmu", remove(".", "CoSimulation"))
    assert cosim.simulate_fmu(path).stats["solver"] == "fmpy ModelExchange"
    with pytest.raises(FmuError, match="has no CoSimulation interface; it has ModelExchange"):
        cosim.simulate_fmu(path, interface="CoSimulation")


@pytest.mark.parametrize("identifier", ["../decay", "/bin/x", "a b", "", "décay"])
def test_library_is_looked_for_in_its_own_folder_only(identifier, fmus, tmp_path):
    edit = set_attributes("CoSimulation", modelIdentifier=identifier)
    path = with_description(fmus["decay", 2], tmp_path / "x.fmu", edit)
    with pytest.raises(SecurityError, match="is no C name"):
        cosim.simulate_fmu(path)


def library(path: Path) -> tuple[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        name = next(name for name in archive.namelist() if name.startswith("binaries/"))
        return name, archive.read(name)


@VERSIONS
def test_missing_platform_is_told(fmi, fmus, tmp_path):
    name, content = library(fmus["decay", fmi])
    moved = {name: None, "binaries/beos/decay.so": content}
    path = rewritten(fmus["decay", fmi], tmp_path / "x.fmu", moved)
    with pytest.raises(FmuError, match=r"has a binary only for beos, none for .*--platform"):
        cosim.simulate_fmu(path)
    path = rewritten(fmus["decay", fmi], tmp_path / "y.fmu", {name: None})
    with pytest.raises(FmuError, match="has a binary for no platform"):
        cosim.simulate_fmu(path)


# -- what the FMU refuses -----------------------------------------------------------------------


@pytest.mark.parametrize("content", [b"", b"garbage", b"\x7fELF" + bytes(200)])
def test_library_that_cannot_be_loaded_is_told(content, fmus, tmp_path):
    name, _ = library(fmus["decay", 2])
    path = rewritten(fmus["decay", 2], tmp_path / "x.fmu", {name: content})
    with pytest.raises(FmuError, match=r"x\.fmu: Failed to load shared library"):
        cosim.simulate_fmu(path)


@INTERFACES
@VERSIONS
def test_wrong_guid_is_refused_with_both_guids(interface, fmi, fmus, tmp_path):
    attribute = {2: "guid", 3: "instantiationToken"}[fmi]
    edit = set_attributes(".", **{attribute: "{wrong}"})
    path = with_description(fmus["decay", fmi], tmp_path / "x.fmu", edit)
    reason = r"fmi\dInstantiate\w*: .*its GUID is \{wrong\}, the binary's is \{[0-9a-f-]{36}\}"
    with pytest.raises(FmuError, match=reason):
        cosim.simulate_fmu(path, interface=interface)


@INTERFACES
@VERSIONS
@pytest.mark.parametrize(
    ("start", "reason"),
    [
        ({"rate": -1.0}, r"fmi\dSet\w+: rate = -1 is not within 0 ... 100"),
        ({"rate": 101.0}, r"rate = 101 is not within 0 ... 100"),
    ],
)
def test_value_out_of_its_bounds_is_refused_by_the_fmu(interface, fmi, start, reason, fmus):
    with pytest.raises(FmuError, match=reason):
        cosim.simulate_fmu(fmus["decay", fmi], interface=interface, start=start)


@pytest.mark.parametrize(
    ("name", "value", "status", "reason"),
    [
        ("x", float("nan"), 2, "fmi2SetReal: x = nan is not finite"),
        ("rate", float("inf"), 2, "fmi2SetReal: rate = inf is not finite"),
        ("y", 1.0, 3, "fmi2SetReal: y, a calculated output, cannot be set now"),
        ("der(x)", 1.0, 3, r"fmi2SetReal: der\(x\), a calculated derivative, cannot be set now"),
        ("time", 1.0, 3, "fmi2SetReal: time, a .*time, cannot be set now"),
        (None, 1.0, 3, "fmi2SetReal: value reference 6 is unknown; the last one is 5"),
    ],
)
def test_bad_setting_names_function_and_reason(name, value, status, reason, fmus):
    """Through ctypes, as an importer that checks nothing."""
    log: list[str] = []
    with unpacked(fmus["decay", 2]) as folder:
        description = fmpy.read_model_description(str(folder))
        references = {v.name: v.valueReference for v in description.modelVariables}
        instance = fmpy.instantiate_fmu(
            str(folder),
            description,
            "ModelExchange",
            debug_logging=True,
            logger=lambda *arguments: log.append(arguments[-1].decode()),
        )
        reference = references.get(name, len(references))
        got = instance.dll.fmi2SetReal(
            ctypes.c_void_p(instance.component),
            (ctypes.c_uint * 1)(reference),
            ctypes.c_size_t(1),
            (ctypes.c_double * 1)(value),
        )
        instance.freeInstance()
    assert got == status
    assert re.search(reason, log[-1])


def test_calculated_start_is_a_guess_before_initialization_and_refused_during_it(exported):
    """The pitch follows from the other angles, whatever its solution begins with."""
    path = exported("bicycle/multipliers")
    with pytest.raises(UsageError, match="theta cannot be set"):
        cosim.simulate_fmu(path, start={"theta": 0.1})
    with unpacked(path) as folder:
        description = fmpy.read_model_description(str(folder))
        log: list[str] = []
        instance = fmpy.instantiate_fmu(
            str(folder), description, debug_logging=True, logger=lambda *a: log.append(a[-1])
        )
        pitch = next(v for v in description.modelVariables if v.name == "theta")
        reference = [pitch.valueReference]
        instance.setReal(reference, [0.1])
        instance.setupExperiment()
        instance.enterInitializationMode()
        assert instance.getReal(reference)[0] == pytest.approx(float(pitch.start), abs=1e-12)
        with pytest.raises(fmpy.fmi1.FMICallException, match="error"):
            instance.setReal(reference, [0.1])
        instance.freeInstance()
    assert b"theta, a calculated state, cannot be set now" in log[-1]


@INTERFACES
@VERSIONS
def test_start_without_solution_is_an_error_with_the_reason(interface, fmi, fmus):
    assert cosim.simulate_fmu(fmus["gap", fmi], interface=interface)["x"][0] == pytest.approx(2.0)
    with pytest.raises(FmuError, match="the start values of x cannot be calculated"):
        cosim.simulate_fmu(fmus["gap", fmi], interface=interface, start={"size": -1.0})


# -- runs that went wrong -----------------------------------------------------------------------


@INTERFACES
@VERSIONS
def test_run_that_ends_early_is_an_error(interface, fmi, fmus):
    """CVODE of fmpy stops near the pole; the solver inside says how far it came."""
    with pytest.raises(FmuError) as caught:
        cosim.simulate_fmu(fmus["blow_up", fmi], interface=interface)
    if interface == "CoSimulation":
        reached = r"fmi\dDoStep: the step from 1\.4\d+ to 1\.4\d+ came no further than 1\.428"
        assert re.search(reached, str(caught.value))


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
    with pytest.raises(FmuError, match="the run ended at 0 s, before the stop time 1 s"):
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
    with pytest.raises(FmuError, match=r"modelDescription\.xml cannot be read"):
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


@pytest.mark.parametrize("interface", ["ModelExchange", "CoSimulation"])
@pytest.mark.parametrize("seconds", [0.3, 0.31, 0.32])  # mostly within a callback of ctypes
def test_ctrl_c_ends_a_run_wherever_it_is(fmus, interface, seconds):
    path, span = fmus["decay", 2], {"stop_time": 1e4, "output_interval": 0.01}
    timer = threading.Timer(seconds, signal.raise_signal, [signal.SIGINT])
    before = signal.getsignal(signal.SIGINT)
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        cosim.simulate_fmu(path, interface=interface, **span)
    assert signal.getsignal(signal.SIGINT) is before
