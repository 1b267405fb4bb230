"""Every check of an FMU is seen to fail once, on a copy with that very fault."""

import io
import zipfile

import pytest
from fmpy.validation import validate_fmu
from helpers.fmu_files import (
    library,
    remove,
    repeat_child,
    rewritten,
    set_attributes,
    swap_children,
    with_description,
)

from cosim.fmi.archive import DESCRIPTION
from cosim.fmi.check.check import check_fmu, required_functions

NAME = "bar_on_frame/reduced"


def variable(name: str) -> str:
    return f"ModelVariables/ScalarVariable[@name='{name}']"


def real(name: str) -> str:
    return f"{variable(name)}/Real"


STRUCTURE = "ModelStructure"
FAULTS = {
    "the GUID or instantiation token is missing": set_attributes(".", guid=""),
    "fmiVersion is '1.0'": set_attributes(".", fmiVersion="1.0"),
    "modelIdentifier '../bar' is no C name": set_attributes(
        "CoSimulation", modelIdentifier="../bar"
    ),
    "tolerance is no finite number": set_attributes("DefaultExperiment", tolerance="0"),
    "stepSize is no finite number": set_attributes("DefaultExperiment", stepSize="NaN"),
    "stopTime is not after startTime": set_attributes("DefaultExperiment", stopTime="0"),
    "unit 'kg' has no base units": remove("UnitDefinitions/Unit[@name='kg']", "BaseUnit"),
    "unit 'kg' is not defined": remove("UnitDefinitions", "Unit[@name='kg']"),
    "unit 'kg' is defined 2 times": set_attributes("UnitDefinitions/Unit[@name='m']", name="kg"),
    "unit 'lb' is not used": set_attributes("UnitDefinitions/Unit[@name='kg']", name="lb"),
    "unit 'rad': factor or offset of DisplayUnit": set_attributes(
        "UnitDefinitions/Unit[@name='rad']/DisplayUnit", factor="INF"
    ),
    "'theta': display unit 'grad' is not defined": set_attributes(
        real("theta"), displayUnit="grad"
    ),
    "'der(theta)': unit 'rad' is not that of 'theta' per second": set_attributes(
        real("der(theta)"), unit="rad"
    ),
    "'der(theta)': it is the derivative of nothing": set_attributes(
        real("der(theta)"), derivative="999"
    ),
    "'der(theta)': 'm', whose derivative it is, is not a continuous": set_attributes(
        real("der(theta)"), derivative="11"
    ),
    "Derivatives: 'der(theta)' does not belong there": set_attributes(
        real("der(theta)"), derivative=None
    ),
    "'m': causality parameter, variability continuous": set_attributes(
        variable("m"), variability="continuous"
    ),
    "'T2': causality input, variability continuous, initial exact": set_attributes(
        variable("T2"), initial="exact"
    ),
    "'time': causality independent, variability continuous, initial calc": set_attributes(
        variable("time"), initial="calculated"
    ),
    "'theta': the start value is missing": set_attributes(real("theta"), start=None),
    "'energy': a calculated variable has a start value": set_attributes(real("energy"), start="0"),
    "'theta': start = NaN is no finite number": set_attributes(real("theta"), start="NaN"),
    "'m': max = INF is no finite number": set_attributes(real("m"), max="INF"),
    "'m': min, start and max do not rise": set_attributes(real("m"), min="5"),
    "'b': min, start and max do not rise": set_attributes(real("b"), max="-1"),
    "'m': nominal is 0": set_attributes(real("m"), nominal="0"),
    "2 variables share value reference 7": set_attributes(variable("m"), valueReference="7"),
    "not consecutive from 0: 10 is unused": set_attributes(variable("m"), valueReference="700"),
    "Outputs: the entries are not in ascending order": swap_children(f"{STRUCTURE}/Outputs"),
    "Derivatives: the entries are not in ascending": swap_children(f"{STRUCTURE}/Derivatives"),
    "InitialUnknowns: the entries are not in ascending": swap_children(
        f"{STRUCTURE}/InitialUnknowns"
    ),
    "Outputs: 'theta' is missing": remove(f"{STRUCTURE}/Outputs", "Unknown"),
    "Derivatives: 'der(theta)' is missing": remove(f"{STRUCTURE}/Derivatives", "Unknown"),
    "InitialUnknowns: 'der(theta)' is missing": remove(f"{STRUCTURE}/InitialUnknowns", "Unknown"),
    "Outputs: 'theta' is listed 2 times": repeat_child(f"{STRUCTURE}/Outputs"),
    "Outputs: an entry refers to no variable": set_attributes(
        f"{STRUCTURE}/Outputs/Unknown", index="0"
    ),
    "Outputs: 'theta' depends on what does not exist": set_attributes(
        f"{STRUCTURE}/Outputs/Unknown", dependencies="4711"
    ),
    "Outputs: 'theta' depends on 'm', which is not a known": set_attributes(
        f"{STRUCTURE}/Outputs/Unknown", dependencies="11"
    ),
    "InitialUnknowns: 'der(theta)' depends on 'energy', which": set_attributes(
        f"{STRUCTURE}/InitialUnknowns/Unknown", dependencies="47"
    ),
    "Outputs: dependencies of 'theta' are not ascending": set_attributes(
        f"{STRUCTURE}/Outputs/Unknown", dependencies="3 2"
    ),
    "listed source files are missing: 'gone.c'": set_attributes(
        "CoSimulation/SourceFiles/File", name="gone.c"
    ),
    "was compiled for another GUID": set_attributes(".", guid="{another}"),
}


