"""FMUs through fmpy: what is asked for is done or refused; a run that went wrong is no result."""

import ctypes
import re

import fmpy
import numpy as np
import pytest
from helpers.fmi_cases import INTERFACES, VERSIONS
from helpers.fmu_files import library, remove, rewritten, set_attributes, with_description

import cosim
from cosim.errors import (
    FmuError,
    ParameterError,
    SecurityError,
    UnknownName,
    UsageError,
)
from cosim.fmi.archive import unpacked

pytestmark = pytest.mark.usefixtures("no_trace")

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


@VERSIONS
@pytest.mark.parametrize(
    ("tolerance", "reason"), [("0", "0.0 is not positive"), ("NaN", "nan is not finite")]
)
def test_tolerance_of_a_file_that_is_none_is_rejected(tolerance, reason, fmi, fmus, tmp_path):
    edit = set_attributes("DefaultExperiment", tolerance=tolerance)
    path = with_description(fmus["decay", fmi], tmp_path / "a.fmu", edit)
    with pytest.raises(ParameterError, match=f"relative_tolerance of the file = {reason}"):
        cosim.simulate_fmu(path)
    assert cosim.simulate_fmu(path, relative_tolerance=1e-6).status == "complete"


def test_output_called_time_does_not_take_the_place_of_the_time(fmus, tmp_path):
    rename = set_attributes("ModelVariables/*[@name='y']", name="time")
    path = with_description(fmus["decay", 2], tmp_path / "time.fmu", rename)
    run = cosim.simulate_fmu(path)
    assert run.names == ("x",)
    assert "its output 'time' is left out" in run.stats["note"]
    with pytest.raises(UsageError, match="the variable 'time' cannot be recorded"):
        cosim.simulate_fmu(path, outputs=["time", "x"])
    coupled = cosim.couple({"a": path}, {}).simulate(macro_step=0.5, stop_time=0.5)
    assert coupled.final["a.time"] == pytest.approx(2 * np.exp(-0.25), rel=1e-6)  # y = 2 x


def test_independent_variable_is_the_time_of_the_run(fmus):
    assert cosim.simulate_fmu(fmus["decay", 2], outputs=["time", "y"]).names == ("y",)


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
        fmus["decay", fmi], interface=interface, start_values=values, relative_tolerance=1e-9
    )
    exact = 0.25 + 2.75 * np.exp(-2 * run.time)
    assert np.allclose(run["y"], 2 * exact, rtol=1e-6, atol=0)  # measured 2e-8


@INTERFACES
def test_values_change_a_run_as_on_the_other_backend(interface, exported):
    start = {"phi_dot": 0.3, "w": 1.1, "mB": 80.0, "steer_torque": 0.2, "delta": 0.01}
    span = {"stop_time": 0.3, "output_interval": 0.1, "relative_tolerance": 1e-10}
    dae = cosim.load("bicycle/multipliers")
    reference = cosim.simulate(dae, start_values=start, compiled=False, **span)
    plain = cosim.simulate(dae, compiled=False, **span)
    run = cosim.simulate_fmu(
        exported(dae.full_name), interface=interface, start_values=start, **span
    )
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
        ({"start_values": {"rat": 1.0}}, UnknownName, "no start value 'rat'; did you mean rate"),
        ({"outputs": ["z"]}, UnknownName, "no output 'z'"),
        ({"start_values": {"y": 1.0}}, UsageError, "y cannot be set"),
        ({"start_values": {"der(x)": 1.0}}, UsageError, "cannot be set"),
        ({"start_values": {"time": 1.0}}, UsageError, "time cannot be set"),
        ({"start_values": {"x": float("nan")}}, ParameterError, "x = nan is not finite"),
        ({"start_values": {"x": "1"}}, ParameterError, "x = '1' is not a real number"),
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


def test_version_that_is_not_read_is_told(fmus, tmp_path):
    edit = set_attributes(".", fmiVersion="1.0")
    path = with_description(fmus["decay", 2], tmp_path / "x.fmu", edit)
    with pytest.raises(
        FmuError, match=r"x\.fmu: .*fmiVersion is '1\.0'; 2\.0 and 3\.0 can be read"
    ):
        cosim.info(path)


def test_file_without_variables_is_told(fmus, tmp_path):
    edit = remove(".", "ModelVariables")
    path = with_description(fmus["decay", 2], tmp_path / "x.fmu", edit)
    with pytest.raises(FmuError, match=r"x\.fmu: modelDescription\.xml has no ModelVariables;"):
        cosim.simulate_fmu(path)


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


@VERSIONS
def test_library_may_have_a_name_with_dashes(fmi, fmus, tmp_path):
    name, content = library(fmus["decay", fmi])
    renamed = {name: None, name.replace("decay", "decay-1.0"): content}
    path = rewritten(fmus["decay", fmi], tmp_path / "x.fmu", renamed)
    with pytest.raises(
        FmuError, match=r"'decay' stands for decay\.\w+, but .* is decay-1\.0\.\w+;"
    ):
        cosim.simulate_fmu(path)
    edit = set_attributes("CoSimulation", modelIdentifier="decay-1.0")
    run = cosim.simulate_fmu(with_description(path, tmp_path / "y.fmu", edit), stop_time=1.0)
    assert run.final["x"] == pytest.approx(np.exp(-0.5), rel=1e-7)


@VERSIONS
def test_missing_platform_is_told(fmi, fmus, tmp_path):
    name, content = library(fmus["decay", fmi])
    moved = {name: None, "binaries/beos/decay.so": content, f"{name.rpartition('/')[0]}/": b""}
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
    with pytest.raises(FmuError, match=r"x\.fmu: Failed to load shared library binaries/"):
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
        cosim.simulate_fmu(fmus["decay", fmi], interface=interface, start_values=start)


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
        cosim.simulate_fmu(path, start_values={"theta": 0.1})
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
        cosim.simulate_fmu(fmus["gap", fmi], interface=interface, start_values={"size": -1.0})
