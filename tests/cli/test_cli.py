"""The command line: every verb answers; runs that fail, files, interrupts, missing tools.

Exit codes: 0 done, 1 a run failed, 2 wrong usage, 3 unknown name, 4 results differ, 5 a tool is
missing, 130 interrupted.
"""

import json
import os
import re
import shlex
import subprocess
import sys
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest

import casadi_models
import cosim
from cosim.backend import Backend
from cosim.cli.main import command_line, main
from cosim.cli.verbs import VERBS
from cosim.codegen import cache
from cosim.errors import CosimError
from cosim.model import catalogue as summary

BLOW_UP = """
from casadi_models.dae import Model


def build():
    model = Model("blow_up")
    x = model.state("x", "m", 1.0, "goes to infinity at 1 s")
    model.derivative(x, x**2)
    return model.freeze()
"""
INTERPRETED = ("--backend", "native-interpreted")
SHORT = ("--stop-time", "0.02", *INTERPRETED)


# -- files ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("verb", ["simulate", "export", "plot"])
@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("{}/none/a.{}", "No such file or directory; create .*none first"),
        ("{}/folder.{}", "it is a directory; give a file name"),
        ("{}/a\0b.{}", "null (byte|character)"),
        ("{}/" + 300 * "a" + ".{}", "File name too long"),
        ("/proc/a.{1}", ""),  # no user can create files there
    ],
)
def test_impossible_output_file_is_named_with_the_cause(verb, name, expected, tmp_path, capsys):
    ending = {"simulate": "csv", "export": "fmu", "plot": "png"}[verb]
    (tmp_path / f"folder.{ending}").mkdir()
    options = SHORT if verb != "export" else ()
    target = name.format(tmp_path, ending)
    assert main([verb, "crank_torque.toml", *options, "--output-file", target]) == 1
    printed = capsys.readouterr().err
    assert re.search(f"ExportError: cannot write .*: .*{expected}", printed), printed
    assert len(printed.splitlines()) == 1
    assert sorted(path.name for path in tmp_path.rglob("*")) == [f"folder.{ending}"]


def test_failed_command_leaves_the_old_file(tmp_path, capsys):
    target = tmp_path / "run.csv"
    target.write_text("old")
    assert main(["simulate", "crank_shaft", "-p", "frob=1", "--output-file", str(target)]) == 3
    assert target.read_text() == "old"


@pytest.mark.parametrize("verb", ["simulate", "crosscheck"])
@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (None, "No such file or directory; give an FMU"),
        (b"", "it is not a zip archive; give an FMU"),
        (b"PK\3\4 and then garbage", "it is not a zip archive; give an FMU"),
    ],
)
def test_file_that_is_no_fmu_is_reported(verb, content, expected, tmp_path, capsys):
    path = tmp_path / "a.fmu"
    if content is not None:
        path.write_bytes(content)
    assert main([verb, str(path)]) == 1
    assert capsys.readouterr().err == f"FmuError: cannot read {path}: {expected}\n"


def test_missing_system_is_reported_with_its_kind_of_file(tmp_path, capsys):
    path = tmp_path / "a.ssp"
    assert main(["simulate", str(path)]) == 1
    told = f"FmuError: cannot read {path}: No such file or directory; give an SSP file\n"
    assert capsys.readouterr().err == told


