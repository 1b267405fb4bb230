"""Trials of FMUs that run: all pass on sound files; each is seen to fail on one with its fault."""

import json
import re
from pathlib import Path

import pytest
from helpers.fmu_files import set_attributes, with_description
from helpers.hostile import hostile, hostile_binary
from helpers.small_models import decay

from cosim.cli.main import main
from cosim.fmi.check.apart import try_apart
from cosim.fmi.check.finding import ADVICE, WRONG
from cosim.fmi.check.trials import TRIALS
from cosim.fmi.export.build import binaries
from cosim.fmi.export.package import source_files, zipped
from cosim.fmi.platforms import targets

NAME = "bar_on_frame/reduced"
GET = """
    fmi2Status status = inner(c, vr, nvr, value);
    static double drift;
    if (nvr) value[0] += drift += 1e-9;
    return status;
"""
STEP = """
    if (60 * point != (double)(long)(60 * point)) return fmi2Error;
    return inner(c, point, size, keep);
"""


def found(path, **options) -> set[tuple[str, str]]:
    return {(one.level, one.rule) for one in try_apart(path, **options).findings}


def wrapped(folder: Path, function: str, parameters: str, body: str) -> Path:
    """Build an FMU one of whose functions is wrapped by another."""
    files = source_files(decay(), "wrapped", 1e-9, 2)
    definition = re.compile(rf"^fmi2Status {function}\(", re.MULTILINE)
    (name,) = [n for n, c in files.items() if n.endswith(".c") and definition.search(c.decode())]
    inner = definition.sub("static fmi2Status inner(", files[name].decode())
    text = f"{inner}\nfmi2Status {function}({parameters}) {{{body}}}\n"
    files[name] = text.encode()
    sources = {Path(n).name: c for n, c in files.items() if n.startswith("sources/")}
    path = folder / "wrapped.fmu"
    path.write_bytes(zipped(files | binaries(sources, "wrapped", targets(["native"], 2))))
    return path


@pytest.mark.parametrize(("name", "fmi"), [(NAME, 2), ("crank_shaft/multipliers", 3)])
def test_our_own_files_pass_every_trial(name, fmi, exported, capsys):
    assert main(["check", str(exported(name, fmi)), "--run", "--json", "-q"]) == 0
    assert json.loads(capsys.readouterr().out) == []
    passed = {one.split()[0] for one in try_apart(exported(name, fmi)).passed}
    assert passed == {trial.__name__ for trial in TRIALS}


def test_memory_outside_the_instance_is_found(tmp_path):
    parameters = "fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[]"
    rules = found(wrapped(tmp_path, "fmi2GetReal", parameters, GET))
    assert {(WRONG, "reset"), (WRONG, "instances")} <= rules


def test_refused_sums_of_steps_are_found(tmp_path):
    parameters = "fmi2Component c, fmi2Real point, fmi2Real size, fmi2Boolean keep"
    rules = found(wrapped(tmp_path, "fmi2DoStep", parameters, STEP))
    assert (WRONG, "steps") in rules
    assert (WRONG, "start") not in rules


def test_undeclared_dependency_is_found(exported, tmp_path):
    edit = set_attributes("ModelStructure/Derivatives/Unknown[2]", dependencies="")
    path = with_description(exported(NAME), tmp_path / "faulty.fmu", edit)
    assert found(path) == {(WRONG, "dependencies")}


def test_derivatives_to_another_state_are_found(exported, tmp_path):
    def swap(root):
        rates = [r for r in root.iterfind("ModelVariables/*/Real") if r.get("derivative")]
        one, two = rates[0].get("derivative"), rates[1].get("derivative")
        rates[0].set("derivative", two)
        rates[1].set("derivative", one)

    path = with_description(exported(NAME), tmp_path / "faulty.fmu", swap)
    assert (WRONG, "derivatives") in found(path)


def test_fixed_parameter_that_can_be_set_is_advice(exported, tmp_path):
    def fix(root):
        for variable in root.iterfind("ModelVariables/ScalarVariable[@causality='parameter']"):
            was = variable.get("variability")
            variable.set("variability", "fixed" if was == "tunable" else "tunable")

    path = with_description(exported(NAME), tmp_path / "faulty.fmu", fix)
    assert (ADVICE, "fixed") in found(path)


def test_file_for_another_token_does_not_start(exported, tmp_path):
    path = with_description(exported(NAME), tmp_path / "a.fmu", set_attributes(".", guid="{b}"))
    assert found(path) == {(WRONG, "start")}


@pytest.mark.parametrize(
    ("fault", "rule"),
    [
        ("fmi2DoStep segv", "crash"),
        ("fmi2Instantiate abort", "crash"),
        ("fmi2Reset exit 0", "crash"),
        ("fmi2DoStep hang", "crash"),
        ("fmi2Reset status 3", "reset"),
        ("fmi2ExitInitializationMode status 3", "start"),
    ],
)
def test_broken_run_is_a_finding(fault, rule, tmp_path_factory):
    folder = tmp_path_factory.getbasetemp() / "hostile"
    folder.mkdir(exist_ok=True)
    binary = folder / "hostile.fmu"
    write = hostile(binary if binary.exists() else hostile_binary(folder))
    assert (WRONG, rule) in found(write(fault), timeout=6.0)


def test_no_code_runs_without_being_asked(tmp_path, capsys):
    write = hostile(hostile_binary(tmp_path))
    path = str(write("fmi2Instantiate abort"))
    main(["check", path, "--json"])
    assert not any(row["rule"] == "crash" for row in json.loads(capsys.readouterr().out))
    assert main(["check", path, "--json", "--run", "--trust", "-q"]) == 4
    assert "crash" in {row["rule"] for row in json.loads(capsys.readouterr().out)}


def test_file_that_cannot_run_keeps_its_other_findings(exported, tmp_path, capsys):
    edit = set_attributes(".", fmiVersion="1.0")
    path = str(with_description(exported(NAME), tmp_path / "old.fmu", edit))
    assert main(["check", path, "--run", "--trust", "--json", "-q"]) == 4
    assert [row["rule"] for row in json.loads(capsys.readouterr().out)] == ["version", "run"]
