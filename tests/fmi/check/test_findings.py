"""Findings on anybody's FMU: none on a sound file, and by name on each damaged one."""

import json
import re
import subprocess
import sys
from xml.etree import ElementTree as ET

import pytest
from helpers.fmu_files import library, remove, rewritten, set_attributes, with_description

from cosim.cli.main import main
from cosim.codegen.compiler import find_compiler
from cosim.fmi.check.check import examine
from cosim.fmi.check.finding import ADVICE, Finding

NAME = "bar_on_frame/reduced"
VARIABLE = "ModelVariables/ScalarVariable[@name='{}']"
REAL = f"{VARIABLE}/Real"


def test_what_only_our_own_files_keep_is_no_finding(exported, tmp_path):
    for edit in (
        set_attributes(VARIABLE.format("m"), valueReference="700"),  # gaps are allowed
        remove("UnitDefinitions/Unit[@name='kg']", "BaseUnit"),
        set_attributes(VARIABLE.format("m"), initial=None),  # exact is what a parameter has
    ):
        path = with_description(exported(NAME), tmp_path / "other.fmu", edit)
        assert examine(path) == ()


def test_token_elsewhere_is_advice_only(exported, tmp_path):
    path = with_description(exported(NAME), tmp_path / "a.fmu", set_attributes(".", guid="{b}"))
    assert [(one.level, one.rule) for one in examine(path)] == [(ADVICE, "token")]


@pytest.mark.quick_rows("2-bar_on_frame/reduced")
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
    assert shown.out.split()[:5] == ["level", "rule", "place", "found", "remedy"]
    assert shown.err.endswith("1 wrong, 0 advice\n")


def test_what_is_no_fmu_is_wrong_and_what_is_missing_an_error(tmp_path):
    (tmp_path / "text.fmu").write_text("text")
    assert main(["check", str(tmp_path / "text.fmu")]) == 4
    assert main(["check", str(tmp_path / "none.fmu")]) == 1


@pytest.mark.skipif(sys.platform != "linux", reason="reads what is made on Linux")
def test_what_keeps_a_library_from_loading_elsewhere_is_advice(exported, tmp_path):
    inside, content = library(exported(NAME))
    newest = max(re.findall(rb"GLIBC_2\.\d\d\0", content))
    changed = content.replace(newest, b"GLIBC_2.99\0").replace(b"libm.so.6\0", b"libq.so.6\0")
    path = rewritten(exported(NAME), tmp_path / "elsewhere.fmu", {inside: changed})
    assert [(f.level, f.rule, f.place, f.found) for f in examine(path)] == [
        (ADVICE, "imports", inside, "it loads libq.so.6, not in the FMU"),
        (ADVICE, "glibc", inside, "it needs glibc 2.99 or newer"),
    ]
    beside = {inside: changed.replace(b"GLIBC_2.99", b"GLIBC_2.10")}
    beside[inside.rpartition("/")[0] + "/libq.so.6"] = b""
    path = rewritten(exported(NAME), tmp_path / "beside.fmu", beside)
    assert examine(path) == ()


@pytest.mark.skipif(sys.platform != "linux", reason="links as on Linux")
def test_run_path_of_the_authors_machine_is_advice(exported, tmp_path):
    inside, _ = library(exported(NAME))
    (tmp_path / "code.c").write_text("int f(void) { return 1; }")
    target = tmp_path / "code.so"
    options = ["-shared", "-fPIC", "-Wl,-rpath,/opt/own:$ORIGIN", "-o", str(target)]
    subprocess.run([*find_compiler(), str(tmp_path / "code.c"), *options], check=True)
    path = rewritten(exported(NAME), tmp_path / "run.fmu", {inside: target.read_bytes()})
    (found,) = (f.found for f in examine(path) if f.rule == "run-path")
    assert found == "it looks for libraries in /opt/own"


def test_clocks_and_scheduled_execution_are_no_fault(exported, tmp_path):
    def schedule(root):
        for tag in ("ModelExchange", "CoSimulation"):
            found = root.find(tag)
            if tag == "ModelExchange":
                root.remove(found)
            else:
                found.tag = "ScheduledExecution"
        variables = root.find("ModelVariables")
        last = max(int(v.get("valueReference")) for v in variables)
        clock = {"name": "tick", "valueReference": str(last + 1), "causality": "output"}
        clock["intervalVariability"] = "triggered"
        variables.append(ET.Element("Clock", clock, variability="discrete"))
        output = ET.Element("Output", {"valueReference": str(last + 1)})
        root.find("ModelStructure").insert(len(root.findall("ModelStructure/Output")), output)

    path = with_description(exported(NAME, 3), tmp_path / "clocks.fmu", schedule)
    assert examine(path) == ()