def test_check_finds_that_a_file_is_no_fmu(tmp_path, capsys):
    path = tmp_path / "a.fmu"
    assert main(["check", str(path)]) == 1  # there is nothing to check
    path.write_bytes(b"PK\3\4 and then garbage")
    for options in ((), ("--run", "--trust")):
        assert main(["check", str(path), *options]) == 4
        assert "it is not a zip archive" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("files", "found"),
    [
        ({}, "it has no modelDescription.xml; give an FMU"),
        ({"modelDescription.xml": "<a>"}, "modelDescription.xml is not well-formed: no element"),
    ],
)
def test_check_places_a_fault_of_the_description_in_its_file(files, found, tmp_path, capsys):
    path = tmp_path / "a.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    assert main(["check", str(path), "--json"]) == 4
    (finding,) = json.loads(capsys.readouterr().out)
    assert (finding["rule"], finding["place"]) == ("xml", "modelDescription.xml")
    assert finding["found"].startswith(found)


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("../x", "", ("archive", "archive")),
        ("sources/buildDescription.xml", "<a>", ("xml", "sources/buildDescription.xml")),
    ],
)
def test_check_places_other_faults_where_they_are(name, text, expected, tmp_path, capsys):
    path = tmp_path / "a.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", "<a/>")
        archive.writestr(name, text)
    assert main(["check", str(path), "--json"]) == 4
    (finding,) = json.loads(capsys.readouterr().out)
    assert (finding["rule"], finding["place"]) == expected


def test_a_missing_file_of_a_model_is_an_unknown_model(capsys):
    assert main(["simulate", "nofile.py:build"]) == 3
    assert capsys.readouterr().err.startswith("UnknownName: nofile.py is not a file")


# -- failed and interrupted runs, missing tools: 1, 130, 5 ----------------------------------------


def test_failed_run_prints_the_computed_part_and_the_error(tmp_path, capsys):
    (tmp_path / "blow_up.py").write_text(BLOW_UP)
    model = f"{tmp_path}/blow_up.py:build"
    assert main(["simulate", model, "--stop-time", "2", *INTERPRETED]) == 1
    printed = capsys.readouterr()
    time, x = np.genfromtxt(printed.out.splitlines()[1:], delimiter=",").T
    assert 0.9 < time[-1] < 1
    np.testing.assert_allclose(x, 1 / (1 - time), rtol=1e-3)  # closed form; measured 5e-5
    assert "SolverError: blow_up: cvodes stopped after 0.99 s: CV_" in printed.err
    assert len(printed.err.splitlines()) == 1


@pytest.mark.parametrize("debug", [False, True])
def test_interrupted_command_ends_with_130(debug, monkeypatch, capsys):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("cosim.cli.runs.run_scene", interrupt)
    assert main(["simulate", "crank_shaft", *["--debug"] * debug]) == 130
    assert capsys.readouterr().err == "interrupted\n"


