"""Findings on anybody's FMU: none on a sound file, and by name on each damaged one."""

import json
import zipfile

import pytest
from helpers.fmu_files import remove, repeat_child, rewritten, set_attributes, with_description

from cosim.cli.main import main
from cosim.fmi.check.findings import ADVICE, WRONG, Finding, examine

NAME = "bar_on_frame/reduced"
VARIABLE = "ModelVariables/ScalarVariable[@name='{}']"
REAL = f"{VARIABLE}/Real"
DAMAGED = {
    ("token", "modelDescription.xml"): set_attributes(".", guid=""),
    ("version", "modelDescription.xml"): set_attributes(".", fmiVersion="1.0"),
    ("identifier", "CoSimulation"): set_attributes("CoSimulation", modelIdentifier="../bar"),
    ("number", "variable 'theta'"): set_attributes(REAL.format("theta"), start="NaN"),
    ("start", "variable 'theta'"): set_attributes(REAL.format("theta"), start=None),
    ("bounds", "variable 'm'"): set_attributes(REAL.format("m"), min="5"),
    ("nominal", "variable 'm'"): set_attributes(REAL.format("m"), nominal="0"),
    ("causality", "variable 'm'"): set_attributes(VARIABLE.format("m"), variability="continuous"),
    ("derivative", "variable 'der(theta)'"): set_attributes(
        REAL.format("der(theta)"), derivative="999"
    ),
    ("unit", "modelDescription.xml"): remove("UnitDefinitions", "Unit[@name='kg']"),
    ("structure", "Outputs"): repeat_child("ModelStructure/Outputs"),
    ("sources", "archive"): set_attributes("CoSimulation/SourceFiles/File", name="gone.c"),
}


@pytest.mark.parametrize(("rule", "place"), DAMAGED)
def test_fault_is_found_by_rule_and_place(rule, place, exported, tmp_path):
    path = with_description(exported(NAME), tmp_path / "faulty.fmu", DAMAGED[rule, place])
    found = {(one.rule, one.place) for one in examine(path) if one.level == WRONG}
    assert (rule, place) in found
    assert all(one.cure and one.found for one in examine(path))


def test_what_only_our_own_files_keep_is_no_finding(exported, tmp_path):
    for edit in (
        set_attributes(VARIABLE.format("m"), valueReference="700"),  # gaps are allowed
        remove("UnitDefinitions/Unit[@name='kg']", "BaseUnit"),
        set_attributes(VARIABLE.format("m"), initial=None),  # exact is what a parameter has
    ):
        path = with_description(exported(NAME), tmp_path / "other.fmu", edit)
        assert examine(path) == ()


def library(path) -> tuple[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        inside = next(name for name in archive.namelist() if name.startswith("binaries/"))
        return inside, archive.read(inside)


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        (lambda b: b.replace(b"fmi2DoStep\0", b"fmi2NoStep\0"), "functions"),
        (lambda b: b[:1000], "binary"),
        (lambda b: b"#!/bin/sh\n" + b, "binary"),
    ],
)
def test_fault_in_the_library_is_found(change, rule, exported, tmp_path):
    inside, content = library(exported(NAME))
    path = rewritten(exported(NAME), tmp_path / "faulty.fmu", {inside: change(content)})
    assert (WRONG, rule, inside) in {(f.level, f.rule, f.place) for f in examine(path)}


def test_token_elsewhere_is_advice_only(exported, tmp_path):
    path = with_description(exported(NAME), tmp_path / "a.fmu", set_attributes(".", guid="{b}"))
    assert [(one.level, one.rule) for one in examine(path)] == [(ADVICE, "token")]


@pytest.mark.parametrize("name", [NAME, "bicycle/independent", "crank_shaft/multipliers"])
@pytest.mark.parametrize("fmi", [2, 3])
def test_our_own_files_are_sound(name, fmi, exported, capsys):
    assert main(["check", str(exported(name, fmi)), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == []


def test_wrong_file_ends_with_4_and_a_table(exported, tmp_path, capsys):
    edit = set_attributes(REAL.format("m"), nominal="0")
    path = str(with_description(exported(NAME), tmp_path / "faulty.fmu", edit))
    assert main(["check", path, "--json"]) == 4
    (row,) = json.loads(capsys.readouterr().out)
    assert Finding(**row) == examine(path)[0]
    assert main(["check", path]) == 4
    shown = capsys.readouterr()
    assert shown.out.split()[:5] == ["level", "rule", "place", "found", "cure"]
    assert shown.err.endswith("1 wrong, 0 advice\n")


def test_what_is_no_fmu_is_an_error(tmp_path):
    (tmp_path / "text.fmu").write_text("text")
    assert main(["check", str(tmp_path / "text.fmu")]) == 1