@pytest.mark.slow_rows("the GUID or instantiation token is missing")
@pytest.mark.parametrize("problem", FAULTS)
def test_fault_in_the_description_is_found(problem, exported, tmp_path):
    path = with_description(exported(NAME), tmp_path / "faulty.fmu", FAULTS[problem])
    assert any(problem in found for found in check_fmu(path)), check_fmu(path)


@pytest.mark.slow
def test_what_fmpy_lets_pass_is_the_larger_part(exported, tmp_path):
    passed = [
        problem
        for problem, edit in FAULTS.items()
        if validate_fmu(str(with_description(exported(NAME), tmp_path / "faulty.fmu", edit))) == []
    ]
    assert len(passed) > len(FAULTS) / 2


def test_library_under_another_name_is_found(exported, tmp_path):
    inside, content = library(exported(NAME))
    moved = {inside: None, inside.replace("bar_on", "barn"): content}
    path = rewritten(exported(NAME), tmp_path / "faulty.fmu", moved)
    assert check_fmu(path) == [f"{inside} is missing"]


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda b: b.replace(b"fmi2DoStep\0", b"fmi2NoStep\0"), "lacks fmi2DoStep"),
        (lambda b: b[:1000], "damaged"),
        (lambda b: b"#!/bin/sh\n" + b, "no shared library"),
        (lambda b: b[:18] + b"\x28" + b[19:], "unknown processor"),
    ],
)
def test_fault_in_the_library_is_found(change, problem, exported, tmp_path):
    inside, content = library(exported(NAME))
    path = rewritten(exported(NAME), tmp_path / "faulty.fmu", {inside: change(content)})
    assert any(problem in found for found in check_fmu(path)), check_fmu(path)


def test_entry_with_a_flipped_bit_is_found(exported, tmp_path):
    path = tmp_path / "faulty.fmu"
    rewritten(exported(NAME), path, {"documentation/note.txt": b"exactly this text"})
    path.write_bytes(path.read_bytes().replace(b"exactly this text", b"exactly that text"))
    assert "entry 'documentation/note.txt' is damaged" in check_fmu(path)


def test_foreign_compression_and_names_are_found(exported, tmp_path):
    path = rewritten(exported(NAME), tmp_path / "faulty.fmu", {})
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("resources/größe.txt", b"")
        archive.writestr("resources/a.txt", b"text" * 99, compress_type=zipfile.ZIP_BZIP2)
    problems = check_fmu(path)
    assert "entry 'resources/größe.txt' has a backslash or is not ASCII" in problems
    assert "entry 'resources/a.txt' is neither stored nor deflated" in problems


def test_file_open_for_reading_is_checked_too(exported):
    assert check_fmu(io.BytesIO(exported(NAME).read_bytes())) == []


def test_description_that_is_no_xml_is_an_error(exported, tmp_path):
    from cosim import CosimError

    path = rewritten(exported(NAME), tmp_path / "faulty.fmu", {DESCRIPTION: b"<fmi"})
    with pytest.raises(CosimError, match="not well-formed"):
        check_fmu(path)


def test_functions_that_must_be_exported_are_those_of_the_standard():
    assert len(required_functions("2")) == 44
    assert len(required_functions("3")) == 75