@pytest.mark.parametrize("verb", ["export", "crosscheck"])
def test_missing_compiler_exits_with_5_and_names_the_remedy(verb, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("COSIM_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("cosim.codegen.compiler.find_spec", lambda _: None)
    assert main([verb, "crank_shaft"]) == 5
    message = capsys.readouterr().err
    assert "MissingTool: no C compiler found" in message
    assert "pip install" in message


def test_internal_error_is_one_line_unless_debugging(monkeypatch, capsys):
    def fail(*_, **__):
        raise ZeroDivisionError("an unforeseen\ncase")

    monkeypatch.setattr("cosim.cli.runs.run_scene", fail)
    assert main(["simulate", "crank_shaft"]) == 1
    expected = "cosim simulate failed with ZeroDivisionError: an unforeseen case; show where with"
    assert capsys.readouterr().err == f"{expected}: --debug\n"
    with pytest.raises(ZeroDivisionError):
        main(["simulate", "crank_shaft", "--debug"])


def test_error_shows_its_origin_when_debugging():
    with pytest.raises(CosimError, match="did you mean bicycle"):
        main(["info", "bycicle", "--debug"])


@pytest.mark.slow
def test_model_that_cannot_be_exported_leaves_the_table_of_the_others(tmp_path, capsys):
    (tmp_path / "word.py").write_text(BLOW_UP.replace("blow_up", "while").replace("x**2", "-x"))
    line = ["crosscheck", "crank_shaft/driven", f"{tmp_path}/word.py:build", "--stop-time", "0.1"]
    assert main([*line, "-q"]) == 1
    printed = capsys.readouterr()
    assert printed.out.count("crank_shaft/driven") == 2
    assert "'while' cannot name an FMU: it is a reserved word" in printed.err


# -- what is done: 0 ------------------------------------------------------------------------------


def test_warning_is_one_line_and_not_an_error(capsys):
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        assert main(["simulate", "bar_on_frame", *SHORT, "-p", "theta=60"]) == 0
    printed = capsys.readouterr().err
    assert printed.startswith(
        "warning: bar_on_frame/reduced: theta = 60 rad is more than two turns"
    )
    assert len(printed.splitlines()) == 1


@pytest.mark.parametrize("verb", ["info", "list"])
def test_list_names_every_formulation_in_text_and_in_json(verb, capsys):
    assert main([verb]) == 0
    text = capsys.readouterr().out
    assert main([verb, "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["models"]
    assert [row["model"] for row in rows] == list(casadi_models.CATALOG)
    assert all(re.search(rf"^{name} ", text, re.MULTILINE) for name in casadi_models.CATALOG)


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("name", casadi_models.CATALOG)
def test_info_shows_unit_start_and_meaning_of_every_variable(name, capsys):
    assert main(["info", name, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    tables = [facts[key] for key in ("states", "algebraic unknowns", "inputs", "parameters")]
    assert all(row["unit"] and row["meaning"] for t in tables for row in t)
    assert all(isinstance(row["start"], float) for t in tables for row in t)  # calculated ones, too


def test_values_settings_and_outputs_reach_the_run(capsys):
    line = ["simulate", "crank_shaft", "-p", "omega=60rpm", "--start-values", "alpha", "0"]
    times = ["--start-time", "1", "--stop-time", "2", "--output-interval", "0.5"]
    how = ["--outputs", "phi, omega", "--solver", "ode8", *INTERPRETED]
    assert main([*line, *times, *how]) == 0
    head, *rows = capsys.readouterr().out.splitlines()
    assert head == "time,phi,omega"
    time, phi, omega = np.genfromtxt(rows, delimiter=",").T
    np.testing.assert_array_equal(time, [1, 1.5, 2])
    np.testing.assert_allclose(omega, 2 * np.pi, rtol=1e-14)  # a turn a second; measured 0
    np.testing.assert_allclose(phi, 2 * np.pi * (time - 1), rtol=1e-14)


def test_json_holds_the_numbers_of_the_csv(capsys):
    assert main(["simulate", "crank_shaft", *SHORT]) == 0
    rows = np.genfromtxt(capsys.readouterr().out.splitlines()[1:], delimiter=",")
    assert main(["simulate", "crank_shaft", *SHORT, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["units"]["omega"] == "rad/s"
    np.testing.assert_array_equal(np.column_stack([*facts["values"].values()]), rows)


@pytest.mark.slow
def test_closed_pipe_is_no_error():
    script = "from cosim.cli.main import main; raise SystemExit(main())"
    command = [sys.executable, "-c", script, "simulate", "bicycle", *INTERPRETED]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout.readline().startswith("time,")
    process.stdout.close()
    assert process.stderr.read() == ""
    process.stderr.close()
    assert process.wait(60) == 0


@pytest.mark.skipif(os.name != "posix", reason="a shell of POSIX closes them")
@pytest.mark.parametrize(
    ("words", "closed", "code", "out", "err"),
    [
        ("--outputs phi", ">&-", 1, "", "cannot write the results: Bad file descriptor\n"),
        ("--outputs phi -o a.csv", "<&- >&- 2>&-", 0, "", ""),
        ("--outputs phi -p phi=20", "2>&-", 0, "time,phi\n0,20\n", ""),  # without the warning
        ("--outputs nothing", "2>&-", 3, "", ""),
    ],
)
def test_closed_streams_get_nothing_and_give_their_numbers_to_no_file(
    words, closed, code, out, err, tmp_path
):
    command = f"{sys.executable} -m cosim simulate bicycle --stop-time 0 {words} {closed}"
    run = subprocess.run(
        ["sh", "-c", command], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (run.returncode, run.stdout, run.stderr) == (code, out, err)
    if "a.csv" in words:
        assert (tmp_path / "a.csv").read_text() == "time,phi\n0,0\n"


@pytest.mark.parametrize("words", ["new -", "scene bicycle_path", "new - --from bicycle_path"])
def test_json_holds_the_text_that_is_printed_without_it(words, capsys):
    assert main(words.split()) == 0
    text = capsys.readouterr().out
    assert main([*words.split(), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"text": text}


def test_json_tells_what_was_removed_from_the_cache(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("COSIM_CACHE", str(tmp_path))
    tmp_path.chmod(0o700)
    cache.store("made/a", b"0" * 100)
    assert main(["cache", "--json"]) == 0
    held = json.loads(capsys.readouterr().out)
    assert main(["cache", "--clear", "--json"]) == 0
    removed = json.loads(capsys.readouterr().out)
    assert removed == {"folder": str(tmp_path), "files": 1, "bytes": held["bytes"], "removed": True}


def test_json_tells_of_an_exported_system(tmp_path, capsys):
    parts = '[parts]\na = "crank_shaft"\nb = "bar_on_frame"\n'
    (tmp_path / "two.toml").write_text(f'{parts}[connections]\n"b.T2" = "a.T"\n')
    target = tmp_path / "two.ssp"
    assert main(["export", str(tmp_path / "two.toml"), "-o", str(target), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts == {"file": str(target), "bytes": target.stat().st_size}
    assert main(["info", str(target), "--json"]) == 0  # of FMUs, whose equations are not known
    facts = json.loads(capsys.readouterr().out)
    assert facts["connections"] == [["a.T", "b.T2"]]
    assert facts["parts"].keys() == {"a", "b"}


def test_character_that_the_terminal_lacks_causes_no_error(tmp_path):
    model = tmp_path / "angle.py"
    model.write_text(BLOW_UP.replace("goes to infinity at 1 s", "Winkel \u03b8"), encoding="utf-8")
    script = "from cosim.cli.main import main; raise SystemExit(main())"
    command = [sys.executable, "-c", script, "info", f"{model}:build"]
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    run = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert run.returncode == 0, run.stderr
    assert r"Winkel \u03b8" in run.stdout


def test_help_needs_neither_casadi_nor_numpy():
    code = (
        "import sys\n"
        "from cosim.cli.main import main\n"
        "try:\n    main(['simulate', '--help'])\n"
        "except SystemExit:\n    pass\n"
        "heavy = {'casadi', 'numpy', 'fmpy', 'matplotlib'}\n"
        "raise SystemExit(', '.join(heavy & {*sys.modules}) or 0)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert "--stop-time" in run.stdout


@pytest.mark.slow
def test_info_reads_scenes_and_fmus(exported, capsys):
    assert main(["info", "bicycle_model_1.toml"]) == 0
    text = capsys.readouterr().out
    assert re.search(r"^scene +bicycle_model_1$", text, re.MULTILINE)
    assert re.search(r"^phi_dot +rad/s +\S+ +0.5 ", text, re.MULTILINE)
    assert main(["info", str(exported("crank_shaft")), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["fmi"] == "2.0, ModelExchange and CoSimulation"
    starts = {row["name"]: row["start"] for row in facts["parameter"]}
    assert starts["alpha"] == 10.0


@pytest.mark.slow
def test_recorded_catalogue_is_that_of_the_models():
    recorded = json.loads(summary.FILE.read_text())
    stale = [n for n in casadi_models.CATALOG if recorded.get(n) != summary.facts_of(n)]
    assert stale == [], "run: python -m cosim.model.catalogue"
    assert [*recorded] == [*casadi_models.CATALOG]


@pytest.mark.slow
def test_endings_of_files_may_be_capitals(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["export", "crank_shaft", "-o", "A.FMU", "-q"]) == 0
    assert main(["simulate", "A.FMU", "--stop-time", "0.02", "--outputs", "T", "-o", "A.CSV"]) == 0
    assert main(["plot", "A.CSV", "-o", "A.PNG", "-q"]) == 0
    (tmp_path / "A.TOML").write_text('model = "crank_shaft"\noutputs = ["T"]\n')
    assert main(["info", "A.TOML"]) == 0
    assert "\nscene        A\n" in f"\n{capsys.readouterr().out}"
    times = "--solvers erk --tolerances 1e-3 --backends native --repeats 0 --stop-time 0.1"
    assert main(["tradeoff", "A.TOML", *times.split(), "-o", "A.JSON"]) == 0
    assert json.loads((tmp_path / "A.JSON").read_text())


def test_list_needs_no_casadi():
    code = (
        "import sys\nfrom cosim.cli.main import main\nmain(['list'])\n"
        "raise SystemExit(', '.join({'casadi', 'numpy', 'fmpy'} & {*sys.modules}) or 0)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr


@pytest.mark.parametrize("verb", VERBS)
def test_help_of_a_verb_explains_it_with_two_examples(verb, capsys):
    with pytest.raises(SystemExit) as end:
        main([verb, "--help"])
    assert end.value.code == 0
    text = " ".join(capsys.readouterr().out.split())
    assert VERBS[verb].summary in text
    assert "output:" in text
    assert len(set(VERBS[verb].examples)) == 2
    for example in VERBS[verb].examples:
        assert example in text
        words = shlex.split(example)[1:]
        assert command_line().parse_args(words).verb == verb


def test_help_lists_daily_verbs_first_and_the_cache_last(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    text = capsys.readouterr().out
    places = [text.index(f"\n  {verb} ") for verb in VERBS]
    assert places == sorted(places)
    assert [*VERBS][:2] == ["info", "simulate"]
    assert [*VERBS][-1] == "cache"


@pytest.mark.slow
def test_backend_of_a_run_is_chosen_by_name(capsys):
    line = ["simulate", "crank_shaft", "--stop-time", "0.02", "--outputs", "phi"]
    runs = []
    for backend in Backend:
        assert main([*line, "--backend", backend]) == 0
        runs.append(np.genfromtxt(capsys.readouterr().out.splitlines()[1:], delimiter=","))
    for run in runs[1:]:
        np.testing.assert_allclose(run, runs[0], rtol=1e-6, atol=1e-12)


def test_equilibrium_is_a_point_to_linearize_at(capsys):
    line = ["linearize", "bar_on_frame", "-p", "Omega_dot=0", "--outputs", "M_phi"]
    assert main([*line, "--equilibrium"]) == 0
    assert "equilibrium" in capsys.readouterr().out
    with pytest.raises(SystemExit) as end:
        main([*line, "--equilibrium", "--at", "1"])
    assert end.value.code == 2


@pytest.mark.slow
def test_exported_fmu_starts_with_the_values_of_the_command_line(tmp_path):
    path = tmp_path / "crank.fmu"
    words = ["export", "crank_shaft", "-p", "alpha=5", "-p", "omega=600rpm", "--reference", "none"]
    assert main([*words, "-o", str(path)]) == 0
    run = cosim.simulate_fmu(path, stop_time=1.0, outputs=["omega"])
    assert run.final["omega"] == pytest.approx(20 * np.pi + 5, rel=1e-9)


def test_values_of_a_system_are_not_ignored_by_export(tmp_path, capsys):
    words = ["export", "bicycle_rider.toml", "-p", "m=1", "-o", str(tmp_path / "s.ssp")]
    assert main(words) in (2, 3)
    assert not (tmp_path / "s.ssp").exists()
    assert capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("--at 1,99", "ride: time 99.0 is not within the run, 0 ... 2 s"),
        ("-p bicycle.phi=1 --start-values bicycle.phi 2", "bicycle.phi is given twice"),
    ],
)
def test_wrong_options_are_rejected_before_a_co_simulation(words, reason, capsys, monkeypatch):
    monkeypatch.setattr(
        "cosim.coupling.system.System.simulate", lambda *_, **__: pytest.fail("ran")
    )
    call = ["simulate", "examples/coupled/ride.toml", "--method", "iterated", *words.split()]
    monkeypatch.chdir(Path(__file__).parents[2])
    assert main(call) == 2
    assert reason in capsys.readouterr().err
